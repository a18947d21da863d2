"""Makes `results.md` and its curves: the built-in models and the classical detectors on objects and on real scenes.

Run from the repository's root, by `make results OBJECTS=FOLDER SCENES="FOLDER .."`; an interrupted run goes on where it
was. The part of the page whose folder is not given stays as it is. Needs nothing but Python.
"""

import argparse
import json
import re
import shutil
import subprocess
import textwrap
from pathlib import Path

RUNS = Path("target/results")
PAGE = Path("docs/results.md")
# A suppression radius with which the model's keypoints cannot crowd, in units of the objects' radius.
SPREAD = "0.05"
# Pairs of scenes, evenly spaced, in repeatability, and in registration beyond the first folder of scenes.
REPEATABILITY_PAIRS = 20
MORE_PAIRS = 60
NAMES = {"iss": "ISS", "harris3d": "Harris 3D", "sift3d": "SIFT 3D", "fps": "farthest-point", "random": "random"}

INTRODUCTION = """# Results

Made by `make results OBJECTS=FOLDER SCENES="FOLDER .."`, which writes these pages whole: do not edit them. OBJECTS is a
folder of objects, SCENES one or more folders of clouds with their `pairs.json` (`snake-cli eval --help` says which layouts
there are). Rows marked as the paper's are its own figures for its own data; they stand beside ours for orientation.

The page in the repository is of the validation split of the corpus, which was not trained on, and of fragments of the
3DMatch benchmark with those of its pairs that overlap by at least a tenth and fit within 2 cm under the published
transforms, as about a fifth do not: its figures do not compare with published ones.
"""


def evaluate(name: str, metric: str, *arguments: str) -> tuple[dict, str]:
    """Runs an evaluation (or what is left of it): its report, and its tables in Markdown."""
    output = RUNS / name
    command = ["cargo", "run", "--release", "--quiet", "--bin", "snake-cli", "--", "eval", metric]
    subprocess.run([*command, *arguments, "-o", str(output)], check=True, stdout=subprocess.DEVNULL)
    report = json.loads((output / f"{metric}.json").read_text())
    return report, (output / f"{metric}.md").read_text()


def fill(text: str) -> str:
    return textwrap.fill(text, 120, subsequent_indent="  " * text.startswith("- "))


def as_good(report: dict, method: str, table_epsilon: float) -> list[str]:
    """Where a method's repeatability is within a standard error of the model's, or above, in words."""

    def view(row: dict) -> tuple[int, float]:
        return row["downsample"], row["noise"]

    model = {view(row): row for row in report["rows"] if row["method"] == "snake"}
    found = []
    for row in (row for row in report["rows"] if row["method"] == method):
        of_model = model[view(row)]
        columns = zip(report["settings"]["epsilon"], row["repeatability"], strict=True)
        for i, (epsilon, share) in enumerate(columns):
            undisturbed = view(row) == (1, 0)
            # The page's tables: all epsilons of the undisturbed views, one of the others.
            if not undisturbed and epsilon != table_epsilon:
                continue
            error = (of_model["deviation"][i] or 0) / report["pairs"] ** 0.5
            if share > of_model["repeatability"][i] - error:
                where = f"ε {epsilon}" if undisturbed else f"1 in {row['downsample']}, σ {row['noise']}"
                found.append(f"{where} ({share:.2f} to {of_model['repeatability'][i]:.2f})")
    return found


def what_does_as_well(report: dict, table_epsilon: float, unit: str) -> str:
    """Says where the classical detectors are as good, and how the keypoints are spread."""
    good = [
        fill(f"- {name}: {', '.join(as_good(report, method, table_epsilon)) or 'nowhere'}")
        for method, name in NAMES.items()
    ]
    undisturbed = {row["method"]: row for row in report["rows"] if row["downsample"] == 1 and row["noise"] == 0}
    nearest = ", ".join(f"{NAMES[method]} {undisturbed[method]['coverage']:.3f}" for method in NAMES)
    spread = (
        f"Coverage is the mean distance from the points of the first view to the nearest keypoint, in {unit}: "
        f"{undisturbed['snake']['coverage']:.3f} for the model, {nearest}."
    )
    if undisturbed["snake"]["coverage"] > undisturbed["random"]["coverage"]:
        spread += (
            " The model's keypoints cluster: they leave more of the surface without one than random points do, and "
            "keypoints that crowd at a place find each other again more easily."
        )
    lines = "\n".join(good)
    return f"""Above the model, or within one standard error of its mean over the {report["pairs"]} pairs (at ε {table_epsilon} where the views
are disturbed; theirs to the model's):

{lines}

{fill(spread)}
"""


