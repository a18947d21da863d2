"""The pictures of the pages: each is made by a command, each command is one of a program that exists, and each file is shown."""

import re
import runpy
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
LISTED = subprocess.run(
    ["git", "ls-files", "*.png", "*.svg", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True
)
FILES = [Path(name) for name in LISTED.stdout.split() if (ROOT / name).is_file()]
PICTURES = {path for path in FILES if path.suffix != ".md" and path.parts[0] == "docs"}
SCRIPT = runpy.run_path(str(ROOT / "docs/pictures.py"))


def test_every_picture_is_made_by_the_rule_of_pictures_or_of_results():
    rules = (ROOT / "Makefile").read_text()
    assert re.search(r"^pictures:.*\n(\t.*\n)*\t.*docs/pictures\.py", rules, re.MULTILINE)
    curves = re.findall(r'"(repeatability\S*\.svg)"', (ROOT / "docs/results.py").read_text())
    assert {Path("docs") / name for name in [*SCRIPT["PICTURES"], *curves]} >= PICTURES
    assert {Path("docs") / name for name in SCRIPT["PICTURES"]} <= PICTURES


def test_every_picture_is_shown():
    shown = set()
    for page in FILES:
        if page.suffix == ".md":
            links = re.findall(r"!\[[^]]*\]\(([^)]+)\)", (ROOT / page).read_text())
            shown |= {(ROOT / page.parent / link).resolve() for link in links if "://" not in link}
    assert {(ROOT / path).resolve() for path in PICTURES} <= shown


def test_clouds_of_the_commands_are_known():
    clouds = {*SCRIPT["MADE"], *SCRIPT["READ"]}
    used = {
        name
        for commands in SCRIPT["PICTURES"].values()
        for command in commands
        for name in re.findall(r"{(\w+)}", command)
    }
    assert used - {"out"} == clouds
    assert all("{out}" in commands[-1] for commands in SCRIPT["PICTURES"].values())


def test_a_picture_without_its_data_stays():
    assert SCRIPT["make"]("gallery/rooms.png", None) == "it shows data: give --data"
