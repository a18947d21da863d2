"""The figures of the 3DMatch benchmark: inlier ratio, feature matching recall, RANSAC, registration recall.

`t_target_source` (4, 4) maps source points to the frame of the target. Lengths are in metres, as the benchmark fixes them.
"""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from .arrays import moved, points_of, some_points, transform_of

INLIER_DISTANCE, INLIER_RATIO = 0.1, 0.05  # of feature matching recall
RMSE = 0.2  # of a registered pair
OVERLAP_DISTANCE = 0.05  # without a gt.info, points nearer than this overlap
RANSAC_DISTANCE, EDGE_RATIO, CONFIDENCE = 0.05, 0.9, 0.999
SAMPLES, ROUND = 50_000, 8192  # of RANSAC, at most and between two checks of its end


def inlier_ratio(source, target, t_target_source, threshold=INLIER_DISTANCE):
    """The share of correspondences, row i of `source` (N, 3) and of `target`, that the transform brings nearer than `threshold`."""
    source, target = points_of("source", source), points_of("target", target)
    if len(source) != len(target):
        raise ValueError(f"target: {len(target)} points, the source has {len(source)}; row i matches row i")
    distance = np.linalg.norm(moved(source, transform_of("t_target_source", t_target_source)) - target, axis=1)
    return float((distance < threshold).mean()) if len(source) else 0.0


def feature_matching_recall(inlier_ratios, threshold=INLIER_RATIO):
    """The share of pairs with an inlier ratio above `threshold`. The benchmark's pairs include consecutive fragments."""
    if len(inlier_ratios) == 0:
        raise ValueError("inlier_ratios: no pairs")
    return float((np.asarray(inlier_ratios) > threshold).mean())


def overlap(source, target, t_target_source, distance=OVERLAP_DISTANCE):
    """The source points (K, 3) that the transform brings nearer than `distance` to a target point."""
    source, target = some_points("source", source), some_points("target", target)
    placed = moved(source, transform_of("t_target_source", t_target_source))
    return source[cKDTree(target).query(placed)[0] < distance]


def information_matrix(points):
    """The matrix (6, 6) of gt.info: the sum of GᵀG with G = [I, -2 [p]ₓ] over the source points (N, 3) of an overlap."""
    points = some_points("points", points)
    x, y, z = points.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    rows = np.concatenate([np.broadcast_to(np.eye(3), cross.shape), -2 * cross], axis=2)
    return np.einsum("nki,nkj->ij", rows, rows)


def squared_registration_error(t_gt, t_estimate, information):
    """The mean squared displacement of a pair's overlap by an estimate's error, to first order (Choi, Zhou and Koltun 2015): eᵀ I e / I₁₁
    with the `information` (6, 6) of gt.info and e = (t, q_xyz) of t_gt⁻¹ t_estimate; the quaternion has q_w ≥ 0.
    """
    information = np.asarray(information, np.float64)
    if information.shape != (6, 6) or not np.isfinite(information).all() or not information[0, 0] > 0:
        raise ValueError(
            "information: expected finite numbers of shape (6, 6), the first of them, a number of points, positive"
        )
    between = np.linalg.inv(transform_of("t_gt", t_gt)) @ transform_of("t_estimate", t_estimate)
    *vector, real = Rotation.from_matrix(between[:3, :3]).as_quat()
    error = np.concatenate([between[:3, 3], np.multiply(vector, -1 if real < 0 else 1)])
    return float(error @ information @ error / information[0, 0])


def registration_recall(fragments, squared_errors, threshold=RMSE):
    """The share of a scene's pairs, numbers of `fragments` (P, 2) without consecutive ones, with an RMSE of at most `threshold`; the error
    of a pair without a transform is infinite. NaN if all are consecutive.
    """
    first, second = np.asarray(fragments, int).reshape(-1, 2).T
    if len(first) != len(squared_errors):
        raise ValueError(f"squared_errors: expected one for each of {len(first)} pairs")
    counted = np.asarray(squared_errors, np.float64)[abs(first - second) > 1]
    return float((counted <= threshold**2).mean()) if len(counted) else np.nan