def objects_part(
    ranked: tuple[dict, str], spread_tables: str, standard_tables: str, standard_spread_tables: str, paper_tables: str
) -> str:
    report, tables = ranked
    return f"""## Objects

Relative repeatability on {report["pairs"]} objects that were not trained on: the share of keypoints of one view that the
other view, rotated at random and sampled anew, finds again within ε (in units of the object's radius). 5000 points and the
best 64 keypoints of each view; `snake` is the model `compact` with the options that it recommends, and `snakex4` the same
averaged over four turned copies of each view, which takes four times as long. The paper's figures are for ModelNet40: other
objects, a network with a 64³ volume, and classical detectors of which it took a random subset.

The classical detectors ranked by their response, the fair way:

{tables}
![the same as curves](repeatability.svg)

`compact` with `--nms-radius {SPREAD}`, so that its keypoints cannot crowd:

{spread_tables}
`--model standard`, three seeds:

{standard_tables}
The same with `--nms-radius {SPREAD}`:

{standard_spread_tables}
The classical detectors as in the paper, a random subset of the detections, which makes them little better than random
points:

{paper_tables}
### What else does as well on objects

{what_does_as_well(report, 0.04, "units of the object's radius")}"""


def registers_as_many(report: dict) -> str:
    """Says where keypoints of the classical detectors register as many pairs as the model's, or more."""
    recall = {
        (row["detector"], row["descriptor"], row["keypoints"]): row["mean"]["registration_recall"]
        for row in report["rows"]
    }
    cases = [(descriptor, keypoints) for detector, descriptor, keypoints in recall if detector == "snake"]
    good = {
        method: [
            f"{descriptor} {keypoints} ({recall[method, descriptor, keypoints]:.2f} to {recall['snake', descriptor, keypoints]:.2f})"
            for descriptor, keypoints in cases
            if recall[method, descriptor, keypoints] >= recall["snake", descriptor, keypoints]
        ]
        for method in NAMES
    }
    lines = "\n".join(fill(f"- {name}: {', '.join(good[method]) or 'nowhere'}") for method, name in NAMES.items())
    count = fill(
        f"Of {len(cases)} columns of descriptors and numbers of keypoints, random points register as many pairs as the "
        f"model's keypoints or more in {len(good['random'])}, farthest points in {len(good['fps'])}."
    )
    return f"""Where a detector registers as many pairs as the model's keypoints, or more (its recall to the model's):

{lines}

{count}
"""


def registration(report: dict, tables: str) -> str:
    scenes, pairs = len(report["scenes"]), report["pairs"]
    return f"""{pairs} pairs of {scenes} scene{"s" * (scenes > 1)}.

{tables}
{registers_as_many(report)}"""


def scenes_part(
    rooms: tuple[dict, str],
    rooms_registration: str,
    repeatability: tuple[dict, str],
    registrations: list[tuple[dict, str]],
) -> str:
    rooms_report, rooms_tables = rooms
    report, tables = repeatability
    more = "".join(f"\n### Registration, more scenes\n\n{registration(*one)}" for one in registrations[1:])
    return f"""## Scenes

Real clouds with known transforms, in metres.

### The model for rooms

`--model rooms`, which has seen no real room, in windows of 0.8 m as it recommends; 10240 points of each cloud, 64
keypoints, {rooms_report["pairs"]} evenly spaced pairs of the first folder; ε in metres.

{rooms_tables}
Registration as below, three seeds:

{rooms_registration}
The rest of this page is of `compact`, which has only seen objects.

### Repeatability on scenes

The paper's settings for Redwood, `--preset redwood --nms-radius 0.04`: 10240 points of each cloud, J = 10, 64 keypoints, ε in
metres. {report["pairs"]} evenly spaced pairs of the first folder. The paper's figures are for Redwood.

{tables}
![the same as curves](repeatability-scenes.svg)

{what_does_as_well(report, 0.2, "metres")}
### Registration

By the rules of the 3DMatch benchmark, clouds reduced to voxels of 3 cm: correspondences are mutual nearest neighbours, right
within 0.1 m; a pair matches with more than 0.05 of them right; RANSAC (0.05 m, edges 0.9, 50 000 samples, no ICP) registers
it with an RMSE of at most 0.2 m over the overlap. A detector that finds fewer keypoints than a column asks for has its
figures of all that it finds there. `snake-cli register` does better on pairs that overlap well ([registration.md](registration.md)), with larger voxels
and radii, and ICP. The paper's figures are for all eight scenes of 3DMatch, with the learned descriptor D3Feat.

{registration(*registrations[0])}{more}"""


