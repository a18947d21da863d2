"""The training loop: `python -m snake_training.train --help`; with `torchrun`, samples are shared out."""

import copy
import math
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist
from torch.nn.parallel import DistributedDataParallel
from tqdm import tqdm

from .augment import distillation_views, two_views
from .command_line import parse_arguments
from .config import from_json, to_json
from .data import Mixture, Procedural, ShapeError, open_all
from .device import choose_device
from .evaluate import DetectOptions, candidates, repeatability, suppress, view_pairs, why_none
from .export import build_network, load_network, replacing
from .losses import LOSSES, distillation_losses, snake_losses
from .model import Decoder, PointEncoder, ResnetBlockFC, SnakeNetwork, voxel_index
from .targets import Targets

DESCRIPTION = """Train a SNAKE keypoint field without labels. Running the same command again resumes the run from its last
checkpoint. Ctrl-C ends the run with a checkpoint after its step. With torchrun, samples are shared out over the processes."""


def make_batch(shapes, config, first, number, device, stream=0):
    """Samples first .. first + number - 1 of shapes or targets, each from its own seed, as tensors."""
    samples = []
    for index in range(first, first + number):
        rng = np.random.default_rng([config.seed, stream, index])
        if isinstance(shapes, Targets):
            samples.append(distillation_views(shapes.sample(rng), config, rng))
        else:
            samples.append(two_views(shapes.cloud(rng), config, rng))
    return {name: torch.from_numpy(np.stack([s[name] for s in samples])).to(device) for name in samples[0]}


def learning_rate(config, step):
    """Linear warm-up, then cosine to zero or a tenth after a share of the steps."""
    if step < config.warmup:
        return config.learning_rate * (step + 1) / config.warmup
    if config.schedule == "step":
        return config.learning_rate * (0.1 if step >= config.steps * config.drop_after else 1.0)
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
    """The four losses, the share of saturated queries, and relative repeatability on unseen shapes.

    Repeatability is at epsilon 0.04 of clouds of radius 1, with suppression at 0.01 and at 0.05.
    """
    network.eval()
    normalization = "unit-sphere" if config.normalization == "mixed" else config.normalization
    options = DetectOptions(normalization=normalization, query_resolution=config.validation_resolution)
    with torch.no_grad():
        batches = [make_batch(shapes, config, first, 4, device, stream=1) for first in range(0, 32, 4)]
        results = [snake_losses(network, batch, config.bf16, ridge=config.sparsity_ridge) for batch in batches]
    values = {name: float(np.mean([losses[name].item() for losses, _ in results])) for name in results[0][0]}
    values["saturated"] = float(np.mean([share.item() for _, share in results]))

    def detector(points):
        found = candidates(network, points, options)
        kept = {radius: suppress(found[:, :3], radius, limit=64) for radius in (0.01, 0.05)}
        return {f"nms_{radius}": found[kept[radius]].numpy() for radius in kept}

    for name, (measured, count) in repeatability(detector, shapes, config.validation_objects).items():
        values |= {f"repeatability_{name}": float(measured[0]), f"keypoints_{name}": count}
    if values["keypoints_nms_0.01"] == 0:
        cloud, _, _ = next(view_pairs(shapes, 1, 5000, 0))
        tqdm.write(f"warning: no keypoint in the validation: {why_none(network, cloud, options)}")
    return values


def score_of(values, config):
    """How good a validation is, by which the best is chosen."""
    if config.best_by == "loss":
        return -total_loss({name: values[name] for name in LOSSES}, config)
    return values["repeatability_nms_0.01"] + values["repeatability_nms_0.05"]


def save_checkpoint(path, config, step, network, average, optimizer, best):
    """Everything that continues the run bit for bit; temporary name, then rename."""
    state = {
        "config": to_json(config), "step": step, "best": best, "network": network.state_dict(),
        "ema": average.state_dict(), "optimizer": optimizer.state_dict(),
    }  # fmt: skip
    with replacing(path) as temporary:
        torch.save(state, temporary)


def of_points(name):
    """Whether a tensor of this name belongs to the point encoder."""
    return name.startswith("encoder.") and not name.startswith("encoder.unet3d.")


