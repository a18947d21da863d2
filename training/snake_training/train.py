"""The training loop: `python -m snake_training.train --help`, or `torchrun --nproc-per-node 2 -m snake_training.train`."""

import copy
import math
import os
import sys
import time
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist
from torch.nn.parallel import DistributedDataParallel
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from .augment import two_views
from .config import from_json, parse_arguments, to_json
from .data import Mixture, Procedural, open_shapes
from .evaluate import candidates, repeatability, suppress
from .export import load_network
from .losses import snake_losses
from .model import SnakeNetwork

DESCRIPTION = """Train a SNAKE keypoint field without labels. Running the same command again resumes the run from its last
checkpoint. With torchrun, samples are shared out over the processes."""


def make_batch(shapes, config, first, number, device, stream=0):
    """Samples first .. first + number - 1, each from its own seed, as tensors."""
    samples = []
    for index in range(first, first + number):
        rng = np.random.default_rng([config.seed, stream, index])
        samples.append(two_views(shapes.cloud(rng), config, rng))
    return {name: torch.from_numpy(np.stack([s[name] for s in samples])).to(device) for name in samples[0]}


def learning_rate(config, step):
    """Linear warm-up, then cosine to zero or a tenth after two thirds."""
    if step < config.warmup:
        return config.learning_rate * (step + 1) / config.warmup
    if config.schedule == "step":
        return config.learning_rate * (0.1 if step >= config.steps * 2 / 3 else 1.0)
    progress = (step - config.warmup) / max(config.steps - config.warmup, 1)
    return config.learning_rate * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))


def total_loss(losses, config):
    """Weighted sum of the four losses."""
    return sum(getattr(config, f"weight_{name}") * loss for name, loss in losses.items())


@torch.no_grad()
def update_average(average, network, decay, step):
    """Exponential moving average of the weights; the decay grows with the step so that early weights are forgotten."""
    decay = min(decay, (1 + step) / (10 + step))
    for ours, theirs in zip(average.parameters(), network.parameters()):
        ours.lerp_(theirs, 1 - decay)


def validate(network, config, shapes, device):
    """The four losses, the share of saturated queries, and relative repeatability (epsilon 0.04) on unseen shapes."""
    network.eval()
    with torch.no_grad():
        mixture = Mixture([shapes], 0.0)
        batches = [make_batch(mixture, config, first, 4, device, stream=1) for first in range(0, 32, 4)]
        results = [snake_losses(network, batch, config.bf16) for batch in batches]
    values = {name: float(np.mean([losses[name].item() for losses, _ in results])) for name in results[0][0]}
    values["saturated"] = float(np.mean([share.item() for _, share in results]))

    def detector(points):
        found = candidates(network, points)
        kept = {radius: suppress(found[:, :3], radius, limit=64) for radius in (0.01, 0.05)}
        return {f"nms_{radius}": found[kept[radius]].numpy() for radius in kept}

    for name, (measured, count) in repeatability(detector, shapes, config.validation_objects).items():
        values |= {f"repeatability_{name}": float(measured[0]), f"keypoints_{name}": count}
    return values


def save_checkpoint(path, config, step, network, average, optimizer, best):
    """Everything that continues the run bit for bit; temporary name, then rename."""
    state = {
        "config": to_json(config), "step": step, "best": best, "network": network.state_dict(),
        "ema": average.state_dict(), "optimizer": optimizer.state_dict(),
    }  # fmt: skip
    torch.save(state, f"{path}.partial")
    Path(f"{path}.partial").replace(path)


def train(config):
    """Train from the configuration to its last step, or until its minutes are spent."""
    rank, world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
    if config.batch % world:
        raise SystemExit(f"--batch {config.batch} does not divide over {world} processes")
    cuda = torch.cuda.is_available() if config.device == "auto" else config.device == "cuda"
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0))) if cuda else torch.device("cpu")
    if world > 1:
        dist.init_process_group("nccl" if cuda else "gloo")
    torch.manual_seed(config.seed)
    run = Path(config.run_dir)
    shapes = Mixture([open_shapes(folder) for folder in config.data], config.procedural_share)
    held_out = open_shapes(config.validation_data[0]) if config.validation_data else Procedural()

    network = (load_network(config.init) if config.init else SnakeNetwork(config.network)).to(device).train()
    average = copy.deepcopy(network).requires_grad_(False)
    optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    step, best = 0, 0.0
    if (run / "last.pt").exists():
        state = torch.load(run / "last.pt", map_location=device, weights_only=True)
        if from_json(state["config"]).network != config.network:
            raise SystemExit(f"{run}/last.pt holds another network; give another --run-dir")
        network.load_state_dict(state["network"])
        average.load_state_dict(state["ema"])
        optimizer.load_state_dict(state["optimizer"])
        step, best = state["step"], state["best"]
    model = DistributedDataParallel(network) if world > 1 else network

    log = None
    if rank == 0:
        run.mkdir(parents=True, exist_ok=True)
        (run / "config.json").write_text(to_json(config))
        log = SummaryWriter(run)
    bar = tqdm(total=config.steps, initial=step, disable=rank != 0, unit="step", mininterval=2 if sys.stderr.isatty() else 60)
    started = saved = time.monotonic()
    share = config.batch // world
    running = {}
    while step < config.steps:
        optimizer.param_groups[0]["lr"] = learning_rate(config, step)
        batch = make_batch(shapes, config, step * config.batch + rank * share, share, device)
        losses, saturated = snake_losses(model, batch, config.bf16)
        loss = total_loss(losses, config)
        optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), config.clip_norm)
        if not torch.isfinite(norm):
            raise SystemExit(f"step {step}: the gradient is not finite; lower --learning-rate and resume")
        optimizer.step()
        update_average(average, network, config.ema_decay, step)
        step += 1
        bar.update()
        for name, value in (losses | {"saturated": saturated, "gradient_norm": norm}).items():
            running[name] = running.get(name, 0.0) * 0.98 + value.item() * 0.02 if name in running else value.item()
        stop = torch.tensor(config.minutes > 0 and time.monotonic() - started > config.minutes * 60)
        if world > 1 and config.minutes > 0:
            dist.all_reduce(stop := stop.int().to(device), dist.ReduceOp.MAX)
        finished = bool(stop) or step == config.steps
        if rank == 0:
            if step % 20 == 0:
                bar.set_postfix({k[:3]: f"{v:.3f}" for k, v in running.items()}, refresh=False)
                for name, value in running.items():
                    log.add_scalar(f"train/{name}", value, step)
            if step % config.validate_every == 0 or finished:
                values = validate(average, config, held_out, device)
                for name, value in values.items():
                    log.add_scalar(f"validation/{name}", value, step)
                tqdm.write(f"step {step}: " + " ".join(f"{k}={v:.3f}" for k, v in values.items()))
                score = values["repeatability_nms_0.01"] + values["repeatability_nms_0.05"]
                if score > best:
                    best = score
                    save_checkpoint(run / "best.pt", config, step, network, average, optimizer, best)
            if finished or time.monotonic() - saved > config.checkpoint_minutes * 60:
                save_checkpoint(run / "last.pt", config, step, network, average, optimizer, best)
                saved = time.monotonic()
        if bool(stop):
            break
    bar.close()
    if world > 1:
        dist.destroy_process_group()


if __name__ == "__main__":
    train(parse_arguments(sys.argv[1:], DESCRIPTION))
