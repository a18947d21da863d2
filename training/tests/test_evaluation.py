"""The metrics of the evaluation by figures that are worked out by hand; the data, whole runs and refusals are in test_evaluation_runs."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from snake_training.data import Procedural
from snake_training.evaluation import registration as benchmark
from snake_training.evaluation.repeatability import (
    coverage,
    radius_of_coverage,
    relative_repeatability,
    repeatability_of_seen,
    share_on_flat_places,
    suppress,
)
from snake_training.evaluation.semantic import body_pair_counts, geodesic_distances, iou, recall, semantic_counts
from snake_training.evaluation.tables import markdown, pivot, report, table_of
from snake_training.evaluation.views import Condition, draw_views, spaced, unit_radius, view_pairs

SAME = np.eye(4)
LINE = np.arange(100.0)[:, None] * (1, 0, 0)


def transform(vector, shift):
    """The transform of a rotation vector in radians and a translation."""
    t = np.eye(4)
    t[:3, :3], t[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), shift
    return t


# Repeatability (SNAKE section 4.2; USIP section 4.1)


def test_repeatability_is_the_share_of_first_view_keypoints_strictly_within_epsilon():
    first, second = [[0, 0, 0], [1, 0, 0], [5, 0, 0], [9, 9, 9]], [[0.25, 0, 0], [1, 0.5, 0]]
    epsilon = [0.25, 0.26, 0.5, 0.51, 100]
    assert relative_repeatability(first, second, SAME, epsilon).tolist() == [0, 0.25, 0.25, 0.5, 1]
    assert relative_repeatability(second, first, SAME, epsilon).tolist() == [0, 0.5, 0.5, 1, 1]  # one direction
    assert relative_repeatability(first, [[0.5, 0, 0]], SAME, [0.6]).tolist() == [0.5]  # not one to one
    for one, other in ((first, []), ([], second), ([], [])):
        assert relative_repeatability(one, other, SAME, [1, 2]).tolist() == [0, 0]
    # A quarter turn about z, then 2 along x: (x, y) in view 2 is (2 - y, x) in view 1.
    t_1_2 = transform([0, 0, np.pi / 2], [2, 0, 0])
    assert relative_repeatability([[-1, 7, 4]], [[7, 3, 4]], t_1_2, 1e-6) == [1]
    assert relative_repeatability([[7, 3, 4]], [[-1, 7, 4]], t_1_2, 1e-6) == [0]


def test_chance_is_what_random_points_of_the_other_view_would_find():
    points = LINE[:10]

    def beyond(first, second, *epsilon):
        return repeatability_of_seen(first, second, points, SAME, epsilon)[1]

    first = np.array([points[0], points[4], [90, 0, 0]])  # the last one is not seen
    # Two of ten points: each is drawn with probability 1/5, and one of two neighbours, or of three, with 17/45 and 24/45.
    chances = np.array([0.2, (17 / 45 + 24 / 45) / 2])
    assert beyond(first, points[[0, 8]], 0.5, 1.5) == pytest.approx((0.5 - chances) / (1 - chances))
    assert repeatability_of_seen(first, points[[0, 8]], points, SAME, [0.5, 1.5])[0].tolist() == [0.5, 0.5]
    assert beyond(first, points[[7, 8]], 0.5) == pytest.approx(-0.25)  # worse than chance
    assert beyond(first, first[:2], 0.5) == 1 and beyond(first, [], 0.5) == 0
    assert np.isnan(beyond(first[2:], first, 0.5, 1.5)).all() and np.isnan(beyond(first, points, 0.5))


def test_flat_places_have_no_thickness():
    grid = np.stack(np.meshgrid(np.arange(30) / 10, np.arange(30) / 10), axis=-1).reshape(-1, 2)
    floor = np.c_[grid, np.zeros(900)]
    wall = np.c_[np.zeros(900), grid]
    corner, inside, away = [0, 1.5, 0], [2, 1.5, 0], [9, 9, 9]
    points = np.concatenate([floor, wall])
    assert share_on_flat_places(points, [inside, corner, away, corner], 0.25) == 0.5
    assert np.isnan(share_on_flat_places(points, [], 0.25))


def test_coverage_is_the_mean_distance_to_the_nearest_keypoint():
    assert coverage([[0, 0, 0], [1, 0, 0], [5, 0, 0]], [[0, 0, 0], [5, 0, 0]]) == pytest.approx(1 / 3)


def test_suppression_keeps_the_better_of_two_within_the_radius():
    points = np.array([0.0, 0.5, 1.25, 1.5, 5])[:, None] * (1, 0, 0)
    kept = lambda radius, count=10: suppress(points, radius, count)[:, 0].tolist()
    assert kept(1.0) == [0, 1.25, 5] and kept(1.0, 2) == [0, 1.25] and kept(0.0, 3) == [0, 0.5, 1.25]
    assert kept(0.5) == [0, 1.25, 5]  # exactly the radius apart is not farther
    assert suppress(points[:0], 1.0, 10).shape == (0, 3)


def test_the_radius_of_a_coverage_is_the_smallest():
    clouds = [(LINE, LINE)] * 2
    covered = lambda radius: coverage(LINE, suppress(LINE, radius, 10))
    for aim in (3.0, 5.0, 10.0):
        radius = radius_of_coverage(clouds, 10, aim)
        assert covered(radius) <= aim < covered(0.98 * radius)
    assert radius_of_coverage(clouds, 10, 41.0) == 0  # the best ten cover at 40.95
    best = radius_of_coverage(clouds, 10, 0.5)  # nothing covers as far
    assert 2 < covered(best) < 3
    assert radius_of_coverage([(LINE, LINE[:0])], 10, 0.5) == 0


# Semantic consistency (SNAKE section 4.1; UKPGAN section 4.2)


def rows(length):
    """Two rows of points at unit steps, far apart, (2 length, 3)."""
    return np.array([[i % length, i // length * 1e4, 0.0] for i in range(2 * length)])


def test_geodesics_follow_the_cloud():
    angle = np.arange(12) * np.pi / 6
    ring, chord = np.c_[np.cos(angle), np.sin(angle), np.zeros(12)], 2 * np.sin(np.pi / 12)
    steps = np.minimum(np.arange(12), 12 - np.arange(12))
    assert geodesic_distances(ring, [0, 3], 2) == pytest.approx(chord * np.array([steps, np.roll(steps, 3)]))
    # The nearest point of 9 is 2.5, and the nearest of that is 1: the edge between them exists nevertheless.
    assert geodesic_distances([[x, 0, 0] for x in (0, 1, 2.5, 9)], [0], 1).tolist() == [[0, 1, 2.5, 9]]
    apart = geodesic_distances(rows(30), [4])[0]
    assert apart[29] == 25 and np.isinf(apart[30:]).all()
    assert geodesic_distances([[1, 1, 1]], [0]).tolist() == [[0]]
    repeated = geodesic_distances(np.repeat([[0.0, 0, 0], [1, 0, 0]], 9, axis=0), [0], 10)
    assert repeated.tolist() == [[0] * 9 + [1] * 9]


def test_annotations_match_along_the_surface():
    keypoints = [[5.2, 0, 0], [12.4, 0, 0], [11.8, 1, 0], [10, 1e4, 0]]  # at points 5, 12, 12 and, apart, 40
    strict = semantic_counts(rows(30), [10, 5, 10], keypoints, [0, 1.9, 2])
    assert strict.tolist() == [[2, 3, 1], [2, 3, 1], [2, 1, 0]]
    assert iou(strict) == pytest.approx([1 / 5, 1 / 5, 2 / 3]) and recall(strict).tolist() == [0.5, 0.5, 1]
    # By the released code the point apart matches every keypoint.
    assert semantic_counts(rows(30), [10, 5], keypoints, [0, 2], paper=True).tolist() == [[2, 2, 0], [2, 0, 0]]
    assert semantic_counts(rows(30), [], keypoints[:1], [9]).tolist() == [[0, 1, 0]]
    assert semantic_counts(rows(30), [1, 2], [], [9]).tolist() == [[2, 0, 2]]
    assert iou(np.zeros((1, 3), int)) == 0


def test_keypoints_are_carried_between_bodies():
    body_1, body_2 = LINE[:30], 2 * LINE[:30, [1, 0, 2]]
    # The distances of the first are 2, 0 and 24 on body 2; those of the second are 1 and 0 on body 1.
    counts = body_pair_counts(body_1, body_2, body_1[[3, 8, 20]], body_2[[4, 8]], [0, 1, 2])
    assert counts.tolist() == [[2, 2, 1], [2, 2, 0], [2, 1, 0]]
    assert body_pair_counts(body_1, body_2, body_1, body_2, [0]).tolist() == [[20, 0, 0]]  # the best 20
    filled = [
        body_pair_counts(body_1, body_2, body_1[[3]], body_2[[3]], [0], np.random.default_rng(s)) for s in range(5)
    ]
    assert all(c[0, 0] == 20 for c in filled) and len({c.tobytes() for c in filled}) > 1


# Registration (3DMatch; Choi, Zhou and Koltun 2015)


def test_figures_of_registration_by_hand():
    source, target, shift = [[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [2, 0.25, 0]], transform([0, 0, 0], [1, 0, 0])
    assert benchmark.inlier_ratio(source, target, shift, 0.25) == 0.5 and benchmark.inlier_ratio([], [], SAME) == 0
    assert benchmark.overlap(source, target, shift, 0.25).tolist() == [[0, 0, 0]]
    assert benchmark.feature_matching_recall([0.05, 0.051, 0, 1]) == 0.5
    fragments, errors = [[0, 1], [0, 2], [5, 1], [2, 9], [4, 2]], [0, 0.04, 0.041, np.inf, 0.001]
    assert benchmark.registration_recall(fragments, errors) == 0.5  # without consecutive ones
    assert np.isnan(benchmark.registration_recall(fragments[:1], errors[:1]))
    assert benchmark.mutual_nearest([[0.0], [4], [10]], [[5.5], [10], [5], [0]]).tolist() == [[0, 3], [1, 2], [2, 1]]


def test_the_error_is_the_mean_squared_displacement_of_the_overlap():
    points = np.random.default_rng(0).normal(size=(50, 3)) + (1, -2, 0)
    truth, information = transform([0.3, -0.2, 0.9], [1, 2, 3]), benchmark.information_matrix(points)
    error = transform([0.004, -0.002, 0.003], [0.01, 0, -0.02])
    placed = [points @ t[:3, :3].T + t[:3, 3] for t in (truth, truth @ error)]
    expected = np.square(placed[0] - placed[1]).sum(axis=1).mean()
    found = benchmark.squared_registration_error(truth, truth @ error, information)
    assert information[0, 0] == 50 and found == pytest.approx(expected, rel=0.01)
    # A quarter turn: e = (0, 0, 0, 0, 0, sin 45°); I₆₆ = 10, I₁₁ = 5: 0.5 · 10 / 5.
    turn = transform([0, 0, np.pi / 2], [0, 0, 0])
    assert benchmark.squared_registration_error(SAME, turn, np.diag([5, 0, 0, 0, 0, 10])) == pytest.approx(1)


@pytest.mark.parametrize("outliers", [0, 150, 240, 270])
def test_ransac_finds_the_truth_among_outliers(outliers):
    rng = np.random.default_rng(outliers)
    source, truth = rng.uniform(-1, 1, (300, 3)), transform(rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3))
    target = source @ truth[:3, :3].T + truth[:3, 3] + rng.uniform(-0.005, 0.005, (300, 3))
    target[:outliers] = rng.uniform(-1, 1, (outliers, 3)) + truth[:3, 3]
    found = benchmark.ransac(source, target, distance=0.02)
    assert np.abs(found - truth).max() < 0.01
    assert np.array_equal(found, benchmark.ransac(source, target, distance=0.02))


def test_degenerate_correspondences_have_no_transform():
    for points in (LINE[:2], np.ones((50, 3)), LINE[:20]):
        assert benchmark.ransac(points, points) is None
    plane = np.array([[i % 5, i // 5, 0.0] for i in range(25)])
    assert benchmark.ransac(plane, plane) == pytest.approx(SAME, abs=1e-9)  # a rotation, no reflection


# Views


def test_views_of_an_object_are_its_points_and_come_back_by_the_transform():
    cloud = unit_radius(Procedural(points=300)[3])
    assert np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).max() == pytest.approx(1, abs=1e-5)
    views = draw_views(cloud, num_points=200, row=3)
    back = views.view_2 @ views.t_1_2[:3, :3].T
    for view in (views.view_1, back):
        assert len(view) == 200 and np.linalg.norm(view[:, None] - cloud, axis=2).min(axis=1).max() < 1e-5
    assert not np.allclose(back, views.view_2, atol=0.05)
    few, noisy = (draw_views(cloud, Condition(*given), 200, row=3) for given in ((16,), (1, 0.1)))
    assert len(few.view_1) == 12 and np.array_equal(few.t_1_2, views.t_1_2)  # the same rotation under every condition
    assert np.std(noisy.view_1 - views.view_1) == pytest.approx(0.1, abs=0.01)
    other = draw_views(cloud, num_points=200, row=4)
    assert not np.array_equal(other.t_1_2, views.t_1_2) and other.seeds != views.seeds


def test_views_of_a_pair_keep_its_transform_and_a_share_of_its_points():
    t_1_2 = transform([0, 0, 1], [2, 0, 0])
    views = draw_views((LINE[:50], LINE[:80], t_1_2), Condition(4), 60)
    assert (len(views.view_1), len(views.view_2)) == (12, 15) and np.array_equal(views.t_1_2, t_1_2)
    one = draw_views((LINE[:50], LINE[:80], t_1_2), Condition(4, is_of_both=False), 60)
    assert (len(one.view_1), len(one.view_2)) == (50, 15)
    named = {(): "clean", (8,): "1 in 8", (1, 0.06): "σ 0.06", (8, 0, False): "1 in 8 of one"}
    assert [str(Condition(*given)) for given in named] == [*named.values()]


def test_few_pairs_are_evenly_spaced_and_seeded_by_their_row():
    assert spaced(9, 3) == [0, 4, 8] and spaced(5) == [0, 1, 2, 3, 4] == spaced(5, 9) and spaced(9, 1) == [0]
    shapes = Procedural(length=9, points=50)
    few, every = list(view_pairs(shapes, 3, 20, 0)), list(view_pairs(shapes, 9, 20, 0))
    assert all(np.array_equal(a.view_2, every[row].view_2) for a, row in zip(few, (0, 4, 8)))


# Tables


def test_a_pivot_has_the_means_over_the_units():
    table = table_of(
        [
            ("repeatability", "iss", "ε 0.04", "a", 0.25), ("repeatability", "iss", "ε 0.04, 1 in 8", "a", 0.1),
            ("repeatability", "iss", "ε 0.1", "a", 0.5), ("repeatability", "iss", "ε 0.04", "b", 0.75),
            ("repeatability", "snake", "ε 0.04", "a", float("nan")), ("coverage", "iss", "clean", "a", 0.14),
        ]
    )  # fmt: skip
    columns = {"at 0.04": ("repeatability", "ε 0.04"), "coverage": ("coverage", "clean")}
    assert (
        markdown(pivot(table, columns)) == "| method | at 0.04 | coverage |\n|---|---|---|\n| iss | 0.500 | 0.140 |\n"
    )
    assert report(table).splitlines()[2] == "| method | ε 0.04 | ε 0.1 | ε 0.04, 1 in 8 |"
