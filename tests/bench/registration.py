"""Registration beside Open3D and KISS-Matcher: recall on indoor scenes, objects and sweeps, seconds a pair, verdicts.

    make bench-registration SCENES=FOLDER OBJECTS=FOLDER [PARTS="speed verdict"]

FOLDER of scenes has `train` and `val`, each with clouds (.npy) and `pairs.json`; that of objects has `val/points.npy`
(N, P, 3). Parts without their folder are left out; the sweeps of a simulated LiDAR (made_pairs.py) need none. Results are
kept in the file of `--cache` as they come, so that a run that was interrupted continues.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import made_pairs
import numpy as np
import registration_runs as runs
import registration_speed
import scene_pairs

TIMED = [runs.OURS, "kiss/0.05", "ransac/0.05"]
CORES = (1, 2)


def tasks(pairs: list[scene_pairs.Pair]) -> list[runs.Task]:
    return [runs.Task(pair.name, pair.clouds) for pair in pairs]


def is_right(pair: scene_pairs.Pair, result: dict) -> bool:
    return pair.t_target_source is not None and scene_pairs.is_right(np.array(result["refined"]), pair.t_target_source)


def table(head: list[str], rows: list[list[str]]) -> None:
    for row in [head, ["---"] * len(head), *rows]:
        print("| " + " | ".join(row) + " |")


def print_recall(pairs: list[scene_pairs.Pair], methods: list[str], found: dict) -> None:
    classes = {"0.5 and more": (0.5, 2), "0.3 to 0.5": (0.3, 0.5), "0.3 and more": (0.3, 2), "0.1 to 0.3": (0, 0.3)}
    rows = []
    for method in methods:
        shares = []
        for low, high in classes.values():
            right = [is_right(pair, found[pair.name, method]) for pair in pairs if low <= pair.overlap < high]
            shares.append(f"{np.mean(right):.3f}" if right else "")
        rows.append([method, *shares])
    table(["method", *classes], rows)


def print_made(pairs: list[made_pairs.MadePair], methods: list[str], found: dict) -> None:
    """Recall on pairs that are made from other data; a transform counts as in `MadePair.is_right`."""
    rows = []
    for method in methods:
        right = [pair.is_right(np.array(found[pair.name, method]["refined"])) for pair in pairs]
        rows.append([method, f"{np.mean(right):.3f}"])
    table(["method", "right"], rows)


def print_speed(pairs: list[scene_pairs.Pair], methods: list[str], found: dict) -> None:
    def median(method: str, cores: int) -> str:
        seconds = [found[registration_speed.name(pair.name, cores), method]["seconds"] for pair in pairs]
        return f"{np.median(seconds):.2f}"

    rows = [[method, *(median(method, cores) for cores in CORES)] for method in methods]
    table(["method", *(f"seconds, {cores} core{'s' * (cores > 1)}" for cores in CORES)], rows)


def print_verdicts(pairs: list[scene_pairs.Pair], methods: list[str], found: dict) -> None:
    """The share of right results above a threshold that 0, 1, 2, 3 and 5 wrong ones pass."""
    allowed, rows = (0, 1, 2, 3, 5), []
    for method in methods:
        right = np.array([is_right(pair, found[pair.name, method]) for pair in pairs])
        scores = np.array([found[pair.name, method]["score"] for pair in pairs])
        wrong = np.sort(scores[~right])[::-1]
        shares = []
        for count in allowed:
            threshold = wrong[count] if count < len(wrong) else -np.inf
            shares.append(f"{np.mean(scores[right] > threshold):.2f}" if right.any() else "")
        rows.append([method, str(right.sum()), str(len(wrong)), *shares])
    table(["method", "right", "wrong", *(f"{count} accepted" for count in allowed)], rows)


class Bench:
    """The parts of the benchmark, by the names of `--parts`."""

    def __init__(self, arguments: argparse.Namespace):
        self.arguments = arguments
        self.methods = arguments.methods or [runs.OURS, *runs.PEERS]

    def chosen(self, methods: list[str]) -> list[str]:
        return [method for method in methods if method in self.methods]

    def scenes(self, split: str, count: int | None = None) -> list[scene_pairs.Pair]:
        pairs = scene_pairs.overlapping(self.arguments.scenes, split)
        return pairs if count is None else scene_pairs.subset(pairs, count)

    def recall(self, split: str, count: int | None) -> None:
        pairs = self.scenes(split, count)
        found = runs.results(f"recall, {split}", tasks(pairs), self.methods, self.arguments.cache)
        print(f"\n{split}, {len(pairs)} pairs: right within 15 degrees and 0.3 m, by overlap\n")
        print_recall(pairs, self.methods, found)

    def made(self, label: str, rule: str, pairs: list[made_pairs.MadePair]) -> None:
        made = [runs.Task(pair.name, lambda pair=pair: (pair.source, pair.target)) for pair in pairs]
        found = runs.results(label, made, self.methods, self.arguments.cache)
        print(f"\n{label}, {len(pairs)} pairs: {rule}\n")
        print_made(pairs, self.methods, found)

    def validation(self) -> None:
        self.recall("val", None)

    def training(self) -> None:
        self.recall("train", self.arguments.train_pairs)

    def objects(self) -> None:
        pairs = made_pairs.objects(self.arguments.objects, self.arguments.made_pairs)
        rule = "the mean distance to the nearest point of the object is below 2 % of the diameter"
        self.made("parts of objects", rule, pairs)

    def sweeps(self) -> None:
        pairs = made_pairs.sweeps(self.arguments.made_pairs)
        self.made("sweeps 10 m apart", "right within 5 degrees and 0.6 m", pairs)

    def speed(self) -> None:
        arguments, methods = self.arguments, self.chosen(TIMED)
        script = Path(registration_speed.__file__)
        count = min(arguments.speed_pairs, len(self.scenes("val")))
        for cores in CORES:
            options = ["--cores", str(cores), "--pairs", str(count), "--cache", str(arguments.cache)]
            command = [sys.executable, str(script), str(arguments.scenes), *options, "--methods", *methods]
            subprocess.run(command, check=True)
        print(f"\nseconds a pair, median of {count} validation pairs in alternation, ICP included\n")
        print_speed(self.scenes("val", count), methods, runs.load(arguments.cache))

    def verdict(self) -> None:
        overlapping = self.scenes("val")
        pairs = overlapping + scene_pairs.not_overlapping(self.arguments.scenes, "val", len(overlapping))
        methods = self.chosen(TIMED)
        found = runs.results("verdict", tasks(pairs), methods, self.arguments.cache)
        print(
            "\nverdicts on the validation pairs and as many that do not overlap: right results accepted with N wrong ones\n"
        )
        print_verdicts(pairs, methods, found)


# The data that each part needs.
PARTS = {
    "validation": "scenes",
    "training": "scenes",
    "objects": "objects",
    "sweeps": None,
    "speed": "scenes",
    "verdict": "scenes",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, help="folder of scenes")
    parser.add_argument("--objects", type=Path, help="folder of objects")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="these only [default: all]")
    parser.add_argument("--methods", nargs="+", help="these only, such as snake-rs kiss/0.05 [default: all]")
    parser.add_argument("--cache", type=Path, default=Path("target/bench-registration.jsonl"))
    parser.add_argument("--train-pairs", type=int, default=140, help="pairs of the fixed random order [default: 140]")
    parser.add_argument("--made-pairs", type=int, default=20, help="pairs of objects, and of sweeps [default: 20]")
    parser.add_argument("--speed-pairs", type=int, default=10, help="pairs that are timed [default: 10]")
    arguments = parser.parse_args()
    bench = Bench(arguments)
    for part in arguments.parts:
        needed = PARTS[part]
        if needed and getattr(arguments, needed) is None:
            print(f"\n{part}: left out, it needs --{needed} FOLDER")
        else:
            getattr(bench, part)()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