def starting_network(config):
    """The network of the configuration, with the weights of `init` if there is one, whatever its resolution.

    If `init` has another point encoder, the layers of that start anew.
    """
    if not config.init:
        return SnakeNetwork(config.network)
    try:
        start = load_network(config.init)
        tensors = start.state_dict()
        if start.config.point_encoder != config.point_encoder:
            kept = {name: tensor for name, tensor in tensors.items() if not of_points(name)}
            tensors = {k: t for k, t in SnakeNetwork(config.network).state_dict().items() if of_points(k)} | kept
        network = build_network(config.network, tensors)
    except ValueError as error:
        raise SystemExit(f"--init {config.init}: {error}") from error
    if config.fresh_saliency:
        network.decoder_keypoint = Decoder(config.network)
    if config.revive:
        if network_health(network, torch.rand(1, 4096, 3) - 0.5)["feature_deviation"] < 1e-3:
            network.encoder = revived(network.encoder)
        for module in network.modules():
            if isinstance(module, ResnetBlockFC):
                revive_units(module)
    return network


@torch.no_grad()
def revived(encoder):
    """An encoder with new layers before the volume, whose features vary a little about the old one's mean."""
    config = encoder.config
    points = torch.rand(1, 4096, 3) - 0.5
    mean = encoder.point_features(points, voxel_index(points, config)).mean(dim=(0, 1))
    fresh = PointEncoder(config)
    fresh.unet3d = encoder.unet3d
    fresh.fc_c.weight *= 0.3
    fresh.fc_c.bias.copy_(mean)
    return fresh


@torch.no_grad()
def revive_units(block):
    """Draws the dead hidden units of a residual block anew, so that they can learn; the block computes what it did before.

    A unit is dead if its largest incoming weight times its largest outgoing weight is below 1e-3.
    """
    dead = block.fc_0.weight.abs().amax(dim=1) * block.fc_1.weight.abs().amax(dim=0) < 1e-3
    fresh = ResnetBlockFC(block.fc_0.in_features, block.fc_1.out_features)
    block.fc_0.weight[dead] = fresh.fc_0.weight[dead]
    block.fc_0.bias[dead] = fresh.fc_0.bias[dead]
    block.fc_1.weight[:, dead] = 0


@torch.no_grad()
def network_health(network, points):
    """How alive the network is, by name, for points (B, N, 3).

    dead_share: share of the layers in which most weights are below 1e-6; feature_deviation: standard deviation of the
    point features over points, relative to their root mean square. A dead encoder has features that do not vary.
    """
    weights = [parameter for parameter in network.parameters() if parameter.dim() >= 2]
    dead = [bool((weight.abs() < 1e-6).float().mean() > 0.5) for weight in weights]
    encoder = network.encoder
    features = encoder.point_features(points, voxel_index(points, encoder.config)).flatten(0, 1)
    spread = features.var(dim=0).mean().sqrt() / features.square().mean().sqrt().clamp(min=1e-12)
    return {"dead_share": float(np.mean(dead)), "feature_deviation": float(spread)}