def mutual_nearest(source, target):
    """Rows (M, 2) of descriptors `source` (N, D) and `target` (L, D) that are each other's nearest."""
    if len(source) == 0 or len(target) == 0:
        return np.zeros((0, 2), int)
    distance = cdist(source, target, "sqeuclidean")
    forth, back = distance.argmin(axis=1), distance.argmin(axis=0)
    rows = np.flatnonzero(back[forth] == np.arange(len(source)))
    return np.column_stack([rows, forth[rows]])


def fit(source, target):
    """Least-squares transforms (..., 4, 4) of correspondences (..., N, 3) (Kabsch 1976), and whether each is determined (...,)."""
    center, aim = source.mean(axis=-2, keepdims=True), target.mean(axis=-2, keepdims=True)
    left, size, right = np.linalg.svd(np.swapaxes(source - center, -1, -2) @ (target - aim))
    sign = np.ones(size.shape)
    sign[..., 2] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    transforms = np.zeros((*size.shape[:-1], 4, 4))
    rotation = np.swapaxes(left * sign[..., None, :] @ right, -1, -2)
    transforms[..., :3, :3], transforms[..., 3, 3] = rotation, 1
    transforms[..., :3, 3] = (aim - center @ np.swapaxes(rotation, -1, -2))[..., 0, :]
    return transforms, size[..., 1] > 1e-10 * size[..., 0]  # collinear points turn about their line


def ransac(source, target, seed=0, distance=RANSAC_DISTANCE, samples=SAMPLES):
    """The transform (4, 4) from `source` (N, 3) to `target` (N, 3), row i to row i, with the most inliers; None if nothing fits.

    RANSAC (Fischler and Bolles 1981) over samples of three, as in Open3D: their edges have similar lengths, and they are inliers of
    their own transform. The best is fitted again to its inliers, while that improves it.
    """
    source, target = points_of("source", source), points_of("target", target)
    rng, best, drawn = np.random.default_rng(seed), (0, 0.0, None), 0
    while len(source) >= 3 and drawn < samples:
        rows = rng.integers(len(source), size=(min(ROUND, samples - drawn), 3))
        drawn += len(rows)
        edges = [np.linalg.norm(side[rows] - side[np.roll(rows, 1, axis=1)], axis=2) for side in (source, target)]
        shorter, longer = np.minimum(*edges), np.maximum(*edges)
        rows = rows[((shorter > 0) & (shorter >= EDGE_RATIO * longer)).all(axis=1)]
        transforms, is_determined = fit(source[rows], target[rows])
        placed = source[rows] @ np.swapaxes(transforms[:, :3, :3], 1, 2) + transforms[:, None, :3, 3]
        agree = is_determined & (np.linalg.norm(placed - target[rows], axis=2) < distance).all(axis=1)
        for transform in transforms[agree]:
            best = better(best, scored(source, target, transform, distance))
        if (1 - (best[0] / len(source)) ** 3) ** drawn <= 1 - CONFIDENCE:
            break
    for _ in range(50):  # ends before, but for changes by rounding alone
        if best[2] is None:
            return None
        inliers = np.linalg.norm(moved(source, best[2]) - target, axis=1) < distance
        refitted, is_determined = fit(source[inliers], target[inliers])
        improved = better(best, scored(source, target, refitted, distance)) if is_determined else best
        if improved is best:
            break
        best = improved
    return best[2]


def scored(source, target, transform, distance):
    """The number of inliers of a transform, their negative sum of squares, and the transform."""
    squared = np.square(moved(source, transform) - target).sum(axis=1)
    squared = squared[squared < distance**2]
    return len(squared), -squared.sum(), transform


def better(best, other):
    """The one of two scored transforms with more inliers, or with as many and a smaller residual."""
    return other if best[2] is None or other[:2] > best[:2] else best
