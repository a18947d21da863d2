"""The benchmark of registration: pairs that are made, and runs that continue (`pytest tests/test_bench_registration.py`)."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

BENCH = Path(__file__).parent / "bench"
sys.path.insert(0, str(BENCH))

import made_pairs
from transforms import moved

from snake_training.data.solids import CUBE, Solids


def is_rigid(t):
    return np.allclose(t[:3, :3] @ t[:3, :3].T, np.eye(3)) and np.linalg.det(t[:3, :3]) > 0.99


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of objects as the benchmark reads it: ellipsoids."""
    rng, folder = np.random.default_rng(0), tmp_path_factory.mktemp("objects")
    points = rng.normal(size=(20, 8000, 3))
    points *= [[0.9, 0.6, 0.4]] / np.linalg.norm(points, axis=2, keepdims=True)
    (folder / "val").mkdir()
    np.save(folder / "val" / "points.npy", np.round(points * 32767).astype(np.int16))
    return folder


def test_parts_of_objects_have_a_plane_a_pose_and_an_overlap(folder):
    pairs = made_pairs.objects(folder, 4)
    assert len(pairs) == 4 and len({pair.name for pair in pairs}) == 4
    for pair in pairs:
        assert is_rigid(pair.t_target_source) and pair.is_right(pair.t_target_source)
        # The 8000 points are halved. Each part has 30 to 70 % of its half.
        assert 1190 <= len(pair.source) <= 2810 and 1190 <= len(pair.target) <= 2810
        source = moved(pair.t_target_source, pair.source)
        distances = cKDTree(source).query(pair.target)[0]
        assert np.mean(distances < 2 * made_pairs.OBJECT_LIMIT) > 0.2 and distances.min() > 0
        # The whole object is 4 m across, and both parts lie on it.
        assert np.linalg.norm(np.ptp(pair.whole, axis=0)) > 4
        whole = cKDTree(moved(pair.t_target_source, pair.whole))
        assert whole.query(pair.target)[0].max() < 0.6 and whole.query(source)[0].max() < 0.6
        # A quarter turn of an ellipsoid is wrong, half a turn about an axis is a symmetry.
        turn = np.eye(4)
        turn[:2, :2] = [[0, -1], [1, 0]]
        assert not pair.is_right(pair.t_target_source @ turn)
        assert pair.is_right(pair.t_target_source @ turn @ turn)
    again = made_pairs.objects(folder, 4)
    assert all(np.array_equal(a.source, b.source) for a, b in zip(pairs, again))


def test_a_sweep_sees_the_nearest_surface_of_each_ray():
    # A wall across the x axis, 20 m away, and nothing else but the ground.
    wall, pose = Solids(), np.eye(4)
    wall.add(CUBE, [20.5, 0, 15], [0.5, 50, 15])
    pose[:3, 3] = [0, 0, 1.8]
    points = made_pairs.sweep(wall, pose, np.random.default_rng(0))
    ground, ahead = np.abs(points[:, 2] + 1.8) < 0.15, np.abs(points[:, 0] - 20) < 0.15
    assert np.all(ground | ahead) and ground.sum() > 1000 and ahead.sum() > 1000
    # The wall hides what is behind it.
    assert points[np.abs(points[:, 1]) < 40, 0].max() < 20.2 and np.linalg.norm(points, axis=1).max() < 80.2


def test_sweeps_fit_by_their_transform():
    pairs = made_pairs.sweeps(2)
    for pair in pairs:
        t = pair.t_target_source
        assert is_rigid(t) and pair.is_right(t) and pair.source.dtype == np.float32
        # The places are 10 m apart along the street and up to 3 m across.
        assert 0.99 < np.linalg.norm(t[:3, 3]) < 1.06
        near = cKDTree(pair.target).query(moved(t, pair.source))[0] < 0.03
        wrong = t.copy()
        wrong[:3, 3] += [0.07, 0, 0]
        assert near.mean() > 0.4 and not pair.is_right(wrong)
    assert not np.array_equal(pairs[0].source, pairs[1].source)


def run(*arguments):
    command = [sys.executable, str(BENCH / "registration.py"), *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result


def test_a_run_continues_and_leaves_out_what_it_has_no_data_for(tmp_path, folder):
    cache = tmp_path / "runs.jsonl"
    options = ("--methods", "snake-rs", "--made-pairs", 2, "--cache", cache, "--objects", folder)
    first = run(*options, "--parts", "validation", "objects")
    assert "validation: left out, it needs --scenes" in first.stdout and "| snake-rs |" in first.stdout
    assert "parts of objects: 100%" in first.stderr, "the progress is shown"
    lines = cache.read_text().splitlines()
    assert len(lines) == 2
    # The run was killed while it wrote the second result.
    cache.write_text(lines[0] + "\n" + lines[1][:40])
    second = run(*options, "--parts", "objects")
    assert second.stdout.strip().splitlines()[-1] == first.stdout.strip().splitlines()[-1]
    rows = [json.loads(line) for line in cache.read_text().splitlines() if line.endswith("}")]
    assert [row["pair"] for row in rows] == [json.loads(line)["pair"] for line in lines]
    # The results of another build are made anew.
    cache.write_text(json.dumps({**rows[0], "build": "other"}) + "\n")
    run(*options, "--parts", "objects")
    assert len([line for line in cache.read_text().splitlines() if line]) == 3
