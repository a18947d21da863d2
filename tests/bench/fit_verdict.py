"""Fits the weights of `confidence` (crates/snake-registration/src/verdict.rs) on pairs of the training scenes.

    python tests/bench/fit_verdict.py FOLDER

300 pairs that overlap and 300 that do not are registered. Wrong transforms within 20 degrees and 0.7 m of the published
ones are left out, because the published ones are not exact. Prints the weights of a logistic regression.
"""

import argparse
from pathlib import Path

import numpy as np
import scene_pairs

import snake_rs

NAMES = ["bias", "log(1 + agreeing)", "log((1 + agreeing) / (1 + rival))", "slide margin", "free-space violation"]
# The ridge penalty, for columns of unit variance, a row.
PENALTY = 1e-4


def evidence(found: snake_rs.Registration) -> list[float]:
    agreeing, rival = np.log1p([found.num_agreeing, found.num_rival_agreeing])
    return [1.0, agreeing, agreeing - rival, found.slide_margin, found.free_space_violation]


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--pairs", type=int, default=300, help="pairs of each kind [default: 300]")
    arguments = parser.parse_args()
    pairs = scene_pairs.subset(scene_pairs.overlapping(arguments.scenes, "train"), arguments.pairs)
    pairs += scene_pairs.not_overlapping(arguments.scenes, "train", arguments.pairs)
    rows, labels = [], []
    for pair in pairs:
        try:
            found = snake_rs.register(np.load(pair.source), np.load(pair.target))
        except ValueError:
            continue
        is_right, is_close = False, False
        if pair.t_target_source is not None:
            degrees, metres = scene_pairs.errors(found.t_target_source, pair.t_target_source)
            is_right = scene_pairs.is_right(found.t_target_source, pair.t_target_source)
            is_close = degrees < 20 and metres < 0.7
        if is_right or not is_close:
            rows.append(evidence(found))
            labels.append(is_right)
    weights = logistic_regression(np.array(rows), np.array(labels, float))
    print(f"{len(rows)} pairs, {sum(labels)} right")
    for name, weight in zip(NAMES, weights):
        print(f"{name:>36} {weight:9.2f}")


if __name__ == "__main__":
    main()
