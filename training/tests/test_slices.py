"""Training in slices: what is packed, what comes back, and that a run goes on over them."""

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest
import torch

from conftest import arguments
from snake_training import slices
from snake_training.config import from_json
from snake_training.data import Corpus, Procedural, write_corpus
from snake_training.export import load_network
from snake_training.slices import expand, main, pack, read_parts, shrink, write_parts
from snake_training.targets import torch_teacher, write_targets
from snake_training.train import train


def state(config, name="last.pt"):
    return torch.load(Path(config.run_dir) / name, weights_only=True)


def unpacked_and_trained(tar, folder, out):
    """What a machine does that has nothing but the slice."""
    with tarfile.open(tar) as file:
        file.extractall(folder, filter="data")
    command = [sys.executable, "-m", "snake_training.slices", "train", "--minutes", "5", "-o", str(out)]
    environment = os.environ | {"PYTHONPATH": str(folder / "slice"), "PYTHONSAFEPATH": "1"}
    subprocess.run(command, cwd=folder / "slice", env=environment, check=True)
    return folder / "slice"


def test_a_run_goes_on_over_slices(tiny, tmp_path):
    """Two steps elsewhere, two here, two elsewhere, one here."""
    write_corpus(tmp_path / "clouds", Procedural(5, 300), 300)
    data = (str(tmp_path / "clouds"),)
    config = tiny(data=data, validation_data=data)
    for number, steps in ((0, 2), (1, 6)):
        settings = arguments(tiny(data=data, validation_data=data, steps=steps))
        main(["pack", str(tmp_path / "slice.tar"), "--megabytes", "5", "--", *settings])
        there = unpacked_and_trained(tmp_path / "slice.tar", tmp_path / f"there{number}", tmp_path / f"out{number}")
        assert len(Corpus(there / "data")) == 5 and len(Corpus(there / "validation")) == 1
        main(["join", str(tmp_path / f"out{number}"), "--run-dir", config.run_dir])
        assert state(config)["step"] == steps and from_json(state(config)["config"]).network == config.network
        if number == 0:
            best, kept = load_network(config.run_dir).state_dict(), load_network(there / "run").state_dict()
            assert all(torch.allclose(best[name], kept[name], atol=1e-3) for name in best)
        train(tiny(data=data, validation_data=data, steps=4 if number == 0 else 7))
    assert state(config)["step"] == 7
    with pytest.raises(SystemExit):  # what is older than the run
        main(["join", str(tmp_path / "out0"), "--run-dir", config.run_dir])


def test_a_shrunk_checkpoint_keeps_the_weights_and_nearly_the_rest(tiny):
    config = tiny(steps=3)
    train(config)
    before, after = state(config), expand(shrink(state(config)))
    assert after.keys() == before.keys() and after["step"] == before["step"] and after["best"] == before["best"]
    for name, value in before["network"].items():
        assert torch.equal(after["network"][name], value)
        assert torch.allclose(after["ema"][name], before["ema"][name], rtol=0, atol=1e-5)
    for index, entry in before["optimizer"]["state"].items():
        for name, value in entry.items():
            assert after["optimizer"]["state"][index][name].dtype == value.dtype
            assert torch.allclose(after["optimizer"]["state"][index][name], value, rtol=0.005, atol=0)


def test_parts_are_small_and_checked(tiny, tmp_path, monkeypatch):
    config = tiny()
    train(config)
    monkeypatch.setattr(slices, "PART", 10_000)
    write_parts(tmp_path / "out", state(config))
    parts = sorted((tmp_path / "out").glob("checkpoint.0*"))
    assert len(parts) > 5 and max(part.stat().st_size for part in parts) == 10_000
    assert read_parts(tmp_path / "out")["step"] == 2
    parts[1].write_bytes(parts[1].read_bytes()[:-1] + b"?")
    with pytest.raises(ValueError, match="copy them again"):
        read_parts(tmp_path / "out")
    parts[1].unlink()
    with pytest.raises(ValueError, match="not the output"):
        read_parts(tmp_path / "out")


def test_as_many_shapes_as_fit_another_draw_each_slice(tiny, tmp_path):
    write_corpus(tmp_path / "clouds", Procedural(40, 300), 300)
    config = tiny(data=(str(tmp_path / "clouds"),))
    found = pack(tmp_path / "a.tar", config, 0.7)
    assert found["step"] == 0 and 1 < found["shapes"] < 40 == found["of"]
    assert (tmp_path / "a.tar").stat().st_size < 700_000
    train(config)
    assert pack(tmp_path / "b.tar", config, 5) == {"step": 2, "shapes": 40, "of": 40}
    draws = [slices.rows_that_fit(40, 1000, 110_000, np.random.default_rng([1, step])).tolist() for step in (0, 0, 2)]
    assert draws[0] == draws[1] != draws[2]
    with pytest.raises(SystemExit):
        main(["pack", str(tmp_path / "c.tar"), "--megabytes", "0.2", "--", *arguments(config)])
    assert not (tmp_path / "c.tar").exists()


def test_targets_and_starting_weights_travel(tiny, tmp_path, network):
    write_targets(
        tmp_path / "targets", torch_teacher(network), Procedural(3, points=200), rotations=1, queries=64, points=128
    )
    train(tiny(run_dir=str(tmp_path / "teacher")))
    config = tiny(targets=(str(tmp_path / "targets"),), init=str(tmp_path / "teacher"))
    pack(tmp_path / "slice.tar", config, 5)
    with tarfile.open(tmp_path / "slice.tar") as tar:
        tar.extractall(tmp_path, filter="data")
    packed = from_json((tmp_path / "slice" / "config.json").read_text())
    assert (packed.targets, packed.init, packed.run_dir) == (("targets.safetensors",), "init.safetensors", "run")
    ours, theirs = (load_network(path).state_dict() for path in (config.init, tmp_path / "slice" / "init.safetensors"))
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
