"""The smallest configuration that exercises everything; one thread, so that runs repeat bit for bit."""

import dataclasses
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from snake_training.config import TrainConfig
from snake_training.losses import losses_of
from snake_training.model import SnakeNetwork
from snake_training.tasks.objects import Objects

torch.set_num_threads(1)
FOLDER = Path(__file__).resolve().parents[2]  # of the repository

TINY = dict(
    resolution=8, unet_levels=2, unet_base_channels=8, c_dim=8, num_points=128, num_occupancy=32, num_grids=8,
    grid_size=3, batch=2, steps=2, warmup=1, bf16=False, validate_every=100, validation_objects=1,
    validation_resolution=6,
)  # fmt: skip


def rng(seed=0):
    return np.random.default_rng(seed)


def cloud(number=600, seed=3):
    """A lopsided cloud far from the origin."""
    return (rng(seed).normal(size=(number, 3)) * (3, 1, 0.5) + (10, -4, 2)).astype(np.float32)


def pytest_configure(config):
    config.addinivalue_line("markers", "nightly: `make test-full` runs it, `make test` another one of its kind")


@pytest.fixture
def tiny(tmp_path):
    """tiny(**changes) -> TrainConfig with its run folder below tmp_path."""
    return lambda **changes: TrainConfig(**TINY | {"run_dir": str(tmp_path / "run")} | changes)


@pytest.fixture
def network():
    """A seeded tiny network in evaluation mode, with no weight at its initial 0."""
    torch.manual_seed(5)
    network = SnakeNetwork(TrainConfig(**TINY).network)
    for parameter in network.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    return network.eval()


def judged(network, batch, autocast=False):
    """The losses of a batch of objects, and the share of saturated queries."""
    return losses_of(*Objects.answer(None, network, batch, autocast), batch)


def arguments(config):
    """The command line that gives a configuration."""
    words = []
    for field in dataclasses.fields(config):
        value, option = getattr(config, field.name), field.name.replace("_", "-")
        if field.type is bool:
            words.append(f"--{option}" if value else f"--no-{option}")
        elif field.type is tuple:
            words += [f"--{option}", *value]
        else:
            words += [f"--{option}", str(value)]
    return words


@pytest.fixture(scope="session")
def snake_cli():
    """snake_cli(*words) -> what the command line of snake-rs did; SNAKE_CLI may say where the binary lies."""
    built = FOLDER / "target/release/snake-cli"
    binary = os.environ.get("SNAKE_CLI", built)
    if not Path(binary).exists():
        pytest.skip(f"no {binary}: cargo build --release")

    def run(*words, **settings):
        done = subprocess.run([binary, *map(str, words)], check=False, capture_output=True, text=True, **settings)
        assert done.returncode == 0, done.stderr
        return done

    run.path = str(binary)
    return run
