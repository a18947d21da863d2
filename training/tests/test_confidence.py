"""The map of confidences: its fit, and the made scenes that it is fitted to."""

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from scipy.spatial import cKDTree

from snake_training.confidence import calibration_error, fit, isotonic, main, repeated, worths_of, write_map
from snake_training.data import Procedural
from snake_training.make import main as make


def test_isotonic_values_rise_and_keep_their_mean():
    rng = np.random.default_rng(0)
    values, weights = rng.normal(size=200) + np.linspace(0, 2, 200), rng.uniform(0.1, 1, 200)
    found = isotonic(values, weights)
    assert (np.diff(found) >= 0).all()
    assert (found * weights).sum() == pytest.approx((values * weights).sum())
    # The residual is orthogonal to the solution, as for any projection onto a cone.
    assert (weights * (values - found) * found).sum() == pytest.approx(0, abs=1e-9)
    assert np.array_equal(isotonic([1.0, 2.0, 3.0], [1, 1, 1]), [1, 2, 3])


def test_a_map_says_how_often_a_keypoint_is_found_again():
    rng = np.random.default_rng(1)
    scores = rng.uniform(size=40_000)
    hits = rng.uniform(size=len(scores)) < scores**2
    knots = fit(scores[::2], hits[::2], np.ones(len(scores) // 2))
    assert knots == sorted(knots) and len(knots) <= 40
    assert calibration_error(knots, scores[1::2], hits[1::2]) < 0.03
    for wrong in ([[0.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0]]):
        assert calibration_error(wrong, scores[1::2], hits[1::2]) > 0.1


def test_precise_places_and_a_long_reach_count_like_a_higher_score():
    rng = np.random.default_rng(2)
    features = rng.uniform(size=(40_000, 3)) * [1, 3, 3]
    for halving, expected in ((0.5, 0.25), (-0.5, 0.0)):
        hits = rng.uniform(size=len(features)) < 1 / (1 + np.exp(1 - features @ [2, halving, 1]))
        assert worths_of(features, hits, np.ones(len(hits))) == pytest.approx([1, expected, 0.5], abs=0.04)


def test_keypoints_are_repeated_within_the_reach():
    points = np.array([[0, 0, 0], [1.0, 0, 0]])
    assert repeated(points, np.array([[0.0, 0.1, 0]]), 0.2).tolist() == [True, False]
    assert repeated(points, np.zeros((0, 3)), 0.2).tolist() == [False, False]


def test_the_map_changes_nothing_else_in_the_file(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file({"a": np.arange(3.0)}, path, metadata={"name": "x"})
    write_map(path, [[0.1, 0.2], [0.5, 0.9]])
    with safe_open(path, "numpy") as file:
        assert file.metadata() == {"name": "x", "confidence": "[[0.1, 0.2], [0.5, 0.9]]"}
    assert np.array_equal(load_file(path)["a"], np.arange(3.0))


@pytest.mark.parametrize(
    "kind, options, distance",
    [
        pytest.param("frames", ["--pairs", "2"], 0.05, marks=pytest.mark.nightly),
        ("drives", ["--drives", "1", "--sweeps", "3"], 0.3),
    ],
)
def test_made_pairs_show_the_same_surface(kind, options, distance, tmp_path, capsys):
    for name in ("first", "again"):
        make([kind, "-o", str(tmp_path / name), *options])
    assert (tmp_path / "first/pairs.json").read_text() == (tmp_path / "again/pairs.json").read_text()
    pairs = json.loads((tmp_path / "first/pairs.json").read_text())
    assert len(pairs) == 2
    for pair in pairs:
        source, target = (np.load(tmp_path / f"first/{pair[end]}.npy") for end in ("source", "target"))
        assert np.array_equal(source, np.load(tmp_path / f"again/{pair['source']}.npy"))
        matrix, tree = np.array(pair["T"]), cKDTree(target)
        moved, as_it_is = (
            np.median(tree.query(points)[0]) for points in (source @ matrix[:3, :3].T + matrix[:3, 3], source)
        )
        assert moved < distance and moved < 0.5 * as_it_is
    for wrong in ("--pairs", "--drives"):
        with pytest.raises(SystemExit):
            make([kind, "-o", str(tmp_path / "none"), wrong, "0"])


def test_a_fit_needs_clouds(tmp_path, capsys):
    np.save(tmp_path / "one.npy", Procedural()[0])
    compact = str(Path(__file__).parents[2] / "crates/snake-core/models/compact.safetensors")
    with pytest.raises(SystemExit):
        main([compact, "--dry-run", "--objects", str(tmp_path)])
    assert "two objects" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([str(tmp_path / "none.safetensors")])
    assert "--objects or --pairs" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([str(tmp_path / "none.safetensors"), "--pairs", str(tmp_path)])
    assert "none.safetensors" in capsys.readouterr().err
