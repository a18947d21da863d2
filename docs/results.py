"""Makes the tables and curves of `results.md`: the built-in models and the classical detectors on objects and on real scenes.

Run from the repository's root, by `make results OBJECTS=FOLDER LANDMARKS=FOLDER BODIES=FOLDER SURFACES=FOLDER SCENES=FOLDER`; methods
that are evaluated already are not evaluated again. A table of the page stands below a comment with its name; those whose folder is
not given stay as they are.
"""

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd

from snake_training.evaluation.__main__ import evaluate
from snake_training.evaluation.tables import markdown, pivot

RUNS = Path("target/results")
PAGE = Path("docs/results.md")
# The coverage of all methods: in units of the objects' radius, and in metres.
OBJECT_COVERAGE, ROOM_COVERAGE = "0.14", "0.197"
PAIRS = "30"  # of scenes, evenly spaced, in repeatability
OURS, CLASSICAL = ("compact", "standard"), ("surface-variation", "iss", "harris3d", "sift3d", "fps", "random")
ROOMS = "scenes", "iss", "harris3d", "sift3d", "random"
CORNERS = tuple(f"{model}:prefer=corners" for model in OURS)
PAPER_MODEL = Path("models/paper.safetensors")
SURFACES = "--methods", "middle", "level", "poisson", "--downsample", "8", "--noise", "0.03"


def run(name: str, words: str, methods: tuple) -> pd.DataFrame:
    """The table of an evaluation, kept below RUNS; words are separated by spaces."""
    return evaluate([*words.split(), "--methods", *methods, "-o", str(RUNS / name)])


def repeatability_table(
    table: pd.DataFrame,
    epsilon: tuple,
    of: str,
    swept: tuple = ("1 in 8", "σ 0.06"),
    seen: tuple = (),
    beyond: bool = True,
) -> str:
    """Repeatability over ε, coverage, thinned and noisy views at the ε `of`, and of places that both saw, a row a method."""
    columns = {f"ε {e}": ("repeatability", f"ε {e}") for e in epsilon} | {"coverage": ("coverage", "clean")}
    columns |= {name: ("repeatability", f"ε {of}, {name}") for name in swept}
    columns |= {f"of seen, ε {e}": ("of seen", f"ε {e}") for e in seen}
    if beyond:
        columns |= {f"beyond ε {of}": ("beyond chance", f"ε {of}"), "on flat places": ("on flat places", "clean")}
    return markdown(pivot(table, columns))


def objects_tables(folder: str, limit: str) -> dict[str, str]:
    """Tables on objects; draws their curves."""
    words = f"repeatability {folder} {limit} --downsample 1 8 --noise 0 0.06"
    alike = f"{words} --epsilon 0.02 0.04 0.1 --coverage {OBJECT_COVERAGE}"
    alike = run("objects", alike, (*OURS, *CLASSICAL, *CORNERS))
    paper = run("paper", f"{words} --epsilon 0.04 --nms-radius 0.01", (*OURS, "surface-variation", "iss"))
    shutil.copy(RUNS / "objects/repeatability.svg", PAGE.with_name("repeatability.svg"))
    return {
        "objects": repeatability_table(alike, ("0.02", "0.04", "0.1"), "0.04"),
        "the paper's protocol": repeatability_table(paper, ("0.04",), "0.04", beyond=False),
    }


def landmarks_tables(folder: str) -> dict[str, str]:
    """The table on landmarks."""
    words = f"semantic {folder} --coverage {OBJECT_COVERAGE} --threshold 0.05 0.1"
    found = run("landmarks", words, (*OURS, *CLASSICAL, *CORNERS))
    return {"landmarks": markdown(pivot(found, {name: ("found", f"threshold {name}") for name in ("0.05", "0.1")}))}


