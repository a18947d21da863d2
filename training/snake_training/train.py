"""The training loop, and its command line for objects: `python -m snake_training.train --help`.

A task draws a batch, the network answers at its queries, the losses judge, the loop steps. With `torchrun`, samples are shared out.
"""

import copy
import math
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import torch
import torch.distributed as dist
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader, Dataset
from tqdm import tqdm

from .command_line import parse_arguments
from .config import to_json
from .data import CloudError
from .device import choose_device, has_fast_unet, why_no_bfloat16
from .export import config_of, network_of, read_state, replacing
from .losses import loss_options, losses_of
from .progress import bar
from .scene_model import SceneNetwork
from .tasks.objects import Objects

DESCRIPTION = """Train a SNAKE keypoint field without labels. Running the same command again resumes the run from its last
checkpoint. Ctrl-C, SIGTERM and SIGUSR1 end the run with a checkpoint after its step. With torchrun, samples are shared out
over the processes."""
CHECKPOINT_MINUTES = 2


class Batches(Dataset):
    """The batch of each step, for a loader whose worker processes draw them ahead."""

    def __init__(self, task, rank, world):
        self.task, self.rank, self.share = task, rank, task.settings.batch // world

    def __getitem__(self, step):
        torch.set_num_threads(1)
        return self.task.batch(step * self.task.settings.batch + self.rank * self.share, self.share)


def batches(task, first, last, rank, world, workers, pinned=False):
    """The batches of steps first .. last - 1, drawn by so many worker processes, or by this one; `pinned` for a GPU."""
    drawn = Batches(task, rank, world)
    if not workers:
        return (drawn[step] for step in range(first, last))
    return DataLoader(
        drawn, batch_size=None, sampler=range(first, last), num_workers=workers, prefetch_factor=4, pin_memory=pinned
    )


def learning_rate(settings, step):
    """Cosine to zero, or a tenth after a share of the steps; linear warm-up."""
    rising = min((step + 1) / settings.warmup, 1.0) if settings.warmup else 1.0
    if settings.schedule == "step":
        return settings.learning_rate * rising * (0.1 if step >= settings.steps * settings.drop_after else 1.0)
    progress = (step - settings.warmup) / max(settings.steps - settings.warmup, 1)
    return settings.learning_rate * rising * 0.5 * (1 + math.cos(math.pi * min(max(progress, 0.0), 1.0)))


def total_loss(losses, settings):
    """Weighted sum of the losses."""
    return sum(getattr(settings, f"weight_{name}") * loss for name, loss in losses.items())


@torch.no_grad()
def update_average(average, network, decay, step):
    """Exponential moving average of the weights; the decay grows with the step so that early weights are forgotten."""
    decay = min(decay, (1 + step) / (10 + step))
    torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), 1 - decay)


@torch.no_grad()
def dead_share(network):
    """Share of the layers in which most weights are below 1e-6: those learn nothing any more."""
    weights = [parameter for parameter in network.parameters() if parameter.dim() >= 2]
    dead = [bool((weight.abs() < 1e-6).float().mean() > 0.5) for weight in weights]
    return sum(dead) / len(dead)


def make_optimizer(network, settings):
    """The released code's Adam with an L2 penalty on everything, or AdamW, with decay on the U-Net alone.

    The L2 penalty inside Adam is divided by the gradient's own scale: where gradients are small it alone decides. It set
    every point encoder trained with it to zero, and most of the occupancy decoders, at learning rates of 1e-3 and more.
    Constants of a network of scenes are no weights to decay.
    """
    rate, decay = settings.learning_rate, settings.weight_decay
    if settings.optimizer == "adam":
        return torch.optim.Adam(network.parameters(), lr=rate, weight_decay=decay)
    unet = [] if isinstance(network, SceneNetwork) else list(network.encoder.unet3d.parameters())
    decayed = {id(p) for p in unet}
    others = [p for p in network.parameters() if id(p) not in decayed]
    groups = [{"params": unet}] if unet else []
    return torch.optim.AdamW([*groups, {"params": others, "weight_decay": 0.0}], lr=rate, weight_decay=decay)


def open_log(folder):
    """TensorBoard's writer for a run folder; None, said once, where it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        print("tensorboard is not installed: losses are shown but not logged", file=sys.stderr)
        return None
    return SummaryWriter(folder)


def write_scalars(log, group, values, step):
    """A step's values to the log, if there is one."""
    for name, value in values.items() if log else ():
        log.add_scalar(f"{group}/{name}", value, step)


@contextmanager
def interruption():
    """An event that Ctrl-C, SIGTERM or SIGUSR1 (of Slurm) sets, so that a step ends before the run does; a second one ends it
    at once."""
    pressed = threading.Event()
    signals = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR1") if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        yield pressed
        return

    def restore():
        for number, handler in previous.items():
            signal.signal(number, handler)

    def press(_number, _frame):
        pressed.set()
        restore()

    previous = {number: signal.signal(number, press) for number in signals}
    try:
        yield pressed
    finally:
        restore()


