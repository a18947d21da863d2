"""Plain PyTorch detection (SNAKE Algorithm 1) and relative repeatability (`python -m snake_training.evaluate --help`).

The reference that the Rust implementation is compared with: one volume a cloud, every step written as the paper has it.
"""

import json
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from .arguments import DATA, option, parser_of
from .augment import choose, normalize, random_rotation
from .data import open_shapes
from .export import load_network
from .model import voxel_index

CHOICES = {
    "normalization": ("unit-sphere", "unit-cube", "none"),
    "refine_method": ("adam", "gradient-descent"),
    "selection": ("best-position", "reference-final-position"),
}


@dataclass(frozen=True)
class DetectOptions:
    """Options of detection; the names and defaults of snake-rs."""

    normalization: str = "unit-sphere"
    query_resolution: int = 64  # queries along each axis
    query_band: int = 0  # voxels: queries farther than this from every voxel with points are dropped; 0: none is
    occupancy_threshold: float = 0.5  # queries below are dropped before refinement
    refine_steps: int = 10  # J
    refine_step_size: float = 1e-3  # network units (Adam's learning rate)
    refine_method: str = "adam"  # or gradient-descent
    selection: str = "best-position"  # or reference-final-position
    surface_threshold: float = 0.8  # a position below this occupancy scores 0
    saliency_threshold: float = 0.7
    nms_radius: float = 0.01  # cloud units
    max_keypoints: int = 64

    def __post_init__(self):
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} {getattr(self, name)!r} is none of {', '.join(allowed)}")


def query_grid(config, resolution, device):
    """(R^3, 3) queries on linspace(-0.5, 0.5) per axis, z within its bounds, x slowest."""
    xy = torch.linspace(-0.5, 0.5, resolution, device=device)
    z = torch.linspace(config.z_min, config.z_max, resolution, device=device)
    return torch.stack(torch.meshgrid(xy, xy, z, indexing="ij"), dim=-1).reshape(-1, 3)


def refine(network, volume, queries, options):
    """Ascent of queries (K, 3) on the saliency; returns positions and scores by `options.selection`.

    Adam climbs 1 - mean saliency of all the queries; gradient descent moves each query by its own gradient.
    A score is saliency x [occupancy > surface threshold]. `best-position` returns the best-scored position, the one
    after the last step included; `reference-final-position` the last position with the best score before any step.
    """
    position = queries.clone().requires_grad_()
    adam = torch.optim.Adam([position], lr=options.refine_step_size)
    best_score, best_position = torch.full_like(queries[:, 0], -1.0), queries.clone()
    for step in range(options.refine_steps + 1):
        last = step == options.refine_steps
        if last and options.selection == "reference-final-position" and step > 0:
            return position.detach(), best_score
        with torch.set_grad_enabled(not last):
            occupancy, saliency = network.occupancy_and_saliency(volume, position[None])
        score = (saliency * (occupancy > options.surface_threshold))[0].detach()
        better = score > best_score
        best_score = torch.where(better, score, best_score)
        best_position = torch.where(better[:, None], position.detach(), best_position)
        if not last:
            mean = saliency.mean() if options.refine_method == "adam" else saliency.sum()
            (position.grad,) = torch.autograd.grad(1 - mean, position)
            if options.refine_method == "adam":
                adam.step()
            else:
                position.data -= options.refine_step_size * position.grad
    return best_position, best_score


def suppress(points, radius, limit):
    """Indices kept by greedy suppression of points sorted by score: farther than `radius` from every kept one."""
    kept, alive = [], torch.arange(len(points), device=points.device)
    while len(alive) and len(kept) < limit:
        kept.append(int(alive[0]))
        alive = alive[1:]
        if radius > 0:
            alive = alive[(points[alive] - points[kept[-1]]).norm(dim=1) > radius]
    return kept


def rank(position, score, options):
    """Positions (K, 3) and scores (K,) above the saliency threshold as rows x y z score on the CPU, by falling score."""
    kept = score > options.saliency_threshold
    order = score[kept].argsort(descending=True, stable=True)
    return torch.cat([position[kept], score[kept][:, None]], dim=1)[order].cpu()


def select(position, score, options):
    """Keypoints (K, 4) numpy of refined positions in the cloud's frame: threshold, rank, suppress."""
    found = rank(position, score, options)
    return found[suppress(found[:, :3], options.nms_radius, options.max_keypoints)].numpy()


