"""Targets of distillation: the saliency of a trained network averaged over rotations of its input, or, without a network,
how much the clean surface bends.

`python -m snake_training.targets WEIGHTS -o targets.safetensors --data CORPUS`, then
`python -m snake_training.train --targets targets.safetensors --init WEIGHTS`. A network is only roughly equivariant, and
its errors in differently rotated copies of a cloud are nearly independent: their mean repeats far better than any one of
them (SuperPoint, DeTone et al. 2018, averages over homographies for the same reason). Still no labels.
"""

import argparse
import json
import sys
from typing import NamedTuple

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save_file
from tqdm import tqdm

from .augment import BOUND, choose, normalize, random_rotation
from .data import Mixture, Procedural, Stretched, open_shapes
from .data.scenes import Place, Places
from .device import has_fast_bfloat16
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
    autocast = has_fast_bfloat16(device)

    @torch.no_grad()
    def fields(points, queries):
        points, queries = (torch.from_numpy(a).to(device) for a in (points, queries))
        occupancy, saliency = network(points, queries, autocast)
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


def weighted_sum(teachers, shares):
    """A teacher whose log-odds are the sum of others' times their shares; its occupancy is their mean."""

    def fields(points, queries):
        log_odds, occupancy = zip(*(teacher(points, queries) for teacher in teachers))
        return sum(share * values for share, values in zip(shares, log_odds, strict=True)), np.mean(occupancy, axis=0)

    return fields


def averaged_fields(teacher, points, queries, rotations, whole=slice(None)):
    """Mean log-odds of the saliency and mean occupancy, both (Q,), of queries (Q, 3) over rotations (K, 3, 3).

    The points, (N, 3) or (K, N, 3) for copies that differ, and the queries are in network units and are turned together.
    The occupancy is that of the copies `whole`.
    """
    turned = rotations.transpose(0, 2, 1)
    log_odds, occupancy = teacher(points @ turned, queries @ turned)
    return log_odds.mean(axis=0), occupancy[whole].mean(axis=0)


WHOLE = slice(None, None, 3)  # which of the `disturbed_copies` are as they are


def disturbed_copies(shape, number, points, rng):
    """Clouds (number, points, 3) of a shape (M, 3) in network units, each of points of its own.

    Of three, one is as it is, one has noise with a standard deviation of 0.01 to 0.035, and one is thinned 4 to 10 times.
    """
    copies = []
    for copy in range(number):
        cloud = choose(rng, shape, points)
        if copy % 3 == 1:
            cloud = cloud + rng.uniform(0.01, 0.035) * rng.standard_normal(cloud.shape)
        elif copy % 3 == 2:
            cloud = choose(rng, cloud[: max(int(points / rng.uniform(4, 10)), 1)], points)
        copies.append(cloud)
    return np.stack(copies).astype(np.float32)


@torch.no_grad()
def surface_variation(surface, queries, radii=(0.125, 0.19, 0.28)):
    """What targets of places are made from, both (Q,): how strongly the surface (M, 3) bends about each query (Q, 3), as a
    logarithm, and how near the surface is, from 0 to 1.

    The response of one radius uses the eigenvalues of the covariance of the surface within it, weighted by 1 - (d / radius)^2:
    the least, which is the response of ISS (Zhong 2009), times the least's share of their sum, which is the surface
    variation of Pauly et al. (2002). The logarithms of three radii are averaged: their mean repeats better than any one.
    The surface is clean and whole, the views that a student is shown are not: it learns to see through noise and gaps
    (SuperPoint, DeTone et al. 2018, begins with the corners of synthetic shapes for the same reason).
    """
    surface, queries = torch.from_numpy(surface), torch.from_numpy(queries)
    outer = (surface[:, :, None] * surface[:, None, :]).flatten(1)
    powers = torch.cat([torch.ones(len(surface), 1), surface, outer], dim=1)
    responses, apart = [], []
    for some in queries.split(256):  # what fits a cache
        distance = torch.cdist(some, surface)
        weights = torch.stack([(1 - (distance / radius).square()).clamp(min=0) for radius in radii])
        weight, first, second = (weights @ powers).double().split([1, 3, 9], dim=2)
        weight = weight.clamp(min=1e-9)
        mean = first / weight
        covariance = (second / weight).unflatten(2, (3, 3)) - mean[..., :, None] * mean[..., None, :]
        values = torch.linalg.eigvalsh(covariance).clamp(min=0)
        response = values[..., 0].square() / values.sum(dim=2).clamp(min=1e-12)
        responses.append((response + 1e-9).log().mean(dim=0))
        apart.append(distance.amin(dim=1))
    beyond = (torch.cat(apart) - 0.01).clamp(min=0) / 0.02
    return torch.cat(responses).float().numpy(), (-0.5 * beyond.square()).exp().numpy()


