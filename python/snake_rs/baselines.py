"""Classical detectors for comparison. They return indices of input points and scores, best first.

index, score = snake_rs.baselines.iss(points, count=64)      # points (N, 3) -> (K,) int64, (K,) float64
keypoints = points[index]
"""

from ._core import farthest_points, harris3d, iss, random_points, sift3d, surface_variation

__all__ = ["farthest_points", "harris3d", "iss", "random_points", "sift3d", "surface_variation"]
