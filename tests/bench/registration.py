"""Registration beside Open3D and KISS-Matcher on pairs of indoor scans: recall, seconds a pair, and verdicts.

    make bench-registration SCENES=FOLDER

FOLDER has `train` and `val`, each with clouds (.npy) and `pairs.json`. With `--objects` parts of objects follow; sweeps of a
simulated LiDAR (made_pairs.py) always do. Results are kept in the file of `--cache` as they come, so that a run can be
continued.
"""

import argparse
import json
import time
from pathlib import Path

import made_pairs
import numpy as np
import registration_peers as peers
import scene_pairs

import snake_rs

OURS = "snake-rs"


def run_ours(source: np.ndarray, target: np.ndarray) -> dict:
    start = time.perf_counter()
    try:
        found = snake_rs.register(source, target)
    except ValueError:
        return {"refined": np.eye(4).tolist(), "score": 0.0, "seconds": time.perf_counter() - start}
    seconds = time.perf_counter() - start
    return {"refined": found.t_target_source.tolist(), "score": found.confidence, "seconds": seconds}


def results(pairs: list[scene_pairs.Pair], methods: list[str], cache: Path) -> dict[tuple[str, str], dict]:
    """The results of all methods on all pairs by (pair, method); methods alternate pair by pair."""
    lines = cache.read_text().splitlines() if cache.exists() else []
    found = {(row["pair"], row["method"]): row for row in map(json.loads, lines)}
    with cache.open("a") as out:
        for pair in pairs:
            source, target = np.load(pair.source), np.load(pair.target)
            for method in methods:
                if (pair.name, method) in found:
                    continue
                result = run_ours(source, target) if method == OURS else peers.run(method, source, target)
                row = {"pair": pair.name, "method": method, **result}
                out.write(json.dumps(row) + "\n")
                out.flush()
                found[pair.name, method] = row
    return found


def is_right(pair: scene_pairs.Pair, result: dict) -> bool:
    return pair.t_target_source is not None and scene_pairs.is_right(np.array(result["refined"]), pair.t_target_source)


def print_recall(pairs, methods, found) -> None:
    classes = {"0.5 and more": (0.5, 2), "0.3 to 0.5": (0.3, 0.5), "0.3 and more": (0.3, 2), "0.1 to 0.3": (0, 0.3)}
    print("| method | " + " | ".join(classes) + " | seconds, median |")
    print("|---" * (len(classes) + 2) + "|")
    for method in methods:
        shares = []
        for low, high in classes.values():
            chosen = [pair for pair in pairs if low <= pair.overlap < high]
            right = [is_right(pair, found[pair.name, method]) for pair in chosen]
            shares.append(f"{np.mean(right):.3f}" if right else "")
        seconds = np.median([found[pair.name, method]["seconds"] for pair in pairs])
        print(f"| {method} | " + " | ".join(shares) + f" | {seconds:.2f} |")


def print_made(pairs: list[made_pairs.MadePair], methods: list[str], cache: Path) -> None:
    """Recall on pairs that are made from other data; a transform counts as in `MadePair.is_right`."""
    lines = cache.read_text().splitlines() if cache.exists() else []
    found = {(row["pair"], row["method"]): row for row in map(json.loads, lines)}
    with cache.open("a") as out:
        for pair in pairs:
            for method in [method for method in methods if (pair.name, method) not in found]:
                clouds = (pair.source, pair.target)
                result = run_ours(*clouds) if method == OURS else peers.run(method, *clouds)
                row = {"pair": pair.name, "method": method, **result}
                out.write(json.dumps(row) + "\n")
                out.flush()
                found[pair.name, method] = row
    print("| method | right | seconds, median |\n|---|---|---|")
    for method in methods:
        rows = [found[pair.name, method] for pair in pairs]
        right = np.mean([pair.is_right(np.array(row["refined"])) for pair, row in zip(pairs, rows)])
        print(f"| {method} | {right:.3f} | {np.median([row['seconds'] for row in rows]):.2f} |")


def print_verdicts(pairs, methods, found) -> None:
    """The share of right results above a threshold that 0, 1, 2, 3 and 5 wrong ones pass."""
    allowed = (0, 1, 2, 3, 5)
    print("| method | right | wrong | " + " | ".join(f"{count} accepted" for count in allowed) + " |")
    print("|---" * (len(allowed) + 3) + "|")
    for method in methods:
        right = [is_right(pair, found[pair.name, method]) for pair in pairs]
        scores = np.array([found[pair.name, method]["score"] for pair in pairs])
        wrong = np.sort(scores[~np.array(right)])[::-1]
        shares = []
        for count in allowed:
            threshold = wrong[count] if count < len(wrong) else -np.inf
            shares.append(f"{np.mean(scores[right] > threshold):.2f}")
        print(f"| {method} | {sum(right)} | {len(wrong)} | " + " | ".join(shares) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--cache", type=Path, default=Path("target/bench-registration.jsonl"))
    parser.add_argument("--train-pairs", type=int, default=140, help="pairs of the fixed random order [default: 140]")
    parser.add_argument("--ours-only", action="store_true")
    parser.add_argument("--objects", type=Path, help="folder of objects: val/points.npy (N, P, 3)")
    parser.add_argument("--made-pairs", type=int, default=30, help="pairs of objects, and of sweeps [default: 30]")
    parser.add_argument("--made-only", action="store_true", help="objects and sweeps only")
    parser.add_argument("--methods", nargs="+", help="these only, such as snake-rs kiss/0.05 [default: all]")
    arguments = parser.parse_args()
    methods = [OURS] if arguments.ours_only else [OURS, *peers.METHODS]
    methods = arguments.methods or methods
    overlapping = scene_pairs.overlapping(arguments.scenes, "val")
    train = scene_pairs.subset(scene_pairs.overlapping(arguments.scenes, "train"), arguments.train_pairs)
    for name, pairs in [] if arguments.made_only else [("validation", overlapping), ("training", train)]:
        print(f"\n{name}, {len(pairs)} pairs: right within 15 degrees and 0.3 m, by overlap\n")
        print_recall(pairs, methods, results(pairs, methods, arguments.cache))
    if arguments.objects:
        print("\nparts of objects: the mean distance to the nearest point of the object is below 2 % of the diameter\n")
        print_made(made_pairs.objects(arguments.objects, arguments.made_pairs), methods, arguments.cache)
    print("\nLiDAR-like sweeps 10 m apart: right within 5 degrees and 0.6 m\n")
    print_made(made_pairs.sweeps(arguments.made_pairs), methods, arguments.cache)
    if arguments.made_only:
        return
    apart = scene_pairs.not_overlapping(arguments.scenes, "val", len(overlapping))
    judged = [OURS] if arguments.ours_only else [OURS, "kiss/0.05", "ransac/0.05"]
    print(
        "\nverdicts on the validation pairs and as many that do not overlap: right results accepted with N wrong ones\n"
    )
    print_verdicts(overlapping + apart, judged, results(overlapping + apart, judged, arguments.cache))


if __name__ == "__main__":
    main()
