"""The device a run computes on, and whether it computes fast in bfloat16."""

import functools
import os
import platform
import time

import torch
import torch.nn.functional as F

# Voxels a side that the lowest level of a U-Net in bfloat16 has. Below, torch 2.15's convolutions on a CPU read memory that nobody
# wrote: gradients are at times not finite.
LEAST_SIDE = 4


def choose_device(name):
    """The torch device of this process: `name` is auto, cpu or cuda."""
    if name == "cpu" or (name == "auto" and not torch.cuda.is_available()):
        return torch.device("cpu")
    if not torch.cuda.is_available():
        raise ValueError("device cuda: torch finds no GPU here")
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
    torch.cuda.set_device(device)
    return device


def has_fast_unet(device, config):
    """Whether the device computes the U-Net of a network of this configuration faster in bfloat16, and rightly."""
    if not has_fast_bfloat16(device):
        return False
    lowest = min(getattr(config, "resolution", (1 << 30,))) >> (config.unet_levels - 1)
    return device.type != "cpu" or lowest >= LEAST_SIDE


def why_no_bfloat16(device):
    """Why a device does not compute a U-Net in bfloat16: it cannot, or the volume is too small for a CPU."""
    if not has_fast_bfloat16(device):
        return f"this {device.type} has no fast bfloat16"
    return f"below {LEAST_SIDE} voxels a side at its lowest level bfloat16 is not reliable on a CPU"


def has_fast_bfloat16(device):
    """Whether a torch device multiplies bfloat16 in hardware."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return processor_has_fast_bfloat16()


@functools.cache
def processor_has_fast_bfloat16():
    """Whether this processor multiplies bfloat16 in hardware. Without it torch emulates, up to 150 times slower.

    On x86 torch names the instructions. Elsewhere, and in a torch that does not name them, a convolution is timed once.
    """
    capabilities = getattr(torch.cpu, "get_capabilities", dict)()
    instructions = [capabilities[name] for name in ("avx512_bf16", "amx_bf16") if name in capabilities]
    if instructions:
        return any(instructions)
    return convolution_seconds(torch.bfloat16) < convolution_seconds(torch.float32)


def convolution_seconds(dtype):
    """Seconds of one 3-D convolution of the U-Net's kind, forward and backward; the fastest of three."""
    volume = torch.ones(4, 64, 8, 8, 8, dtype=dtype).contiguous(memory_format=torch.channels_last_3d).requires_grad_()
    weight = torch.ones(64, 64, 3, 3, 3, dtype=dtype, requires_grad=True)
    seconds = []
    for _ in range(3):
        started = time.perf_counter()
        F.conv3d(volume, weight, padding=1).sum().backward()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def processor():
    """The name of this machine's processor, and what PyTorch says of its bfloat16."""
    capabilities = getattr(torch.cpu, "get_capabilities", dict)()
    bfloat16 = [name for name in ("amx_bf16", "avx512_bf16") if capabilities.get(name)]
    return " ".join([str(capabilities.get("cpu_name") or platform.machine()), *bfloat16])
