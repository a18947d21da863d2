"""Targets of distillation: the saliency of a trained network averaged over rotations of its input, or corners of rooms.

`python -m snake_training.targets WEIGHTS -o targets.safetensors --data CORPUS`, then
`python -m snake_training.train --targets targets.safetensors --init WEIGHTS`. A network is only roughly equivariant, and
its errors in differently rotated copies of a cloud are nearly independent: their mean repeats far better than any one of
them (SuperPoint, DeTone et al. 2018, averages over homographies for the same reason). Still no labels.
"""

import argparse
import json
import sys

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save_file
from tqdm import tqdm

from .augment import BOUND, choose, normalize, random_rotation
from .data import Mixture, Procedural, Stretched, open_shapes
from .data.scenes import Place, Places
from .export import load_network, replacing

QUANTUM = 1 / 32767  # of stored coordinates, which lie within +-0.5625
FORMAT = {"format": "snake-targets", "format_version": "2"}


def sample_queries(points, number, rng):
    """Queries (number, 3) about points (N, 3): most within a voxel or two of them, an eighth anywhere."""
    anywhere = rng.uniform(-BOUND, BOUND, (number // 8, 3))
    spread = rng.choice([0.015, 0.03], (number - len(anywhere), 1), p=[0.75, 0.25])
    near = points[rng.integers(len(points), size=len(spread))] + spread * rng.standard_normal((len(spread), 3))
    return np.concatenate([near, anywhere]).clip(-BOUND, BOUND).astype(np.float32)


def torch_teacher(network):
    """Points (K, N, 3) and queries (K, Q, 3) in network units -> log-odds of the saliency, occupancy, both (K, Q)."""
    device = next(network.parameters()).device

    @torch.no_grad()
    def fields(points, queries):
        points, queries = (torch.from_numpy(a).to(device) for a in (points, queries))
        occupancy, saliency = network(points, queries, autocast=True)
        return torch.logit(saliency, eps=1e-6).cpu().numpy(), occupancy.cpu().numpy()

    return fields


def snake_rs_teacher(weights):
    """The same by snake-rs, for exports: on a CPU twice as fast."""
    import snake_rs

    model = snake_rs.Model.load(weights)

    def fields(points, queries):
        volumes = [model.encode(cloud, normalization="none") for cloud in points]
        saliency = torch.from_numpy(np.stack([field.saliency(at) for field, at in zip(volumes, queries)]))
        occupancy = np.stack([field.occupancy(at) for field, at in zip(volumes, queries)])
        return torch.logit(saliency, eps=1e-6).numpy(), occupancy

    return fields


def averaged_fields(teacher, points, queries, rotations):
    """Mean log-odds of the saliency and mean occupancy, both (Q,), of queries (Q, 3) over rotations (K, 3, 3).

    The points (N, 3) and the queries are in network units and are turned together.
    """
    turned = rotations.transpose(0, 2, 1)
    log_odds, occupancy = teacher(points @ turned, queries @ turned)
    return log_odds.mean(axis=0), occupancy.mean(axis=0)


@torch.no_grad()
def corners(surface, queries, scale=0.04):
    """What a room's targets are made from, both (Q,): how much of a corner the surface (M, 3) is about each query (Q, 3),
    as a logarithm, and how near the surface is, from 0 to 1.

    A corner has normals in three directions: the smallest eigenvalue of their second moment, Gaussian weighted, is zero on
    planes and straight edges (Shi and Tomasi 1994, of normals). The surface is clean and whole, the views that a student
    is shown are not: it learns to see through noise and gaps (SuperPoint, DeTone et al. 2018, begins with the corners of
    synthetic shapes for the same reason).
    """
    surface, queries = torch.from_numpy(surface), torch.from_numpy(queries)
    near = (torch.cdist(surface, surface) < 0.05).float()
    number = near.sum(dim=1)[:, None]
    mean = near @ surface / number
    covariance = (near @ outer(surface) / number - outer(mean)).unflatten(1, (3, 3))
    normals = torch.linalg.eigh(covariance.double()).eigenvectors[:, :, 0].float()
    apart = torch.cdist(queries, surface)
    weight = torch.exp(-0.5 * (apart / scale) ** 2)
    moment = (weight @ outer(normals) / weight.sum(dim=1, keepdim=True).clamp(min=1e-3)).unflatten(1, (3, 3))
    least = torch.linalg.eigvalsh(moment.double())[:, 0].clamp(min=0)
    nearness = torch.exp(-0.5 * (apart.min(dim=1).values / 0.02) ** 2)
    return (least + 1e-3).log().numpy(), nearness.numpy()


def outer(vectors):
    """Each vector (N, 3) times itself, (N, 9)."""
    return (vectors[:, :, None] * vectors[:, None, :]).flatten(1)


def rank_targets(log_odds, occupancy):
    """Target log-odds, same shape, from the averaged fields, or `corners`, of all shapes.

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
    """Files of `write_targets`, of as many points and queries a shape.

    `targets.sample(rng)` is (views (V, N, 3), queries (Q, 3), target (Q,)) of one shape.
    """

    def __init__(self, *paths):
        files = []
        for path in paths:
            try:
                with safe_open(path, "np") as file:
                    metadata = file.metadata() or {}
                if not FORMAT.items() <= metadata.items():
                    raise ValueError("not a file of python -m snake_training.targets")
                arrays = load_file(path)
                files.append([arrays[name] for name in ("points", "queries", "target", "views")])
            except (SafetensorError, KeyError, ValueError) as error:
                raise ValueError(f"{path}: {error}") from error
        self.points, self.queries, self.target, self.views = map(np.concatenate, zip(*files))

    def __len__(self):
        return len(self.points)

    def sample(self, rng):
        """A random shape."""
        row = rng.integers(len(self))
        points, queries = (array[row].astype(np.float32) * QUANTUM for array in (self.points, self.queries))
        return points.reshape(self.views[row], -1, 3), queries, self.target[row].astype(np.float32)


def write_targets(path, teacher, shapes, rotations=8, queries=4096, points=4096, seed=1, metadata=None):
    """Targets of all shapes, each with its own seed, to a safetensors file (temporary name, then rename).

    A shape is a cloud (M, 3), which a teacher looks at, or a `Place` whose number of views divides `points`.
    """
    stored = {
        name: np.empty((len(shapes), size, 3), np.int16) for name, size in (("points", points), ("queries", queries))
    }
    views = np.ones(len(shapes), np.uint8)
    log_odds, occupancy = np.empty((2, len(shapes), queries), np.float32)
    for row in tqdm(range(len(shapes)), unit="shape", mininterval=2 if sys.stderr.isatty() else 60):
        rng = np.random.default_rng([seed, row])
        shape = shapes[row]
        if isinstance(shape, Place):
            views[row] = len(shape.views)
            cloud = np.concatenate([choose(rng, view, points // len(shape.views)) for view in shape.views])
            at = sample_queries(shape.surface, queries, rng)
            log_odds[row], occupancy[row] = corners(choose(rng, shape.surface, points), at)
        else:
            cloud = choose(rng, normalize(shape)[0], points)
            at = sample_queries(cloud, queries, rng)
            turns = np.stack([random_rotation(rng) for _ in range(rotations)])
            log_odds[row], occupancy[row] = averaged_fields(teacher, cloud, at, turns)
        stored["points"][row], stored["queries"][row] = ((a / QUANTUM).round() for a in (cloud, at))
    stored |= {"target": rank_targets(log_odds, occupancy).astype(np.float16), "views": views}
    with replacing(path) as temporary:
        save_file(stored, temporary, metadata=FORMAT | (metadata or {}))


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.targets",
        description="Write the rotation-averaged saliency of a network on shapes, for train --targets.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("weights", nargs="?", help="the teacher: a safetensors export, checkpoint or run folder")
    parser.add_argument("-o", "--output", required=True, help="file to write, about 57 kB a shape")
    parser.add_argument("--data", nargs="*", default=[], help="corpus folders or folders of .npy / .ply files")
    parser.add_argument("--stretched", type=int, default=0, help="stretched copies added of each shape of the data")
    parser.add_argument("--procedural", type=int, default=500, help="procedural shapes added")
    parser.add_argument(
        "--places",
        type=int,
        default=0,
        help="instead: corners of places in rooms, with the data in them; no weights are needed",
    )
    parser.add_argument("--rotations", type=int, default=8, help="rotated copies averaged")
    parser.add_argument("--queries", type=int, default=4096, help="queries a shape")
    parser.add_argument("--points", type=int, default=4096, help="points a shape")
    parser.add_argument("--seed", type=int, default=1, help="of queries and rotations")
    parser.add_argument(
        "--engine", choices=("torch", "snake-rs"), default="torch", help="snake-rs: exports only, on a CPU"
    )
    parser.add_argument("--device", default="cpu", help="torch device, for instance cuda")
    arguments = parser.parse_args(argv)
    for name, least in {
        "stretched": 0,
        "procedural": 0,
        "places": 0,
        "rotations": 1,
        "queries": 1,
        "points": 2,
    }.items():
        if getattr(arguments, name) < least:
            parser.error(f"--{name} must be {least} or more")
    try:
        clouds = Mixture([open_shapes(folder) for folder in arguments.data], 0.0)
        copies = [Stretched(clouds, arguments.stretched)] if arguments.stretched else []
        shapes = Mixture([clouds, *copies, Procedural(arguments.procedural)], 0.0)
        if arguments.places:
            shapes = Places(Mixture([clouds] if len(clouds) else [], 0.25), arguments.places, seed=arguments.seed)
        if len(shapes) == 0:
            parser.error("no shapes: give --data, --procedural or --places")
        settings = {name: json.dumps(getattr(arguments, name)) for name in ("weights", "rotations", "seed")}
        if not (arguments.places or arguments.weights):
            parser.error("give the WEIGHTS of a teacher, or --places")
        teachers = {
            "snake-rs": snake_rs_teacher,
            "torch": lambda weights: torch_teacher(load_network(weights, arguments.device)),
        }
        teacher = None if arguments.places else teachers[arguments.engine](arguments.weights)
        write_targets(
            arguments.output, teacher, shapes, arguments.rotations, arguments.queries, arguments.points,
            arguments.seed, settings,
        )  # fmt: skip
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
