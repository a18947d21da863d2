"""Which constants of registration matter: each is halved and doubled, and pairs are registered again.

    cargo build --release -p snake-keypoints --features snake-registration/scan
    python tests/bench/sensitivity.py target/release/snake-cli --scenes SCENES [--seed 71] [--only judge]

The pairs are one of each kind of confusion.py and every sixth of the scenes' `pairs.json`; pairs that took more than
`--slowest` seconds are left out. A constant matters if, at half or twice its value, a pair has another outcome: right or
wrong, reliable or not. What only `align`, maps, several instances, unknown scales, single matches, `--gravity` and notes use
is left out.
"""

import argparse
import itertools
import os
import re
import tempfile
import time
from pathlib import Path

import confusion

CRATE = Path(__file__).parents[2] / "crates/snake-registration"
ROW = re.compile(r'^\s+(\w+): [^=\n]+ = [^;]*?, unit "[^"]*",\s*from "([^"]*)";', re.MULTILINE)
# Of unknown scales, units, single matches, a known gravity, and names in notes.
LEFT_OUT = "scale_|min_scale|unit_ratio|(lead|min_lead|max_tilt|no_rotation)$"
UNUSED = (
    "register/instances",
    "register/scale",
    "register/prepared_map",
    "many",
    "steps/votes",
    "steps/single_matches",
)


def constants(only: str) -> list[tuple[str, str]]:
    """The path of each constant that a plain registration uses, and where it comes from."""
    found = []
    for file in sorted((CRATE / "src").rglob("*.rs")):
        text, place = file.read_text(), str(file.relative_to(CRATE / "src").with_suffix("")).removesuffix("/mod")
        if "\ntuning! {" in text and only in place and not place.startswith(UNUSED):
            module = "::".join(["snake_registration", *place.split("/")])
            rows = [row for row in ROW.findall(text) if not re.match(LEFT_OUT, row[0])]
            found += [(f"{module}::{name}", source) for name, source in rows]
    return found


def outcome(program: str, files: list[Path], is_right_at: object) -> str:
    found, is_reliable, *_ = confusion.run(program, files)
    right = is_right_at(found)
    return "near" if right is None else confusion.outcome(bool(right), is_reliable)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=71)
    parser.add_argument("--only", default="", help="files with this in their path")
    parser.add_argument("--source", default="", help='rows whose values come from this, such as "set by hand"')
    parser.add_argument("--slowest", type=float, default=0.8, help="seconds [default: 0.8]")
    arguments = parser.parse_args()
    os.environ |= {"RAYON_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        pairs = []
        made = confusion.made(confusion.KINDS, range(arguments.seed, arguments.seed + 1), Path(folder))
        for number, (_, name, files, is_right_at) in enumerate(
            itertools.chain(itertools.islice(confusion.real(arguments.scenes), 0, None, 6), made)
        ):
            kept = [
                file.rename(file.with_name(f"{number}-{file.name}")) if folder in str(file) else file for file in files
            ]
            start = time.perf_counter()
            expected = outcome(arguments.program, kept, is_right_at)
            if time.perf_counter() - start < arguments.slowest:
                pairs.append((name, kept, is_right_at, expected))
        print(
            f"{len(pairs)} pairs: {', '.join(name for name, *_ in pairs)}\n\n| constant | from | 0.5 | 2 |\n|---|---|---|---|"
        )
        for path, source in constants(arguments.only):
            if not source.startswith(arguments.source):
                continue
            changed = []
            for factor in (0.5, 2):
                os.environ["SNAKE_SCAN"] = f"{path}={factor}"
                others = (name for name, files, test, was in pairs if outcome(arguments.program, files, test) != was)
                changed.append(next(others, "-"))
            print(
                f"| {path.removeprefix('snake_registration::')} | {source[:40]} | {' | '.join(changed)} |", flush=True
            )
            # A pair that one constant changes is likely to be changed by the next: it comes first.
            pairs.sort(key=lambda pair: pair[0] not in changed)


if __name__ == "__main__":
    main()
