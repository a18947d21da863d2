"""snake_rs.metrics on cases worked out by hand, against plain numpy, and on random keypoints of real objects.

The objects are those of `../shared/data`; without it the calibration is skipped.
"""

import heapq
from pathlib import Path

import numpy as np
import pytest

from snake_rs import baselines, metrics
from snake_training.data import open_shapes
from snake_training.evaluate import relative_repeatability as plain_repeatability
from snake_training.evaluate import view_pairs

OBJECTS = Path(__file__).parents[2] / "shared" / "data" / "objects" / "val"
QUARTER_TURN = np.array([[0, -1, 0, 2], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])  # about z, then 2 along x


def points(*rows):
    return np.array(rows, np.float32).reshape(-1, 3)


# Repeatability


def test_repeatability_by_hand():
    first, second = points([0, 0, 0], [1, 0, 0], [5, 0, 0], [9, 9, 9]), points([0.25, 0, 0], [1, 0.5, 0])
    epsilon = [0.25, 0.26, 0.5, 0.51, 100]
    shares = metrics.relative_repeatability(first, second, np.eye(4), epsilon)
    assert shares.tolist() == [0, 0.25, 0.25, 0.5, 1] and shares.dtype == np.float64
    assert metrics.relative_repeatability(second, first, np.eye(4), epsilon).tolist() == [0, 0.5, 0.5, 1, 1]
    assert metrics.symmetric_repeatability(first, second, np.eye(4), epsilon).tolist() == [0, 0.375, 0.375, 0.75, 1]
    view_1, view_2 = points([-1, 7, 4]), points([7, 3, 4])
    assert metrics.relative_repeatability(view_1, view_2, QUARTER_TURN, [1e-6]).tolist() == [1]
    assert metrics.relative_repeatability(points(), second, np.eye(4), [1]).tolist() == [0]
    assert metrics.mean_distance_to_keypoints(first[:3], points([0, 0, 0], [5, 0, 0])) == pytest.approx(1 / 3)


def test_repeatability_is_that_of_the_training_side():
    rng = np.random.default_rng(0)
    epsilon = [0.1, 0.3, 0.5]
    for _ in range(20):
        first, second = rng.normal(size=(64, 3)).astype("f4"), rng.normal(size=(50, 3)).astype("f4")
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rotation *= np.linalg.det(rotation)
        t_1_2 = np.eye(4)
        t_1_2[:3, :3] = rotation
        found = metrics.relative_repeatability(first, second, t_1_2, epsilon)
        assert found == pytest.approx(plain_repeatability(first, second, rotation, epsilon))


@pytest.fixture(scope="module")
def pairs():
    """The pairs of views of the evaluation: top 64 of 5000 points, in units of the object's radius."""
    if not OBJECTS.is_dir():
        pytest.skip(f"no corpus in {OBJECTS}: random keypoints are not calibrated")
    shapes = open_shapes(OBJECTS)
    return list(view_pairs(shapes, len(shapes), 5000, seed=0))


def mean_repeatability(pairs, detect):
    """Mean over pairs at epsilon 0.04 and 0.10, of detect(points, seed) -> indices."""
    values = []
    for number, (first, second, rotation) in enumerate(pairs):
        t_1_2 = np.eye(4)
        t_1_2[:3, :3] = rotation
        keypoints = [cloud[detect(cloud, 2 * number + view)] for view, cloud in enumerate((first, second))]
        values.append(metrics.relative_repeatability(*keypoints, t_1_2, [0.04, 0.1]))
    return np.mean(values, axis=0)


def test_random_keypoints_repeat_as_often_as_they_should(pairs):
    found = mean_repeatability(pairs, lambda cloud, seed: baselines.random_points(cloud, 64, seed)[0])
    assert found[0] == pytest.approx(0.13, abs=0.02) and found[1] == pytest.approx(0.5, abs=0.03), found


