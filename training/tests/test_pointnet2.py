"""PointNet++ as point encoder. tests/test_parity.py and the tests of snake-core compare its features with those of snake-rs."""

from dataclasses import replace

import pytest
import torch

from snake_training.export import load_network, write_weights
from snake_training.model import NetworkConfig, SnakeNetwork
from snake_training.pointnet2 import PointNet2, farthest_points
from snake_training.train import network_health, starting_network, train


@pytest.fixture
def points():
    """Two spheres of different density, (2, 700, 3)."""
    torch.manual_seed(2)
    return torch.nn.functional.normalize(torch.randn(2, 700, 3), dim=2) * torch.tensor([0.5, 0.2])[:, None, None]


def test_each_centre_is_the_farthest_from_those_before():
    line = torch.tensor([0.0, 1, 4, 6, 10])
    flat = torch.stack([line, torch.zeros(5), torch.zeros(5)], dim=1)
    # The mean is 4.2; 10 is the farthest from it, then 0, then 4 (4 from 0, 6 from 10), then 6 (2 from 4), 1.
    chosen, distinct = farthest_points(torch.stack([flat, flat[[0, 0, 1, 1, 0]]]), 5)
    assert chosen[0].tolist() == [4, 0, 2, 3, 1] and distinct.tolist() == [5, 2]


@torch.no_grad()
def test_features_do_not_depend_on_order_batch_or_repeats(points):
    network = PointNet2(16)
    features = network(points)
    assert features.std(dim=1).mean() > 0.01
    order = torch.randperm(700)
    assert torch.allclose(network(points[:, order]), features[:, order], atol=1e-5)
    assert torch.allclose(network(points[1:]), features[1:], atol=1e-5)
    few = points[:, :100]  # fewer than there are centres
    assert torch.allclose(network(few.repeat(1, 3, 1)), network(few).repeat(1, 3, 1), atol=1e-5)
    assert network(points[:, :1]).isfinite().all()


def test_its_weights_start_from_a_network_with_the_other_encoder(tiny, tmp_path):
    source = SnakeNetwork(replace(tiny().network, point_encoder="pointnet"))
    write_weights(tmp_path / "source.safetensors", source.config, source.state_dict())
    config = tiny(init=str(tmp_path / "source.safetensors"), point_encoder="pointnet2")
    network, old = starting_network(config), source.state_dict()
    assert network.config == replace(source.config, point_encoder="pointnet2")
    shared = {name for name in network.state_dict() if "pointnet2" not in name and "fc_c" not in name}
    assert all(torch.equal(network.state_dict()[name], old[name]) for name in shared if name in old)
    assert {name for name in shared if name.startswith("encoder.")} == {
        n for n in old if n.startswith("encoder.unet3d.")
    }


def test_a_run_trains_and_exports_it(tiny, tmp_path):
    config = tiny(point_encoder="pointnet2", steps=20, learning_rate=1e-2)
    torch.manual_seed(config.seed)
    before = SnakeNetwork(config.network)
    train(config)
    network = load_network(config.run_dir)
    assert network_health(network, torch.rand(2, 64, 3) - 0.5)["feature_deviation"] > 0.005
    assert not torch.equal(network.encoder.pointnet2.fine[0].weight, before.encoder.pointnet2.fine[0].weight)
    write_weights(tmp_path / "x.safetensors", network.config, network.state_dict())
    loaded = load_network(tmp_path / "x.safetensors")
    assert isinstance(loaded.config, NetworkConfig) and loaded.config.point_encoder == "pointnet2"
