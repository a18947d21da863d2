"""Which of several networks repeats best at equal coverage, by PyTorch alone: a machine that is there for its GPU has no more."""

import numpy as np
import torch

from .augment import choose
from .evaluate import DetectOptions, candidates, relative_repeatability, suppress, view_pairs

OPTIONS = DetectOptions(query_band=1, refine_steps=0, saliency_threshold=0.0)
COVERAGE, EPSILON = 0.145, 0.04  # radii of the cloud
CONDITIONS = {"clean": (1, 0.0), "thinned": (8, 0.0), "noise": (1, 0.06)}  # one point of so many, standard deviation


def judge(network, shapes, objects, coverage=COVERAGE):
    """The repeatability at EPSILON of clean, thinned and noisy views of so many shapes, and their mean, `score`.

    Suppression has the one radius at which the clean views reach the coverage, so that dense and sparse networks compare.
    """
    pairs = list(view_pairs(shapes, objects, 5000, 0))
    found = {
        name: [[candidates(network, under(view, condition), OPTIONS) for view in pair[:2]] for pair in pairs]
        for name, condition in CONDITIONS.items()
    }
    clean = [(torch.from_numpy(pair[0]), both[0]) for pair, both in zip(pairs, found["clean"])]
    radius = radius_of_coverage(clean, coverage)
    report = {"radius": radius, "coverage": covered(clean, radius)}
    for name, some in found.items():
        kept = [[strongest(view, radius).numpy() for view in both] for both in some]
        shares = [relative_repeatability(*both, pair[2], (EPSILON,))[0] for both, pair in zip(kept, pairs, strict=True)]
        report[name] = float(np.mean(shares))
    report["score"] = float(np.mean([report[name] for name in CONDITIONS]))
    return {name: round(value, 4) for name, value in report.items()}


def under(points, condition):
    """Points (N, 3) thinned and with noise; the same each time."""
    one_of, sigma = condition
    rng = np.random.default_rng(0)
    return choose(rng, points, len(points) // one_of) + (
        sigma * rng.standard_normal((len(points) // one_of, 3))
    ).astype(np.float32)


def strongest(found, radius):
    """The best of ranked candidates (K, 4) after suppression."""
    return found[suppress(found[:, :3], radius, OPTIONS.max_keypoints)]


def covered(clouds, radius):
    """The mean distance of the points of clouds (points (N, 3), candidates (K, 4)) to their nearest keypoint; infinite if no cloud
    has one."""
    each = [
        torch.cdist(points, strongest(found, radius)[:, :3]).amin(dim=1).mean().item()
        for points, found in clouds
        if len(found)
    ]
    return float(np.mean(each)) if each else float("inf")


def radius_of_coverage(clouds, coverage):
    """The smallest radius of suppression, to a hundredth, that reaches the coverage, or the one that comes nearest to it."""
    reached = {radius: covered(clouds, radius) for radius in np.linspace(0.0, 0.3, 16).tolist()}
    enough = [radius for radius, value in reached.items() if value <= coverage]
    if not enough:
        return min(reached, key=reached.get)
    low, high = max(enough[0] - 0.02, 0.0), enough[0]
    while high - low > 0.002:
        middle = (low + high) / 2
        low, high = (low, middle) if covered(clouds, middle) <= coverage else (middle, high)
    return high
