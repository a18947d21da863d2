"""Fits the weights of `confidence` (crates/snake-registration/src/steps/judge/tuning.rs), and prints how it does.

    python tests/bench/fit_verdict.py SCENES --objects FOLDER [--pairs 150] [--made 15]
    python tests/bench/fit_verdict.py SCENES --objects FOLDER --split val --seed 9 --blind

Pairs are of the scenes, half of which do not overlap, and made ones of every kind of verdict_pairs.py; a run that was
interrupted continues. Wrong transforms within 20 degrees and 0.7 m of the published ones are left out, because the published
ones are not exact. What the rules call ambiguous takes no part in the fit, nor do pillars, which only a rule can judge. It is
a logistic regression on columns between limits. `--blind` prints only what the confidence of this build accepts.
"""

import argparse
from pathlib import Path

import numpy as np
import registration_runs as runs
import scene_pairs
import verdict_pairs

NAMES = ["bias", "log(1 + agreeing)", "log((1 + agreeing) / (1 + rival))", "slide margin", "match spread"]
NAMES += ["free-space violation"]
# The ridge penalty, for columns of unit variance, a row.
PENALTY = 1e-4
# As in judge/tuning.rs.
LIMITS = [(1, 1), (0, np.log(200)), (-1.5, 1.5), (-0.1, 0.1), (0, 1), (0, 1)]


def columns(evidence: dict) -> np.ndarray:
    agreeing, rival = np.log1p([evidence["num_agreeing"], evidence["num_rival_agreeing"]])
    row = [1.0, agreeing, agreeing - rival, evidence["slide_margin"], evidence["match_spread"]]
    return np.clip([*row, evidence["free_space_violation"]], *np.transpose(LIMITS))


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


def is_right(pair: scene_pairs.Pair, transform: np.ndarray) -> bool | None:
    """Whether a transform is right; None if that cannot be said."""
    if pair.t_target_source is None:
        return False
    if scene_pairs.is_right(transform, pair.t_target_source):
        return True
    degrees, metres = scene_pairs.errors(transform, pair.t_target_source)
    return None if degrees < scene_pairs.NEAR_DEGREES and metres < scene_pairs.NEAR_METRES else False


def results(arguments: argparse.Namespace) -> list[tuple[str, bool, dict]]:
    """The kind of each pair, whether its transform is right, and the result."""
    scenes, split = arguments.scenes, arguments.split
    overlapping = scene_pairs.subset(scene_pairs.overlapping(scenes, split), arguments.pairs)
    apart = scene_pairs.not_overlapping(scenes, split, len(overlapping)) if overlapping else []
    real = overlapping + apart
    tasks = [runs.Task(pair.name, pair.clouds) for pair in real]
    found = runs.results("scenes", tasks, [runs.OURS], arguments.cache)
    rows = []
    for pair in real:
        row = found[pair.name, runs.OURS]
        kind = "scenes, no overlap" if pair.t_target_source is None else "scenes"
        rows.append((kind, is_right(pair, np.array(row["refined"])), row))
    for make in verdict_pairs.pairs(arguments.made, arguments.seed, arguments.objects, split, arguments.kinds):
        pair = make()
        task = runs.Task(f"made {split} {pair.name}", lambda pair=pair: (pair.source, pair.target))
        row = runs.results(pair.name, [task], [runs.OURS], arguments.cache)[task.name, runs.OURS]
        rows.append((pair.kind, pair.is_right(np.array(row["refined"])), row))
    return [row for row in rows if row[1] is not None]


def print_fit(rows: list[tuple[str, bool, dict]]) -> None:
    left = [(right, row["evidence"]) for kind, right, row in rows if "evidence" in row and kind != "pillars"]
    left = [(right, evidence) for right, evidence in left if not evidence["is_ambiguous"]]
    table, labels = np.array([columns(e) for _, e in left]), np.array([right for right, _ in left], float)
    weights = logistic_regression(table, labels)
    print(f"\n{len(left)} pairs left by the rules, {labels.sum():.0f} right")
    for name, weight in zip(NAMES, weights, strict=True):
        print(f"{name:>36} {weight:9.2f}")


def print_curve(rows: list[tuple[str, bool, dict]]) -> None:
    right = np.array([row["score"] for _, is_right, row in rows if is_right])
    wrong = np.array([row["score"] for _, is_right, row in rows if not is_right])
    real = np.array([row["score"] for kind, is_right, row in rows if is_right and kind == "scenes"])
    print(f"\n| confidence | of {len(real)} right real | of {len(right)} right | of {len(wrong)} wrong or absent |")
    print("|---|---|---|---|")
    for level in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
        shares = [f"{np.mean(scores >= level):.3f}" if len(scores) else "" for scores in (real, right)]
        print(f"| {level:.2f} | {' | '.join(shares)} | {np.sum(wrong >= level)} |")
    print("\n| kind | right | reliable of these | wrong | reliable of these |\n|---|---|---|---|---|")
    for kind in dict.fromkeys(kind for kind, *_ in rows):
        own = [(is_right, row["score"] >= 0.5) for of, is_right, row in rows if of == kind]
        counts = [(sum(r == label for r, _ in own), sum(r == label and ok for r, ok in own)) for label in (True, False)]
        print(f"| {kind} | " + " | ".join(f"{all_} | {reliable}" for all_, reliable in counts) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--objects", type=Path, help="folder of objects; without, kinds with objects are left out")
    parser.add_argument("--split", default="train", choices=["train", "val"])
    parser.add_argument(
        "--pairs", type=int, default=150, help="pairs of scenes that overlap, and that do not [default: 150]"
    )
    parser.add_argument("--made", type=int, default=15, help="made pairs of each kind [default: 15]")
    parser.add_argument("--kinds", nargs="+", help="these kinds of made pairs only [default: all]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--blind", action="store_true", help="no fit")
    parser.add_argument("--cache", type=Path, default=Path("target/bench-registration.jsonl"))
    arguments = parser.parse_args()
    rows = results(arguments)
    if not arguments.blind:
        print_fit(rows)
    print_curve(rows)


if __name__ == "__main__":
    main()
