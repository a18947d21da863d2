"""Relative repeatability of keypoints, and what tells it from chance: the places that were seen, coverage, flat places.

Keypoints are (K, 3) in the frame of their view. `t_1_2` (4, 4) maps view 2 to the frame of view 1.
"""

import numpy as np
from scipy.spatial import cKDTree

from .arrays import lengths_of, moved, points_of, some_points, transform_of

MAX_FLAT_VARIATION = 0.01  # the least eigenvalue of a flat neighbourhood, as a share of the sum of the three
STEP, STEPS = 1.2, 50  # of the search of a radius: from a hundredth of the coverage to a hundred times it
HALVINGS = 7  # of the last step: the radius is right to a part in 1000


def relative_repeatability(keypoints_1, keypoints_2, t_1_2, epsilon):
    """Shares (T,) of the keypoints of view 1 that are nearer than each `epsilon` (T,) to a keypoint of view 2 (USIP; SNAKE section 4.2).

    The measure has one direction, is not one-to-one and does not test for overlap. A view without keypoints gives 0.
    """
    first, second = points_of("keypoints_1", keypoints_1), points_of("keypoints_2", keypoints_2)
    limits, second = lengths_of("epsilon", epsilon), moved(second, transform_of("t_1_2", t_1_2))
    if len(first) == 0 or len(second) == 0:
        return np.zeros(len(limits))
    return (cKDTree(second).query(first)[0][:, None] < limits).mean(axis=0)


def repeatability_of_seen(keypoints_1, keypoints_2, points_2, t_1_2, epsilon):
    """Relative repeatability of the keypoints of view 1 that have a point of view 2 nearer than `epsilon`: the share, and that beyond
    chance (2, T).

    The latter is (share - chance) / (1 - chance); chance is the expected share if view 2 had as many random ones of its `points_2`
    (N, 3) as it has keypoints. 1 is perfect, 0 is chance; NaN where view 2 sees no keypoint, or chance finds every one.
    """
    first, second = points_of("keypoints_1", keypoints_1), points_of("keypoints_2", keypoints_2)
    limits, transform = lengths_of("epsilon", epsilon), transform_of("t_1_2", t_1_2)
    points = moved(points_of("points_2", points_2), transform)
    if len(points) == 0 or len(first) == 0:
        return np.full((2, len(limits)), np.nan)
    distance = cKDTree(moved(second, transform)).query(first)[0] if len(second) else np.full(len(first), np.inf)
    tree, drawn = cKDTree(points), np.arange(min(len(second), len(points)))
    values = []
    for limit in limits:
        near = tree.query_ball_point(first, np.nextafter(limit, 0), return_length=True)
        seen = near > 0
        # None of the drawn points is near if all are drawn from those that are farther away.
        missed = np.maximum(len(points) - near[seen, None] - drawn, 0) / (len(points) - drawn)
        chance = 1 - missed.prod(axis=1).mean() if seen.any() else 1.0
        share = (distance[seen] < limit).mean() if seen.any() else np.nan
        values.append((share, (share - chance) / (1 - chance) if chance < 1 else np.nan))
    return np.transpose(values)


def coverage(points, keypoints):
    """The mean distance from the points (N, 3) of a cloud to the nearest keypoint: clustered keypoints cover less."""
    return float(cKDTree(some_points("keypoints", keypoints)).query(some_points("points", points))[0].mean())


def share_on_flat_places(points, keypoints, radius):
    """The share of keypoints whose neighbours within `radius` among the points (N, 3) lie in a plane: the least of the three
    eigenvalues of their covariance is at most 1 % of the sum. NaN without keypoints.
    """
    points, keypoints = some_points("points", points), points_of("keypoints", keypoints)
    (radius,) = lengths_of("radius", radius)
    if len(keypoints) == 0:
        return np.nan

    def is_flat(neighbors):
        if len(neighbors) <= 3:  # a plane passes through any three points
            return True
        values = np.linalg.eigvalsh(np.cov(points[neighbors].T, bias=True))
        return values[0] <= MAX_FLAT_VARIATION * values.sum()

    return float(
        np.mean([is_flat(some) for some in cKDTree(points).query_ball_point(keypoints, np.nextafter(radius, 0))])
    )


def suppress(keypoints, radius, count):
    """The best `count` of ranked keypoints (K, 3), best first, each farther than `radius` from all better ones that are kept."""
    import snake_rs

    if radius <= 0 or len(keypoints) == 0:
        return keypoints[:count]
    near = keypoints - keypoints.mean(axis=0)  # float32 keeps their digits
    return keypoints[snake_rs.steps.suppress(near, -np.arange(len(keypoints)), radius, count)]


def radius_of_coverage(clouds, count, aim):
    """The radius of suppression at which a detector covers clouds as asked; one radius serves all of them.

    clouds: (points (N, 3), keypoints (K, 3) best first and not suppressed) of each; those without keypoints do not count. The
    radius is the smallest at which the mean coverage by the best `count` keypoints is at most `aim`; 0 if no suppression is
    needed, and the one with the best coverage if none is enough.
    """
    if not 0 < aim < np.inf:
        raise ValueError(f"coverage is {aim}: expected a length above 0")
    clouds = [(points, keypoints) for points, keypoints in clouds if len(keypoints)]

    def reached(radius):
        return np.mean([coverage(points, suppress(keypoints, radius, count)) for points, keypoints in clouds])

    if not clouds or reached(0.0) <= aim:
        return 0.0
    best, least = 0.0, np.inf
    for radius in 0.01 * aim * STEP ** np.arange(STEPS):
        covered = reached(radius)
        if covered < least:
            best, least = radius, covered
        # With a growing radius the keypoints spread, until so few are left that they cover less again.
        if covered <= aim or covered > 1.5 * least:
            break
    if least > aim:
        return float(best)
    low, high = best / STEP, best
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if reached(middle) <= aim else (middle, high)
    return float(high)
