"""Training of a network of scenes on crops (`snake_training.data.crops`): its start, its losses and its loop.

`snake_training.recipes` runs it, from a file that says every setting. All positions are in voxels.
"""

import copy
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from .augment import random_rotation
from .data.solids import about_axis
from .export import load_network, replacing
from .model import NetworkConfig, SnakeNetwork
from .scene_model import SceneConfig, SceneNetwork
from .train import update_average


@dataclass(frozen=True)
class SceneTraining:
    """Settings of a training stage."""

    seed: int = 1
    steps: int = 4000
    batch: int = 2  # crops a step, of two views each
    side: int = 32  # voxels of the box that a view is cut to; a multiple of the network's period
    teacher_share: float = 0.6  # of the target, where there is a teacher; the rest is the crop's level
    queries: int = 1500  # of the saliency, a crop
    occupancy_queries: int = 300  # on the surface, and as many off it, a view
    learning_rate: float = 1.5e-3
    warmup: int = 50
    clip_norm: float = 1.0
    ema_decay: float = 0.998
    turned_share: float = 0.4  # of the views that are turned in any way, not only about z
    max_thinning: float = 8.0
    max_noise: float = 0.5  # voxels
    weight_consistency: float = 0.1
    weight_occupancy: float = 0.5
    bf16: bool = True


def shown(points, settings, rng):
    """What a student is shown of a view (M, 3) in voxels: half of them thinned, a third with noise."""
    if rng.random() < 0.5:
        share = settings.max_thinning ** -rng.random()
        points = points[rng.permutation(len(points))[: max(int(len(points) * share), 30)]]
    if rng.random() < 0.35:
        points = points + rng.uniform(0, settings.max_noise) * rng.standard_normal(points.shape)
    return points


class Placement:
    """A turn and a shift of a crop into a box of `side` voxels: of a share of them the turn is any, else about z."""

    def __init__(self, settings, rng):
        turned = rng.random() < settings.turned_share
        self.turn = random_rotation(rng) if turned else about_axis(2, rng.uniform(0, 2 * np.pi))
        self.shift, self.side = settings.side / 2 + rng.uniform(-4, 4, 3), settings.side

    def __call__(self, points):
        return (points @ self.turn.T + self.shift).astype(np.float32)

    def cut(self, points):
        """The points (N, 3), placed, that lie in the box."""
        placed = self(points)
        return placed[((placed >= 0) & (placed < self.side - 1)).all(axis=1)]


def sample_of(crop, settings, rng):
    """Two views of a crop and its clean surface for the teacher, each turned and moved by itself and cut to a box: points
    [(N, 3)] of the three, their queries (3, Q, 3), whose level (Q,) the crop knows, and occupancy queries (2, 2 K, 3) of
    the views, the first K of them on the surface. None if a box holds too little."""
    placements = [Placement(settings, rng) for _ in range(3)]
    clouds = [shown(crop["points_0"], settings, rng), shown(crop["points_1"], settings, rng), crop["surface"]]
    points = [place.cut(cloud) for place, cloud in zip(placements, clouds, strict=True)]
    queries = np.stack([place(crop["queries"]) for place in placements])
    rows = np.flatnonzero(((queries > 1) & (queries < settings.side - 2)).all(axis=(0, 2)))
    sides = [(place(crop[f"solid_{view}"]), place(crop["free"])) for view, place in enumerate(placements[:2])]
    drawings = [[drawn(q, settings, rng) for q in side] for side in sides]
    if len(rows) < 50 or min(len(cloud) for cloud in points) < 20 or any(d is None for side in drawings for d in side):
        return None
    rows = rows[rng.integers(len(rows), size=settings.queries)]
    return points, queries[:, rows], crop["target"][rows], np.stack([np.concatenate(side) for side in drawings])


def drawn(queries, settings, rng):
    """Draws `occupancy_queries` of the queries within the box, with repetition; None if the box has none."""
    inside = queries[((queries > 0.5) & (queries < settings.side - 1.5)).all(axis=1)]
    return inside[rng.integers(len(inside), size=settings.occupancy_queries)] if len(inside) else None


