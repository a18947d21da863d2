"""Metrics of keypoints: repeatability, semantic consistency and registration, by the rules of the compared papers.

t_1_2 = np.eye(4)                                             # maps view 2 to view 1
share = snake_rs.metrics.relative_repeatability(keypoints_1, keypoints_2, t_1_2, epsilon=[0.04, 0.1])
"""

from ._core import (
    feature_matching_recall,
    geodesic_distances,
    information_matrix,
    inlier_ratio,
    iou,
    mean_distance_to_keypoints,
    registration_recall,
    relative_repeatability,
    semantic_counts,
    smpl_iou,
    smpl_pair_counts,
    squared_registration_error,
    symmetric_repeatability,
)

__all__ = [
    "feature_matching_recall",
    "geodesic_distances",
    "information_matrix",
    "inlier_ratio",
    "iou",
    "mean_distance_to_keypoints",
    "registration_recall",
    "relative_repeatability",
    "semantic_counts",
    "smpl_iou",
    "smpl_pair_counts",
    "squared_registration_error",
    "symmetric_repeatability",
]
