"""Targets for a student: the saliency of a trained network averaged over turned copies of each shape.

`python -m snake_training.teacher WEIGHTS -o targets.safetensors --data CORPUS`, then
`python -m snake_training.train --targets targets.safetensors --init WEIGHTS`. A network is only roughly equivariant, and its errors
in differently turned copies of a cloud are nearly independent: their mean repeats far better than any one of them (SuperPoint,
DeTone et al. 2018, averages over homographies for the same reason). A third of the copies has noise and a third is thinned, so
that the mean is what survives both. Still no labels.

The target is the highest of several networks: one student learns the keypoints of all.
"""

import json
from dataclasses import dataclass, replace

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save_file
from torch.utils.data import DataLoader, Dataset

from .arguments import option, parser_of
from .augment import BOUND, choose, normalize, random_rotation
from .config import setting
from .data import Mixture, Procedural, open_all
from .device import has_fast_bfloat16
from .export import load_network, replacing
from .progress import bar

QUANTUM = 1 / 32767  # of stored coordinates, which lie within +-0.5625
FORMAT = {"format": "snake-targets", "format_version": "3"}
CLEAN = slice(None, None, 3)  # which of the `copies` are as they are
LEAST = -3.0  # log-odds: lower targets are all alike to detection


@dataclass(frozen=True)
class TeacherSettings:
    """How targets are made."""

    procedural: int = setting(500, "procedural shapes added to those of the data")
    rotations: int = setting(9, "turned copies averaged")
    queries: int = setting(4096, "queries a shape")
    points: int = setting(4096, "points of a copy")
    seed: int = setting(1, "of queries, turns and noise")
    engine: str = setting("torch", "torch, or snake-rs: faster on a CPU", choices=("torch", "snake-rs"))
    scales: tuple = setting(
        (), "of several networks: factors of their log-odds above -3, so that peaks compare; default: 1", type=float
    )


