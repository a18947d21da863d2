"""Plain PyTorch detection (SNAKE Algorithm 1).

The reference that the Rust implementation is compared with: one volume a cloud, every step written as the paper has it.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F

from .augment import normalize
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
