"""The weights that are shipped: their point encoders see where the points are."""

from pathlib import Path

import pytest
import torch

from snake_training.data import Procedural
from snake_training.export import load_network
from snake_training.train import encoder_health

MODELS = Path(__file__).resolve().parents[2] / "crates" / "snake-core" / "models"


@pytest.mark.parametrize("name", ["compact"])
def test_the_point_encoder_is_alive(name):
    network = load_network(MODELS / f"{name}.safetensors")
    shape = torch.from_numpy(Procedural(1, points=2048)[0])[None]
    health = encoder_health(network.encoder, 0.5 * shape / shape.norm(dim=2).max())
    assert health["dead_share"] == 0 and health["feature_deviation"] > 1e-3, health
