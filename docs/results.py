"""Makes `results.md` and its curves: the built-in models and the classical detectors on objects and on real scenes.

Run from the repository's root, by `make results OBJECTS=FOLDER LANDMARKS=FOLDER BODIES=FOLDER SURFACES=FOLDER SCENES="FOLDER .."`; an
interrupted run goes on where it was. The part of the page whose folder is not given stays as it is. Needs nothing but Python; the part on
reconstruction also the packages of `training` and Open3D.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

RUNS = Path("target/results")
PAGE = Path("docs/results.md")
# The coverage of all methods: in units of the objects' radius, and in metres.
OBJECT_COVERAGE = "0.14"
ROOM_COVERAGE = "0.197"
# Pairs of scenes, evenly spaced, in repeatability, and in registration beyond the first folder of scenes.
REPEATABILITY_PAIRS = 30
MORE_PAIRS = 60
CLASSICAL = "surface-variation,iss,harris3d,sift3d,fps,random"
THRESHOLDS = "0.05", "0.1"
BODIES = "annotated", "posed", "bent"
PAPER_MODEL = Path("models/paper.safetensors")

HEADINGS = "Objects", "Landmarks", "Semantic consistency", "Reconstruction", "Scenes"

INTRODUCTION = """# Results

Made by `make results OBJECTS=FOLDER LANDMARKS=FOLDER BODIES=FOLDER SCENES="FOLDER .."` (`snake-cli eval repeatability --help` lists the
layouts): do not edit it.

Objects: 79 that chose nothing (`judge` of `python -m snake_training.make halves`). Rooms: 3DMatch, without the fifth of its pairs that
overlap by less than a tenth or do not fit within 2 cm; published figures are of all pairs.

The table of the README:

```sh
snake-cli eval repeatability OBJECTS --model compact --methods snake,snakex4,iss,surface-variation,sift3d \\
    --coverage 0.14 --epsilon 0.04 --downsample 1 --noise 0    # snakex4 is standard
snake-cli eval repeatability SCENES --model scenes --methods snake,iss,sift3d --limit 30 --coverage 0.197 --epsilon 0.16 \\
    --table-epsilon 0.16 --downsample 1,8 --noise 0
snake-cli eval repeatability SWEEPS --model scenes --methods snake,iss,sift3d --max-keypoints 128 --coverage 3 --epsilon 0.5 \\
    --num-points 30000 --downsample 1 --noise 0
```
"""


def evaluate(name: str, metric: str, *arguments: str) -> tuple[dict, str]:
    """Runs an evaluation (or what is left of it): its report, and its tables in Markdown."""
    output = RUNS / name
    command = ["cargo", "run", "--release", "--quiet", "--bin", "snake-cli", "--", "eval", metric]
    subprocess.run([*command, *arguments, "-o", str(output)], check=True, stdout=subprocess.DEVNULL)
    report = json.loads((output / f"{metric}.json").read_text())
    return report, one_number_a_cell((output / f"{metric}.md").read_text())


def one_number_a_cell(tables: str) -> str:
    """The tables without standard deviations, which are in the reports."""
    return re.sub(r" ± standard deviation over \w+| ±\d+\.\d+", "", tables)


def joined(tables: str, beyond: str = "") -> str:
    """The tables of one evaluation of repeatability as one: a row a method, views that are not disturbed once.

    Of the figures beyond chance, those at one ε."""
    columns: dict[str, dict[str, str]] = {}
    for table in re.findall(r"(?:^\|.*\n?)+", tables, re.MULTILINE):
        head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines())
        for i, name in enumerate(head):
            is_left_out = name.startswith("beyond ") and name != f"beyond ε {beyond}"
            kept_out = ("method", "keypoints", "1 in 1", "σ 0", *([] if beyond else ["on flat places"]))
            if not is_left_out and name not in kept_out:
                columns[name] = {row[0]: row[i] for row in rows}
    methods = list(next(iter(columns.values())))
    rows = [["method", *columns]]
    rows += [[method, *(cells.get(method, "-") for cells in columns.values())] for method in methods]
    head, *lines = (f"| {' | '.join(row)} |\n" for row in rows)
    return "".join([head, f"|{'---|' * (1 + len(columns))}\n", *lines])


def with_corners(table: str, corners: str) -> str:
    """A table with the rows of the same one of an evaluation with `--prefer corners`."""
    rows = re.findall(r"^\| snake.*\n", corners, re.MULTILINE)
    return table + "".join(re.sub(r"^\| (\w+)", r"| \1, corners", row) for row in rows)


def objects_part(alike: tuple[dict, str], corners: str, paper_tables: str) -> str:
    report, tables = alike
    return f"""## Objects