def near_points(config, points, queries, reach):
    """(Q,): whether a query (Q, 3) lies at most `reach` voxels, along every axis, from a voxel with points (N, 3)."""
    occupied = queries.new_zeros(1, *reversed(config.resolution))
    occupied.view(-1)[voxel_index(points, config)] = 1
    near = F.max_pool3d(occupied, 2 * reach + 1, stride=1, padding=reach)
    return near.view(-1)[voxel_index(queries, config)] > 0


def refined_queries(network, points, options):
    """Occupied grid queries after refinement: positions (K, 3) in the frame of the cloud `points`, scores (K,)."""
    device = next(network.parameters()).device
    unit, center, scale = normalize(points, options.normalization)
    with torch.no_grad():
        unit = torch.from_numpy(unit).to(device)
        volume = network.encode(unit[None])
        queries = query_grid(network.config, options.query_resolution, device)
        if options.query_band:
            queries = queries[near_points(network.config, unit, queries, options.query_band)]
        occupancy = torch.cat([network.occupancy(volume, chunk[None])[0] for chunk in queries.split(1 << 15)])
    queries = queries[occupancy > options.occupancy_threshold]
    if len(queries) == 0:
        return queries, queries[:, 0]
    position, score = refine(network, volume, queries, options)
    return position * float(scale) + torch.from_numpy(center).to(device), score


def candidates(network, points, options=DetectOptions()):
    """Refined queries above the saliency threshold: (K, 4) x y z score in the cloud's frame, by falling score."""
    return rank(*refined_queries(network, points, options), options)


def detect(network, points, options=DetectOptions()):
    """points (N, 3) numpy -> keypoints (K, 4) numpy, x y z score in the cloud's frame, by falling score."""
    return select(*refined_queries(network, points, options), options)


def why_none(network, points, options=DetectOptions()):
    """Why a detection on the cloud `points` (N, 3) finds no keypoint, in a sentence; None if it finds some."""
    if len(candidates(network, points, options)):
        return None
    unit = torch.from_numpy(normalize(points, options.normalization)[0]).to(next(network.parameters()).device)
    queries = query_grid(network.config, options.query_resolution, unit.device)
    with torch.no_grad():
        volume = network.encode(unit[None])
        fields = [network.occupancy_and_saliency(volume, some[None]) for some in queries.split(1 << 15)]
    occupancy, saliency = (torch.cat([field[0] for field in some]) for some in zip(*fields))
    if not (occupancy > options.surface_threshold).any():
        return (
            f"the occupancy is at most {occupancy.max():.2f}, and nowhere above the surface threshold of "
            f"{options.surface_threshold}: the network has not learnt the surface yet"
        )
    on, rim = saliency[occupancy > options.surface_threshold], occupancy <= options.surface_threshold
    off = saliency[rim & (occupancy > 0.1)]
    if len(off) and off.max() > max(on.max(), options.saliency_threshold):
        return (
            f"the saliency peaks beside the surface: it reaches {off.max():.2f} where the occupancy is "
            f"{options.surface_threshold} and less, but only {on.max():.2f} on the surface. Another --saliency-threshold does "
            "not help; learn the surface first, with the weights of the other losses 0, then start from it with fresh_saliency"
        )
    return f"the saliency is at most {on.max():.2f} on the surface, the threshold is {options.saliency_threshold}"


def relative_repeatability(keypoints_1, keypoints_2, rotation_1_2, epsilon):
    """Share of view 1's keypoints with one of view 2's, brought to view 1 by the rotation, closer than epsilon."""
    if len(keypoints_1) == 0 or len(keypoints_2) == 0:
        return np.zeros(len(epsilon))
    moved = keypoints_2[:, :3] @ rotation_1_2.T
    nearest = np.linalg.norm(keypoints_1[:, None, :3] - moved[None], axis=2).min(axis=1)
    return (nearest[:, None] < np.asarray(epsilon)).mean(axis=0)


def view_pairs(shapes, number, num_points, seed):
    """Pairs of an evaluation: (cloud, rotated cloud, rotation of view 2 back to view 1), seeded by row.

    Clouds are scaled to radius 1 about their mean, the unit of the paper's ModelNet40 figures.
    """
    for row in np.linspace(0, len(shapes) - 1, min(number, len(shapes))).round().astype(int):
        rng = np.random.default_rng([seed, row])
        cloud = shapes[row]
        cloud = cloud / (normalize(cloud)[2] / 2)
        rotation = random_rotation(rng)
        yield choose(rng, cloud, num_points), choose(rng, cloud, num_points) @ rotation.T, rotation.T


