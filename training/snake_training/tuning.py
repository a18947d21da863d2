"""What may make training on a GPU faster, tried there on steps that train anyway. What helps differs between GPUs."""

import json
import statistics
import sys
from functools import partial
from subprocess import SubprocessError

import torch
import torch.nn.functional as F


def benchmark(_unet, is_on):
    """cuDNN times its algorithms for each shape and takes the fastest."""
    torch.backends.cudnn.benchmark = is_on


def rough_products(_unet, is_on):
    """Products of float32 matrices with 10 bits of mantissa."""
    torch.set_float32_matmul_precision("high" if is_on else "highest")


def channels_last(unet, is_on):
    """Weights of convolutions with the channels as the innermost axis."""
    unet.to(memory_format=torch.channels_last_3d if is_on else torch.contiguous_format)


def narrow_norms(unet, is_on):
    """GroupNorm in bfloat16, which autocast leaves in float32; its sums stay in float32."""
    for norm in (module for module in unet.modules() if isinstance(module, torch.nn.GroupNorm)):
        norm.__dict__.pop("forward", None)
        if is_on:
            norm.forward = partial(narrow_norm, norm)


def narrow_norm(norm, x):
    """A GroupNorm of x (B, C, ...) in bfloat16."""
    with torch.autocast(x.device.type, enabled=False):
        return F.group_norm(x.bfloat16(), norm.num_groups, norm.weight.bfloat16(), norm.bias.bfloat16(), norm.eps)


def compiled(unet, is_on):
    """The U-Net compiled, where the machine has what that needs."""
    unet._compiled_call_impl = None
    if is_on:
        unet.compile()


TRIALS = {trial.__name__: trial for trial in (benchmark, rough_products, channels_last, narrow_norms, compiled)}
LEAST_GAIN = 0.02  # of the time of a step


class Tuner:
    """Switches on one trial after the other for so many seconds of steps, at least `steps`, and keeps those that make the median
    step faster.

    What was kept stands in tuned.json in the run folder; a run that goes on begins with it.
    """

    def __init__(self, network, batch, autocast, folder, seconds=5.0, steps=12):
        self.unet, self.path, self.seconds, self.steps = network.encoder.unet3d, folder / "tuned.json", seconds, steps
        self.shape = 2 * batch, network.config.c_dim, *reversed(network.config.resolution)
        self.autocast, self.times, self.last, self.trial = autocast, [], None, ""
        self.left = [name for name in TRIALS if autocast or name != "narrow_norms"]
        self.report, self.best = {"kept": []}, None
        if self.path.exists():
            self.report, self.left, self.best = json.loads(self.path.read_text()), [], 0.0
            for name in self.report["kept"]:
                self.switch_on(name)

    def step(self, now):
        """Takes note of the end of a step, in seconds of a clock, and switches when it has seen enough."""
        if self.best is not None and not self.trial:
            return
        if self.last is not None:
            self.times.append(now - self.last)
        self.last = now
        if len(self.times) < self.steps or sum(self.times) < self.seconds:
            return
        seconds = statistics.median(self.times)
        self.report[self.trial or "seconds"] = round(seconds, 5)
        if self.best is None or seconds < (1 - LEAST_GAIN) * self.best:
            self.best = seconds
            self.report["kept"] += [self.trial] if self.trial else []
        else:
            TRIALS[self.trial](self.unet, False)
        self.times, self.last, self.trial = [], None, ""
        while self.left and not self.trial:
            name = self.left.pop(0)
            self.trial = name if self.switch_on(name) else ""
        self.path.write_text(json.dumps(self.report))

    def switch_on(self, name):
        """Whether the U-Net runs with it, forward and backward."""
        TRIALS[name](self.unet, True)
        device = next(self.unet.parameters()).device
        volumes = torch.zeros(self.shape, device=device).contiguous(memory_format=torch.channels_last_3d)
        try:
            with torch.autocast(device.type, torch.bfloat16, enabled=self.autocast):
                self.unet(volumes.requires_grad_()).float().sum().backward()
        except (RuntimeError, OSError, ImportError, SubprocessError) as error:  # no compiler, or no memory
            print(f"{name}: {error}", file=sys.stderr)
            TRIALS[name](self.unet, False)
            return False
        finally:
            self.unet.zero_grad()
        return True
