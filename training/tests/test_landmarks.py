"""Shapes with known landmarks."""

import json

import numpy as np
import pytest

from snake_training.data.landmarks import RECIPES, boxes, landmarks
from snake_training.make import main


@pytest.mark.parametrize("name", RECIPES)
def test_landmarks_are_points_of_a_shape_of_radius_one_and_stand_apart(name):
    points, indices = landmarks(name, np.random.default_rng(3))
    again, _ = landmarks(name, np.random.default_rng(3))
    assert (points == again).all() and points.dtype == np.float32
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(1, abs=1e-5)
    assert 7 <= len(indices) <= 16
    marks = points[indices]
    assert np.linalg.norm(marks[:, None] - marks, axis=2)[np.triu_indices(len(marks), 1)].min() > 0.02


def test_the_landmarks_of_a_box_are_its_extreme_points():
    patches, marks = boxes(np.random.default_rng(1))
    vertices = np.concatenate([patch.reshape(-1, 3) for patch in patches])
    assert (np.abs(marks[:8]) == np.abs(vertices[:24]).max(axis=0)).all()


def test_the_folder_has_keypointnets_layout(tmp_path):
    main(["landmarks", "-o", str(tmp_path), "--number", "12", "--points", "512"])
    for name in RECIPES:
        rows = json.loads((tmp_path / "annotations" / f"{name}.json").read_text())
        assert len(rows) == 2
        for row in rows:
            header, _, values = (
                (tmp_path / "pcds" / row["class_id"] / f"{row['model_id']}.pcd")
                .read_bytes()
                .partition(b"DATA binary\n")
            )
            assert b"POINTS 512" in header and len(values) == 512 * 12
            assert all(0 <= mark["pcd_info"]["point_index"] < 512 for mark in row["keypoints"])


def test_too_few_shapes_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["landmarks", "-o", str(tmp_path), "--number", "3"])
    assert "number must be" in capsys.readouterr().err
