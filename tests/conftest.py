"""Fixtures of the tests of the Python module: a cloud, a golden network, its field and its keypoints."""

import numpy as np
import pytest
from golden_network import EASY, GOLDEN

import snake_rs


@pytest.fixture(scope="session")
def points():
    """A bumpy sphere off the origin, (700, 3) float32 in metres."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(700, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = 2 + 0.3 * np.sin(5 * direction[:, :1]) + 0.2 * np.sign(direction[:, 1:2])
    return (direction * radius + [3, -1, 0.5]).astype(np.float32)


@pytest.fixture(scope="session")
def model():
    return snake_rs.Model.load(GOLDEN / "odd" / "weights.safetensors")


@pytest.fixture(scope="session")
def field(model, points):
    return model.encode(points)


@pytest.fixture(scope="session")
def keypoints(field):
    return field.detect(**EASY, max_keypoints=10**6, nms_radius=0.3)
