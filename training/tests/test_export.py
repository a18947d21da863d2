"""Checkpoint to weight file and back, official checkpoints, and what is refused."""

import argparse
import datetime
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from snake_training.config import to_json
from snake_training.export import config_from_yaml, load_network, main, read_checkpoint, replacing, write_weights
from snake_training.model import NetworkConfig, SnakeNetwork


@pytest.fixture
def checkpoint(tmp_path, tiny, network):
    """A checkpoint of ours whose averaged weights are `network`'s and whose raw weights are others."""
    path = tmp_path / "last.pt"
    raw = SnakeNetwork(network.config).state_dict()
    own = {"settings": to_json(tiny()), "network_config": network.config.to_metadata(), "step": 1, "best": 0.0}
    torch.save(own | {"network": raw, "ema": network.state_dict()}, path)
    return path


def fields(network):
    """Both fields on a fixed cloud and queries."""
    generator = torch.Generator().manual_seed(0)
    points, queries = (torch.rand(1, 50, 3, generator=generator) - 0.5 for _ in range(2))
    with torch.no_grad():
        return torch.stack(network(points, queries))


def test_checkpoint_to_weight_file_and_back(tmp_path, checkpoint, network, capsys):
    main([str(checkpoint), "-o", str(tmp_path / "out.safetensors"), "--metadata", "licence=CC0", "data=a=b"])
    loaded = load_network(tmp_path / "out.safetensors")
    assert loaded.config == network.config and not loaded.training
    assert torch.equal(fields(loaded), fields(network))
    with safe_open(tmp_path / "out.safetensors", "pt") as file:
        metadata = file.metadata()
    assert metadata["format"] == "snake-field" and metadata["format_version"] == "1"
    assert metadata["licence"] == "CC0" and metadata["data"] == "a=b"
    assert json.loads(metadata["resolution"]) == [8, 8, 8] and metadata["padding"] == "0.125"
    assert set(NetworkConfig.__dataclass_fields__) <= set(metadata)
    report = json.loads(capsys.readouterr().out)
    assert report["parameters"] == sum(p.numel() for p in network.parameters()) and report["c_dim"] == 8
    assert sorted(os.listdir(tmp_path)) == ["last.pt", "out.safetensors"]


def test_a_run_folder_gives_its_best_checkpoint_then_its_last(tmp_path, checkpoint, network):
    assert torch.equal(fields(load_network(tmp_path)), fields(network))
    state = torch.load(checkpoint, weights_only=True)
    torch.save(state | {"ema": state["network"]}, tmp_path / "best.pt")
    assert not torch.equal(fields(load_network(tmp_path)), fields(network))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
def test_the_digest_is_that_of_the_stored_tensors(tmp_path, network, dtype):
    path = tmp_path / "out.safetensors"
    write_weights(path, network.config, network.state_dict(), dtype)
    digest = hashlib.sha256()
    for name, tensor in sorted(load_file(path).items()):
        digest.update(name.encode() + tensor.numpy().tobytes())
    with safe_open(path, "pt") as file:
        assert file.metadata()["digest"] == f"sha256:{digest.hexdigest()}"
    state = network.state_dict()
    state["encoder.fc_pos.bias"] = state["encoder.fc_pos.bias"] + 1
    write_weights(tmp_path / "other.safetensors", network.config, state, dtype)
    with safe_open(tmp_path / "other.safetensors", "pt") as file:
        assert file.metadata()["digest"] != f"sha256:{digest.hexdigest()}"


def test_added_metadata_cannot_contradict_the_configuration(tmp_path, network):
    path = tmp_path / "out.safetensors"
    write_weights(path, network.config, network.state_dict(), extra={"c_dim": "99", "digest": "none", "note": "kept"})
    with safe_open(path, "pt") as file:
        metadata = file.metadata()
    assert metadata["c_dim"] == "8" and metadata["digest"].startswith("sha256:") and metadata["note"] == "kept"


# Official checkpoints

