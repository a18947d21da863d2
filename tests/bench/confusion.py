"""How often a verdict is wrong, by kind of pair: the confusion of right and reliable, for one program or several side by side.

    python tests/bench/confusion.py target/release/snake-cli [OTHER ...] [--seeds 0 6] [--kinds stairs "verdict: ball"]

Kinds are those of alike_pairs.py, and with "verdict: " before them those of verdict_pairs.py. `--scenes FOLDER` adds the pairs
of a folder with `pairs.json`, by their overlap. Several programs take turns pair by pair, so that their processor times can be
compared.
"""

import argparse
import itertools
import json
import os
import resource
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import alike_pairs
import numpy as np
import verdict_pairs
from scene_pairs import NEAR_DEGREES, NEAR_METRES, errors, is_right

VERDICT = "verdict: "
KINDS = [*alike_pairs.KINDS, *(VERDICT + name for name in verdict_pairs.kinds(None, ""))]

OUTCOMES = ["right, reliable", "right, not", "wrong, reliable", "wrong, not", "near"]


def made(kinds: list[str], seeds: range, folder: Path) -> Iterator[tuple]:
    """Kind, name, files and the test of a transform."""
    for kind in kinds:
        for seed in seeds:
            if kind.startswith(VERDICT):
                pair = verdict_pairs.pairs(1, seed, None, "", [kind.removeprefix(VERDICT)])[0]()
            else:
                pair = alike_pairs.make(kind, seed)
            files = [folder / f"{end}.npy" for end in ("source", "target")]
            for file, points in zip(files, (pair.source, pair.target), strict=True):
                np.save(file, points)
            yield kind, f"{kind} {seed}", files, pair.is_right


def real(scenes: Path) -> Iterator[tuple]:
    for row in json.loads((scenes / "pairs.json").read_text()):
        files = [scenes / f"{row[end]}.npy" for end in ("source", "target")]
        low = max(limit for limit in (0.0, 0.3, 0.5) if row["overlap"] >= limit)
        truth = np.array(row["T"])
        kind = f"real, overlap {low or 0.1} and more"
        yield kind, f"{row['source']} {row['target']}", files, lambda found, truth=truth: is_about_right(found, truth)


def is_about_right(found: np.ndarray, truth: np.ndarray) -> bool | None:
    """Whether a transform is right; None near a published one, which is not exact."""
    degrees, metres = errors(found, truth)
    return is_right(found, truth) or (None if degrees < NEAR_DEGREES and metres < NEAR_METRES else False)


def run(program: str, files: list[Path]) -> tuple[np.ndarray, bool, float, list[str]]:
    """The transform, whether it is reliable, processor seconds and notes; without a transform the identity, not reliable."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [program, "register", *map(str, files), "--json", "--threads", "1"]
    found = subprocess.run(command, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime - before.ru_utime
    if found.returncode not in (0, 1, 2) or not found.stdout.strip():
        return np.eye(4), False, seconds, [found.stderr.strip()]
    result = json.loads(found.stdout)
    verdict = result["verdict"]
    return np.array(result["t_target_source"]), verdict["is_reliable"], seconds, verdict["notes"]


def outcome(is_right: bool, is_reliable: bool) -> str:
    return f"{'right' if is_right else 'wrong'}, {'reliable' if is_reliable else 'not'}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", nargs="+")
    parser.add_argument("--seeds", type=int, nargs=2, default=[0, 6], help="first seed, and the one after the last")
    parser.add_argument("--kinds", nargs="*", default=KINDS)
    parser.add_argument("--scenes", type=Path)
    parser.add_argument("--lines", action="store_true", help="a line for each pair too")
    arguments = parser.parse_args()
    os.environ |= {"RAYON_NUM_THREADS": "1"}
    counts = [defaultdict(lambda: dict.fromkeys(OUTCOMES, 0)) for _ in arguments.programs]
    seconds = np.zeros(len(arguments.programs))
    with tempfile.TemporaryDirectory() as folder:
        pairs = list(real(arguments.scenes)) if arguments.scenes else []
        made_pairs = made(arguments.kinds, range(*arguments.seeds), Path(folder))
        for kind, name, files, is_right_at in itertools.chain(pairs, made_pairs):
            line = []
            for number, program in enumerate(arguments.programs):
                found, is_reliable, taken, notes = run(program, files)
                right = is_right_at(found)
                told = "near" if right is None else outcome(bool(right), is_reliable)
                counts[number][kind][told] += 1
                seconds[number] += taken
                line.append(f"{told}, {taken:.2f} s, {notes[:1]}")
            if arguments.lines:
                print(name, *line, sep="\n    ", flush=True)
    for number, program in enumerate(arguments.programs):
        print(
            f"\n{program}: {seconds[number]:.1f} s\n\n| kind | {' | '.join(OUTCOMES)} |\n|---|{'---|' * len(OUTCOMES)}"
        )
        for kind, of in counts[number].items():
            mark = " (held out)" if kind in alike_pairs.HELD_OUT else ""
            print(f"| {kind}{mark} | {' | '.join(str(of[name]) for name in OUTCOMES)} |")


if __name__ == "__main__":
    main()
