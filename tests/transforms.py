"""Rigid transforms (4, 4) in tests of the Python module, and the sample that they move."""

from pathlib import Path

import numpy as np

import snake_rs

SAMPLE = snake_rs.read_points(Path(__file__).parents[1] / "samples/plane.ply")  # (4096, 3) float32


def rigid(seed=0):
    """A random rotation and a translation."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    t = np.eye(4)
    t[:3, :3], t[:3, 3] = q * np.sign(np.linalg.det(q)), rng.normal(size=3)
    return t


def moved(t, points):
    """Points (N, 3) under a transform."""
    return points @ t[:3, :3].T + t[:3, 3]