OFFICIAL = dict(decoder_hidden_dim=16, c_dim=8, unet_levels=2, unet_base_channels=8, resolution=(8, 8, 8))
YAML = """
model:
  c_dim: 8
  encoder_kwargs: {unet3d: true, grid_resolution: 8, hidden_dim: 32, unet3d_kwargs: {num_levels: 2, f_maps: 8}}
  decoder_kwargs: {hidden_size: 16}
data: {padding: 0.1}
"""


@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: {"state_dict": t, "epoch": 3}, lambda t: {"model": t}])
@pytest.mark.parametrize("prefix", ["", "module."])
def test_official_checkpoint_with_its_yaml(tmp_path, wrap, prefix):
    torch.manual_seed(1)
    network = SnakeNetwork(NetworkConfig(**OFFICIAL, padding=0.1)).eval()
    torch.save(wrap({prefix + name: t for name, t in network.state_dict().items()}), tmp_path / "model_best.pth")
    (tmp_path / "config.yaml").write_text(YAML)
    assert config_from_yaml(tmp_path / "config.yaml") == network.config
    output = tmp_path / "out.safetensors"
    main([str(tmp_path / "model_best.pth"), "-o", str(output), "--yaml", str(tmp_path / "config.yaml")])
    assert torch.equal(fields(load_network(output)), fields(network))


def test_official_checkpoint_with_flags_which_override_the_yaml(tmp_path, network):
    torch.save(network.state_dict(), tmp_path / "model_best.pth")
    (tmp_path / "config.yaml").write_text("c_dim: 8\ngrid_resolution: 64\nnum_levels: 5\n")
    flags = ["--resolution", "8", "--unet-levels", "2", "--unet-base-channels", "8", "--padding", "0.125"]
    output = tmp_path / "out.safetensors"
    main([str(tmp_path / "model_best.pth"), "-o", str(output), "--yaml", str(tmp_path / "config.yaml"), *flags])
    assert load_network(output).config == replace(network.config, scatter="hard")  # as the authors' networks are


def test_scores_settings_and_paths_beside_the_tensors_are_left_out(tmp_path, network):
    beside = {"best": np.float64(0.5), "args": argparse.Namespace(lr=np.zeros(2)), "run": Path("runs/1")}
    torch.save({"state_dict": network.state_dict()} | beside, tmp_path / "model_best.pth")
    found = read_checkpoint(tmp_path / "model_best.pth", network.config)[1]
    assert all(torch.equal(found[name], tensor) for name, tensor in network.state_dict().items())


def test_the_papers_network_is_the_default(tmp_path):
    torch.save(SnakeNetwork(NetworkConfig()).state_dict(), tmp_path / "model_best.pth")
    assert read_checkpoint(tmp_path / "model_best.pth")[0] == NetworkConfig()
    main([str(tmp_path / "model_best.pth"), "-o", str(tmp_path / "out.safetensors")])
    assert load_network(tmp_path / "out.safetensors").config == NetworkConfig()


def test_a_weight_file_keeps_its_configuration(tmp_path, network):
    write_weights(tmp_path / "one.safetensors", network.config, network.state_dict())
    main([str(tmp_path / "one.safetensors"), "-o", str(tmp_path / "other.safetensors")])
    assert load_network(tmp_path / "other.safetensors").config == network.config != NetworkConfig()


# Refusals


def refused(capsys, *words):
    """The one line that the command line ends with."""
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    assert stop.value.code == 2
    return capsys.readouterr().err


