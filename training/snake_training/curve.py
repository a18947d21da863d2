"""The curve of repeatability over an option of detection, or over models (SNAKE figure 7 and tables 5 and 14):

    python -m snake_training.curve DATA --model modelnet40.safetensors --option refine_steps --values 0 5 10 -o curves/steps
    python -m snake_training.curve DATA --models 4=grid4.safetensors 6=grid6.safetensors 8=grid8.safetensors -o curves/grid

Each value is a run of `snake-cli eval repeatability` (the program in SNAKE_CLI, where that is set) with clean views, into a folder
below the output; a run that is finished is not repeated. Options that are not named here go to that command. The output has curve.md
and curve.svg.
"""

import argparse
import json
import os
import subprocess
from pathlib import Path

from .arguments import parser_of

WIDTH, HEIGHT, MARGIN = 420, 280, 48


def evaluate(data, output, words):
    """Repeatability at 0.04 (or the first distance), its deviation, and the number of keypoints, of one run."""
    command = [os.environ.get("SNAKE_CLI", "snake-cli"), "eval", "repeatability", *data, "-o", output]
    command += ["--methods", "snake", "--downsample", "1", "--noise", "0", *words]
    subprocess.run([*map(str, command)], check=True, stdout=subprocess.DEVNULL)
    report = json.loads((output / "repeatability.json").read_text())
    (row,), epsilon = report["rows"], report["settings"]["epsilon"]
    column = epsilon.index(0.04) if 0.04 in epsilon else 0
    return row["repeatability"][column], row["deviation"][column], row["keypoints"], epsilon[column]


def svg(label, points):
    """A curve through points (value, share) as SVG; the shares are on an axis from 0 to 1."""
    low, high = min(x for x, _ in points), max(x for x, _ in points)

    def pixel(x, y):
        across = (x - low) / (high - low) if high > low else 0.5
        return MARGIN + across * (WIDTH - 2 * MARGIN), HEIGHT - MARGIN - y * (HEIGHT - 2 * MARGIN)

    def text(x, y, words, turn=""):
        return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle"{turn}>{words}</text>'

    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in (pixel(*point) for point in points))
    marks = [text(pixel(x, 0)[0], HEIGHT - MARGIN + 16, f"{x:g}") for x, _ in points]
    marks += [text(MARGIN - 16, pixel(low, y / 5)[1] + 4, f"{y / 5:g}") for y in range(6)]
    middle = HEIGHT / 2
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" font-family="sans-serif" font-size="11">',
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
            f'<path d="M{MARGIN},{MARGIN}V{HEIGHT - MARGIN}H{WIDTH - MARGIN}" fill="none" stroke="black"/>',
            f'<polyline points="{path}" fill="none" stroke="#c00" stroke-width="2"/>',
            *marks,
            text(WIDTH / 2, HEIGHT - 10, label.replace("&", "&amp;").replace("<", "&lt;")),
            text(12, middle, "relative repeatability", f' transform="rotate(-90 12 {middle})"'),
            "</svg>\n",
        ]
    )


def curve(data, output, label, runs):
    """Evaluates the words of each value in `runs`, and writes curve.md and curve.svg; returns the table."""
    found = {value: evaluate(data, output / f"{value:g}", words) for value, words in sorted(runs.items())}
    epsilon = next(iter(found.values()))[3]
    lines = [f"| {label} | repeatability at {epsilon:g} | keypoints |", "|---|---|---|"]
    for x, (mean, deviation, number, _) in found.items():
        spread = "" if deviation is None else f" ±{deviation:.3f}"  # one pair has none
        lines.append(f"| {x:g} | {mean:.3f}{spread} | {number:.1f} |")
    (output / "curve.md").write_text("\n".join(lines) + "\n")
    (output / "curve.svg").write_text(svg(label, [(x, row[0]) for x, row in found.items()]))
    return "\n".join(lines)


def named_model(text):
    """`VALUE=MODEL` as a number and a model."""
    value, separator, model = text.partition("=")
    if not separator:
        raise argparse.ArgumentTypeError(f"{text!r}: expected VALUE=MODEL")
    return float(value), model


def main(argv=None):
    """Command line."""
    arguments = {
        "data": dict(nargs="+", help="data set of `snake-cli eval repeatability`"),
        "--option": dict(help="option of detection that varies, such as refine_steps"),
        "--values": dict(nargs="+", type=float, help="its values"),
        "--models": dict(nargs="+", type=named_model, metavar="VALUE=MODEL", help="models that vary"),
        "--label": dict(help="name of what varies; the option's by default"),
        "-o": dict(dest="output", metavar="FOLDER", required=True, type=Path, help="folder of the runs and the curve"),
    }
    parser = parser_of("curve", __doc__, arguments, allow_abbrev=False)  # --model is of `snake-cli eval`
    given, words = parser.parse_known_args(argv)
    if (given.option is None) == (given.models is None) or (given.option is None) != (given.values is None):
        parser.error("give --option with --values, or --models")
    if given.models:
        runs = {value: [*words, "--model", model] for value, model in given.models}
    else:
        runs = {value: [*words, "--set", f"{given.option}={value:g}"] for value in given.values}
    given.output.mkdir(parents=True, exist_ok=True)
    try:
        print(curve(given.data, given.output, given.label or given.option or "model", runs))
    except (OSError, subprocess.CalledProcessError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
