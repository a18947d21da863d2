"""Makes `results.md` and its curves: the built-in models and the classical detectors on objects and on real scenes.

Run from the repository's root, by `make results OBJECTS=FOLDER LANDMARKS=FOLDER BODIES=FOLDER SURFACES=FOLDER SCENES="FOLDER .."`; methods that
are evaluated already are not evaluated again. The part of the page whose folder is not given stays as it is.
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
# Pairs of scenes, evenly spaced, in repeatability, and in registration beyond the first folder of scenes.
REPEATABILITY_PAIRS, MORE_PAIRS = "30", "60"
OURS, CLASSICAL = ("compact", "standard"), ("surface-variation", "iss", "harris3d", "sift3d", "fps", "random")
CORNERS = tuple(f"{model}:prefer=corners" for model in OURS)
PAPER_MODEL = Path("models/paper.safetensors")
UNDISTURBED = "--downsample", "1", "--noise", "0"

HEADINGS = "Objects", "Landmarks", "Semantic consistency", "Reconstruction", "Scenes"

INTRODUCTION = """# Results

Made by `make results OBJECTS=FOLDER LANDMARKS=FOLDER BODIES=FOLDER SCENES="FOLDER .."`
(`python -m snake_training.evaluation repeatability --help` lists the layouts): do not edit it.

Objects: 79 that chose nothing (`judge` of `python -m snake_training.make halves`). Rooms: 3DMatch, without the fifth of its pairs that
overlap by less than a tenth or do not fit within 2 cm; published figures are of all pairs.

The table of the README:

```sh
python -m snake_training.evaluation repeatability OBJECTS --methods compact standard iss surface-variation sift3d --coverage 0.14 \\
    --epsilon 0.04 --downsample 1 --noise 0
python -m snake_training.evaluation repeatability SCENES --methods scenes iss sift3d --limit 30 --coverage 0.197 --epsilon 0.16 \\
    --downsample 1 8 --noise 0
python -m snake_training.evaluation repeatability SWEEPS --methods scenes iss sift3d --max-keypoints 128 --coverage 3 --epsilon 0.5 \\
    --num-points 30000 --downsample 1 --noise 0
```
"""


def run(name: str, *words: str) -> pd.DataFrame:
    """The table of an evaluation, kept below RUNS."""
    return evaluate([*words, "-o", str(RUNS / name)])


def units(table: pd.DataFrame) -> int:
    """The number of pairs, shapes or scenes."""
    return table["unit"].nunique()


def repeatability_table(
    table: pd.DataFrame, epsilon: tuple, of: str, swept: tuple = ("1 in 8", "σ 0.06"), beyond: bool = True
) -> str:
    """Repeatability over ε, coverage, and thinned and noisy views at the ε `of`, a row a method."""
    columns = {f"ε {e}": ("repeatability", f"ε {e}") for e in epsilon} | {"coverage": ("coverage", "clean")}
    columns |= {name: ("repeatability", f"ε {of}, {name}") for name in swept}
    if beyond:
        columns |= {f"beyond ε {of}": ("beyond chance", f"ε {of}"), "on flat places": ("on flat places", "clean")}
    return markdown(pivot(table, columns))


def objects_part(folder: str, limit: tuple) -> str:
    """The part on objects; draws its curves."""
    views = "--downsample", "1", "8", "--noise", "0", "0.06"
    words = "repeatability", folder, *limit, *views, "--methods"
    methods = *OURS, *CLASSICAL, *CORNERS
    alike = run("objects", *words, *methods, "--epsilon", "0.02", "0.04", "0.1", "--coverage", OBJECT_COVERAGE)
    paper = run("paper", *words, *OURS, "surface-variation", "iss", "--epsilon", "0.04", "--nms-radius", "0.01")
    shutil.copy(RUNS / "objects/repeatability.svg", PAGE.with_name("repeatability.svg"))
    return f"""## Objects