def sample_queries(points, number, rng):
    """Queries (number, 3) about points (N, 3): most within a voxel or two of them, an eighth anywhere."""
    anywhere = rng.uniform(-BOUND, BOUND, (number // 8, 3))
    spread = rng.choice([0.015, 0.03], (number - len(anywhere), 1), p=[0.75, 0.25])
    near = points[rng.integers(len(points), size=len(spread))] + spread * rng.standard_normal((len(spread), 3))
    return np.concatenate([near, anywhere]).clip(-BOUND, BOUND).astype(np.float32)


def torch_teacher(network):
    """Points (K, N, 3) and queries (K, Q, 3) in network units -> log-odds of the saliency, occupancy, both (K, Q)."""
    device = next(network.parameters()).device
    autocast = has_fast_bfloat16(device)

    @torch.no_grad()
    def fields(points, queries):
        points, queries = (torch.from_numpy(a).to(device) for a in (points, queries))
        occupancy, saliency = network(points, queries, autocast)
        return torch.logit(saliency, eps=1e-6).cpu().numpy(), occupancy.cpu().numpy()

    return fields


def snake_rs_teacher(weights):
    """A teacher by snake-rs, for weight files on a CPU."""
    import snake_rs

    model = snake_rs.Model.load(weights)

    def fields(points, queries):
        volumes = [model.encode(cloud, normalization="none") for cloud in points]
        saliency = torch.from_numpy(np.stack([field.saliency(at) for field, at in zip(volumes, queries)]))
        occupancy = np.stack([field.occupancy(at) for field, at in zip(volumes, queries)])
        return torch.logit(saliency, eps=1e-6).numpy(), occupancy

    return fields


def copies(shape, number, points, rng):
    """Clouds (number, points, 3) of a shape (M, 3) in network units, each of points of its own.

    Of three, one is as it is, one has noise with a standard deviation of 0.01 to 0.035, and one is thinned 4 to 10 times.
    """
    clouds = []
    for copy in range(number):
        cloud = choose(rng, shape, points)
        if copy % 3 == 1:
            cloud = cloud + rng.uniform(0.01, 0.035) * rng.standard_normal(cloud.shape)
        elif copy % 3 == 2:
            cloud = choose(rng, cloud[: max(int(points / rng.uniform(4, 10)), 1)], points)
        clouds.append(cloud)
    return np.stack(clouds).astype(np.float32)


def averaged_fields(teacher, clouds, queries, rotations):
    """Mean log-odds of the saliency and mean occupancy, both (Q,), of queries (Q, 3) over clouds (K, N, 3), each turned by one
    of the rotations (K, 3, 3) together with the queries. The occupancy is that of the clean copies."""
    transposed = rotations.transpose(0, 2, 1)
    log_odds, occupancy = teacher(clouds @ transposed, queries @ transposed)
    return log_odds.mean(axis=0), occupancy[CLEAN].mean(axis=0)


def scales_of(settings, teachers):
    """One scale for each teacher. No teachers, or another number of scales, is a ValueError."""
    if teachers < 1:
        raise ValueError("no network to learn from")
    if len(settings.scales) not in (0, teachers):
        raise ValueError(f"scales must be one for each network, got {len(settings.scales)} for {teachers}")
    return settings.scales or (1.0,) * teachers


def target_of(fields, scales):
    """Target log-odds (Q,) of the averaged log-odds and occupancy (Q,) of each teacher: the highest of the scaled ones, lower
    off the surface, so that peaks lie on it."""
    lowered = [log_odds + np.log((occupancy + 0.02) / 1.02) - 0.7 for log_odds, occupancy in fields]
    return np.max(
        [LEAST + scale * np.maximum(part - LEAST, 0) for part, scale in zip(lowered, scales, strict=True)], axis=0
    )


class Targets:
    """Files of `write_targets`, of as many points and queries a shape.

    `targets.sample(rng)` is (points (N, 3), queries (Q, 3), target (Q,)) of one shape.
    """

    def __init__(self, *paths):
        files = []
        for path in paths:
            try:
                with safe_open(path, "np") as file:
                    metadata = file.metadata() or {}
                if not FORMAT.items() <= metadata.items():
                    raise ValueError("not a file of python -m snake_training.teacher")
                arrays = load_file(path)
                files.append([arrays[name] for name in ("points", "queries", "target")])
            except (SafetensorError, KeyError, ValueError) as error:
                raise ValueError(f"{path}: {error}") from error
        self.points, self.queries, self.target = map(np.concatenate, zip(*files))

    def __len__(self):
        return len(self.points)

    def sample(self, rng):
        """A random shape."""
        row = rng.integers(len(self))
        points, queries = (array[row].astype(np.float32) * QUANTUM for array in (self.points, self.queries))
        return points, queries, self.target[row].astype(np.float32)


class Draws(Dataset):
    """The teacher's input for each shape: (cloud (N, 3), queries (Q, 3), clouds (K, N, 3), rotations (K, 3, 3))."""

    def __init__(self, shapes, settings):
        self.shapes, self.settings = shapes, settings

    def __len__(self):
        return len(self.shapes)

    def __getitem__(self, row):
        settings = self.settings
        rng = np.random.default_rng([settings.seed, row])
        shape = normalize(self.shapes[row])[0]
        cloud = choose(rng, shape, settings.points)
        queries = sample_queries(cloud, settings.queries, rng)
        rotations = np.stack([random_rotation(rng) for _ in range(settings.rotations)])
        return cloud, queries, copies(shape, settings.rotations, settings.points, rng), rotations


def write_targets(path, teachers, shapes, settings, workers=0):
    """Targets of all shapes, clouds (M, 3), each with its own seed, to a safetensors file (temporary name, then rename).

    So many worker processes draw ahead of the teacher; 0: none.
    """
    stored = {
        "points": np.empty((len(shapes), settings.points, 3), np.int16),
        "queries": np.empty((len(shapes), settings.queries, 3), np.int16),
        "target": np.empty((len(shapes), settings.queries), np.float16),
    }
    scales = scales_of(settings, len(teachers))
    sees_surface = False
    drawn = DataLoader(Draws(shapes, settings), batch_size=None, num_workers=workers, collate_fn=tuple)
    for row, (cloud, queries, clouds, rotations) in enumerate(bar(drawn, unit="shape")):
        fields = [averaged_fields(teacher, clouds, queries, rotations) for teacher in teachers]
        sees_surface |= any((occupancy > 0.5).any() for _, occupancy in fields)
        stored["points"][row], stored["queries"][row] = ((a / QUANTUM).round() for a in (cloud, queries))
        stored["target"][row] = target_of(fields, scales)
    if not sees_surface:
        raise ValueError("the network sees no surface anywhere: train it first")
    with replacing(path) as temporary:
        save_file(stored, temporary, metadata=FORMAT | {"settings": json.dumps(vars(settings))})


def make_targets(output, weights, data, settings, device="cpu", workers=0):
    """Targets of the shapes of the data folders and procedural ones, by the networks in weight files, checkpoints or runs."""
    shapes = Mixture([*open_all(data, ()), Procedural(settings.procedural)], 0.0)
    if len(shapes) == 0:
        raise ValueError("no shapes: give data, or procedural shapes")
    if settings.engine == "snake-rs":
        teachers = [snake_rs_teacher(path) for path in weights]
    else:
        teachers = [torch_teacher(load_network(path, device)) for path in weights]
    write_targets(output, teachers, shapes, settings, workers)


def main(argv=None):
    """Command line."""
    arguments = {
        "weights": dict(nargs="+", help="the teachers: safetensors exports, checkpoints or run folders"),
        "-o": dict(dest="output", metavar="FILE", required=True, help="file to write, about 57 kB a shape"),
        "--data": option([], "corpus folders, or folders of clouds", str, nargs="*"),
        "--device": option("cpu", "torch device, for instance cuda"),
    }
    about = "Write the saliency of networks on shapes, averaged over turned copies, for train --targets."
    parser = parser_of("teacher", about, arguments)
    for name, field in TeacherSettings.__dataclass_fields__.items():
        parser.add_argument(f"--{name}", default=field.default, **{"type": field.type} | dict(field.metadata))
    given = vars(parser.parse_args(argv))
    settings = TeacherSettings(**{name: given[name] for name in TeacherSettings.__dataclass_fields__})
    settings = replace(settings, scales=tuple(settings.scales))
    for name in ("procedural", "rotations", "queries", "points"):
        if getattr(settings, name) < (name != "procedural"):
            parser.error(f"--{name} must be {int(name != 'procedural')} or more")
    try:
        make_targets(given["output"], given["weights"], given["data"], settings, given["device"])
    except ImportError as error:
        parser.error(f"{error}: --engine snake-rs needs the module snake_rs")
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