def test_iss_by_rank_is_far_better_than_the_random_subset_of_the_paper(pairs):
    def iss(protocol):
        return lambda cloud, seed: baselines.iss(cloud, count=64, protocol=protocol, seed=seed)[0]

    paper, ranked = mean_repeatability(pairs, iss("paper")), mean_repeatability(pairs, iss("ranked"))
    assert paper == pytest.approx([0.21, 0.57], abs=0.03), paper
    assert ranked == pytest.approx([0.51, 0.87], abs=0.03), ranked


# Semantic consistency


def rows(length):
    """Two rows of points at unit steps, far apart, (2 length, 3)."""
    return np.array([[i % length, i // length * 1e4, 0] for i in range(2 * length)], np.float32)


def plain_geodesics(cloud, source, neighbors):
    """Dijkstra's algorithm over the undirected graph of nearest neighbours, from all distances."""
    distance = np.linalg.norm(cloud[:, None].astype(np.float64) - cloud, axis=2)
    np.fill_diagonal(distance, np.inf)
    edge = np.zeros(distance.shape, bool)
    np.put_along_axis(edge, distance.argsort(axis=1)[:, :neighbors], True, axis=1)
    edge |= edge.T
    shortest = np.full(len(cloud), np.inf)
    frontier = [(0.0, source)]
    while frontier:
        length, point = heapq.heappop(frontier)
        if length < shortest[point]:
            shortest[point] = length
            for other in np.flatnonzero(edge[point]):
                heapq.heappush(frontier, (length + distance[point, other], other))
    return shortest


def test_geodesic_distances_are_those_of_the_plain_graph():
    cloud = np.random.default_rng(0).normal(size=(150, 3)).astype("f4")
    cloud[:30] += 50  # another component
    found = metrics.geodesic_distances(cloud, [0, 3, 149], 6)
    assert found.shape == (3, 150) and np.isinf(found).any()
    for row, source in zip(found, [0, 3, 149]):
        assert np.allclose(row, plain_geodesics(cloud, source, 6), atol=1e-6)
    default = metrics.geodesic_distances(cloud, [0])
    assert np.array_equal(default, metrics.geodesic_distances(cloud, [0], 20)) and not np.array_equal(
        default[0], found[0]
    )


def test_semantic_counts_by_hand():
    found = points([5.2, 0, 0], [12.4, 0, 0], [11.8, 1, 0], [10, 1e4, 0])  # snapped to 5, 12, 12, 40
    strict = metrics.semantic_counts(rows(30), [10, 5, 10], found, [0, 2])
    assert strict.tolist() == [[2, 3, 1], [2, 1, 0]] and strict.dtype == np.int64
    paper = metrics.semantic_counts(rows(30), [10, 5], found, [0, 2], unreachable="paper")
    assert paper.tolist() == [[2, 2, 0], [2, 0, 0]]
    assert metrics.iou(strict).tolist() == [1 / 5, 2 / 3]
    assert metrics.iou(strict + paper).tolist() == [3 / 9, 4 / 5]  # a class is the sum of its shapes
    assert metrics.semantic_counts(rows(30), [], points(), [0.0]).tolist() == [[0, 0, 0]]


def test_smpl_by_hand():
    body_1 = np.array([[i, 0, 0] for i in range(30)], np.float32)
    body_2 = 2 * body_1[:, [1, 0, 2]]
    first, second = body_1[[3, 8, 20]], body_2[[4, 8]]
    counts = metrics.smpl_pair_counts(body_1, body_2, first, second, [0, 1, 2])
    assert counts.tolist() == [[2, 2, 1], [2, 2, 0], [2, 1, 0]]
    paper = [metrics.smpl_pair_counts(body_1, body_2, first, second, [0], "paper", seed=seed) for seed in range(9)]
    assert all(c[0, 0] == 20 for c in paper) and len({c.tobytes() for c in paper}) > 1
    two = [[4, 0, 0], [4, 4, 4]]
    assert metrics.smpl_iou(two) == 0.5 and metrics.smpl_iou(two, "paper") == pytest.approx((1 + 4 / 12) / 2)


# Registration


def test_registration_figures_by_hand():
    source, target = points([0, 0, 0], [1, 0, 0]), points([1, 0, 0], [2, 0.25, 0])
    shift = np.eye(4)
    shift[0, 3] = 1
    assert metrics.inlier_ratio(source, target, shift) == 0.5
    assert metrics.inlier_ratio(source, target, shift, threshold=0.3) == 1
    assert metrics.inlier_ratio(points(), points(), shift) == 0
    assert metrics.feature_matching_recall([0.05, 0.06, 0.9, 0.0]) == 0.5
    assert metrics.feature_matching_recall(np.array([0.05, 0.06]), threshold=0.04) == 1
    information = metrics.information_matrix(points([0.4, 0.1, 0.9], [1, -2, 0.3]))
    assert information.shape == (6, 6) and information[0, 0] == 2
    assert metrics.squared_registration_error(np.eye(4), shift, information) == pytest.approx(1)
    fragments, errors = [[0, 1], [0, 2], [1, 5], [2, 9]], [0, 0.04, 0.041, np.inf]
    assert metrics.registration_recall(fragments, errors) == pytest.approx(1 / 3)
    assert metrics.registration_recall(np.array(fragments), np.array(errors), threshold=0.21) == pytest.approx(2 / 3)


# Arrays that cannot be used


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda: metrics.relative_repeatability(points([0, 0, np.nan]), points(), np.eye(4), [1]),
            "^keypoints_1: 1 of 1",
        ),
        (lambda: metrics.relative_repeatability(points(), points(), np.eye(3), [1]), "^t_1_2: expected a transform of"),
        (lambda: metrics.relative_repeatability(points(), points(), 2 * np.eye(4), [1]), "^t_1_2: expected a finite"),
        (lambda: metrics.symmetric_repeatability(points(), points(), np.eye(4), [-1]), "^option `epsilon` is -1"),
        (lambda: metrics.mean_distance_to_keypoints(rows(3), points()), "^keypoints: no points"),
        (lambda: metrics.geodesic_distances(rows(3), [6]), "^sources: index 6 is outside a cloud of 6 points"),
        (lambda: metrics.geodesic_distances(rows(3), [-1]), "^sources: expected indices of shape"),
        (lambda: metrics.geodesic_distances(rows(3), [0.5]), "^sources: expected indices of shape"),
        (lambda: metrics.geodesic_distances(rows(3), [0], 0), "^option `neighbors` is 0"),
        (lambda: metrics.semantic_counts(rows(3), [9], points(), [0]), "^ground_truth: index 9 is outside"),
        (lambda: metrics.semantic_counts(rows(3), [0], points(), [0], "loose"), "^option `unreachable` is loose"),
        (lambda: metrics.iou([1, 2, 3]), r"^counts: expected whole numbers, 0 or more, of shape \(T, 3\)"),
        (lambda: metrics.smpl_pair_counts(rows(3), rows(4), points(), points(), [0]), "^body_2: 8 samples"),
        (lambda: metrics.smpl_iou(np.zeros((0, 3), int)), "^pairs: no pairs"),
        (lambda: metrics.inlier_ratio(rows(3), rows(4), np.eye(4)), "^target: 8 points"),
        (lambda: metrics.feature_matching_recall([]), "^inlier_ratios: no pairs"),
        (
            lambda: metrics.squared_registration_error(np.eye(4), -np.eye(4), np.eye(6)),
            "^t_estimate: expected a finite",
        ),
        (lambda: metrics.squared_registration_error(np.eye(4), np.eye(4), np.eye(5)), "^information: expected numbers"),
        (lambda: metrics.registration_recall([[0, 1]], [0.0]), "^outcomes: no pairs besides consecutive"),
        (lambda: metrics.registration_recall([[0, 2]], []), "^squared_errors: expected one for each of 1 pairs"),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