def page(parts: dict[str, str], before: str) -> str:
    """The parts, by their headings; those that are not given as they were before."""
    old = {found[1]: found[0] for found in re.finditer(r"^## (\w+)\n.*?(?=^## |\Z)", before, re.DOTALL | re.MULTILINE)}
    texts = [(old | parts)[name].rstrip() + "\n" for name in ("Objects", "Scenes") if name in old | parts]
    return "\n".join([INTRODUCTION, *texts])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", help="corpus folder, or any folder of clouds")
    parser.add_argument(
        "--scenes", nargs="+", default=[], help="folders with pairs.json; of those after the first 60 pairs"
    )
    parser.add_argument("--limit", help="how many objects, evenly spaced; default: all")
    arguments = parser.parse_args()
    if not arguments.objects and not arguments.scenes:
        parser.error("give --objects FOLDER, --scenes FOLDER, or both")
    parts, undisturbed = {}, ["--downsample", "1", "--noise", "0"]
    if arguments.objects:
        data = [arguments.objects, *(["--limit", arguments.limit] if arguments.limit else [])]
        methods = "snake,snakex4,iss,harris3d,sift3d,fps,random"
        ranked = evaluate("ranked", "repeatability", *data, "--methods", methods, "--paper")
        _, spread = evaluate("spread", "repeatability", *data, "--methods", "snake", "--nms-radius", SPREAD)
        few = ["--model", "standard", "--methods", "snake", "--epsilon", "0.02,0.03,0.04,0.1", "--seeds", "3"]
        _, standard = evaluate("standard", "repeatability", *data, *few, "--downsample", "1,8", "--noise", "0,0.06")
        _, standard_spread = evaluate(
            "standard-spread", "repeatability", *data, *few, *undisturbed, "--nms-radius", SPREAD
        )
        as_in_paper = ["--protocol", "paper", "--methods", "iss,harris3d,sift3d", *undisturbed]
        _, paper = evaluate("paper", "repeatability", *data, *as_in_paper)
        parts["Objects"] = objects_part(ranked, spread, standard, standard_spread, paper)
        shutil.copy(RUNS / "ranked/repeatability.svg", PAGE.with_name("repeatability.svg"))
    if arguments.scenes:
        first, *others = arguments.scenes
        pairs = ["--limit", str(REPEATABILITY_PAIRS), "--paper"]
        rooms = evaluate("rooms", "repeatability", first, "--model", "rooms", *pairs, *undisturbed)
        few = ["--descriptors", "fpfh", "--keypoints", "500,250,100", "--seeds", "3"]
        _, rooms_registration = evaluate("rooms", "registration", first, "--model", "rooms", *few)
        repeatability = evaluate(
            "scenes", "repeatability", first, *pairs, "--preset", "redwood", "--nms-radius", "0.04"
        )
        registrations = [evaluate("scenes", "registration", first, "--paper")]
        for number, folder in enumerate(others):
            registrations.append(evaluate(f"scenes-{number}", "registration", folder, "--limit", str(MORE_PAIRS)))
        parts["Scenes"] = scenes_part(rooms, rooms_registration, repeatability, registrations)
        shutil.copy(RUNS / "scenes/repeatability.svg", PAGE.with_name("repeatability-scenes.svg"))
    PAGE.write_text(page(parts, PAGE.read_text() if PAGE.exists() else ""))


if __name__ == "__main__":
    main()
