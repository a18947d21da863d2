"""How often a verdict is wrong, by kind of pair: the confusion of right and reliable, for one program or several side by side.

    python tests/bench/confusion.py target/release/snake-cli [OTHER ...] [--seeds 0 6] [--kinds stairs ramp] [--scenes FOLDER]
        [--options="--detector snake --set num_keypoints=60"]

Kinds are those of made_pairs.py. `--scenes` adds the pairs of a folder of clouds (.npy) with `pairs.json`, by their overlap.
"""

import argparse
import itertools
import json
import os
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import made_pairs
import numpy as np

OUTCOMES = ["right, reliable", "right, not", "wrong, reliable", "wrong, not", "near"]


def made(kinds: list[str], seeds: range, folder: Path) -> Iterator[tuple]:
    """Kind, files and the test of a transform."""
    for kind, seed in itertools.product(kinds, seeds):
        pair, files = made_pairs.make(kind, seed), [folder / f"{end}.npy" for end in ("source", "target")]
        for file, points in zip(files, (pair.source, pair.target), strict=True):
            np.save(file, points)
        yield f"{kind} (held out)" if kind in made_pairs.HELD_OUT else kind, files, pair.is_right


def real(scenes: Path) -> Iterator[tuple]:
    """The same of published pairs."""
    for row in json.loads((scenes / "pairs.json").read_text()):
        files = [scenes / f"{row[end]}.npy" for end in ("source", "target")]
        low = max(limit for limit in (0.0, 0.3, 0.5) if row["overlap"] >= limit)
        yield f"real, overlap {low or 0.1} and more", files, partial(is_near, np.array(row["T"]))


def is_near(truth: np.ndarray, transform: np.ndarray) -> bool | None:
    """Whether a transform is right; None near a published one, which is not exact."""
    degrees, metres = made_pairs.errors(transform, truth)
    return (degrees <= 15 and metres <= 0.3) or (None if degrees < 20 and metres < 0.7 else False)


def run(program: str, files: list[Path], options: str) -> tuple[np.ndarray, bool]:
    """The transform, and whether it is reliable; without a transform the identity, not reliable."""
    command = [program, "register", *map(str, files), "--json", "--threads", "1", *options.split()]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"RAYON_NUM_THREADS": "1"})
    if done.returncode not in (0, 1, 2) or not done.stdout.strip():
        return np.eye(4), False
    result = json.loads(done.stdout)
    return np.array(result["t_target_source"]), result["verdict"]["is_reliable"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", nargs="+")
    parser.add_argument("--seeds", type=int, nargs=2, default=[0, 6], help="first seed, and the one after the last")
    parser.add_argument("--kinds", nargs="*", default=list(made_pairs.KINDS), choices=made_pairs.KINDS, metavar="KIND")
    parser.add_argument("--scenes", type=Path)
    parser.add_argument("--options", default="", help="of `register`, as one word")
    arguments = parser.parse_args()
    counts = [defaultdict(lambda: dict.fromkeys(OUTCOMES, 0)) for _ in arguments.programs]
    with tempfile.TemporaryDirectory() as folder:
        pairs = real(arguments.scenes) if arguments.scenes else ()
        pairs = itertools.chain(pairs, made(arguments.kinds, range(*arguments.seeds), Path(folder)))
        for kind, files, is_right in pairs:
            for number, program in enumerate(arguments.programs):
                transform, is_reliable = run(program, files, arguments.options)
                answer = {True: "right, ", False: "wrong, ", None: "near"}[is_right(transform)]
                told = answer if answer == "near" else answer + ("reliable" if is_reliable else "not")
                counts[number][kind][told] += 1
    for program, rows in zip(arguments.programs, counts, strict=True):
        print(f"\n{program}\n\n| kind | {' | '.join(OUTCOMES)} |\n|---|{'---|' * len(OUTCOMES)}")
        whole = {name: sum(row[name] for kind, row in rows.items() if kind[:4] != "real") for name in OUTCOMES}
        for kind, row in [*rows.items(), ("all made", whole)]:
            print(f"| {kind} | {' | '.join(str(count) for count in row.values())} |")


if __name__ == "__main__":
    main()
