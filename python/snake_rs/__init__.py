"""Repeatable 3-D keypoints from point clouds: SNAKE, the shape-aware neural 3D keypoint field, on the CPU.

import numpy as np, snake_rs

points = np.load("cloud.npy")              # (N, 3), float32 or float64
keypoints = snake_rs.detect(points)        # one call, built-in model
keypoints.points, keypoints.saliency       # (K, 3), (K,)

model = snake_rs.Model.load("weights.safetensors")
field = model.encode(points)               # encode once, query many times
saliency, gradient = field.saliency_and_gradient(points)
keypoints = field.detect(nms_radius=0.05, max_keypoints=128)

Classical detectors are in snake_rs.baselines, figures of merit in snake_rs.metrics.
"""

from . import baselines, metrics
from ._core import Field, Keypoints, Model, __version__, detect

__all__ = ["Field", "Keypoints", "Model", "__version__", "baselines", "detect", "metrics"]
