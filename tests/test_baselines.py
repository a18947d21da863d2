"""snake_rs.baselines against Open3D and against its own rules (`pytest tests/test_baselines.py`).

tests/data/iss_open3d.json holds Open3D's keypoints of the clouds below, for machines without Open3D and for the tests
of the crate; `python tests/test_baselines.py` writes it anew.
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


def compare(expected):
    """Checks ISS of every cloud against Open3D's indices, a list for each.

    Points of equal saliency have the same neighbours: all of them stay here, while Open3D keeps the one that rounding
    favours. Without such ties the keypoints are the same.
    """
    without_ties = 0
    for seed, indices in enumerate(expected):
        points = box(seed)
        found, score = baselines.iss(points)
        saliency = dict(zip(found.tolist(), score))
        assert set(indices) <= set(saliency), seed
        extra = set(saliency) - set(indices)
        for index in extra:
            near = [i for i in indices if np.linalg.norm(points[i] - points[index]) < 0.5]
            assert any(saliency[i] == pytest.approx(saliency[index], rel=1e-9) for i in near), (seed, index)
        without_ties += not extra
    assert without_ties >= 20
    return without_ties


def test_iss_is_that_of_open3d_as_stored():
    expected = json.loads(FIXTURE.read_text())
    assert len(expected) == CLOUDS
    compare(expected)


def test_iss_is_that_of_open3d_live():
    expected = [open3d_iss(box(seed)) for seed in range(CLOUDS)]
    assert expected == json.loads(FIXTURE.read_text())
    compare(expected)


# The rules


DETECTORS = {
    "iss": baselines.iss,
    "harris3d": baselines.harris3d,
    "sift3d": baselines.sift3d,
    "surface_variation": baselines.surface_variation,
    "farthest_points": baselines.farthest_points,
    "random_points": baselines.random_points,
}


@pytest.mark.parametrize("name", DETECTORS)
def test_detectors_give_different_indices_by_falling_score(name):
    points = box(0)
    index, score = DETECTORS[name](points, count=10)
    assert index.dtype == np.int64 and score.dtype == np.float64
    assert index.shape == score.shape == (10,) and len(set(index.tolist())) == 10
    assert 0 <= index.min() and index.max() < 1000 and (np.diff(score) <= 0).all()
    again, same = DETECTORS[name](points.astype(np.float64), count=10)
    assert np.array_equal(index, again) and np.array_equal(score, same)


def test_scores_are_what_they_say():
    points = box(1)
    index, score = baselines.farthest_points(points, 30)
    chosen = points[index].astype(np.float64)
    for i in range(1, 30):
        assert score[i] == pytest.approx(np.linalg.norm(chosen[:i] - chosen[i], axis=1).min())
    index, score = baselines.iss(points, salient_radius=0.4, covariance="about-point", count=5)
    for i, value in zip(index, score):
        offset = (points - points[i]).astype(np.float64)
        offset = offset[np.linalg.norm(offset, axis=1) < 0.4]
        assert value == pytest.approx(np.linalg.eigvalsh(offset.T @ offset)[0])
    every, response = baselines.harris3d(points, non_max=False)
    assert sorted(every) == list(range(1000)) and 0 <= response.min() and response.max() <= 1 / 27


def test_surface_variation_is_that_of_numpy():
    points = box(1)
    index, score = baselines.surface_variation(points, radius=0.5, non_max_radius=0.3)
    distance = np.linalg.norm(points[:, None].astype(np.float64) - points, axis=2)

    def variation(near):
        values = np.linalg.eigvalsh(np.cov(points[near].astype(np.float64).T))
        return values[0] / values.sum()

    expected = np.array([variation(row < 0.5) for row in distance])
    maxima = [i for i, row in enumerate(distance) if expected[i] >= expected[row < 0.3].max() - 1e-12]
    assert sorted(index) == maxima and score == pytest.approx(expected[index])
    radius = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    relative = baselines.surface_variation(points)
    assert np.array_equal(relative[0], baselines.surface_variation(points, radius=0.3 * float(radius))[0])


def test_lengths_are_units_or_multiples_of_the_resolution():
    points = box(2)
    distance = np.linalg.norm(points[:, None].astype(np.float64) - points, axis=2)
    np.fill_diagonal(distance, np.inf)
    resolution = distance.min(axis=1).mean()
    for detector, name in (
        ("iss", "salient_radius"),
        ("iss", "non_max_radius"),
        ("harris3d", "radius"),
        ("sift3d", "min_scale"),
        ("surface_variation", "radius"),
    ):
        relative = DETECTORS[detector](points, **{name: "5r"})
        absolute = DETECTORS[detector](points, **{name: 5 * resolution})
        assert np.array_equal(relative[0], absolute[0]) and len(relative[0])
    assert not np.array_equal(baselines.iss(points)[0], baselines.iss(points, salient_radius="5r")[0])
    # Everything scales and shifts with the cloud.
    moved = points * np.float32(64) + np.float32(8)
    assert np.array_equal(baselines.harris3d(moved)[0], baselines.harris3d(points)[0])


def test_every_option_does_something():
    points = box(3)
    changes = {
        "iss": dict(
            non_max_radius="6r", gamma_21=0.5, gamma_32=0.2, min_neighbors=30, covariance="about-point", count=3
        ),
        "harris3d": dict(threshold=0.01, non_max=False, count=3),
        "surface_variation": dict(radius="20%", non_max_radius="6r", count=3),
        "sift3d": dict(octaves=1, scales_per_octave=3, min_contrast=0.01, field="y", curvature_radius="4r", count=3),
    }
    for name, options in changes.items():
        usual = DETECTORS[name](points)
        for option, value in options.items():
            assert not np.array_equal(DETECTORS[name](points, **{option: value})[1], usual[1]), (name, option)


def test_the_paper_protocol_is_a_random_subset():
    points = box(4)
    found, _ = baselines.iss(points)
    drawn = [baselines.iss(points, count=10, protocol="paper", seed=seed)[0] for seed in (0, 0, 1)]
    assert np.array_equal(drawn[0], drawn[1]) and not np.array_equal(drawn[0], drawn[2])
    assert set(drawn[0]) <= set(found) and set(drawn[0]) != set(found[:10])
    filled, score = baselines.iss(points, count=200, protocol="paper")
    assert np.array_equal(filled[: len(found)], found) and len(filled) == 200 and not score[len(found) :].any()
    assert not np.array_equal(baselines.random_points(points, 10)[0], baselines.random_points(points, 10, seed=1)[0])


@pytest.mark.parametrize("name", DETECTORS)
def test_clouds_that_cannot_be_used_are_refused(name):
    for bad in (np.zeros((0, 3)), np.ones((1, 3)), np.ones((50, 3)), np.full((5, 3), np.nan), np.zeros((5, 2))):
        with pytest.raises(ValueError, match="^points: "):
            DETECTORS[name](bad, count=5)
    with pytest.raises(ValueError, match="^option `count` is 0: allowed is 1 or more"):
        DETECTORS[name](box(0), count=0)


@pytest.mark.parametrize(
    "name, option, value, message",
    [
        ("iss", "salient_radius", 0, "^option `salient_radius` is 0: allowed is a positive length"),
        ("iss", "non_max_radius", "-4r", "^option `non_max_radius` is -4r: allowed is a positive length"),
        ("iss", "salient_radius", "wide", "^option `salient_radius` is wide: .*expected a number of cloud units"),
        ("iss", "gamma_21", float("nan"), "^option `gamma_21` is nan: expected finite numbers"),
        ("iss", "covariance", "pcl", "^option `covariance` is pcl: .*expected `about-mean` or `about-point`"),
        ("iss", "protocol", "best", "^option `protocol` is best: allowed is ranked or paper"),
        ("iss", "protocol", "paper", "^option `count` is None: protocol paper needs a number"),
        ("harris3d", "radius", float("inf"), "^option `radius` is inf"),
        ("sift3d", "octaves", 0, "^option `octaves` is 0: allowed is 1 to 64"),
        ("sift3d", "field", "z", "^option `field` is z: .*expected `curvature` or `y`"),
        ("sift3d", "curvature_radius", -1.0, "^option `curvature_radius` is -1: allowed is a positive length"),
    ],
)
def test_values_that_cannot_be_used_are_refused(name, option, value, message):
    with pytest.raises(ValueError, match=message):
        DETECTORS[name](box(0), **{option: value})


if __name__ == "__main__":
    FIXTURE.write_text(json.dumps([open3d_iss(box(seed)) for seed in range(CLOUDS)]).replace("], ", "],\n") + "\n")
    print(compare(json.loads(FIXTURE.read_text())), "of", CLOUDS, "clouds without ties")
