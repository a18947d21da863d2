"""snake_rs.baselines (`pytest tests/test_baselines.py`).

tests/data/iss_open3d.json holds Open3D's keypoints of the clouds below, for machines without Open3D;
`python tests/test_baselines.py` writes it anew.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from snake_rs import baselines

FIXTURE = Path(__file__).parent / "data" / "iss_open3d.json"
CLOUDS = 30


def uniform(numbers):
    """SplitMix64 of whole numbers, as floats in [0, 1): the same bits in any language."""
    with np.errstate(over="ignore"):
        z = (numbers + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return ((z ^ (z >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) / 2**53


def box(seed):
    """1000 noisy points (1000, 3) float32 on a box of sides 1, 1.7 and 2.9: nothing is exactly flat."""
    u = uniform(
        np.arange(1000 * seed, 1000 * (seed + 1), dtype=np.uint64)[:, None] * np.uint64(8) + np.arange(8).astype("u8")
    )
    points = u[:, :3].copy()
    points[np.arange(1000), (u[:, 3] * 3).astype(int)] = u[:, 4] < 0.5
    return (points * [1, 1.7, 2.9] + 0.04 * u[:, 5:]).astype(np.float32)


def open3d_iss(points):
    """Indices of Open3D's ISS keypoints, ascending."""
    open3d = pytest.importorskip(
        "open3d", reason="Open3D is not installed: only the stored keypoints are compared", exc_type=ImportError
    )
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.astype(np.float64)))
    found = np.asarray(open3d.geometry.keypoint.compute_iss_keypoints(cloud).points)
    return sorted(int((points == point).all(axis=1).argmax()) for point in found)


def test_the_stored_keypoints_are_those_of_open3d():
    assert [open3d_iss(box(seed)) for seed in range(CLOUDS)] == json.loads(FIXTURE.read_text())


def test_iss_has_the_stored_keypoints():
    without_ties = 0
    for seed, stored in enumerate(json.loads(FIXTURE.read_text())):
        index, score = baselines.iss(box(seed))
        is_stored = np.isin(index, stored)
        assert is_stored.sum() == len(stored)
        # Among keypoints of equal saliency Open3D's rounding keeps one.
        assert np.isclose(score[~is_stored, None], score[is_stored], rtol=1e-9, atol=0).any(axis=1).all()
        without_ties += is_stored.all()
    assert without_ties >= 20


@pytest.mark.parametrize("name", baselines.__all__)
def test_detectors_give_different_indices_by_falling_score(name):
    points, detector = box(0), getattr(baselines, name)
    index, score = detector(points, count=10)
    assert index.dtype == np.int64 and score.dtype == np.float64
    assert index.shape == score.shape == (10,) and len(set(index.tolist())) == 10 and (np.diff(score) <= 0).all()
    again, same = detector(points.astype(np.float64), count=10)
    assert np.array_equal(index, again) and np.array_equal(score, same)
    with pytest.raises(ValueError, match="^points: "):
        detector(np.full((5, 3), np.nan), count=5)


def test_options_reach_the_detectors():
    points = box(3)
    for options in ({"gamma_21": 0.5}, {"salient_radius": "5r"}, {"protocol": "paper", "count": 10, "seed": 1}):
        assert not np.array_equal(baselines.iss(points, **options)[1], baselines.iss(points)[1]), options
    with pytest.raises(ValueError, match="^option `covariance` is pcl: .*expected `about-mean` or `about-point`"):
        baselines.iss(points, covariance="pcl")


if __name__ == "__main__":
    FIXTURE.write_text(json.dumps([open3d_iss(box(seed)) for seed in range(CLOUDS)]).replace("], ", "],\n") + "\n")
