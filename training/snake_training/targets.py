"""Targets of distillation: the saliency of a trained network averaged over rotations of its input.

`python -m snake_training.targets WEIGHTS -o targets.safetensors --data CORPUS`, then
`python -m snake_training.train --targets targets.safetensors --init WEIGHTS`. A network is only roughly equivariant, and
its errors in differently rotated copies of a cloud are nearly independent: their mean repeats far better than any one of
them (SuperPoint, DeTone et al. 2018, averages over homographies for the same reason). Still no labels.
"""

import argparse
import json

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save_file
from tqdm import tqdm

from .augment import BOUND, choose, normalize, random_rotation
from .data import Mixture, Procedural, open_shapes
from .export import load_network, replacing

QUANTUM = 1 / 32767  # of stored coordinates, which lie within +-0.5625
FORMAT = {"format": "snake-targets", "format_version": "1"}


def sample_queries(points, number, rng):
    """Queries (number, 3) about points (N, 3): most within a voxel or two of them, an eighth anywhere."""
    anywhere = rng.uniform(-BOUND, BOUND, (number // 8, 3))
    spread = rng.choice([0.015, 0.03], (number - len(anywhere), 1), p=[0.75, 0.25])
    near = points[rng.integers(len(points), size=len(spread))] + spread * rng.standard_normal((len(spread), 3))
    return np.concatenate([near, anywhere]).clip(-BOUND, BOUND).astype(np.float32)


@torch.no_grad()
def averaged_fields(network, points, queries, rotations):
    """Mean log-odds of the saliency and mean occupancy, both (Q,), of queries (Q, 3) over rotations (K, 3, 3).

    The points (N, 3) and the queries are in network units and are turned together.
    """
    device = next(network.parameters()).device
    points, queries, rotations = (torch.from_numpy(a).to(device) for a in (points, queries, rotations))
    turned = rotations.transpose(1, 2)
    occupancy, saliency = network(points @ turned, queries @ turned, autocast=True)
    return torch.logit(saliency, eps=1e-6).mean(dim=0).cpu().numpy(), occupancy.mean(dim=0).cpu().numpy()


def rank_targets(log_odds, occupancy):
    """Target log-odds, same shape, from the averaged fields of all shapes.

    The value is 0.6 T - 1 with T minus the logarithm of the share of surface queries that are more salient, so that the
    few best are as far apart as the many others: a trained saliency saturates, and what detection needs, the order among
    its highest values, is lost in rounding. 5 % of the surface lie above the usual threshold of 0.7. Weighing by the
    occupancy draws peaks onto the surface and lowers what is off it.
    """
    surface = np.log((occupancy + 0.02) / 1.02)
    score = log_odds + 2 * surface
    ranked = np.sort(score[occupancy > 0.5])
    if len(ranked) == 0:
        raise ValueError("the network sees no surface anywhere: train it first")
    share = 1 - np.searchsorted(ranked, score) / len(ranked)
    return np.maximum(-0.6 * np.log(share + 1e-4) - 1 + surface, -3)


class Targets:
    """A file of `write_targets`: `targets.sample(rng)` is (points (N, 3), queries (Q, 3), target (Q,)) of one shape."""

    def __init__(self, path):
        try:
            with safe_open(path, "np") as file:
                metadata = file.metadata() or {}
            if not FORMAT.items() <= metadata.items():
                raise ValueError("not a file of python -m snake_training.targets")
            arrays = load_file(path)
            self.points, self.queries, self.target = (arrays[name] for name in ("points", "queries", "target"))
        except (SafetensorError, KeyError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from error

    def __len__(self):
        return len(self.points)

    def sample(self, rng):
        """A random shape."""
        row = rng.integers(len(self))
        points, queries = (array[row].astype(np.float32) * QUANTUM for array in (self.points, self.queries))
        return points, queries, self.target[row].astype(np.float32)


def write_targets(path, network, shapes, rotations=8, queries=4096, points=4096, seed=1, metadata=None):
    """Targets of all shapes, each with its own seed, to a safetensors file (temporary name, then rename)."""
    stored = {
        name: np.empty((len(shapes), size, 3), np.int16) for name, size in (("points", points), ("queries", queries))
    }
    log_odds, occupancy = np.empty((2, len(shapes), queries), np.float32)
    for row in tqdm(range(len(shapes)), unit="shape"):
        rng = np.random.default_rng([seed, row])
        cloud = choose(rng, normalize(shapes[row])[0], points)
        at = sample_queries(cloud, queries, rng)
        turns = np.stack([random_rotation(rng) for _ in range(rotations)])
        log_odds[row], occupancy[row] = averaged_fields(network, cloud, at, turns)
        stored["points"][row], stored["queries"][row] = ((a / QUANTUM).round() for a in (cloud, at))
    stored["target"] = rank_targets(log_odds, occupancy).astype(np.float16)
    with replacing(path) as temporary:
        save_file(stored, temporary, metadata=FORMAT | (metadata or {}))


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.targets",
        description="Write the rotation-averaged saliency of a network on shapes, for train --targets.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("weights", help="the teacher: a safetensors export, checkpoint or run folder")
    parser.add_argument("-o", "--output", required=True, help="file to write, about 57 kB a shape")
    parser.add_argument("--data", nargs="*", default=[], help="corpus folders or folders of .npy / .ply files")
    parser.add_argument("--procedural", type=int, default=500, help="procedural shapes added")
    parser.add_argument("--rotations", type=int, default=8, help="rotated copies averaged")
    parser.add_argument("--queries", type=int, default=4096, help="queries a shape")
    parser.add_argument("--points", type=int, default=4096, help="points a shape")
    parser.add_argument("--seed", type=int, default=1, help="of queries and rotations")
    parser.add_argument("--device", default="cpu", help="torch device, for instance cuda")
    arguments = parser.parse_args(argv)
    for name, least in {"procedural": 0, "rotations": 1, "queries": 1, "points": 2}.items():
        if getattr(arguments, name) < least:
            parser.error(f"--{name} must be {least} or more")
    try:
        shapes = Mixture([*map(open_shapes, arguments.data), Procedural(arguments.procedural)], 0.0)
        if len(shapes) == 0:
            parser.error("no shapes: give --data or --procedural")
        settings = {name: json.dumps(getattr(arguments, name)) for name in ("weights", "rotations", "seed")}
        write_targets(
            arguments.output, load_network(arguments.weights, arguments.device), shapes, arguments.rotations,
            arguments.queries, arguments.points, arguments.seed, settings,
        )  # fmt: skip
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
