"""What a millisecond buys: `python -m snake_training.tradeoff WEIGHTS .. --data SHAPES -o tradeoff.svg`.

Relative repeatability of weight files, each averaged over several numbers of turned copies, against the time of a
detection by snake-rs. All settings take turns on every cloud, so that a busy moment slows them alike. The numbers go to a
.csv file beside the plot.
"""

import argparse
import csv
import time
from pathlib import Path
from statistics import median

from .data import open_shapes
from .evaluate import repeatability
from .export import replacing

NMS_RADII = 0.01, 0.05
EPSILON = 0.04
COLUMNS = "model", "rotations", "milliseconds", *(f"repeatability at NMS {radius}" for radius in NMS_RADII)


def measure(models, shapes, rotations, objects):
    """Rows of `COLUMNS`, for models {name: snake_rs.Model} with the options that they recommend."""
    import snake_rs

    settings = [(name, copies) for name in models for copies in rotations]
    seconds = {setting: [] for setting in settings}

    def detect(points):
        found = {}
        for name, copies in settings:
            for radius in NMS_RADII:
                start = time.perf_counter()
                keypoints = snake_rs.detect(points, models[name], rotations=copies, nms_radius=radius, max_keypoints=64)
                seconds[name, copies].append(time.perf_counter() - start)
                found[name, copies, radius] = keypoints.points
        return found

    measured = repeatability(detect, shapes, objects, epsilon=(EPSILON,), progress=True)
    shares = {setting: [float(measured[(*setting, radius)][0][0]) for radius in NMS_RADII] for setting in settings}
    return [(*setting, 1000 * median(seconds[setting]), *shares[setting]) for setting in settings]


def plot(path, rows):
    """A panel for each suppression radius with a line for each model."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "tradeoff", "font.size": 8})
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, len(NMS_RADII), figsize=(7, 3), sharey=True)
    for number, (panel, radius) in enumerate(zip(panels, NMS_RADII)):
        for name in dict.fromkeys(row[0] for row in rows):
            line = [(row[2], row[3 + number], row[1]) for row in rows if row[0] == name]
            panel.semilogx([x for x, _, _ in line], [y for _, y, _ in line], "o-", ms=3, lw=1, label=name)
            for x, y, copies in line:
                panel.annotate(f"×{copies}", (x, y), (2, -8), textcoords="offset points", fontsize=6)
        low, high = min(row[2] for row in rows), max(row[2] for row in rows)
        ticks = [tick for tick in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000) if low / 2 < tick < high * 2]
        panel.set_xticks(ticks, ticks)
        panel.minorticks_off()
        panel.set_title(f"NMS {radius}")
        panel.set_xlabel("milliseconds a cloud")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel(f"relative repeatability, ε {EPSILON}")
    panels[0].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


def main(argv=None):
    """Measures, prints the table, writes numbers and plot."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.tradeoff",
        description=__doc__.split("\n\n")[1],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("weights", nargs="+", type=Path, help="safetensors exports, named by their files")
    parser.add_argument("--data", required=True, help="corpus folder, or a folder of .npy / .ply clouds")
    parser.add_argument("-o", "--output", required=True, type=Path, help="plot (.svg); the numbers go beside it")
    parser.add_argument("--rotations", nargs="+", type=int, default=[1, 2, 4], help="numbers of turned copies")
    parser.add_argument("--objects", type=int, default=58, help="evaluate on this many, evenly spaced")
    arguments = parser.parse_args(argv)
    if arguments.output.suffix != ".svg":
        parser.error(f"--output {arguments.output} must end in .svg")
    try:
        import snake_rs

        models = {file.stem: snake_rs.Model.load(file) for file in arguments.weights}
        rows = measure(models, open_shapes(arguments.data), arguments.rotations, arguments.objects)
        for row in rows:
            print("| {} | {} | {:.0f} | {:.3f} | {:.3f} |".format(*row))
        with replacing(arguments.output.with_suffix(".csv")) as temporary, open(temporary, "w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *((*row[:2], *(f"{v:.4f}" for v in row[2:])) for row in rows)])
        plot(arguments.output, rows)
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