def bodies_tables(folder: Path, limit: str) -> dict[str, str]:
    """The table on bodies; a set of bent objects is there if they were made of a corpus."""
    methods = *OURS, *CORNERS[:1], *CLASSICAL, *([str(PAPER_MODEL)] if PAPER_MODEL.exists() else [])
    tables, columns = [], {}
    for name, metrics in {
        "annotated": ("mIoU, strict", "found"),
        "posed": ("mIoU, strict",),
        "bent": ("mIoU, strict",),
    }.items():
        if not (folder / name).is_dir():
            continue
        table = run(name, f"semantic {folder / name} --threshold 0.05 0.1 {limit}", methods)
        tables.append(table.assign(metric=name + table["metric"]))
        for metric in metrics:
            title = "found" if metric == "found" else name
            columns |= {f"{title} {t}": (name + metric, f"threshold {t}") for t in ("0.05", "0.1")}
    return {"bodies": markdown(pivot(pd.concat(tables).replace({"method": {str(PAPER_MODEL): "paper"}}), columns))}


def surfaces_tables(folder: str) -> dict[str, str]:
    """The table on reconstruction."""
    words = [sys.executable, "-m", "snake_training.reconstruction", folder, *SURFACES]
    return {"reconstruction": subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout}


def scenes_tables(folder: str) -> dict[str, str]:
    """Tables on rooms; draws their curves."""
    pairs = f"repeatability {folder} --noise 0 --limit {PAIRS} --table-epsilon"
    alike = f"{pairs} 0.16 --epsilon 0.05 0.1 0.16 --coverage {ROOM_COVERAGE} --downsample 1 8 --downsample-one 8"
    alike = run("scenes", alike, ROOMS)
    many = f"{pairs} 0.1 --max-keypoints 256 --num-points 1000000 --epsilon 0.05 0.1 --downsample 1"
    many = run("scenes-default", many, ("scenes", "iss"))
    found = f"registration {folder} --max-keypoints 500 250 100"
    found = run("scenes-0", found, ROOMS)
    shutil.copy(RUNS / "scenes/repeatability.svg", PAGE.with_name("repeatability-scenes.svg"))
    return {
        "scenes": repeatability_table(
            alike, ("0.05", "0.1", "0.16"), "0.16", ("1 in 8", "1 in 8 of one"), ("0.05", "0.1")
        ),
        "scenes by default": repeatability_table(many, ("0.05", "0.1"), "0.1", ()),
    } | {
        name: markdown(pivot(found[found["metric"] == name]))
        for name in ("feature matching recall", "registration recall")
    }


def page(tables: dict[str, str], before: str) -> str:
    """The page with these tables, by the names in the comments above them."""
    for name, table in tables.items():
        mark = f"<!-- table: {name} -->\n"
        above, rest = before.split(mark)
        before = above + mark + table.strip() + "\n" + re.sub(r"\A(\|.*\n)+", "", rest)
    return before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", help="corpus folder, or any folder of clouds")
    parser.add_argument("--landmarks", help="folder of python -m snake_training.make landmarks")
    parser.add_argument("--bodies", type=Path, help="folder of python -m snake_training.make bodies")
    parser.add_argument("--surfaces", help="corpus folder, for the part on reconstruction")
    parser.add_argument("--scenes", help="folder with pairs.json")
    parser.add_argument("--limit", help="so many objects, evenly spaced, instead of all")
    given = parser.parse_args()
    limit, tables = f"--limit {given.limit}" if given.limit else "", {}
    if given.objects:
        tables |= objects_tables(given.objects, limit)
    if given.landmarks:
        tables |= landmarks_tables(given.landmarks)
    if given.bodies:
        tables |= bodies_tables(given.bodies, limit)
    if given.surfaces:
        tables |= surfaces_tables(given.surfaces)
    if given.scenes:
        tables |= scenes_tables(given.scenes)
    if not tables:
        parser.error("give --objects, --landmarks, --bodies, --surfaces or --scenes FOLDER, or several of them")
    PAGE.write_text(page(tables, PAGE.read_text()))


if __name__ == "__main__":
    main()
