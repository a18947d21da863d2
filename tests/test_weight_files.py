"""Weight files that snake_training writes, read by snake_rs: what arrives, and what is refused."""

import json

import numpy as np
import pytest

import snake_rs

torch = pytest.importorskip("torch")
pytest.importorskip("snake_training")

from safetensors.torch import load_file, save
from test_parity import random_network, random_points

from snake_training.export import load_network, write_weights
from snake_training.model import NetworkConfig


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """(config, tensors, metadata, points) of a small network; `tensors` in the names of the file."""
    config = NetworkConfig((8, 8, 8), c_dim=4, hidden_dim=4, decoder_hidden_dim=4, resnet_blocks=2, unet_levels=2,
                           unet_base_channels=4, group_norm_groups=4)  # fmt: skip
    points = random_points(np.random.default_rng(0), 300)
    network = random_network(config, 0, points)
    return config, dict(network.state_dict()), config.to_metadata(), points


def test_float16_exports_load(weights, tmp_path):
    config, tensors, _, points = weights
    path = tmp_path / "half.safetensors"
    write_weights(path, config, tensors, torch.float16)
    assert all(tensor.dtype == torch.float16 for tensor in load_file(path).values())
    network, model = load_network(path), snake_rs.Model.load(path)
    with torch.no_grad():
        volume = network.encode(torch.from_numpy(points)[None])[0].numpy()
    half = model.encode(points, normalization="none").volume
    assert np.abs(half - volume).max() < 1e-4
    full = snake_rs.Model.from_bytes(save(tensors, config.to_metadata())).encode(points, normalization="none").volume
    assert 1e-5 < np.abs(half - full).max() < 0.1  # rounded, and not by much


def test_exported_metadata_arrives(weights, tmp_path):
    config, tensors, _, points = weights
    options = {"encode": {"normalization": "unit-cube"}, "detect": {"nms_radius": 0.25}}
    extra = {"licence": "CC0", "recommended_options": json.dumps(options)}
    write_weights(tmp_path / "extra.safetensors", config, tensors, extra=extra)
    model = snake_rs.Model.load(tmp_path / "extra.safetensors")
    assert model.metadata["licence"] == "CC0" and model.metadata["digest"].startswith("sha256:")
    assert model.recommended["normalization"] == "unit-cube" and model.recommended["nms_radius"] == 0.25