Relative repeatability on {units(alike)} objects: the share of keypoints of one view that the other view, rotated at random and sampled
anew, finds again within ε (in units of the object's radius), with 5000 points and the best 64 keypoints of each view. Coverage is the mean
distance from the points to the nearest keypoint. Each method keeps its keypoints as far apart as makes its coverage {OBJECT_COVERAGE}, so that none gains by
keypoints that cluster. Thinned (1 in N) and noisy (σ) views are at ε 0.04:

{repeatability_table(alike, ("0.02", "0.04", "0.1"), "0.04")}
Beyond chance, 0 is what random points of the other view would find, as many as it has keypoints. On a flat place, the least of three
eigenvalues of the neighbourhood is below 1 % of their sum.

![the same as curves](repeatability.svg)

### The paper's protocol

The paper's suppression of 0.01 lets keypoints cluster, and then they repeat more easily: compare the coverage.
[The paper's own figures](reproduce.md#repeatability) are of other objects.

{repeatability_table(paper, ("0.04",), "0.04", beyond=False)}"""


def landmarks_part(folder: str) -> str:
    """The part on landmarks."""
    methods = *OURS, *CLASSICAL, *CORNERS
    found = run(
        "landmarks",
        "semantic",
        folder,
        "--coverage",
        OBJECT_COVERAGE,
        "--threshold",
        "0.05",
        "0.1",
        "--methods",
        *methods,
    )
    return f"""## Landmarks

The share of the corners, tips and ends of 200 procedural shapes, which know them (`python -m snake_training.make landmarks`), that have a
keypoint within 0.05 and 0.1, all methods at the coverage {OBJECT_COVERAGE}. What `--prefer corners` costs stands under [objects](#objects).

{markdown(pivot(found, {name: ("found", f"threshold {name}") for name in ("0.05", "0.1")}))}"""


def bodies_part(folder: Path, limit: tuple) -> str:
    """The part on bodies; a set of bent objects is there if they were made of a corpus."""
    methods = *OURS, *CLASSICAL, *([str(PAPER_MODEL)] if PAPER_MODEL.exists() else [])
    tables, columns = {}, {}
    for name, metrics in {
        "annotated": ("mIoU, strict", "found"),
        "posed": ("mIoU, strict",),
        "bent": ("mIoU, strict",),
    }.items():
        if not (folder / name).is_dir():
            continue
        table = run(name, "semantic", str(folder / name), "--threshold", "0.05", "0.1", *limit, "--methods", *methods)
        tables[name] = table.assign(metric=name + table["metric"])
        for metric in metrics:
            title = "found" if metric == "found" else name
            columns |= {f"{title} {t}": (name + metric, f"threshold {t}") for t in ("0.05", "0.1")}
    table = pd.concat(tables.values()).replace({"method": {str(PAPER_MODEL): "paper"}})
    bent = (
        f"\n- bent: {units(tables['bent'])} pairs of a validation object and a bent, twisted copy, in the same way."
        if "bent" in tables
        else ""
    )
    return f"""## Semantic consistency

The mIoU of made bodies with known correspondences by the two protocols of the paper, with its suppression of 0.1 for all methods
(`python -m snake_training.make bodies -o bodies/ --corpus CORPUS/val --bends 8`, BODIES is `bodies/`). `paper` is
[that model](../models/README.md#paper). [The paper's own figures](reproduce.md#semantic-consistency) are of other bodies.

- annotated: shapes of {units(tables["annotated"])} classes in random poses and proportions, 2048 points each, with annotated tips, ends and corners; the box
  around a shape has the diagonal 1. mIoU counts every other keypoint as false; found is the share of annotations with a keypoint. Distances
  are geodesic.
- posed: {units(tables["posed"])} pairs of such bodies in two poses and of proportions that differ by up to 15 %, with the same 2048 points of the surface; the
  first has the radius 1. The best 20 keypoints of one body are carried to the other.{bent}

{markdown(pivot(table, columns))}"""


def surfaces_part(folder: str) -> str:
    """The part on reconstruction."""
    words = ["--methods", "middle", "level", "poisson", "--downsample", "8", "--noise", "0.03"]
    module = [sys.executable, "-m", "snake_training.reconstruction", folder]
    table = subprocess.run([*module, *words], check=True, stdout=subprocess.PIPE, text=True).stdout
    return f"""## Reconstruction

The surface of the field of `compact` beside Open3D's Poisson reconstruction, on the objects. A method sees 5000 points, or 625, or 5000
with noise; its mesh is compared with all 8192 points (radius 1). Accuracy is the mean distance from the mesh to the nearest point,
completeness that from a point to the mesh, F the harmonic mean of the shares that are nearer than 0.02 and 0.05. `middle` is the default
of `snake-cli reconstruct`, `level` the surface of the paper.

```sh
python -m snake_training.reconstruction OBJECTS {" ".join(words)}
```

{table.strip()}
"""


def registration_text(table: pd.DataFrame) -> str:
    """Two tables of the benchmark."""
    shown = (
        markdown(pivot(table[table["metric"] == name])) for name in ("feature matching recall", "registration recall")
    )
    return "Feature matching recall:\n\n{}\nRegistration recall, without consecutive fragments:\n\n{}".format(*shown)


def scenes_part(folders: list[str]) -> str:
    """The part on rooms; draws its curves."""
    pairs = "repeatability", folders[0], *UNDISTURBED, "--limit", REPEATABILITY_PAIRS
    alike = run(
        "scenes",
        *pairs,
        "--epsilon",
        "0.05",
        "0.1",
        "0.16",
        "--table-epsilon",
        "0.1",
        "--coverage",
        ROOM_COVERAGE,
        "--methods",
        "scenes",
        *CLASSICAL,
    )
    many = "--max-keypoints", "256", "--num-points", "1000000"
    by_default = run(
        "scenes-default",
        *pairs,
        *many,
        "--epsilon",
        "0.05",
        "0.1",
        "--table-epsilon",
        "0.1",
        "--methods",
        "scenes",
        "iss",
        "fps",
    )
    shutil.copy(RUNS / "scenes/repeatability.svg", PAGE.with_name("repeatability-scenes.svg"))
    parts = []
    for number, folder in enumerate(folders):
        few = "--max-keypoints", "500", "250", "100", *(("--limit", MORE_PAIRS) if number else ())
        parts.append(
            registration_text(
                run(f"scenes-{number}", "registration", folder, *few, "--methods", "scenes", *CLASSICAL, "register")
            )
        )
    more = "".join(f"\n### Registration, more scenes\n\n{part}" for part in parts[1:])
    return f"""## Scenes

Real clouds with known transforms, in metres. `scenes` has seen no real room.

### Repeatability on scenes

10240 points of each cloud, the best 64 keypoints, {REPEATABILITY_PAIRS} pairs; each method at the coverage {ROOM_COVERAGE} m.

{repeatability_table(alike, ("0.05", "0.1", "0.16"), "0.1", ())}
![the same as curves](repeatability-scenes.svg)

Up to 256 keypoints of all points: `scenes` keeps those of a confidence of 0.21 and more. Even spacing alone lifts farthest points.

{repeatability_table(by_default, ("0.05", "0.1"), "0.1", ())}
### Registration

By the rules of the 3DMatch benchmark, clouds reduced to voxels of 3 cm: correspondences are mutual nearest neighbours, right within 0.1 m;
a pair matches with more than 0.05 of them right; RANSAC (0.05 m, edges 0.9, 50 000 samples, no ICP) registers it with an RMSE of at most
0.2 m over the overlap. [`register`](registration.md) matches every voxel instead.

{parts[0]}{more}"""


def page(parts: dict[str, str], before: str) -> str:
    """The parts, by their headings; those that are not given as they were before."""
    old = {
        found[1]: found[0] for found in re.finditer(r"^## ([\w ]+)\n.*?(?=^## |\Z)", before, re.DOTALL | re.MULTILINE)
    }
    texts = [(old | parts)[name].rstrip() + "\n" for name in HEADINGS if name in old | parts]
    return "\n".join([INTRODUCTION, *texts])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", help="corpus folder, or any folder of clouds")
    parser.add_argument("--landmarks", help="folder of python -m snake_training.make landmarks")
    parser.add_argument("--bodies", help="folder of python -m snake_training.make bodies")
    parser.add_argument("--surfaces", help="corpus folder, for the part on reconstruction")
    parser.add_argument(
        "--scenes", nargs="+", default=[], help="folders with pairs.json; of those after the first 60 pairs"
    )
    parser.add_argument("--limit", help="so many objects, evenly spaced, instead of all")
    given = parser.parse_args()
    limit, parts = ("--limit", given.limit) if given.limit else (), {}
    if given.objects:
        parts["Objects"] = objects_part(given.objects, limit)
    if given.landmarks:
        parts["Landmarks"] = landmarks_part(given.landmarks)
    if given.bodies:
        parts["Semantic consistency"] = bodies_part(Path(given.bodies), limit)
    if given.surfaces:
        parts["Reconstruction"] = surfaces_part(given.surfaces)
    if given.scenes:
        parts["Scenes"] = scenes_part(given.scenes)
    if not parts:
        parser.error("give --objects, --landmarks, --bodies, --surfaces or --scenes FOLDER, or several of them")
    PAGE.write_text(page(parts, PAGE.read_text() if PAGE.exists() else ""))


if __name__ == "__main__":
    main()
