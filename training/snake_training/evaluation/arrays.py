"""Checks of the arrays and lengths that metrics take."""

import numpy as np


def points_of(name, value):
    """Points (N, 3) as float64. A ValueError names the argument."""
    points = np.asarray(value, np.float64)
    points = points.reshape(0, 3) if points.size == 0 else points
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"{name}: expected finite numbers of shape (N, 3), found {points.shape}")
    return points


def some_points(name, value):
    """Points (N, 3), at least one."""
    points = points_of(name, value)
    if len(points) == 0:
        raise ValueError(f"{name}: no points")
    return points


def transform_of(name, value):
    """A rigid transform (4, 4)."""
    transform = np.asarray(value, np.float64)
    is_rigid = transform.shape == (4, 4) and np.allclose(transform[3], (0, 0, 0, 1))
    rotation = transform[:3, :3] if is_rigid else np.zeros((3, 3))
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(rotation) < 0:
        raise ValueError(f"{name}: expected a rotation with a translation, of shape (4, 4)")
    return transform


def lengths_of(name, value):
    """Lengths (T,), 0 or more, in the unit of the points."""
    lengths = np.atleast_1d(np.asarray(value, np.float64))
    if lengths.ndim != 1 or not (lengths >= 0).all():
        raise ValueError(f"{name} is {value}: expected lengths of 0 or more")
    return lengths


def moved(points, transform):
    """Points (N, 3) under a transform (4, 4)."""
    return points @ transform[:3, :3].T + transform[:3, 3]