Relative repeatability on {report["pairs"]} objects: the share of keypoints of one view that the other view, rotated at random and sampled
anew, finds again within ε (in units of the object's radius), with 5000 points and the best 64 keypoints of each view. `snake` is
`compact`, `snakex4` is `standard`, `corners` is `--prefer corners`. Coverage is the mean distance from the points to the nearest keypoint.
Each method keeps its keypoints as far apart as makes its coverage {OBJECT_COVERAGE}, so that none gains by keypoints that cluster. Thinned (1 in N) and noisy (σ) views are
at ε 0.04:

{with_corners(joined(tables, "0.04"), joined(corners, "0.04"))}
Beyond chance, 0 is what random points of the other view would find, as many as it has keypoints. On a flat place, the least of three
eigenvalues of the neighbourhood is below 1 % of their sum.

![the same as curves](repeatability.svg)

### The paper's protocol

The paper's suppression of 0.01 lets keypoints cluster, and then they repeat more easily: compare the coverage.
[The paper's own figures](reproduce.md#repeatability) are of other objects.

{joined(paper_tables)}"""


def shares(tables: str) -> str:
    """The table with the share of the landmarks that are found, of those of an evaluation."""
    found = re.search(r"^Share of annotated[^\n]*\n\n(\|[^\n]*\n)+", tables, re.MULTILINE)[0]
    return re.sub(r"^(\|.*\|)[^|]*\|$", r"\1", found, flags=re.MULTILINE)  # without the number of keypoints


def landmarks_part(tables: str, corners: str) -> str:
    return f"""## Landmarks

200 procedural shapes that know their corners, tips and ends (`python -m snake_training.make landmarks`), all methods at the
coverage {OBJECT_COVERAGE}. What `--prefer corners` costs stands under [objects](#objects).

{with_corners(shares(tables), shares(corners))}"""


def consistency(reports: dict[str, list[dict]], *kinds: tuple[str, str, str]) -> str:
    """A table of reports of semantic consistency, a row a method; kinds: set of bodies, figure of its reports, title of the columns."""
    kinds = tuple(kind for kind in kinds if reports[kind[0]])
    columns = [f"{title} {threshold}" for _, _, title in kinds for threshold in THRESHOLDS]
    rows: dict[str, list[str]] = {}
    for name, figure, _ in kinds:
        for row in (row for report in reports[name] for row in report["rows"] if row["class"] is None):
            rows.setdefault(row["method"], []).extend(f"{value:.3f}" for value in row[figure])
    lines = [
        f"| {' | '.join(cells)} |\n" for cells in [["method", *columns], *([name, *row] for name, row in rows.items())]
    ]
    return "".join([lines[0], f"|{'---|' * (1 + len(columns))}\n", *lines[1:]])


def bodies_part(reports: dict[str, list[dict]]) -> str:
    annotated, posed, bent = (reports[name][0]["shapes"] if reports[name] else 0 for name in BODIES)
    kinds = ("annotated", "strict", "annotated"), ("annotated", "recall", "found"), ("posed", "strict", "posed")
    return f"""## Semantic consistency

The mIoU of made bodies with known correspondences by the two protocols of the paper, with its suppression of 0.1 for all methods
(`python -m snake_training.make bodies -o bodies/ --corpus CORPUS/val --bends 8`, BODIES is `bodies/`). `paper` is
[that model](../models/README.md#paper). [The paper's own figures](reproduce.md#semantic-consistency) are of other bodies.

- annotated: {annotated} shapes of 8 classes in random poses and proportions, 2048 points each, with annotated tips, ends and corners; the box
  around a shape has the diagonal 1. mIoU counts every other keypoint as false; found is the share of annotations with a keypoint. Distances
  are geodesic.
- posed: {posed} pairs of such bodies in two poses and of proportions that differ by up to 15 %, with the same 2048 points of the surface; the
  first has the radius 1. The best 20 keypoints of one body are carried to the other.
{f"- bent: {bent} pairs of a validation object and a bent, twisted copy, in the same way." if bent else ""}

{consistency(reports, *kinds, ("bent", "strict", "bent"))}"""


def surfaces_part(table: str, objects: str) -> str:
    return f"""## Reconstruction

The surface of the field of `compact` beside Open3D's Poisson reconstruction, on {objects} objects. A method sees 5000 points, or 625, or 5000
with noise; its mesh is compared with all 8192 points (radius 1). Accuracy is the mean distance from the mesh to the nearest point,
completeness that from a point to the mesh, F the harmonic mean of the shares that are nearer than 0.02 and 0.05. `middle` is the default
of `snake-cli reconstruct`, `level` the surface of the paper.

```sh
python -m snake_training.reconstruction OBJECTS --methods middle level poisson --downsample 8 --noise 0.03
```

{table}
"""


def surfaces(folder: str) -> str:
    """The part on reconstruction."""
    module = [sys.executable, "-m", "snake_training.reconstruction", folder]
    words = ["--methods", "middle", "level", "poisson", "--downsample", "8", "--noise", "0.03"]
    table = subprocess.run([*module, *words], check=True, stdout=subprocess.PIPE, text=True).stdout
    return surfaces_part(table.strip(), str(len(json.loads((Path(folder) / "index.json").read_text()))))


def registration(report: dict, tables: str) -> str:
    scenes, pairs = len(report["scenes"]), report["pairs"]
    found = (
        re.search(rf"^{title}.*:\n\n(?:\|.*\n)+", tables, re.MULTILINE) for title in ("Feature", "Registration recall")
    )
    shown = "\n".join(table[0] for table in found if table)
    return f"""{pairs} pairs of {scenes} scene{"s" * (scenes > 1)}; the reports have inlier ratios too.

{shown}"""


def scenes_part(rooms: tuple[dict, str], by_default: str, registrations: list[tuple[dict, str]]) -> str:
    report, tables = rooms
    more = "".join(f"\n### Registration, more scenes\n\n{registration(*one)}" for one in registrations[1:])
    return f"""## Scenes

Real clouds with known transforms, in metres. `snake` is the model `scenes`, which has seen no real room.

### Repeatability on scenes

10240 points of each cloud, the best 64 keypoints, {report["pairs"]} pairs; each method at the coverage {ROOM_COVERAGE} m.

{joined(tables, "0.1")}
![the same as curves](repeatability-scenes.svg)

Up to 256 keypoints of all points: `snake` keeps those of a confidence of 0.21 and more. Even spacing alone lifts farthest points.

{joined(by_default, "0.1")}
### Registration

By the rules of the 3DMatch benchmark, clouds reduced to voxels of 3 cm: correspondences are mutual nearest neighbours, right within 0.1 m;
a pair matches with more than 0.05 of them right; RANSAC (0.05 m, edges 0.9, 50 000 samples, no ICP) registers it with an RMSE of at most
0.2 m over the overlap. [`snake-cli register`](registration.md) matches every voxel instead, and does better.

{registration(*registrations[0])}{more}"""


def bodies_reports(folder: Path, compact: list[str], methods: list[str], few: list[str]) -> list[dict]:
    """The reports of a set of bodies, of the built-in models and of the paper's; none without the set, which needs a corpus."""
    if not folder.is_dir() and folder.name == "bent":
        return []
    reports = [evaluate(folder.name, "semantic", str(folder), *compact, *methods, *few)[0]]
    if PAPER_MODEL.exists():
        model = ["--model", str(PAPER_MODEL), "--methods", "snake"]
        report, _ = evaluate(f"{folder.name}-paper", "semantic", str(folder), *model, *few)
        reports.append(report | {"rows": [row | {"method": "paper"} for row in report["rows"]]})
    return reports


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
    parser.add_argument("--limit", type=int, help="so many objects, evenly spaced, instead of all")
    arguments = parser.parse_args()
    given = arguments.objects, arguments.landmarks, arguments.bodies, arguments.surfaces, arguments.scenes
    if not any(given):
        parser.error("give --objects, --landmarks, --bodies, --surfaces or --scenes FOLDER, or several of them")
    parts, undisturbed = {}, ["--downsample", "1", "--noise", "0"]
    methods = ["--methods", f"snake,snakex4,{CLASSICAL}"]
    compact = ["--model", "compact"]
    prefer_corners = ["--methods", "snake,snakex4", "--set", "prefer=corners"]
    if arguments.objects:
        objects = [arguments.objects, *compact, *(["--limit", str(arguments.limit)] if arguments.limit else [])]
        views = ["--epsilon", "0.02,0.04,0.1", "--downsample", "1,8", "--noise", "0,0.06"]
        views += ["--coverage", OBJECT_COVERAGE]
        alike = evaluate("objects", "repeatability", *objects, *methods, *views)
        _, corners = evaluate("objects-corners", "repeatability", *objects, *prefer_corners, *views)
        few = [
            "--methods",
            "snake,snakex4,surface-variation,iss",
            "--epsilon",
            "0.04",
            "--downsample",
            "1,8",
            "--noise",
            "0,0.06",
        ]
        _, paper = evaluate("paper", "repeatability", *objects, *few, "--nms-radius", "0.01")
        parts["Objects"] = objects_part(alike, corners, paper)
        shutil.copy(RUNS / "objects/repeatability.svg", PAGE.with_name("repeatability.svg"))
    if arguments.landmarks:
        few = [arguments.landmarks, *compact, "--coverage", OBJECT_COVERAGE, "--threshold", "0.05,0.1"]
        _, found = evaluate("landmarks", "semantic", *few, *methods)
        _, corners = evaluate("landmarks-corners", "semantic", *few, *prefer_corners)
        parts["Landmarks"] = landmarks_part(found, corners)
    if arguments.bodies:
        few = ["--threshold", ",".join(THRESHOLDS), *(["--limit", str(arguments.limit)] if arguments.limit else [])]
        sets = {name: bodies_reports(Path(arguments.bodies) / name, compact, methods, few) for name in BODIES}
        parts["Semantic consistency"] = bodies_part(sets)
    if arguments.surfaces:
        parts["Reconstruction"] = surfaces(arguments.surfaces)
    if arguments.scenes:
        scenes = ["--model", "scenes"]
        scale = ["--table-epsilon", "0.1", *undisturbed, "--limit", str(REPEATABILITY_PAIRS)]
        pairs = [arguments.scenes[0], *scenes, *scale]
        words = ["--epsilon", "0.05,0.1,0.16", "--methods", f"snake,{CLASSICAL}", "--coverage", ROOM_COVERAGE]
        repeatability = evaluate("scenes", "repeatability", *pairs, *words)
        words = [
            "--epsilon",
            "0.05,0.1",
            "--methods",
            "snake,iss,fps",
            "--max-keypoints",
            "256",
            "--num-points",
            "1000000",
        ]
        _, by_default = evaluate("scenes-default", "repeatability", *pairs, *words)
        registrations = []
        for number, folder in enumerate(arguments.scenes):
            few = ["--descriptors", "fpfh", "--max-keypoints", "500,250,100"]
            few += ["--limit", str(MORE_PAIRS)] if number else []
            registrations.append(evaluate(f"scenes-{number}", "registration", folder, *scenes, *few))
        parts["Scenes"] = scenes_part(repeatability, by_default, registrations)
        shutil.copy(RUNS / "scenes/repeatability.svg", PAGE.with_name("repeatability-scenes.svg"))
    PAGE.write_text(page(parts, PAGE.read_text() if PAGE.exists() else ""))


if __name__ == "__main__":
    main()
