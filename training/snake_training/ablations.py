"""The paper's ablations: `python -m snake_training.ablations -o ablations/ --data … --shapes …`.

Trains the preset once for each row (losses off, U, resolution) and evaluates each on unseen shapes; the refinement
rows evaluate the full recipe with other J and step sizes. What is done is kept in the folder: run again to go on.
"""

import argparse
import json
import subprocess
from dataclasses import dataclass, field, replace
from pathlib import Path

from .config import PRESETS, TrainConfig, check
from .data import open_shapes
from .evaluate import DetectOptions, detector, repeatability
from .export import load_network, replacing, write_weights
from .train import train

EPSILON = 0.04
THRESHOLD = 0.1  # geodesic distance up to which a keypoint is that of an annotation
BLIND = dict(occupancy_threshold=0.0, surface_threshold=0.0)  # a network that never learned where the surface is


@dataclass(frozen=True)
class Row:
    """One row of a table: settings of training, options of detection, and the paper's figures for its own networks."""

    table: str
    name: str
    training: dict = field(default_factory=dict)
    detection: dict = field(default_factory=dict)
    paper: float | None = None
    paper_miou: float | None = None

    @property
    def run(self):
        """The name of the folder of its run; rows that train alike share one."""
        return "-".join(f"{name}-{value:g}" for name, value in sorted(self.training.items())) or "all"

    @property
    def key(self):
        """Its name in the results."""
        return f"{self.table}: {self.name}"

    @property
    def options(self):
        """The options of its detection."""
        return replace(DetectOptions(), **self.detection)


# Relative repeatability at epsilon 0.04 on ModelNet40, and mIoU at 0.1 on KeypointNet; section 4.4 of the paper.
ROWS = (
    Row("losses", "all four", paper=0.85, paper_miou=0.42),
    Row("losses", "no occupancy, no surface", dict(weight_occupancy=0, weight_surface=0), BLIND, 0.92, 0.28),
    Row("losses", "no surface", dict(weight_surface=0), paper=0.28, paper_miou=0.39),
    Row("losses", "no repeatability", dict(weight_repeatability=0), paper=0.22, paper_miou=0.39),
    Row("losses", "no sparsity", dict(weight_sparsity=0), paper=0.0, paper_miou=0.0),
    Row("local grids", "U = 4", dict(grid_fraction=4), paper=0.79),
    Row("local grids", "U = 6", paper=0.85),
    Row("local grids", "U = 8", dict(grid_fraction=8), paper=0.79),
    Row("local grids", "U = 10", dict(grid_fraction=10), paper=0.77),
    Row("volume", "32³", dict(resolution=32), paper=0.62),
    Row("volume", "48³", dict(resolution=48), paper=0.79),
    Row("volume", "64³", dict(resolution=64), paper=0.85),
    Row("volume", "80³", dict(resolution=80), paper=0.78),
    *(Row("refinement", f"J = {steps}", detection=dict(refine_steps=steps), paper=paper)
      for steps, paper in ((0, 0.811), (5, 0.850), (10, 0.864), (20, None))),
    *(Row("refinement", f"J = 10, steps of {size:g}", detection=dict(refine_step_size=size), paper=paper)
      for size, paper in ((0.1, 0.002), (0.01, 0.622), (0.001, 0.854), (0.0001, 0.826))),
)  # fmt: skip


def measure(row, folder, config, shapes, objects, engine, seeds=3):
    """Train what the row needs, unless it is there, and evaluate it: {"repeatability", "deviation", "keypoints"}."""
    run = folder / row.run
    finished = run / "finished.safetensors"
    if not finished.exists():
        train(check(replace(config, run_dir=str(run), **row.training)))
        network = load_network(run / "last.pt")
        write_weights(finished, network.config, network.state_dict())
    find = detector(engine, str(finished), row.options)
    values = []
    for seed in range(seeds):
        measured = repeatability(lambda points: {"": find(points)}, shapes, objects, seed=seed, epsilon=(EPSILON,))
        values.append((float(measured[""][0][0]), measured[""][1]))
    repeated, counts = zip(*values)
    mean = sum(repeated) / seeds
    deviation = (sum((value - mean) ** 2 for value in repeated) / seeds) ** 0.5
    return {"repeatability": mean, "deviation": deviation, "keypoints": sum(counts) / seeds}


def consistency(row, folder, cli, annotated, split):
    """mIoU at 0.1 of a row that is trained, by the rule of the released code: {"miou", "miou_deviation"}.

    `annotated` is a folder in the layout of KeypointNet; `snake-cli eval semantic` measures with its preset.
    """
    run = folder / row.run
    # The options of another row of the same run would be refused as other settings.
    output = run / "-".join(["semantic", *(f"{name}={value:g}" for name, value in sorted(row.detection.items()))])
    words = [cli, "eval", "semantic", annotated, *(["--split", split] if split else []), "--methods", "snake"]
    words += ["--model", str(run / "finished.safetensors"), "--preset", "keypointnet", "--threshold", str(THRESHOLD)]
    words += [word for name, value in row.detection.items() for word in ("--set", f"{name}={value}")]
    try:
        subprocess.run([*words, "-o", str(output)], check=True, capture_output=True, text=True)
    except FileNotFoundError as error:
        raise ValueError(f"--annotated needs snake-cli: there is no {cli!r}; give its path by --cli") from error
    except subprocess.CalledProcessError as error:
        raise ValueError(f"{' '.join(words)}: {error.stderr.strip()}") from error
    found = next(row for row in json.loads((output / "semantic.json").read_text())["rows"] if row["class"] is None)
    return {"miou": found["paper"][0], "miou_deviation": found["paper_deviation"][0] or 0.0}