class Malicious:
    """Unpickling it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


def test_a_malicious_pickle_is_refused_and_not_run(tmp_path, capsys):
    torch.save({"state_dict": Malicious(tmp_path / "harm")}, tmp_path / "bad.pth")
    message = refused(capsys, tmp_path / "bad.pth", "-o", tmp_path / "out.safetensors")
    assert "not a checkpoint of plain tensors" in message
    assert os.listdir(tmp_path) == ["bad.pth"]
    torch.load(tmp_path / "bad.pth", weights_only=False)
    assert (tmp_path / "harm").exists()  # it would have


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_non_finite_weights_are_refused_and_leave_no_file(tmp_path, network, value):
    state = network.state_dict()
    state["decoder_occup.fc_out.bias"] = torch.tensor([value])
    (tmp_path / "out.safetensors").write_text("an older export")
    with pytest.raises(ValueError, match="decoder_occup.fc_out.bias: has values that are not finite"):
        write_weights(tmp_path / "out.safetensors", network.config, state)
    assert os.listdir(tmp_path) == ["out.safetensors"]
    assert (tmp_path / "out.safetensors").read_text() == "an older export"


def test_values_beyond_float16_are_refused(tmp_path, network):
    state = network.state_dict()
    state["decoder_occup.fc_out.bias"] = torch.tensor([1e5])
    write_weights(tmp_path / "out.safetensors", network.config, state)
    with pytest.raises(ValueError, match="not finite as torch.float16"):
        write_weights(tmp_path / "out.safetensors", network.config, state, torch.float16)


def test_a_failed_write_leaves_no_half_written_file(tmp_path, network, monkeypatch):
    def full_disk(tensors, path, metadata):
        path.write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr("snake_training.export.save_file", full_disk)
    with pytest.raises(OSError, match="no space"):
        write_weights(tmp_path / "out.safetensors", network.config, network.state_dict())
    assert os.listdir(tmp_path) == []


def test_other_bad_sources(tmp_path, checkpoint, network, capsys):
    output = tmp_path / "out.safetensors"
    assert "absent.pt" in refused(capsys, tmp_path / "absent.pt", "-o", output)
    assert "KEY=VALUE" in refused(capsys, checkpoint, "-o", output, "--metadata", "licence")
    (tmp_path / "text.pth").write_text("hello")
    assert "not a checkpoint" in refused(capsys, tmp_path / "text.pth", "-o", output)
    torch.save({"state_dict": {}, "when": datetime.date(2026, 1, 2)}, tmp_path / "more.pth")
    message = refused(capsys, tmp_path / "more.pth", "-o", output)
    assert "it holds a datetime.date; save its state_dict alone" in message
    content = checkpoint.read_bytes()
    (tmp_path / "cut.pt").write_bytes(content[: len(content) // 2])
    assert "cut short" in refused(capsys, tmp_path / "cut.pt", "-o", output)
    torch.save(torch.zeros(3), tmp_path / "tensor.pth")
    assert "expected a dictionary" in refused(capsys, tmp_path / "tensor.pth", "-o", output)
    torch.save({"epoch": 3}, tmp_path / "number.pth")
    assert "epoch" in refused(capsys, tmp_path / "number.pth", "-o", output)
    state = network.state_dict()
    missing = {name: t for name, t in state.items() if name != "encoder.fc_pos.bias"}
    for name, tensors in {"missing": missing, "more": state | {"extra.weight": torch.zeros(1)}}.items():
        torch.save(tensors, tmp_path / f"{name}.pth")
        flags = ["--resolution", "8", "--unet-levels", "2", "--unet-base-channels", "8"]
        message = refused(capsys, tmp_path / f"{name}.pth", "-o", output, *flags)
        assert "do not fit" in message
        assert ("encoder.fc_pos.bias" if name == "missing" else "extra.weight") in message
    assert not output.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_version": "2"}, "format version 1"),
        ({"format": "other"}, "not a snake-field"),
        ({"c_dim": None}, "lacks c_dim"),
    ],
)
def test_weight_files_of_another_kind_are_refused(tmp_path, network, change, message):
    metadata = {k: v for k, v in (network.config.to_metadata() | change).items() if v is not None}
    save_file(network.state_dict(), tmp_path / "out.safetensors", metadata=metadata)
    with pytest.raises(ValueError, match=message):
        load_network(tmp_path / "out.safetensors")


@pytest.mark.skipif(os.name == "nt", reason="files have no mode")
def test_a_replaced_file_keeps_its_mode(tmp_path):
    path = tmp_path / "weights"
    path.write_text("old")
    path.chmod(0o600)
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new" and path.stat().st_mode & 0o777 == 0o600