@torch.no_grad()
def local_contrast(surface, queries, scales=((0.25, 0.3), (0.5, 0.15)), samples=2048):
    """What local targets are made from, both (Q,): how much the surface (M, 3) about each query (Q, 3) stands out from its
    neighbourhood, in standard deviations, and how near the surface is, from 0 to 1.

    What stands out is the distance of a surface point from the centroid of the surface within a radius, divided by the
    radius (the zero-moment shift of Clarenz et al. 2004): large at tips, corners and edges. It is an average over many points, so noise
    hardly moves it. For each pair (radius, neighbourhood) of `scales` its mean within the neighbourhood is subtracted and
    the rest divided by the deviation there; the scores are averaged. A query takes the score of the surface nearest to it.
    """
    surface, queries = torch.from_numpy(surface[:samples]), torch.from_numpy(queries)
    squared = torch.cdist(surface, surface).square()

    def kernel(radius):
        weight = (1 - squared / radius**2).clamp(min=0)
        return weight / weight.sum(dim=1, keepdim=True)

    score = torch.zeros(len(surface))
    for radius, neighborhood in scales:
        offset = (kernel(radius) @ surface - surface).norm(dim=1) / radius
        near = kernel(neighborhood)
        mean = near @ offset
        deviation = (near @ offset.square() - mean.square()).clamp(min=0).sqrt()
        score += (offset - mean) / (deviation + 0.1 * offset.std() + 1e-6) / len(scales)
    values, apart = [], []
    for some in queries.split(512):  # what fits a cache
        distance = torch.cdist(some, surface)
        nearest = distance.amin(dim=1)
        weight = (-0.5 * (distance.square() - nearest[:, None].square()) / 0.0125**2).exp()
        values.append(weight @ score / weight.sum(dim=1))
        apart.append(nearest)
    beyond = (torch.cat(apart) - 0.01).clamp(min=0) / 0.02
    return torch.cat(values).numpy(), (-0.5 * beyond.square()).exp().numpy()


