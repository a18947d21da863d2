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


def test_the_file_of_the_fixture_is_good(weights):
    _, tensors, metadata, points = weights
    assert snake_rs.Model.from_bytes(save(tensors, metadata)).encode(points, normalization="none").volume.any()


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


NAME = "encoder.blocks.1.fc_0.weight"


@pytest.mark.parametrize(
    "tensor_changes, metadata_changes, message",
    [
        ({NAME: None}, {}, rf"weights: `{NAME}`: expected float32 or float16 of shape \[4, 8\], found nothing"),
        ({"encoder.extra": torch.ones(2)}, {}, "weights: `encoder.extra`: expected no such tensor .* found 1 unknown"),
        ({NAME: torch.ones(4, 9)}, {}, rf"`{NAME}`: expected .* of shape \[4, 8\], found shape \[4, 9\]"),
        ({NAME: torch.ones(32)}, {}, rf"`{NAME}`: expected .* of shape \[4, 8\], found shape \[32\]"),
        ({NAME: torch.full((4, 8), torch.nan)}, {}, f"`{NAME}`: expected finite values, found NaN at index 0"),
        ({NAME: torch.full((4, 8), -torch.inf)}, {}, f"`{NAME}`: expected finite values, found -inf at index 0"),
        ({NAME: torch.ones(4, 8, dtype=torch.int32)}, {}, rf"`{NAME}`: expected float32 or float16 .*, found I32"),
        ({NAME: torch.ones(4, 8, dtype=torch.float64)}, {}, rf"`{NAME}`: expected float32 or float16 .*, found F64"),
        (
            {},
            {"format_version": "2"},
            "`format_version`: expected 1, or 2 with `coordinates` voxel, found 2; use a newer snake-rs",
        ),
        ({}, {"format_version": "new"}, '`format_version`: expected a number, found "new"'),
        ({}, {"format": None}, '`format`: expected snake-field, found ""'),
        ({}, {"c_dim": None}, "`c_dim`: expected a metadata value, found none"),
        ({}, {"c_dim": "8"}, "weights: `encoder.*`: expected .*, found shape"),
        ({}, {"resolution": "[8, 8]"}, r"`resolution`: expected \[x, y, z\], found \[8, 8\]"),
        ({}, {"resolution": "[8, 8, 1]"}, "`resolution`: expected 2 to 512 voxels along each axis"),
        ({}, {"z_min": "0.5"}, "`padding`: expected 0 to 10, and z_min below z_max, found padding 0.125, z from 0.5"),
        ({}, {"recommended_options": '{"nms": 1}'}, "`recommended_options`: expected options of snake-rs as JSON"),
        ({}, {"recommended_options": '{"detect": {"nms_radius": -1}}'}, "option `nms_radius` is -1"),
    ],
)
def test_wrong_weight_files_are_refused(weights, tensor_changes, metadata_changes, message):
    _, tensors, metadata, _ = weights
    tensors = {name: tensor for name, tensor in (tensors | tensor_changes).items() if tensor is not None}
    metadata = {key: value for key, value in (metadata | metadata_changes).items() if value is not None}
    with pytest.raises(ValueError, match=message):
        snake_rs.Model.from_bytes(save(tensors, metadata))


def test_broken_files_are_refused(weights, tmp_path):
    _, tensors, metadata, _ = weights
    good = save(tensors, metadata)
    header = 8 + int.from_bytes(good[:8], "little")
    huge = (1 << 60).to_bytes(8, "little") + good[8:]
    cut = [good[:length] for length in (0, 4, 8, header // 2, header, len(good) - 1)]
    for broken in (*cut, good + b"\0", huge, bytes(99)):
        (tmp_path / "broken.safetensors").write_bytes(broken)
        with pytest.raises(ValueError, match="weights: `file`: expected a safetensors file, found "):
            snake_rs.Model.load(tmp_path / "broken.safetensors")
