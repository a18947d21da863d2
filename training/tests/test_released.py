"""The weights that are shipped or that a recipe begins with: their layers are alive, and their point encoders see where the points are."""

from pathlib import Path

import pytest
import torch

from snake_training.data import Procedural
from snake_training.export import load_network
from snake_training.train import network_health

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "path",
    [
        "crates/snake-core/models/compact.safetensors",
        "training/recipes/start/compact.safetensors",
        "training/recipes/start/rooms.safetensors",
    ],
)
def test_all_layers_are_alive(path):
    network = load_network(ROOT / path)
    shape = torch.from_numpy(Procedural(1, points=2048)[0])[None]
    health = network_health(network, 0.5 * shape / shape.norm(dim=2).max())
    assert health["dead_share"] == 0 and health["feature_deviation"] > 1e-3, health
