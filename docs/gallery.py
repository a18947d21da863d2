"""Draws clouds with their keypoints: `python docs/gallery.py OUT.png CLOUD.. [--model MODEL..]`.

Keypoints are those of `snake-cli detect` with its default options: the larger, the higher their confidence or, without one, their saliency. Points have the colour of
the saliency at them, of the field that gave the keypoints, from violet (0) to yellow (0.7). Needs snake-cli, snake_rs and Pillow.
"""

import argparse
import itertools
import json
import subprocess
from pathlib import Path

import numpy as np

WIDTH, TITLE, MARGIN = 1000, 26, 12  # pixels
VIRIDIS = [(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)]
# Rotations to x right, y away and z up, by the axis that points up in a cloud; a camera has -y there.
UPRIGHT = {
    "z": np.eye(3),
    "y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "camera": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


def detected(path, model):
    """Keypoints (K, 4), the worst first: x, y, z and confidence; and the name of the model that found them."""
    command = ["snake-cli", "detect", path, "--json", *(["--model", model] if model else [])]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    rows = [
        [
            *(keypoint[key] for key in "xyz"),
            keypoint["saliency"] if keypoint["confidence"] is None else keypoint["confidence"],
        ]
        for keypoint in found["keypoints"]
    ]
    return np.array(rows, float).reshape(-1, 4)[::-1], found["model"].split(",")[0]


def rotation(azimuth, elevation):
    """Rotation (3, 3) to the picture: right, up, towards the viewer; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.sin(e), np.cos(e)], [0, -np.cos(e), np.sin(e)]])
    return about_x @ about_z


def colours(saliency):
    """Colours (N, 3) of saliencies (N,)."""
    stops = np.linspace(0, 0.7, len(VIRIDIS))
    return np.stack([np.interp(saliency, stops, channel) for channel in zip(*VIRIDIS)], axis=1).astype(np.uint8)


def panel(path, named, arguments, turn, width):
    """The picture of a cloud by the named model, or by that of the cloud; `width` pixels wide."""
    from PIL import Image, ImageDraw, ImageFont

    import snake_rs

    points = np.asarray(snake_rs.read_points(path))
    found, model = detected(path, named)
    field = snake_rs.Model.load(named) if named and Path(named).is_file() else snake_rs.Model.builtin(model)
    saliency = field.encode(points).saliency(points)
    middle = np.median(points, axis=0)
    shown, near = (np.linalg.norm(cloud[:, :3] - middle, axis=1) < arguments.radius for cloud in (points, found))
    seen, marks = points[shown] @ turn.T, found[near, :3] @ turn.T
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    scale = (width - 2 * MARGIN) / max(high[0] - low[0], high[1] - low[1])
    height = int((high[1] - low[1]) * scale) + 2 * MARGIN + TITLE

    def pixels(cloud):
        across = MARGIN + (cloud[:, 0] - (low[0] + high[0]) / 2) * scale + (width - 2 * MARGIN) / 2
        return np.column_stack([across, TITLE + MARGIN + (high[1] - cloud[:, 1]) * scale]).astype(int)

    canvas = np.full((height, width, 3), 255, np.uint8)
    order = np.argsort(seen[:, 2])  # the nearest is drawn last
    for step in np.ndindex(arguments.size, arguments.size):
        column, row = np.minimum(pixels(seen[order]) + step, (width - 1, height - 1)).T
        canvas[row, column] = colours(saliency[shown][order])
    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    for (x, y), confidence in zip(pixels(marks), found[near, 3]):
        radius = width * (0.003 + 0.014 * confidence)
        box = (x - radius, y - radius, x + radius, y + radius)
        draw.ellipse(box, fill="#e5484d", outline="white" if radius > 3 else None, width=1)
    title = f"{Path(path).stem}{f', {Path(named).stem}' if named else ''}: {len(found)}"
    draw.text((width / 2, TITLE / 2), title, fill="black", font=ImageFont.load_default(15), anchor="mm")
    return image


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output")
    parser.add_argument("clouds", nargs="+")
    parser.add_argument("--model", nargs="+", default=[None], help="for all or for each; default: as the cloud looks")
    parser.add_argument("--columns", type=int, default=4)
    parser.add_argument("--view", type=float, nargs=2, default=(35, 25), help="azimuth and elevation, degrees")
    parser.add_argument(
        "--up", nargs="+", choices=UPRIGHT, default=["z"], help="the axis that points up, for all or for each"
    )
    parser.add_argument("--radius", type=float, default=np.inf, help="show only what is so near to the median point")
    parser.add_argument("--size", type=int, default=2, help="pixels of a point")
    arguments = parser.parse_args()
    from PIL import Image  # Not before: the help needs nothing.

    up, width = itertools.cycle(arguments.up), WIDTH // arguments.columns
    turns = (rotation(*arguments.view) @ UPRIGHT[axis] for axis in up)
    models = itertools.cycle(arguments.model)
    panels = [panel(path, model, arguments, turn, width) for path, model, turn in zip(arguments.clouds, models, turns)]
    rows = [panels[i : i + arguments.columns] for i in range(0, len(panels), arguments.columns)]
    heights = [max(image.height for image in row) for row in rows]
    picture = Image.new("RGB", (WIDTH, sum(heights)), "white")
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            picture.paste(image, (j * width, sum(heights[:i]) + (heights[i] - image.height) // 2))
    picture.quantize(64).save(arguments.output, optimize=True)


if __name__ == "__main__":
    main()
