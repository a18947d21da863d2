"""Fits the weights of `confidence` (crates/snake-registration/src/verdict.rs) on pairs of the training scenes.

    python tests/bench/fit_verdict.py FOLDER [--pairs 60]

300 pairs that overlap and 300 that do not are registered, which takes minutes; a run that was interrupted continues. Wrong
transforms within 20 degrees and 0.7 m of the published ones are left out, because the published ones are not exact. Prints
the weights of a logistic regression, and what the verdict loses without each column: the mean log loss on the pairs of
each scene by weights that were fitted on the other scenes.
"""

import argparse
from pathlib import Path

import numpy as np
import registration_runs as runs
import scene_pairs

NAMES = ["bias", "log(1 + agreeing)", "log((1 + agreeing) / (1 + rival))", "slide margin", "match spread, at most 1"]
NAMES += ["free-space violation"]
# The ridge penalty, for columns of unit variance, a row.
PENALTY = 1e-4


def columns(evidence: dict) -> list[float]:
    agreeing, rival = np.log1p([evidence["num_agreeing"], evidence["num_rival_agreeing"]])
    spread = min(evidence["match_spread"], 1.0)
    return [1.0, agreeing, agreeing - rival, evidence["slide_margin"], spread, evidence["free_space_violation"]]


def logistic_regression(rows: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Weights of the columns; the first column is 1."""
    scale = np.r_[1.0, rows[:, 1:].std(axis=0)]
    scaled, weights = rows / scale, np.zeros(rows.shape[1])
    penalty = PENALTY * len(rows) * np.r_[0.0, np.ones(rows.shape[1] - 1)]
    for _ in range(100):
        probability = 1 / (1 + np.exp(-scaled @ weights))
        hessian = (scaled.T * (probability * (1 - probability))) @ scaled + np.diag(penalty + 1e-9)
        weights -= np.linalg.solve(hessian, scaled.T @ (probability - labels) + penalty * weights)
    return weights / scale


def held_out_loss(rows: np.ndarray, labels: np.ndarray, scenes: np.ndarray) -> float:
    """The mean log loss on each scene by the weights of the others."""
    sums = np.zeros(len(rows))
    for scene in np.unique(scenes):
        own = scenes == scene
        sums[own] = rows[own] @ logistic_regression(rows[~own], labels[~own])
    return float(np.logaddexp(0, np.where(labels > 0, -sums, sums)).mean())


def is_right(pair: scene_pairs.Pair, transform: np.ndarray) -> bool | None:
    """Whether a transform is right; None if that cannot be said."""
    if pair.t_target_source is None:
        return False
    if scene_pairs.is_right(transform, pair.t_target_source):
        return True
    degrees, metres = scene_pairs.errors(transform, pair.t_target_source)
    return None if degrees < 20 and metres < 0.7 else False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--pairs", type=int, default=300, help="pairs of each kind [default: 300]")
    parser.add_argument("--cache", type=Path, default=Path("target/bench-registration.jsonl"))
    arguments = parser.parse_args()
    pairs = scene_pairs.subset(scene_pairs.overlapping(arguments.scenes, "train"), arguments.pairs)
    pairs += scene_pairs.not_overlapping(arguments.scenes, "train", arguments.pairs)
    tasks = [runs.Task(pair.name, pair.clouds) for pair in pairs]
    found = runs.results("registration", tasks, [runs.OURS], arguments.cache)
    rows, labels, scenes = [], [], []
    for pair in pairs:
        row = found[pair.name, runs.OURS]
        label = is_right(pair, np.array(row["refined"]))
        if label is not None and "evidence" in row:
            rows.append(columns(row["evidence"]))
            labels.append(label)
            scenes.append(pair.source.stem.rsplit("__", 1)[0])
    rows, labels, scenes = np.array(rows), np.array(labels, float), np.array(scenes)
    weights = logistic_regression(rows, labels)
    print(
        f"{len(rows)} pairs, {labels.sum():.0f} right; log loss on held-out scenes {held_out_loss(rows, labels, scenes):.3f}"
    )
    for index, (name, weight) in enumerate(zip(NAMES, weights)):
        without = held_out_loss(np.delete(rows, index, axis=1), labels, scenes) if index > 0 else None
        print(f"{name:>36} {weight:9.2f}" + (f", {without:.3f} without" if without is not None else ""))


if __name__ == "__main__":
    main()