def repeatability(detector, shapes, number=10**9, num_points=5000, seed=0, epsilon=(0.04,), progress=False):
    """Mean relative repeatability over pairs of views, for a detector points -> {name: keypoints (K, >= 3)}.

    Returns {name: (values by epsilon, mean number of keypoints)}.
    """
    if number < 1:
        raise ValueError(f"repeatability needs at least one object, got {number}")
    pairs = tqdm(view_pairs(shapes, number, num_points, seed), total=min(number, len(shapes)), disable=not progress)
    values, counts = {}, {}
    for cloud_1, cloud_2, rotation_1_2 in pairs:
        found_1, found_2 = detector(cloud_1), detector(cloud_2)
        for name in found_1:
            value = relative_repeatability(found_1[name], found_2[name], rotation_1_2, epsilon)
            values.setdefault(name, []).append(value)
            counts.setdefault(name, []).append(len(found_1[name]))
    return {name: (np.mean(values[name], axis=0), float(np.mean(counts[name]))) for name in values}


def detector(engine, weights, options, device="cpu", rotations=1):
    """points (N, 3) -> keypoints (K, >= 3), by the PyTorch detection of this file or by snake-rs.

    Only snake-rs averages over `rotations` of the input, and detects with the options of the weights (`options` None).
    """
    if engine == "snake-rs":
        import snake_rs

        model = snake_rs.Model.load(weights)
        given = {} if options is None else vars(options) | {"rotations": rotations}
        return lambda points: snake_rs.detect(points, model, **given).points
    if rotations > 1 or options is None:
        raise ValueError("--rotations and --recommended need --engine snake-rs")
    network = load_network(weights, device)
    return lambda points: detect(network, points, options)


def figures(
    weights, data, objects=10**9, num_points=5000, epsilon=(0.02, 0.04, 0.06, 0.10), seed=0, engine="torch", rotations=1,
    options=None, device="cpu",
):  # fmt: skip
    """The relative repeatability of a weight file on a folder of shapes: {"repeatability": by epsilon, "keypoints", "options"}.

    Without `options` those that the weights recommend, by snake-rs.
    """
    find = detector(engine, weights, options, device, rotations)
    measured = repeatability(
        lambda points: {"snake": find(points)}, open_shapes(data), objects, num_points, seed, epsilon, progress=True
    )
    values, count = measured["snake"]
    by_epsilon = {f"{e:g}": round(float(v), 4) for e, v in zip(epsilon, values)}
    return {"repeatability": by_epsilon, "keypoints": round(count, 1), "options": options and vars(options)}


def main(argv=None):
    """Prints the repeatability of a weight file on a folder of shapes."""
    arguments = {
        "weights": dict(help="safetensors export or checkpoint"),
        "--objects": option(10**9, "evaluate this many, evenly spaced"),
        "--num-points": option(5000, "points of each view"),
        "--epsilon": option([0.02, 0.04, 0.06, 0.10], "unit-sphere units", float, nargs="+"),
        "--seed": option(0, "seed of rotations and point choices"),
        "--engine": option("torch", "which implementation detects", choices=("torch", "snake-rs")),
        "--rotations": option(1, "turned copies averaged (snake-rs only)"),
        "--recommended": dict(
            action="store_true", help="detect with the options of the weights, not those below (snake-rs only)"
        ),
        "--device": option("cpu", "torch device, for instance cuda"),
        "--threads": option(0, "torch threads; 0: torch's default"),
    }
    about = "Relative repeatability: 5000 points, second view rotated at random, top 64 keypoints."
    parser = parser_of("evaluate", about, arguments | DATA)
    for name, field in DetectOptions.__dataclass_fields__.items():
        words = option(field.default, "of detection", field.type, choices=CHOICES.get(name))
        parser.add_argument("--" + name.replace("_", "-"), **words)
    arguments = parser.parse_args(argv)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    try:
        options = DetectOptions(**{name: getattr(arguments, name) for name in DetectOptions.__dataclass_fields__})
        result = figures(
            arguments.weights, arguments.data, arguments.objects, arguments.num_points, arguments.epsilon, arguments.seed,
            arguments.engine, arguments.rotations, None if arguments.recommended else options, arguments.device,
        )  # fmt: skip
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
