"""Repeatability and semantic consistency of methods on a data set, as the long table of `tables`.

With an output folder, each method has a file METRIC-METHOD.csv there; a method whose file is there is not evaluated again.
"""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from .datasets import apart_note, open_semantic, open_views, read_cloud
from .methods import ALL, CLASSICAL, OWN, methods_of
from .published import THRESHOLDS, published
from .repeatability import coverage as coverage_of
from .repeatability import (
    radius_of_coverage,
    relative_repeatability,
    repeatability_of_seen,
    share_on_flat_places,
    suppress,
)
from .semantic import body_pair_counts, iou, recall, semantic_counts
from .tables import COLUMNS, kept, table_of
from .views import CLEAN, Condition, draw_views, spaced

METHODS = ("snake", *CLASSICAL)
FLAT_RADIUS = 1.5  # of the neighbourhood of a flat place, in multiples of the ε of the tables
BODY_RADIUS = 0.1  # the suppression of the paper's figures of semantic consistency
# The columns of the paper's tables by the units of the data: ε, the ε of thinned and noisy views, σ, and the points of a view.
SETTINGS = {
    "object": (tuple(e / 100 for e in range(3, 11)), 0.04, tuple(e / 100 for e in range(0, 13, 2)), 5000),
    "annotated": ((0.03, 0.05, 0.07, 0.09, 0.1), 0.03, (0.0, 0.02, 0.03), 2048),
    "room": (tuple(e / 100 for e in range(10, 25, 2)), 0.2, tuple(e / 100 for e in range(0, 11, 2)), 10240),
}


def by_method(metric, methods, output, settings, rows, paper=None):
    """The tables of all methods below each other, then the paper's; rows: method -> rows of the table."""
    tables = []
    for method in methods:
        name = re.sub(r"[^\w.=,-]+", "_", method.name)
        path = Path(output) / f"{metric}-{name}.csv" if output else None
        tables.append(kept(path, settings | method.settings(), lambda method=method: rows(method)))
    theirs = [table_of(published(paper))] if paper else []
    return pd.concat(tables + theirs, ignore_index=True)[COLUMNS]


def progress(rows, name):
    """The rows, with a bar on a terminal."""
    return tqdm(rows, desc=name, disable=None, leave=False)


def repeatability(
    data, methods=METHODS, external=(), split="", epsilon=None, table_epsilon=None, downsample=(1, 2, 4, 8, 16), downsample_one=(),
    noise=None, num_points=None, max_keypoints=64, nms_radius=None, coverage=None, protocol="ranked", limit=None, seed=0, output=None, paper=False,
):  # fmt: skip
    """Relative repeatability of methods on the views of a data set, and of places that both views saw, beyond chance; with coverage and flat places.

    All methods see the same views: clean ones, thinned ones and noisy ones, the latter two at `table_epsilon`. With `coverage` each
    method's keypoints are suppressed until their mean distance from the points is that, by one radius a condition, found on the first views.
    """
    views, methods = open_views(data, split), methods_of(methods, external, protocol == "paper")
    usual_epsilon, usual_table, usual_noise, usual_points = SETTINGS[views.scale]
    epsilon, noise = tuple(epsilon or usual_epsilon), usual_noise if noise is None else tuple(noise)
    if table_epsilon is None:
        table_epsilon = usual_table if usual_table in epsilon else epsilon[0]
    if table_epsilon not in epsilon:
        raise ValueError(f"table_epsilon is {table_epsilon}: allowed are the values of epsilon")
    if coverage is not None and nms_radius is not None:
        raise ValueError("coverage and nms_radius: give one of them")
    number, rows = num_points or usual_points, spaced(len(views), limit)
    conditions = [CLEAN, *(Condition(rate) for rate in downsample), *(Condition(1, sigma) for sigma in noise)]
    conditions += [Condition(rate, is_of_both=False) for rate in downsample_one]
    conditions = list(dict.fromkeys(conditions))
    spacing = ALL if coverage else OWN if nms_radius is None else nms_radius
    if views.files:
        warn(apart_note(views.names, views.clouds, rows))

    def found(method, condition, row):
        """The views of a row with a method's keypoints on both."""
        drawn = draw_views(views.clouds(row), condition, number, seed, row)
        files = views.files[row] if views.files else (None, None)
        sides = zip((drawn.view_1, drawn.view_2), files, drawn.seeds)
        return row, drawn, [method.find(view, file, at, max_keypoints, spacing) for view, file, at in sides]

    def figures(method):
        for condition in conditions:
            pairs = (found(method, condition, row) for row in progress(rows, f"{method.name}, {condition}"))
            if coverage:
                pairs = list(pairs)
                clouds = [(drawn.view_1, keypoints[0]) for _, drawn, keypoints in pairs]
                radius = radius_of_coverage(clouds, max_keypoints, coverage)
                pairs = [
                    (row, drawn, [suppress(some, radius, max_keypoints) for some in both]) for row, drawn, both in pairs
                ]
            for row, drawn, (first, second) in pairs:
                yield from pair_rows(method, condition, row, drawn, first, second)

    def pair_rows(method, condition, row, drawn, first, second):
        """The figures of one pair. Clean views are also the first of the thinned and of the noisy ones."""
        shares = relative_repeatability(first, second, drawn.t_1_2, epsilon)
        seen = repeatability_of_seen(first, second, drawn.view_2, drawn.t_1_2, epsilon)
        for distance, *values in zip(epsilon, shares, *seen):
            names = [f"ε {distance:g}"] if condition == CLEAN else []
            if distance == table_epsilon:
                is_first = condition == CLEAN
                names += [f"ε {distance:g}, {condition}"] if not is_first else []
                names += [f"ε {distance:g}, 1 in 1"] if is_first and 1 in downsample and len(downsample) > 1 else []
                names += [f"ε {distance:g}, σ 0"] if is_first and 0 in noise and len(noise) > 1 else []
            for name in names:
                for metric, value in zip(("repeatability", "of seen", "beyond chance"), values):
                    yield metric, method.name, name, views.names[row], value
        others = {
            "coverage": coverage_of(drawn.view_1, first) if len(first) else np.nan,
            "on flat places": share_on_flat_places(drawn.view_1, first, FLAT_RADIUS * table_epsilon),
            "keypoints": float(len(first)),
        }
        for metric, value in others.items():
            yield metric, method.name, str(condition), views.names[row], value

    settings = {
        "data": str(data), "split": str(split), "epsilon": epsilon, "table_epsilon": table_epsilon, "downsample": list(downsample),
        "downsample_one": list(downsample_one), "noise": noise, "num_points": number, "max_keypoints": max_keypoints,
        "nms_radius": nms_radius, "coverage": coverage, "limit": limit, "seed": seed,
    }  # fmt: skip
    return by_method("repeatability", methods, output, settings, figures, views.scale if paper else None)