def make_batch(crops, settings, stream, step):
    """A batch of B crops as tensors: of all boxes, three a crop, points (N, 3), owner (N,) and queries (3 B, Q, 3); level
    (B, Q); of the views, surface (2 B, 2 K, 3). The last B boxes are the teacher's."""
    rng = np.random.default_rng([settings.seed, stream, step])
    samples = []
    while len(samples) < settings.batch:
        sample = sample_of(crops[rng.integers(len(crops))], settings, rng)
        samples += [sample] if sample else []
    clouds = [s[0][view] for s in samples for view in (0, 1)] + [s[0][2] for s in samples]
    queries = np.concatenate([np.concatenate([s[1][:2] for s in samples]), np.stack([s[1][2] for s in samples])])
    arrays = {
        "points": np.concatenate(clouds), "owner": np.repeat(np.arange(len(clouds)), [len(c) for c in clouds]),
        "queries": queries, "level": np.stack([s[2] for s in samples]), "surface": np.concatenate([s[3] for s in samples]),
    }  # fmt: skip
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


def log_odds(saliency):
    """Log-odds of the saliency from the decoder's output."""
    return F.softplus(saliency).clamp(min=1e-6).log()


@torch.no_grad()
def teacher_log_odds(teacher, batch, settings):
    """What the teacher says of the clean surface at the queries (B, Q)."""
    number = len(batch["level"])
    own = batch["owner"] >= 2 * number
    side = (settings.side,) * 3
    volume, far = teacher.encode(batch["points"][own], batch["owner"][own] - 2 * number, number, side, settings.bf16)
    return log_odds(teacher.logits(volume, far, batch["queries"][2 * number :])[1])


class Target:
    """Log-odds that the student is to have: the crop's level and the teacher's log-odds, both in deviations from their mean,
    mixed. `teacher_share` of the mixture is the teacher's; mean and deviations are those of some made crops."""

    MEAN, DEVIATION = -1.0, 1.0

    def __init__(self, teacher, crops, settings):
        self.teacher, self.settings = teacher, settings
        batches = [make_batch(crops, settings, 3, step) for step in range(24)]
        self.level = moments([batch["level"] for batch in batches])
        if teacher:
            self.taught = moments([teacher_log_odds(teacher, batch, settings) for batch in batches])

    def __call__(self, batch):
        share = self.settings.teacher_share if self.teacher else 0.0
        mixed = (1 - share) * (batch["level"] - self.level[0]) / self.level[1]
        if self.teacher:
            taught = teacher_log_odds(self.teacher, batch, self.settings)
            mixed = mixed + share * (taught - self.taught[0]) / self.taught[1]
        return self.MEAN + self.DEVIATION * mixed / math.hypot(share, 1 - share)


def moments(parts):
    """Mean and standard deviation."""
    values = torch.cat([part.flatten() for part in parts])
    return values.mean().item(), values.std().item()