def make_optimizer(network, config):
    """The released code's Adam with an L2 penalty on everything, or AdamW, with decay on the U-Net alone.

    The L2 penalty inside Adam is divided by the gradient's own scale: where gradients are small it alone decides. It set
    every point encoder trained with it to zero, and most of the occupancy decoders, at learning rates of 1e-3 and more.
    """
    if config.optimizer == "adam":
        return torch.optim.Adam(network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    unet = list(network.encoder.unet3d.parameters())
    decayed = {id(p) for p in unet}
    others = [p for p in network.parameters() if id(p) not in decayed]
    groups = [{"params": unet}, {"params": others, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=config.learning_rate, weight_decay=config.weight_decay)


def open_log(run):
    """TensorBoard's writer for a run folder; None, said once, where it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        print("tensorboard is not installed: losses are shown but not logged", file=sys.stderr)
        return None
    return SummaryWriter(run)


def write_scalars(log, group, values, step):
    """A step's values to the log, if there is one."""
    for name, value in values.items() if log else ():
        log.add_scalar(f"{group}/{name}", value, step)


def train(config):
    """Train from the configuration to its last step, or until its minutes are spent."""
    try:
        run_steps(config)
    except ShapeError as error:
        raise SystemExit(f"{error}; remove that file and run the same command again to resume") from error


@contextmanager
def interruption():
    """A flag that Ctrl-C sets, so that a step ends before the run does; a second Ctrl-C ends it at once."""
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed
        return

    def press(_number, _frame):
        pressed.set()
        signal.signal(signal.SIGINT, previous)

    previous = signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, previous)


def run_steps(config):
    """The training loop, which Ctrl-C ends with a checkpoint."""
    with interruption() as pressed:
        run_until(config, pressed)


def run_until(config, pressed):
    """The training loop, until the event `pressed` is set."""
    rank, world = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    if config.batch % world:
        raise SystemExit(f"--batch {config.batch} does not divide over {world} processes")
    device, config = choose_device(config)
    if world > 1:
        # The other processes wait while the first validates, on a slow machine for longer than the default minutes.
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=timedelta(hours=4))
    torch.manual_seed(config.seed)
    run = Path(config.run_dir)
    resumed = (run / "last.pt").exists()
    try:
        clouds = open_all(config.data, config.split)
        shapes = Targets(*config.targets) if config.targets else Mixture(clouds, config.procedural_share)
        held_out = Mixture(open_all(config.validation_data, config.validation_split) or [Procedural()], 0.0)
        network = (SnakeNetwork(config.network) if resumed else starting_network(config)).to(device).train()
    except (OSError, ValueError) as error:
        raise SystemExit(str(error)) from error
    average = copy.deepcopy(network).requires_grad_(False)
    optimizer = make_optimizer(network, config)
    step, best = 0, -math.inf
    if resumed:
        state = torch.load(run / "last.pt", map_location="cpu", weights_only=True)
        if from_json(state["config"]).network != config.network:
            raise SystemExit(f"{run}/last.pt holds another network; give another --run-dir")
        network.load_state_dict(state["network"])
        average.load_state_dict(state["ema"])
        optimizer.load_state_dict(state["optimizer"])
        step, best = state["step"], state["best"]
    losses_of = distillation_losses if config.targets else partial(snake_losses, ridge=config.sparsity_ridge)
    model = DistributedDataParallel(network) if world > 1 else network

    log = None
    if rank == 0:
        run.mkdir(parents=True, exist_ok=True)
        (run / "config.json").write_text(to_json(config))
        log = open_log(run)
    bar = tqdm(
        total=config.steps, initial=step, disable=rank != 0, unit="step", mininterval=2 if sys.stderr.isatty() else 60
    )
    started = saved = time.monotonic()
    share = config.batch // world
    running = {}
    while step < config.steps:
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(config, step)
        batch = make_batch(shapes, config, step * config.batch + rank * share, share, device)
        losses, saturated = losses_of(model, batch, config.bf16, world)
        loss = total_loss(losses, config)
        optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), config.clip_norm or math.inf)
        if not torch.isfinite(norm):
            raise SystemExit(f"step {step}: the gradient is not finite; lower --learning-rate and resume")
        optimizer.step()
        update_average(average, network, config.ema_decay, step)
        step += 1
        bar.update()
        measured = losses | {"saturated": saturated, "gradient_norm": norm}
        values = torch.stack([value.detach() for value in measured.values()])
        if world > 1:
            dist.all_reduce(values)
        for name, value in zip(measured, (values / world).tolist()):
            running[name] = running.get(name, value) * 0.98 + value * 0.02
        spent = config.minutes > 0 and time.monotonic() - started > config.minutes * 60
        stop = torch.tensor([spent, pressed.is_set()])
        if world > 1:
            dist.all_reduce(stop := stop.int().to(device), dist.ReduceOp.MAX)
        spent, interrupted = stop.bool().tolist()
        finished = spent or step == config.steps
        if rank == 0:
            if step % 20 == 0 or finished:
                bar.set_postfix({k[:3]: f"{v:.3f}" for k, v in running.items()}, refresh=False)
                write_scalars(log, "train", running, step)
            if step % config.validate_every == 0 or finished:
                values = validate(average, config, held_out, device)
                values |= network_health(average, batch["points"].flatten(0, 1))
                write_scalars(log, "validation", values, step)
                tqdm.write(f"step {step}: " + " ".join(f"{k}={v:.3f}" for k, v in values.items()))
                score = score_of(values, config)
                if score > best:
                    best = score
                    save_checkpoint(run / "best.pt", config, step, network, average, optimizer, best)
            if finished or interrupted or time.monotonic() - saved > config.checkpoint_minutes * 60:
                save_checkpoint(run / "last.pt", config, step, network, average, optimizer, best)
                saved = time.monotonic()
        if interrupted:
            sys.exit(f"step {step}: stopped; its checkpoint is {run}/last.pt, and the same command resumes from it")
        if spent:
            break
    bar.close()
    if log:
        log.close()
    if world > 1:
        dist.destroy_process_group()


if __name__ == "__main__":
    train(parse_arguments(sys.argv[1:], DESCRIPTION))
