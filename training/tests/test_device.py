"""Which device and precision a run computes in."""

import numpy as np
import pytest
import torch

from conftest import judged
from snake_training import device
from snake_training.data import Mixture
from snake_training.device import (
    choose_device,
    has_fast_unet,
    processor_has_fast_bfloat16,
)
from snake_training.tasks.objects import make_batch
from snake_training.teacher import torch_teacher

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def forget_the_processor():
    """Each test asks the processor anew."""
    processor_has_fast_bfloat16.cache_clear()
    yield
    processor_has_fast_bfloat16.cache_clear()


def test_bfloat16_changes_the_losses_by_rounding_only(tiny, network):
    batch = make_batch(Mixture([], 1.0), tiny(), 0, 2)
    full, _ = judged(network, batch)
    rounded, _ = judged(network, batch, autocast=True)
    # The volume's values round to 8 bits; each loss is a mean over them.
    assert {name: value.item() for name, value in rounded.items()} == pytest.approx(
        {name: value.item() for name, value in full.items()}, abs=0.02
    )


@pytest.mark.parametrize(
    ("capabilities", "fast"),
    [
        ({"avx512_f": True, "avx512_bf16": False, "amx_bf16": False}, False),
        ({"avx512_f": True, "avx512_bf16": True, "amx_bf16": False}, True),
        ({"avx512_f": True, "avx512_bf16": False, "amx_bf16": True}, True),
    ],
)
def test_bfloat16_is_used_only_where_the_processor_has_it(tiny, monkeypatch, capabilities, fast):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities, raising=False)
    assert choose_device("cpu") == CPU and has_fast_unet(CPU, tiny(resolution=16).network) is fast


@pytest.mark.parametrize("fast", [False, True])
def test_bfloat16_is_timed_once_where_torch_does_not_name_the_instructions(tiny, monkeypatch, fast):
    timed = []

    def seconds(dtype):
        timed.append(dtype)
        return 1.0 if (dtype == torch.bfloat16) == fast else 2.0

    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"architecture": "aarch64"}, raising=False)
    monkeypatch.setattr(device, "convolution_seconds", seconds)
    config = tiny(resolution=16).network
    assert has_fast_unet(CPU, config) == has_fast_unet(CPU, config) == fast
    assert sorted(map(str, timed)) == ["torch.bfloat16", "torch.float32"]


@pytest.mark.parametrize("fast", [False, True])
def test_a_teacher_computes_in_the_precision_that_is_fast(network, monkeypatch, fast):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": fast}, raising=False)
    used = []

    def fields(points, queries, autocast):
        used.append(autocast)
        return torch.full(queries.shape[:2], 0.5), torch.full(queries.shape[:2], 0.5)

    monkeypatch.setattr(network, "forward", fields)
    torch_teacher(network)(np.zeros((1, 8, 3), np.float32), np.zeros((1, 4, 3), np.float32))
    assert used == [fast]


@pytest.mark.parametrize(("resolution", "runs"), [(8, False), (16, True)])
def test_small_volumes_are_in_float32(tiny, monkeypatch, resolution, runs):
    """torch's bfloat16 convolutions of 2 voxels a side read memory that nobody wrote."""
    monkeypatch.setattr(device, "has_fast_bfloat16", lambda _: True)
    assert has_fast_unet(CPU, tiny(resolution=resolution, unet_levels=3).network) is runs
