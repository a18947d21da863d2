"""Draws clouds with their keypoints: `python docs/gallery.py OUT.png CLOUD.. [--model NAME]`.

Needs snake-cli and matplotlib. A cloud is an .npy file (N, 3); its keypoints are those of `snake-cli detect` with its
default options. Keypoints on the far side are drawn smaller.
"""

import argparse
import json
import subprocess
from pathlib import Path

import numpy as np


def keypoints(path, model):
    """Keypoints (K, 3) of a cloud, best first."""
    command = ["snake-cli", "detect", path, "--json", "--model", model]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)["keypoints"]
    return np.array([[keypoint[axis] for axis in "xyz"] for keypoint in found]).reshape(-1, 3)


def rotation(azimuth, elevation):
    """Rotation (3, 3) to the picture: right, up, towards the viewer; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.sin(e), np.cos(e)], [0, -np.cos(e), np.sin(e)]])
    return about_x @ about_z


def draw(axes, points, found, turn):
    """A cloud (N, 3), shaded by depth, with keypoints (K, 3)."""
    points, found = points @ turn.T, found @ turn.T
    order = np.argsort(points[:, 2])
    axes.scatter(
        *points[order, :2].T, c=points[order, 2], cmap="Greys", s=1.2, vmin=2 * points[:, 2].min(), linewidths=0
    )
    near = (found[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    axes.scatter(*found[:, :2].T, s=12 + 28 * near, c="#e5484d", edgecolors="black", linewidths=0.6)
    axes.set_aspect("equal")
    axes.axis("off")


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output")
    parser.add_argument("clouds", nargs="+")
    parser.add_argument("--model", default="compact")
    parser.add_argument("--columns", type=int, default=4)
    parser.add_argument("--view", type=float, nargs=2, default=(35, 25), help="azimuth and elevation, degrees")
    arguments = parser.parse_args()
    import matplotlib  # Not before: the help needs none.

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rows = -(-len(arguments.clouds) // arguments.columns)
    figure, grid = plt.subplots(rows, arguments.columns, figsize=(4 * arguments.columns, 4 * rows), squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for axes, path in zip(grid.flat, arguments.clouds):
        points = np.load(path)
        found = keypoints(path, arguments.model)
        draw(axes, points, found, rotation(*arguments.view))
        axes.set_title(f"{Path(path).stem}: {len(found)}", fontsize=11)
    figure.tight_layout()
    figure.savefig(arguments.output, dpi=75)


if __name__ == "__main__":
    main()
