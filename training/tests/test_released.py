"""The weights that are shipped: their layers are alive, their point encoder sees where the points are, and a recipe names them."""

from pathlib import Path

import torch

from snake_training.data import Procedural
from snake_training.export import load_network
from snake_training.model import voxel_index
from snake_training.train import dead_share

ROOT = Path(__file__).resolve().parents[2]


def test_all_layers_of_compact_are_alive():
    network = load_network(ROOT / "crates/snake-core/models/compact.safetensors")
    shape = torch.from_numpy(Procedural(1, points=2048)[0])[None]
    points = 0.5 * shape / shape.norm(dim=2).max()
    features = network.encoder.point_features(points, voxel_index(points, network.config)).flatten(0, 1)
    spread = features.var(dim=0).mean().sqrt() / features.square().mean().sqrt()
    assert dead_share(network) == 0 and spread > 1e-3
