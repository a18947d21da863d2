"""Which of several networks repeats best at equal coverage, by PyTorch alone: a machine that is there for its GPU has no more."""

import numpy as np
import torch

from .augment import choose
from .evaluate import DetectOptions, detect, relative_repeatability, view_pairs

OPTIONS = DetectOptions(query_band=1, refine_steps=0, saliency_threshold=0.0, nms_radius=0.1)
COVERAGE, EPSILON = 0.145, 0.04  # radii of the cloud
CONDITIONS = {"clean": (1, 0.0), "thinned": (8, 0.0), "noise": (1, 0.06)}  # one point of so many, standard deviation


def judge(network, shapes, objects, coverage=COVERAGE):
    """The repeatability at EPSILON of clean, thinned and noisy views of so many shapes, and their mean, `score`.

    Each cloud has as many keypoints, the fewest with which the clean views reach the coverage, so that networks compare; a network
    that does not reach it has them all.
    """
    pairs = list(view_pairs(shapes, objects, 5000, 0))
    found = {
        name: [[detect(network, under(view, condition), OPTIONS) for view in pair[:2]] for pair in pairs]
        for name, condition in CONDITIONS.items()
    }
    clean = [(torch.from_numpy(pair[0]), torch.from_numpy(both[0])[:, :3]) for pair, both in zip(pairs, found["clean"])]
    reached = coverage_by_number(clean)
    number = min(int((reached > coverage).sum()) + 1, len(reached))
    report = {"keypoints": number, "coverage": reached[number - 1].item()}
    for name, views in found.items():
        shares = [
            relative_repeatability(first[:number], second[:number], rotation, (EPSILON,))[0]
            for (first, second), (_, _, rotation) in zip(views, pairs, strict=True)
        ]
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


def coverage_by_number(clouds):
    """The mean distance of the points of clouds (points (N, 3), ranked keypoints (K, 3)) to the nearest of their best 1, 2, ..
    `max_keypoints`; a cloud with fewer has all of them, one without counts with its radius, 1."""
    each = []
    for points, ranked in clouds:
        nearest = torch.cdist(points, ranked).cummin(dim=1).values.mean(dim=0) if len(ranked) else torch.ones(1)
        each.append(torch.cat([nearest, nearest[-1:].expand(OPTIONS.max_keypoints - len(nearest))]))
    return torch.stack(each).mean(dim=0)