def markdown(results):
    """The rows that are done, as a table for each of the paper's."""
    lines = []
    for table in dict.fromkeys(row.table for row in ROWS):
        done = [row for row in ROWS if row.table == table and row.key in results]
        if not done:
            continue
        head = [table, f"repeatability at ε {EPSILON}", "keypoints", "paper (64³, ModelNet40)"]
        with_miou = any("miou" in results[row.key] for row in done)
        head += [f"mIoU at {THRESHOLD}", "paper (64³, KeypointNet)"] if with_miou else []
        lines += [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
        for row in done:
            found = results[row.key]
            cells = [
                row.name,
                cell(found, "repeatability", "deviation"),
                f"{found['keypoints']:.0f}",
                figure(row.paper),
            ]
            cells += [cell(found, "miou", "miou_deviation"), figure(row.paper_miou)] if with_miou else []
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def cell(found, name, deviation):
    """A mean with its deviation, if it was measured."""
    return f"{found[name]:.3f} ±{found[deviation]:.3f}" if name in found else "–"


def figure(value):
    """A figure of the paper, if there is one."""
    return "–" if value is None else f"{value:g}"


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.ablations",
        description=__doc__.split("\n\n")[1],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("-o", "--output", required=True, help="folder of the runs, results.json and tables.md")
    parser.add_argument("--preset", choices=PRESETS, default="compact", help="settings of the rows")
    parser.add_argument("--data", nargs="*", default=[], help="training shapes; without them, procedural ones")
    parser.add_argument("--split", nargs="*", default=[], help="a list for each of them")
    parser.add_argument("--shapes", required=True, help="unseen shapes to evaluate on")
    parser.add_argument("--objects", type=int, default=40, help="evaluate on this many of them, evenly spaced")
    parser.add_argument(
        "--init", default="", help="start from these weights with a new saliency decoder, which takes far fewer steps"
    )
    parser.add_argument("--steps", type=int, default=1000, help="optimiser steps of each run")
    parser.add_argument("--batch", type=int, default=4, help="samples a step")
    parser.add_argument("--tables", nargs="*", default=sorted({row.table for row in ROWS}), help="tables to make")
    parser.add_argument("--engine", choices=("torch", "snake-rs"), default="torch", help="which implementation detects")
    parser.add_argument(
        "--annotated", default="", help="KeypointNet's folder: the tables have a column of mIoU, by snake-cli"
    )
    parser.add_argument("--annotated-split", default="", help="the list of the annotated shapes to evaluate on")
    parser.add_argument("--cli", default="snake-cli", help="the program snake-cli")
    arguments = parser.parse_args(argv)
    unknown = set(arguments.tables) - {row.table for row in ROWS}
    if unknown:
        parser.error(f"--tables knows {', '.join(sorted({row.table for row in ROWS}))}; not {', '.join(unknown)}")
    folder = Path(arguments.output)
    given = dict(
        data=tuple(arguments.data), split=tuple(arguments.split), steps=arguments.steps, batch=arguments.batch,
        warmup=min(200, arguments.steps // 5), validate_every=arguments.steps, validation_objects=1,
        init=arguments.init, fresh_saliency=bool(arguments.init),
    )  # fmt: skip
    config = TrainConfig(**PRESETS[arguments.preset] | given)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shapes = open_shapes(arguments.shapes)
        kept, settings = folder / "results.json", {k: v for k, v in vars(arguments).items() if k != "tables"}
        results = json.loads(kept.read_text()) if kept.exists() else {"settings": settings}
        if results["settings"] != settings:
            raise ValueError(f"{kept} was made with other settings, {results['settings']}; give another --output")
        for row in ROWS:
            if row.table not in arguments.tables or row.key in results:
                continue
            print(row.key, flush=True)
            alike = [other.key for other in ROWS if (other.run, other.options) == (row.run, row.options)]
            known = [results[key] for key in alike if key in results]
            if known:
                results[row.key] = known[0]
            else:
                found = measure(row, folder, config, shapes, arguments.objects, arguments.engine)
                if arguments.annotated:
                    found |= consistency(row, folder, arguments.cli, arguments.annotated, arguments.annotated_split)
                results[row.key] = found
            for path, text in ((kept, json.dumps(results, indent=1)), (folder / "tables.md", markdown(results))):
                with replacing(path) as temporary:
                    temporary.write_text(text)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print(markdown(results))


if __name__ == "__main__":
    main()