def losses_of(network, batch, target, settings):
    """Occupancy, distance of both views' saliency to the target (B, Q), and to each other, by name. Distances are squared
    and of log-odds."""
    views, side = len(batch["surface"]), (settings.side,) * 3
    own = batch["owner"] < views
    volume, far = network.encode(batch["points"][own], batch["owner"][own], views, side, settings.bf16)
    number = batch["surface"].shape[1]
    queries = torch.cat([batch["surface"], batch["queries"][:views]], dim=1)
    occupancy, saliency = network.logits(volume, far, queries)
    label = (torch.arange(number) < number // 2).float().expand(views, -1)
    student = log_odds(saliency[:, number:]).unflatten(0, (-1, 2))
    both = target[:, None].expand_as(student)
    return {
        "occupancy": F.binary_cross_entropy_with_logits(occupancy[:, :number], label),
        "distillation": F.mse_loss(student, both),
        "consistency": F.mse_loss(*student.unbind(1)),
    }, {"correlation": torch.corrcoef(torch.stack([student.flatten(), both.flatten()]))[0, 1].detach()}


@torch.no_grad()
def started(init, crops, settings):
    """A network whose layers have the statistics of made crops for constants, each measured behind those before it.

    `init` is a file of a network of objects or rooms, whose other weights it takes, or "", and then it is new.
    """
    torch.manual_seed(settings.seed)
    if init:
        old = load_network(init)
        if not isinstance(old, SnakeNetwork):
            raise ValueError(f"{init}: a network of scenes already has its constants")
        shape = {
            name: getattr(old.config, name) for name in SceneConfig.__dataclass_fields__ if hasattr(old.config, name)
        }
    else:
        shape = {}
        old = SnakeNetwork(NetworkConfig(unet_levels=3, unet_base_channels=16))
    network = SceneNetwork(SceneConfig(**shape))
    tensors = old.state_dict()
    kept = {name: tensors.get(name, value) for name, value in network.state_dict().items()}
    network.load_state_dict(kept)
    norms = {}
    for ours, theirs in zip(network.encoder.unet3d.doubles(), old.encoder.unet3d.doubles(), strict=True):
        for name in ("SingleConv1", "SingleConv2"):
            norms[getattr(ours, name)] = getattr(theirs, name).groupnorm
    batch = make_batch(crops, SceneTraining(**asdict(settings) | {"batch": 16}), 2, 0)

    def visit(layer, x, far):
        layer.fix(x, far, norms[layer].weight, norms[layer].bias, old.config.group_norm_groups)

    encoder, side = network.encoder, (settings.side,) * 3
    features = encoder.point_features(batch["points"], batch["owner"])
    volume = encoder.scatter(features, batch["points"], batch["owner"], len(batch["queries"]), side)
    encoder.unet3d(volume, visit)
    return network


def rate(settings, step):
    """Linear warm-up, then cosine to zero."""
    if step < settings.warmup:
        return settings.learning_rate * (step + 1) / settings.warmup
    progress = (step - settings.warmup) / max(settings.steps - settings.warmup, 1)
    return settings.learning_rate * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))


def train(folder, crops, settings, network, target, log=print, checkpoint_minutes=5.0, stop=None):
    """Runs the loop to its end, or to the step `stop`, from the folder's checkpoint if there is one; returns the averaged
    network."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    average = copy.deepcopy(network).requires_grad_(False)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    step, running, last = 0, {}, folder / "last.pt"
    if last.exists():
        state = torch.load(last, map_location="cpu", weights_only=True)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["ema"])
        optimizer.load_state_dict(state["optimizer"])
        step = state["step"]
    saved = started_at = time.monotonic()
    first = step
    stop = min(stop or settings.steps, settings.steps)
    while step < stop:
        for group in optimizer.param_groups:
            group["lr"] = rate(settings, step)
        batch = make_batch(crops, settings, 0, step)
        losses, measured = losses_of(network, batch, target(batch), settings)
        weights = {"occupancy": settings.weight_occupancy, "consistency": settings.weight_consistency}
        loss = sum(weights.get(name, 1.0) * value for name, value in losses.items())
        optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), settings.clip_norm)
        if not torch.isfinite(norm):
            raise ValueError(f"step {step}: the gradient is not finite; lower learning_rate")
        optimizer.step()
        update_average(average, network, settings.ema_decay, step)
        step += 1
        for name, value in (losses | measured).items():
            running[name] = running.get(name, value.item()) * 0.98 + value.item() * 0.02
        done = step == stop
        if step % 50 == 0 or done:
            each = (time.monotonic() - started_at) / (step - first)
            log(f"step {step}: {each:.2f} s a step, " + ", ".join(f"{k} {v:.3f}" for k, v in running.items()))
        if done or time.monotonic() - saved > 60 * checkpoint_minutes:
            state = {"step": step, "network": network.state_dict(), "ema": average.state_dict()}
            with replacing(last) as temporary:
                torch.save(state | {"optimizer": optimizer.state_dict()}, temporary)
            saved = time.monotonic()
    return average