def warn(note):
    """Prints a note, if there is one."""
    if note:
        print(f"warning: {note}", file=sys.stderr)


def semantic(
    data, methods=METHODS, external=(), split="", threshold=THRESHOLDS, max_keypoints=64, nms_radius=BODY_RADIUS, coverage=None,
    protocol="ranked", limit=None, seed=0, output=None, paper=False,
):  # fmt: skip
    """Semantic consistency of methods by two rules, and the share of the annotated keypoints that are found.

    strict: points without a path never match, a body has only the keypoints that were found, and the mIoU is the mean over the pairs.
    as released: points without a path match, random ones fill a body up to 20, and the IoU of all pairs so far is averaged. Of annotated
    shapes the units are classes.
    """
    opened, methods = open_semantic(data, split), methods_of(methods, external, protocol == "paper")
    are_bodies = isinstance(opened, tuple)
    length = opened[1] if are_bodies else len(opened)
    rows, spacing = spaced(length, limit), ALL if coverage else nms_radius

    def clouds(row):
        """The clouds of a row with their names to files of keypoints, and a generator of random numbers."""
        rng = np.random.default_rng([seed, row])
        if are_bodies:
            return list(zip(opened[0](row, rng), (f"body_1_{row}", f"body_2_{row}"))), rng
        return [(read_cloud(opened[row].path), opened[row].name)], rng

    def figures(method):
        found = []
        for row in progress(rows, method.name):
            some, rng = clouds(row)
            seeds = rng.integers(2**32, size=len(some))
            keypoints = [method.find(c, name, int(at), max_keypoints, spacing) for (c, name), at in zip(some, seeds)]
            found.append((row, [cloud for cloud, _ in some], keypoints, rng))
        if coverage:
            radius = radius_of_coverage(
                [(some[0], keypoints[0]) for _, some, keypoints, _ in found], max_keypoints, coverage
            )
            found = [(*rest, [suppress(k, radius, max_keypoints) for k in both], rng) for *rest, both, rng in found]
        yield from (body_rows if are_bodies else class_rows)(method, found)

    def class_rows(method, found):
        counts = {}
        for row, (points,), (keypoints,), _ in found:
            of_class = counts.setdefault(opened[row].kind, {"strict": 0, "released": 0, "keypoints": []})
            for rule in ("strict", "released"):
                of_class[rule] = of_class[rule] + semantic_counts(
                    points, opened[row].keypoints, keypoints, threshold, rule == "released"
                )
            of_class["keypoints"].append(len(keypoints))
        for kind, sums in counts.items():
            values = iou(sums["strict"]), iou(sums["released"]), recall(sums["strict"])
            yield from threshold_rows(method, kind, values, np.mean(sums["keypoints"]))

    def body_rows(method, found):
        running = 0
        for row, bodies, keypoints, rng in found:
            strict = body_pair_counts(*bodies, *keypoints, threshold)
            running = running + body_pair_counts(*bodies, *keypoints, threshold, rng)
            yield from threshold_rows(
                method, f"pair {row}", (iou(strict), iou(running), recall(strict)), float(len(keypoints[0]))
            )

    def threshold_rows(method, unit, values, number):
        for metric, by_threshold in zip(("mIoU, strict", "mIoU, as released", "found"), values):
            for distance, value in zip(threshold, by_threshold):
                yield metric, method.name, f"threshold {distance:g}", unit, value
        yield "keypoints", method.name, "clean", unit, number

    settings = {
        "data": str(data), "split": str(split), "threshold": list(threshold), "max_keypoints": max_keypoints, "nms_radius": nms_radius,
        "coverage": coverage, "limit": limit, "seed": seed,
    }  # fmt: skip
    theirs = ("smpl" if are_bodies else "keypointnet") if paper else None
    return by_method("semantic", methods, output, settings, figures, theirs)
