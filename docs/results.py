"""Makes `results.md` and its curves: repeatability of the built-in model and of the classical detectors on objects.

Run from the repository's root, by `make results OBJECTS=FOLDER`; an interrupted run goes on where it was. Needs nothing
but Python.
"""

import argparse
import json
import shutil
import subprocess
import textwrap
from pathlib import Path

RUNS = Path("target/results")
PAGE = Path("docs/results.md")
CURVES = Path("docs/repeatability.svg")
# Differences below this are called none: about the standard error of a mean over 40 objects.
MARGIN = 0.03
# A suppression radius with which the model's keypoints cannot crowd, in units of the objects' radius.
SPREAD = "0.05"


def evaluate(name: str, objects: str, limit: int, *extra: str) -> tuple[list[dict], str]:
    """Runs the evaluation (or what is left of it): its rows, and its tables in Markdown."""
    output = RUNS / name
    command = ["cargo", "run", "--release", "--quiet", "--bin", "snake-cli", "--", "eval", "repeatability", objects]
    subprocess.run([*command, "--limit", str(limit), "-o", str(output), *extra], check=True, stdout=subprocess.DEVNULL)
    report = json.loads((output / "repeatability.json").read_text())
    epsilons = report["settings"]["epsilon"]
    rows = [
        {**row, "repeatability": dict(zip(epsilons, row["repeatability"], strict=True)), "pairs": report["pairs"]}
        for row in report["rows"]
    ]
    return rows, (output / "repeatability.md").read_text()


def as_good(rows: list[dict], method: str) -> list[str]:
    """Where a method does as well as the model, in words."""
    found = []
    for row in (row for row in rows if row["method"] == method):
        view = {"downsample": row["downsample"], "noise": row["noise"]}
        model = next(r for r in rows if r["method"] == "snake" and all(r[key] == view[key] for key in view))
        undisturbed = view == {"downsample": 1, "noise": 0}
        for epsilon, share in row["repeatability"].items():
            # The page's tables: all epsilons of the undisturbed views, one of the others.
            if (undisturbed or epsilon == 0.04) and share > model["repeatability"][epsilon] - MARGIN:
                where = f"ε {epsilon}" if undisturbed else f"1 in {row['downsample']}, σ {row['noise']}"
                found.append(f"{where} ({share:.2f} to {model['repeatability'][epsilon]:.2f})")
    return found


def page(ranked: list[dict], ranked_tables: str, spread_tables: str, paper_tables: str) -> str:
    undisturbed = {row["method"]: row for row in ranked if row["downsample"] == 1 and row["noise"] == 0}
    names = {"iss": "ISS", "harris3d": "Harris 3D", "sift3d": "SIFT 3D", "fps": "farthest-point", "random": "random"}
    good = [f"- {name}: {', '.join(as_good(ranked, method)) or 'nowhere'}" for method, name in names.items()]
    nearest = ", ".join(f"{names[m]} {undisturbed[m]['coverage']:.3f}" for m in names)
    spread = (
        f"Coverage is the mean distance from the points of the surface to the nearest keypoint, in units of the object's "
        f"radius: {undisturbed['snake']['coverage']:.3f} for the model, {nearest}."
    )
    if undisturbed["snake"]["coverage"] > undisturbed["random"]["coverage"]:
        spread += (
            " The model's keypoints cluster: they leave more of the surface without one than random points do, and "
            "keypoints that crowd at a place find each other again more easily."
        )
    return f"""# Results

Made by `make results OBJECTS=FOLDER`, which writes this page whole: do not edit it.

## Repeatability of objects

Relative repeatability on {ranked[0]["pairs"]} objects, evenly spaced in the validation split, which was not trained on:
the share of keypoints of one view that the other view, rotated at random and sampled anew, finds again within ε (in units
of the object's radius). 5000 points and the best 64 keypoints of each view; the built-in model with the options that it
recommends. The rows marked as the paper's are its figures for ModelNet40: other objects, and a network with a 64³ volume.

The classical detectors are ranked by their response, the fair way:

{ranked_tables}
![the same as curves](repeatability.svg)

The model with `--nms-radius {SPREAD}`, so that its keypoints cannot crowd:

{spread_tables}
The paper's baselines were a random subset of the detections, which makes them little better than random points:

{paper_tables}
### What else does as well

Within {MARGIN} of the model, or better (at ε 0.04 where the views are disturbed; theirs to the model's):

{chr(10).join(good)}

{textwrap.fill(spread, 120)}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("objects", help="corpus folder, or any folder of clouds")
    parser.add_argument("--limit", type=int, default=40, help="how many objects")
    arguments = parser.parse_args()
    ranked, ranked_tables = evaluate("ranked", arguments.objects, arguments.limit, "--paper")
    _, spread_tables = evaluate(
        "spread", arguments.objects, arguments.limit, "--methods", "snake", "--nms-radius", SPREAD
    )
    picked = ["--protocol", "paper", "--methods", "iss,harris3d,sift3d"]
    _, paper_tables = evaluate("paper", arguments.objects, arguments.limit, *picked)
    PAGE.write_text(page(ranked, ranked_tables, spread_tables, paper_tables))
    shutil.copy(RUNS / "ranked" / "repeatability.svg", CURVES)


if __name__ == "__main__":
    main()