def rank_targets(log_odds, occupancy):
    """Target log-odds, same shape, from the averaged fields, or the `surface_variation`, of all shapes.

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


@torch.no_grad()
def sharpen(target, queries, radius=0.15):
    """Targets (Q,) of one shape's queries (Q, 3) with a sharp peak at each local maximum, wherever on the shape it is.

    A logarithm of the share of the surface queries within `radius` that have a higher target, plus a quarter of the target,
    by which the peaks are ordered. What a shape's best place does to `rank_targets`, each place does to its neighbourhood.
    """
    at, value = torch.from_numpy(queries), torch.from_numpy(target)
    sharp = torch.full_like(value, -3.0)
    asked = value > -2.9
    at, value = at[asked], value[asked]
    on_surface = (value > -1.3).float()
    shares = []
    for some, values in zip(at.split(512), value.split(512)):
        weight = (1 - torch.cdist(some, at).square() / radius**2).clamp(min=0) * on_surface
        higher = (weight * (value[None] > values[:, None])).sum(dim=1)
        shares.append(higher / weight.sum(dim=1).clamp(min=1e-6))
    peaks = -0.6 * (torch.cat(shares) + 0.01).log() - 1 + 0.25 * value - 0.6 * (1 - on_surface)
    sharp[asked] = peaks.clamp(min=-3)
    return sharp.numpy()


def mean_targets(log_odds, occupancy):
    """Target log-odds, same shape: the averaged ones as they are, but lower off the surface, so that peaks lie on it."""
    return np.maximum(log_odds + np.log((occupancy + 0.02) / 1.02) - 0.7, -3)


def seek_modes(log_odds, occupancy, queries, radius=0.04, starts=704, spacing=0.05, limit=64):
    """Keypoints (K, 3) of an averaged field at queries (Q, 3), best first, by the mean shift of snake-rs.

    The best `starts` move three times to the mean within `radius`, weighted by a power of the saliency. The radius falls and
    the power rises, so that modes come near to the peaks; those nearer than `spacing` to a better one are dropped.
    """
    on_surface = occupancy > 0.8
    if not on_surface.any():
        raise ValueError("the network sees no surface in a shape: train it first")
    at, saliency = (torch.from_numpy(a[on_surface]).double() for a in (queries, 1 / (1 + np.exp(-log_odds))))
    relative = saliency / saliency.amax()
    modes = at[saliency.argsort(descending=True)[:starts]]
    for share, power in ((1, 8), (0.85, 12), (0.7, 16)):
        near = (torch.cdist(modes, at) <= share * radius) * relative**power
        total = near.sum(dim=1, keepdim=True)
        modes = torch.where(total > 0, near @ at / total.clamp(min=1e-30), modes)
    distance, nearest = torch.cdist(modes, at).topk(min(4, len(at)), largest=False)
    near = (-((distance / 0.015) ** 2)).exp() + 1e-9
    score = (near * saliency[nearest]).sum(dim=1) / near.sum(dim=1)
    kept = []
    for mode in modes[score.argsort(descending=True)]:
        if len(kept) < limit and all((mode - other).norm() >= spacing for other in kept):
            kept.append(mode)
    return torch.stack(kept)


@torch.no_grad()
def keypoint_targets(log_odds, occupancy, queries, width=0.03):
    """Targets (Q,) of one shape's queries (Q, 3): the averaged log-odds with a bump at each of its keypoints.

    The field of a student is as smooth as its targets, and the smallest error moves a wide peak far. The keypoints of the
    mean over rotations repeat best, so the bumps, about as wide as a voxel of 32, mark what the student is to find.
    """
    keypoints = seek_modes(log_odds, occupancy, queries)
    nearest = torch.cdist(torch.from_numpy(queries).double(), keypoints).amin(dim=1).numpy()
    return mean_targets(log_odds + 2 * np.exp(-0.5 * (nearest / width) ** 2), occupancy)


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


class Fields(NamedTuple):
    """What `write_targets` computes of one shape."""

    points: np.ndarray
    queries: np.ndarray
    log_odds: np.ndarray
    occupancy: np.ndarray
    views: int
    is_ranked_alone: bool


def fields_of(row, shape, teacher, rotations=8, queries=4096, points=4096, seed=1, local=None, disturbed=False):
    """The `Fields` of one shape; its number, `row`, and the seed determine the draws."""
    rng = np.random.default_rng([seed, row])
    if isinstance(shape, Place):
        cloud = np.concatenate([choose(rng, view, points // len(shape.views)) for view in shape.views])
        at = sample_queries(shape.surface, queries, rng)
        return Fields(cloud, at, *surface_variation(choose(rng, shape.surface, points), at), len(shape.views), False)
    shape = normalize(shape)[0]
    cloud = choose(rng, shape, points)
    at = sample_queries(cloud, queries, rng)
    if teacher:
        turns = np.stack([random_rotation(rng) for _ in range(rotations)])
        if disturbed:
            copies = disturbed_copies(shape, rotations, points, rng)
            return Fields(cloud, at, *averaged_fields(teacher, copies, at, turns, WHOLE), 1, False)
        return Fields(cloud, at, *averaged_fields(teacher, cloud, at, turns), 1, False)
    return Fields(cloud, at, *(local_contrast if local else surface_variation)(cloud, at), 1, True)


def write_targets(
    path, teacher, shapes, rotations=8, queries=4096, points=4096, seed=1, metadata=None, local=None, disturbed=False,
    fields=None,
):  # fmt: skip
    """Targets of all shapes, each with its own seed, to a safetensors file (temporary name, then rename).

    A shape is a cloud (M, 3), or a `Place` whose number of views divides `points`. Without a teacher, and of places
    always, the targets are the `surface_variation`, or if `local` is "contrast" or "peaks" the `local_contrast`, for peaks
    with `sharpen`. With `local` "keypoints" they are the `keypoint_targets` of the teacher, with "mean" its `mean_targets`;
    `disturbed` averages over `disturbed_copies`. Ranks without a teacher are those within a cloud, which is as it is seen;
    places are parts of larger scenes and are ranked together, as a teacher's values are. `fields` has the number and the
    `Fields` of each shape, in any order, if they are computed elsewhere.
    """
    stored = {
        name: np.empty((len(shapes), size, 3), np.int16) for name, size in (("points", points), ("queries", queries))
    }
    views = np.ones(len(shapes), np.uint8)
    log_odds, occupancy = np.empty((2, len(shapes), queries), np.float32)
    alone = []  # rows that are ranked by themselves
    settings = (teacher, rotations, queries, points, seed, local, disturbed)
    fields = fields or ((row, fields_of(row, shapes[row], *settings)) for row in range(len(shapes)))
    for row, found in tqdm(fields, total=len(shapes), unit="shape", mininterval=2 if sys.stderr.isatty() else 60):
        log_odds[row], occupancy[row], views[row] = found.log_odds, found.occupancy, found.views
        alone += [row] if found.is_ranked_alone else []
        for name, positions in (("points", found.points), ("queries", found.queries)):
            stored[name][row] = (positions / QUANTUM).round()
    target = np.empty(log_odds.shape, np.float16)
    if local == "keypoints":
        for row, at in enumerate(stored["queries"]):
            target[row] = keypoint_targets(log_odds[row], occupancy[row], at.astype(np.float32) * QUANTUM)
        alone, together = [], []
    elif local == "mean":
        target[:] = mean_targets(log_odds, occupancy)
        alone, together = [], []
    else:
        together = np.setdiff1d(np.arange(len(shapes)), alone)
    for rows in [*alone, together] if len(together) else alone:
        target[rows] = rank_targets(log_odds[rows], occupancy[rows])
    for row in range(len(shapes)) if local == "peaks" else ():
        at = stored["queries"][row].astype(np.float32) * QUANTUM
        target[row] = sharpen(target[row].astype(np.float32), at)
    stored |= {"target": target, "views": views}
    with replacing(path) as temporary:
        save_file(stored, temporary, metadata=FORMAT | (metadata or {}))


def open_all(arguments):
    """The shapes and the teacher that the command line names."""
    clouds = Mixture([open_shapes(folder) for folder in arguments.data], 0.0)
    copies = [Stretched(clouds, arguments.stretched)] if arguments.stretched else []
    shapes = Mixture([clouds, *copies, Procedural(arguments.procedural)], 0.0)
    if arguments.places:
        shapes = Places(Mixture([clouds] if len(clouds) else [], 0.25), arguments.places, seed=arguments.seed)
    if not arguments.weights:
        return shapes, None
    if arguments.engine == "snake-rs":
        teachers = [snake_rs_teacher(path) for path in arguments.weights]
    else:
        teachers = [torch_teacher(load_network(path, arguments.device)) for path in arguments.weights]
    return shapes, weighted_sum(teachers, arguments.shares or [1 / len(teachers)] * len(teachers))


class FieldsOnCluster:
    """The `Fields` of the rows of a batch, for `ray.data.Dataset.map_batches`. Each actor opens the shapes and the teacher."""

    def __init__(self, arguments):
        torch.set_num_threads(1)
        self.arguments, (self.shapes, self.teacher) = arguments, open_all(arguments)

    def __call__(self, batch):
        given = self.arguments
        settings = given.rotations, given.queries, given.points, given.seed, given.local, given.disturbed
        found = [fields_of(row, self.shapes[int(row)], self.teacher, *settings) for row in batch["id"].tolist()]
        return {"id": batch["id"]} | {name: np.stack([getattr(of, name) for of in found]) for name in Fields._fields}


def fields_on_cluster(arguments, number):
    """The number and the `Fields` of each shape, as Ray's actors finish them."""
    import ray
    import ray.data

    ray.init(ignore_reinit_error=True, log_to_driver=False)
    # Not `ray.data.range`, whose tasks would wait for a processor that the actors hold.
    rows = ray.data.from_items([{"id": row} for row in range(number)], override_num_blocks=-(-number // 8))
    settings = {"fn_constructor_args": (arguments,), "batch_size": 8, "concurrency": arguments.ray, "num_cpus": 1}
    for row in rows.map_batches(FieldsOnCluster, **settings).iter_rows():
        yield int(row.pop("id")), Fields(**row)


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.targets",
        description="Write the rotation-averaged saliency of a network on shapes, for train --targets.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument(
        "weights",
        nargs="*",
        help="the teachers: safetensors exports, checkpoints or run folders; without any, how much the surface bends",
    )
    parser.add_argument(
        "--shares",
        type=float,
        nargs="*",
        help="what the log-odds of each teacher are multiplied by before they are added; by default their mean is taken",
    )
    parser.add_argument("-o", "--output", required=True, help="file to write, about 57 kB a shape")
    parser.add_argument(
        "--data", nargs="*", default=[], help="corpus folders, folders of .npy / .ply files, or of WebDataset shards"
    )
    parser.add_argument("--stretched", type=int, default=0, help="stretched copies added of each shape of the data")
    parser.add_argument("--procedural", type=int, default=500, help="procedural shapes added")
    parser.add_argument(
        "--places",
        type=int,
        default=0,
        help="instead: this many places in rooms, with the data in them; no weights are used",
    )
    parser.add_argument(
        "--local",
        choices=("contrast", "peaks", "keypoints", "mean"),
        help="instead of a teacher: how much the surface stands out from its neighbourhood, ranked over the whole shape; "
        "peaks: ranked in each neighbourhood too; keypoints: the teacher's saliency with a bump at each of its keypoints; mean: the teacher's saliency, not its ranks",
    )
    parser.add_argument(
        "--disturbed",
        action="store_true",
        help="of the rotated copies a third has noise and a third is thinned, so that what they hide is averaged out",
    )
    parser.add_argument("--rotations", type=int, default=8, help="rotated copies averaged")
    parser.add_argument("--queries", type=int, default=4096, help="queries a shape")
    parser.add_argument("--points", type=int, default=4096, help="points a shape")
    parser.add_argument("--seed", type=int, default=1, help="of queries and rotations")
    parser.add_argument(
        "--engine", choices=("torch", "snake-rs"), default="torch", help="snake-rs: exports only, on a CPU"
    )
    parser.add_argument("--device", default="cpu", help="torch device, for instance cuda")
    parser.add_argument(
        "--ray",
        type=int,
        default=0,
        metavar="N",
        help="on so many processors of a Ray cluster: that of RAY_ADDRESS, else of this machine; all must see the data",
    )
    arguments = parser.parse_args(argv)
    least_of = dict(ray=0, stretched=0, procedural=0, places=0, rotations=1, queries=1, points=2)
    for name, least in least_of.items():
        if getattr(arguments, name) < least:
            parser.error(f"--{name} must be {least} or more")
    if arguments.places and arguments.weights:
        parser.error("--places makes its targets without a teacher; leave out the WEIGHTS")
    if arguments.shares and len(arguments.shares) != len(arguments.weights):
        parser.error("--shares needs as many numbers as there are WEIGHTS")
    of_teacher = arguments.local in ("keypoints", "mean")
    if (of_teacher or arguments.disturbed) and not arguments.weights:
        parser.error("--local keypoints, --local mean and --disturbed are for a teacher; give WEIGHTS")
    if arguments.local and (arguments.weights and not of_teacher or arguments.places):
        parser.error("--local makes its targets of whole shapes without a teacher; leave out WEIGHTS and --places")
    try:
        shapes, teacher = open_all(arguments)
        if len(shapes) == 0:
            parser.error("no shapes: give --data, --procedural or --places")
        settings = {
            name: json.dumps(getattr(arguments, name))
            for name in ("weights", "shares", "rotations", "seed", "disturbed")
        }
        fields = fields_on_cluster(arguments, len(shapes)) if arguments.ray else None
        write_targets(
            arguments.output, teacher, shapes, arguments.rotations, arguments.queries, arguments.points,
            arguments.seed, settings, arguments.local, arguments.disturbed, fields,
        )  # fmt: skip
    except ImportError as error:
        parser.error(f"{error}: --ray needs pip install 'ray[data]', --engine snake-rs the module snake_rs")
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
