"""How snake-rs scales: `python tests/bench/scaling.py -o scaling.svg`.

Seconds of each stage of detection against points, voxels, queries and refinement steps, for the paper's U-Net with
seeded random weights (see `tests/bench/speed.py`). The numbers go to a .csv file beside the plot.
"""

import csv
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from speed import STAGES, alternate, machine, run_snake_rs, seeded_network

from snake_training.arguments import option, parser_of
from snake_training.data import Procedural
from snake_training.detection import DetectOptions
from snake_training.export import write_weights
from snake_training.model import NetworkConfig

PARTS = STAGES[:-1]
BASE = {"points": 4096, "resolution": 64, "query_resolution": 64, "refine_steps": 10}
SWEEPS = {
    "points": [2**10, 2**12, 2**14, 2**16, 2**18, 2**20],
    "resolution": [32, 48, 64, 96, 128],
    "query_resolution": [32, 64, 96, 128],
    "refine_steps": [0, 5, 10, 20, 40],
}
# Quantities that time is at best proportional to: label of the axis, and value for a setting.
AXES = {
    "points": ("points", lambda n: n),
    "resolution": ("voxels of the volume", lambda r: r**3),
    "query_resolution": ("queries", lambda r: r**3),
    "refine_steps": ("J + 1", lambda j: j + 1),
}


def seconds(setting, base, occupied, runs, config):
    """{stage: median seconds} at one setting; `occupied` of the base's queries are, and more of more queries."""
    import snake_rs

    config = NetworkConfig(**vars(config) | {"resolution": (setting["resolution"],) * 3})
    points = Procedural(points=setting["points"])[0]
    network = seeded_network(config, points, occupied, base["query_resolution"])
    with TemporaryDirectory() as folder:
        file = Path(folder) / "network.safetensors"
        write_weights(file, config, network.state_dict())
        model = snake_rs.Model.load(file)
    options = DetectOptions(**{name: setting[name] for name in ("query_resolution", "refine_steps")})
    return alternate({"snake-rs": lambda: run_snake_rs(model, points, options)}, runs)["snake-rs"]


def sweep(sweeps, base, occupied, runs, config):
    """Rows (swept setting, its value, x of its axis, {stage: seconds}), printed as they come."""
    rows = []
    print(f"{'':18}{'value':>9}" + "".join(f"{stage:>11}" for stage in STAGES))
    for name, values in sweeps.items():
        for value in values:
            found = seconds(base | {name: value}, base, occupied, runs, config)
            rows.append((name, value, AXES[name][1](value), found))
            print(f"{name:18}{value:9}" + "".join(f"{found[stage]:11.4f}" for stage in STAGES), flush=True)
    return rows


def exponents(rows, name):
    """{stage: (fitted exponent over all values of a sweep, exponent between the two largest)}; 1 is linear."""
    x = np.log([row[2] for row in rows if row[0] == name])
    found = {}
    for stage in STAGES:
        y = np.log([row[3][stage] for row in rows if row[0] == name])
        found[stage] = (float(np.polyfit(x, y, 1)[0]), float((y[-1] - y[-2]) / (x[-1] - x[-2])))
    return found


def write_csv(path, rows):
    """One line per measurement."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["sweep", "value", "x", *STAGES])
        writer.writerows([name, value, x, *(f"{found[s]:.6f}" for s in STAGES)] for name, value, x, found in rows)


def plot(path, rows, title):
    """One log-log panel per sweep with a line per stage; dotted: linear, to the slowest stage's last value."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "scaling", "font.size": 8})
    from matplotlib import pyplot

    names = list(dict.fromkeys(row[0] for row in rows))
    figure, panels = pyplot.subplots(1, len(names), figsize=(3 * len(names), 3.2), sharey=True, squeeze=False)
    for panel, name in zip(panels[0], names):
        x = np.array([row[2] for row in rows if row[0] == name], float)
        lines = {stage: [row[3][stage] for row in rows if row[0] == name] for stage in PARTS}
        for stage, line in lines.items():
            panel.loglog(x, line, "o-", ms=3, lw=1, label=stage)
        panel.loglog(x, max(line[-1] for line in lines.values()) * x / x[-1], "k:", lw=1, label="linear")
        panel.set_xlabel(AXES[name][0])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    panels[0][0].set_ylabel("seconds")
    handles = panels[0][0].get_legend_handles_labels()
    figure.legend(*handles, loc="upper center", ncols=len(PARTS) + 1, title=title, frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.86))
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


def main(argv=None):
    """Measures, prints the table with fitted exponents, writes plot and numbers."""
    options = {
        "-o": dict(dest="output", type=Path, required=True, help="plot (.svg); the numbers go beside it"),
        "--threads": option(os.cpu_count(), "of the program"),
        "--runs": option(3, "counted runs of each, after one that is not"),
    }
    parser = parser_of("", __doc__, options, prog="python tests/bench/scaling.py")
    arguments = parser.parse_args(argv)
    if arguments.output.suffix != ".svg":
        parser.error(f"-o {arguments.output} must end in .svg")
    if arguments.threads < 1 or arguments.runs < 1:
        parser.error("--threads and --runs must be 1 or more")
    os.environ["RAYON_NUM_THREADS"] = str(arguments.threads)
    host = machine()
    rows = sweep(SWEEPS, BASE, 12000, arguments.runs, NetworkConfig())
    print("\nfitted exponent (and that of the last step); 1: linear")
    print(" " * 20 + "".join(f"{stage:>14}" for stage in STAGES))
    for name in SWEEPS:
        cells = (f"{fitted:.2f} ({last:.2f})" for fitted, last in exponents(rows, name).values())
        print(f"{AXES[name][0]:20}" + "".join(f"{cell:>14}" for cell in cells))
    write_csv(arguments.output.with_suffix(".csv"), rows)
    plot(arguments.output, rows, f"{host['cpu']}, {arguments.threads} threads, {host['date'][:10]}")


if __name__ == "__main__":
    main()