class State:
    """What a run has reached: step, network, averaged weights, Adam, best score."""

    def __init__(self, task, folder, device):
        self.task, self.folder = task, folder
        torch.manual_seed(task.settings.seed)
        self.step, self.best = 0, -math.inf
        last = folder / "last.pt"
        state = read_state(last) if last.exists() else None
        network = network_of(config_of(state["network_config"])) if state else task.network()
        if network.config != task.network_config:
            raise ValueError(f"{last} holds another network; give another run folder")
        self.network = network.to(device).train()
        self.average = copy.deepcopy(network).requires_grad_(False)
        self.optimizer = make_optimizer(network, task.settings)
        if state:
            self.network.load_state_dict(state["network"])
            self.average.load_state_dict(state["ema"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.best = state["step"], state["best"]

    def save(self, name):
        """Everything that continues the run bit for bit; temporary name, then rename."""
        state = {
            "settings": to_json(self.task.settings), "network_config": self.network.config.to_metadata(),
            "step": self.step, "best": self.best, "network": self.network.state_dict(), "ema": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }  # fmt: skip
        with replacing(self.folder / name) as temporary:
            torch.save(state, temporary)


def run(task, folder, device="auto", minutes=0.0, workers=0):
    """Trains to the last step of the settings; returns whether it was reached. Otherwise so many `minutes` are spent.

    The folder gets the settings, checkpoints and logs; a run that it holds goes on from its checkpoint. `workers` processes draw the batches ahead. Ctrl-C is a SystemExit after a checkpoint.
    """
    with interruption() as pressed:
        return run_until(task, Path(folder), device, minutes, workers, pressed)


def run_until(task, folder, device, minutes, workers, pressed):
    """The loop of `run`, until the event `pressed` is set."""
    started = saved = time.monotonic()
    settings = task.settings
    rank, world = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    if settings.batch % world:
        raise ValueError(f"batch {settings.batch} does not divide over {world} processes")
    device = choose_device(device)
    if world > 1:
        # The other processes wait while the first validates, on a slow machine for longer than the default minutes.
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=timedelta(hours=4))
    state = State(task, folder, device)
    autocast = settings.bf16 and has_fast_unet(device, state.network.config)
    if settings.bf16 and not autocast and rank == 0:
        print(f"the U-Net runs in float32: {why_no_bfloat16(device)}", file=sys.stderr)
    model = DistributedDataParallel(state.network) if world > 1 else state.network

    log = None
    if rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "config.json").write_text(to_json(settings))
        log = open_log(folder)
    steps = bar(total=settings.steps, initial=state.step, disable=rank != 0, unit="step")
    running, spent = {}, False
    for batch in batches(task, state.step, settings.steps, rank, world, workers, device.type == "cuda"):
        for group in state.optimizer.param_groups:
            group["lr"] = learning_rate(settings, state.step)
        batch = task.ready({name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()})
        losses, saturated = losses_of(*task.answer(model, batch, autocast), batch, world, **loss_options(settings))
        state.optimizer.zero_grad()
        total_loss(losses, settings).backward()
        norm = torch.nn.utils.clip_grad_norm_(state.network.parameters(), settings.clip_norm or math.inf)
        if not torch.isfinite(norm):
            raise ValueError(f"step {state.step}: the gradient is not finite; lower learning_rate and resume")
        state.optimizer.step()
        update_average(state.average, state.network, settings.ema_decay, state.step)
        state.step += 1
        steps.update()
        measured = losses | {"saturated": saturated, "gradient_norm": norm}
        values = torch.stack([value.detach() for value in measured.values()])
        spent = 0 < minutes <= (time.monotonic() - started) / 60
        stop = torch.tensor([spent, pressed.is_set()])
        if world > 1:
            dist.all_reduce(values)
            dist.all_reduce(stop := stop.int().to(device), dist.ReduceOp.MAX)
        for name, value in zip(measured, (values / world).tolist()):
            running[name] = running.get(name, value) * 0.98 + value * 0.02
        spent, interrupted = stop.bool().tolist()
        finished = spent or state.step == settings.steps
        if rank == 0:
            if state.step % 20 == 0 or finished:
                steps.set_postfix({k[:3]: f"{v:.3f}" for k, v in running.items()}, refresh=False)
                write_scalars(log, "train", running, state.step)
            if state.step % settings.validate_every == 0 or (finished and not spent):
                validate(state, device, autocast, log)
            if finished or interrupted or time.monotonic() - saved > 60 * CHECKPOINT_MINUTES:
                state.save("last.pt")
                saved = time.monotonic()
        if interrupted:
            sys.exit(
                f"step {state.step}: stopped; its checkpoint is {folder}/last.pt, and the same command resumes from it"
            )
        if spent:
            break
    steps.close()
    if log:
        log.close()
    if world > 1:
        dist.destroy_process_group()
    return not spent


def validate(state, device, autocast, log):
    """The figures of the averaged weights to the log; the best are kept in best.pt."""
    figures = state.task.validate(state.average, device, autocast)
    if not figures:
        return
    figures["dead_share"] = dead_share(state.average)
    write_scalars(log, "validation", figures, state.step)
    tqdm.write(f"step {state.step}: " + " ".join(f"{k}={v:.3f}" for k, v in figures.items()))
    if state.task.score(figures) > state.best:
        state.best = state.task.score(figures)
        state.save("best.pt")


def train(config, device="auto", minutes=0.0, workers=0):
    """A run on objects, as the command line asks for it; returns whether it reached its last step. Data that cannot be read or
    trained on are a SystemExit of one line."""
    try:
        return run(Objects(config), config.run_dir, device, minutes, workers)
    except CloudError as error:
        raise SystemExit(f"{error}; remove that file and run the same command again to resume") from error
    except (OSError, ValueError) as error:
        raise SystemExit(str(error)) from error


if __name__ == "__main__":
    train(*parse_arguments(sys.argv[1:], DESCRIPTION))
