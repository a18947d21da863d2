"""Learning from crops of made rooms and streets (`snake_training.data.crops`). All positions are in voxels."""

import math
from dataclasses import replace

import numpy as np
import torch

from ..augment import local_grid, random_rotation
from ..data.solids import about_axis
from ..device import has_fast_unet
from ..losses import saliency_log_odds
from ..model import NetworkConfig, SnakeNetwork
from ..scene_model import SHAPES, SceneNetwork
from .objects import label

MAX_THINNING, MAX_NOISE = 8.0, 0.5  # of views: one point of so many is kept; standard deviation, in voxels
GRID_SIDE = 6.0  # voxels, of a local grid


class Scenes:
    """Crops, two views each. The saliency is learnt by the four losses if the settings have local grids; else from the crop's
    level and a teacher, mixed.

    init: a network to go on from, or None for a new one. teacher: a network that sees the clean surface, or None.
    """

    MEAN, DEVIATION = -1.0, 1.0  # of the target's log-odds

    def __init__(self, settings, crops, init=None, teacher=None):
        self.settings, self.crops, self.init, self.teacher = settings, crops, init, teacher
        self.network_config = init.config if init else settings.network
        if settings.num_grids:
            return
        batches = [
            self.batch(first, settings.batch, stream=3) for first in range(0, 24 * settings.batch, settings.batch)
        ]
        self.level = moments([batch["level"] for batch in batches])
        if teacher:
            self.taught = moments([self.teacher_log_odds(batch) for batch in batches])

    def network(self):
        """The network to start from."""
        return self.init or started(self.crops, self.settings)

    def batch(self, first, number, stream=0):
        """Samples of B crops as tensors. Of the two views: points (N, 3), owner (N,), queries (B, 2, 2 K + Q, 3), of which the
        first K are on the surface. For the four losses inside (B, 2, G, H^3); else level (B, Q), and `surface_` points, owner
        and queries (B, Q, 3) of the clean surface, in a box of its own, for the teacher."""
        samples = [
            self.sample(np.random.default_rng([self.settings.seed, stream, row]))
            for row in range(first, first + number)
        ]
        batch = {"label": label(self.settings.num_occupancy)}
        for name in samples[0]:
            if name.endswith("points"):
                clouds = [cloud for sample in samples for cloud in sample[name]]
                owner = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
                batch[name] = torch.from_numpy(np.concatenate(clouds))
                batch[name.replace("points", "owner")] = torch.from_numpy(owner)
            else:
                batch[name] = torch.from_numpy(np.stack([sample[name] for sample in samples]))
        return batch

    def sample(self, rng):
        """The arrays of one crop, drawn until a box holds enough."""
        while True:
            crop = self.crops[rng.integers(len(self.crops))]
            sample = sample_of(crop, self.settings, rng)
            if sample:
                return sample

    def ready(self, batch):
        """The batch with its target (B, Q): the crop's level and the teacher's log-odds, both in deviations from their mean,
        mixed. `teacher_share` of the mixture is the teacher's."""
        if self.settings.num_grids:
            return batch
        share = self.settings.teacher_share if self.teacher else 0.0
        mixed = (1 - share) * (batch["level"] - self.level[0]) / self.level[1]
        if self.teacher:
            mixed = mixed + share * (self.teacher_log_odds(batch) - self.taught[0]) / self.taught[1]
        return batch | {"target": self.MEAN + self.DEVIATION * mixed / math.hypot(share, 1 - share)}

    @torch.no_grad()
    def teacher_log_odds(self, batch):
        """The teacher's log-odds (B, Q) for the clean surface at the queries."""
        queries = batch["surface_queries"]
        autocast = self.settings.bf16 and has_fast_unet(queries.device, self.teacher.config)
        points, owner = batch["surface_points"], batch["surface_owner"]
        _, saliency = self.teacher.to(queries.device)(points, owner, queries, self.settings.side, autocast)
        return saliency_log_odds(saliency)

    def answer(self, model, batch, autocast):
        """The two fields at the queries of both views."""
        size = len(batch["queries"])
        fields = model(batch["points"], batch["owner"], batch["queries"].flatten(0, 1), self.settings.side, autocast)
        return tuple(field.unflatten(0, (size, 2)) for field in fields)

    def validate(self, network, device, autocast):
        """Nothing: `snake_training.evaluation` measures scenes."""
        return {}

    def score(self, figures):
        """The last is the best."""
        return math.nan


