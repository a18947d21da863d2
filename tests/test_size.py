"""The lines of Rust and Python, tests included, only fall: who adds a capability names what goes, and lowers the numbers here."""

import subprocess
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAX_LINES = {
    "crates/snake-capi": 907,
    "crates/snake-cli": 6367,
    "crates/snake-core": 12068,
    "crates/snake-detectors": 1221,
    "crates/snake-geometry": 5887,
    "crates/snake-io": 10561,
    "crates/snake-kernels": 2976,
    "crates/snake-registration": 10922,
    "crates/snake-tiles": 1846,
    "crates/snake-view": 575,
    "docs": 456,
    "examples": 229,
    "fuzz": 79,
    "python": 4558,
    "tests": 4816,
    "tools": 209,
    "training": 13294,
}


def folder_of(name: str) -> str:
    """A crate, or a folder of the root."""
    parts = name.split("/")
    return "/".join(parts[: 2 if parts[0] == "crates" else 1])


def test_no_folder_has_more_lines_than_its_greatest_number():
    listed = subprocess.run(
        ["git", "ls-files", "*.rs", "*.py", "*.pyi"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    lines = Counter()
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            lines[folder_of(name)] += len((ROOT / name).read_text(encoding="utf-8").splitlines())
    assert lines.keys() == MAX_LINES.keys()
    assert {folder: number for folder, number in lines.items() if number > MAX_LINES[folder]} == {}