class Placement:
    """A turn and a shift of a crop into a box of `side` voxels: of a share of them the turn is any, else about z."""

    def __init__(self, settings, rng):
        is_any = rng.random() < settings.turned_share
        self.turn = random_rotation(rng) if is_any else about_axis(2, rng.uniform(0, 2 * np.pi))
        self.shift, self.side = settings.side / 2 + rng.uniform(-4, 4, 3), settings.side

    def __call__(self, points):
        return (points @ self.turn.T + self.shift).astype(np.float32)

    def cut(self, points):
        """The points (N, 3), placed, that lie in the box."""
        placed = self(points)
        return placed[((placed >= 0) & (placed < self.side - 1)).all(axis=1)]

    def inside(self, placed, margin):
        """(..., 3) -> (...): which placed positions lie so many voxels within the box."""
        return ((placed > margin) & (placed < self.side - 1 - margin)).all(axis=-1)


def shown(points, rng):
    """The points (K, 3) of a view (M, 3) for a network: half of the views are thinned, a third have noise."""
    if rng.random() < 0.5:
        share = MAX_THINNING ** -rng.random()
        points = points[rng.permutation(len(points))[: max(int(len(points) * share), 30)]]
    if rng.random() < 0.35:
        points = points + rng.uniform(0, MAX_NOISE) * rng.standard_normal(points.shape)
    return points


def sample_of(crop, settings, rng):
    """The arrays of a crop that `Scenes.batch` joins; None if a box holds too little. The views are turned and moved each by
    itself and cut to a box."""
    placements = [Placement(settings, rng) for _ in range(2)]
    points = [placement.cut(shown(crop[f"points_{view}"], rng)) for view, placement in enumerate(placements)]
    sides = [(placement(crop[f"solid_{view}"]), placement(crop["free"])) for view, placement in enumerate(placements)]
    drawings = [[drawn(side, placement, settings, rng) for side in both] for both, placement in zip(sides, placements)]
    if min(map(len, points)) < 20 or any(some is None for both in drawings for some in both):
        return None
    surface = np.stack([np.concatenate(both) for both in drawings])
    boxes = placements if settings.num_grids else [*placements, Placement(settings, rng)]
    placed = np.stack([placement(crop["queries"]) for placement in boxes])
    rows = np.flatnonzero(np.all([placement.inside(at, 1.0) for placement, at in zip(boxes, placed)], axis=0))
    if len(rows) < 50:
        return None
    if settings.num_grids:  # the crop's queries lie near what both sensors saw
        grid = local_grid(settings.grid_size, GRID_SIDE)
        centers = crop["queries"][rows[rng.integers(len(rows), size=settings.num_grids)]]
        grids = np.stack([placement((centers[:, None] + grid).reshape(-1, 3)) for placement in placements])
        inside = np.stack([placement.inside(at, 0.5) for placement, at in zip(placements, grids)])
        inside = inside.reshape(2, settings.num_grids, -1)
        return {"points": points, "queries": np.concatenate([surface, grids], axis=1), "inside": inside}
    rows = rows[rng.integers(len(rows), size=settings.queries)]
    clean = boxes[2].cut(crop["surface"])
    if len(clean) < 20:
        return None
    return {
        "points": points, "queries": np.concatenate([surface, placed[:2, rows]], axis=1), "level": crop["target"][rows],
        "surface_points": [clean], "surface_queries": placed[2, rows],
    }  # fmt: skip


def drawn(queries, placement, settings, rng):
    """Draws `num_occupancy` of the placed queries within the box, with repetition; None if the box has none."""
    within = queries[placement.inside(queries, 0.5)]
    return within[rng.integers(len(within), size=settings.num_occupancy)] if len(within) else None


def moments(parts):
    """Mean and standard deviation."""
    values = torch.cat([part.flatten() for part in parts])
    return values.mean().item(), values.std().item()


@torch.no_grad()
def started(crops, settings):
    """A new network whose layers have the statistics of made crops for constants, each measured behind those before it."""
    torch.manual_seed(settings.seed)
    network = SceneNetwork(settings.network)
    fresh = SnakeNetwork(NetworkConfig(**{name: getattr(network.config, name) for name in SHAPES}))
    tensors = fresh.state_dict()
    network.load_state_dict({name: tensors.get(name, value) for name, value in network.state_dict().items()})
    norms = {}
    for ours, theirs in zip(network.encoder.unet3d.doubles(), fresh.encoder.unet3d.doubles(), strict=True):
        for name in ("SingleConv1", "SingleConv2"):
            norms[getattr(ours, name)] = getattr(theirs, name).groupnorm
    batch = measured(crops, settings)

    def visit(layer, x, far):
        layer.fix(x, far, norms[layer].weight, norms[layer].bias, fresh.config.group_norm_groups)

    encoder, side = network.encoder, (settings.side,) * 3
    features = encoder.point_features(batch["points"], batch["owner"])
    volume = encoder.scatter(features, batch["points"], batch["owner"], 32, side)
    encoder.unet3d(volume, visit)
    return network


def measured(crops, settings):
    """The views of 16 crops, by which constants are measured."""
    task = Scenes(replace(settings, num_grids=1), crops)
    return task.batch(0, 16, stream=2)
