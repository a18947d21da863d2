"""Makes every picture of the pages: `make pictures DATA=FOLDER`, or `python docs/pictures.py [NAME..] [--data FOLDER]`.

FOLDER holds objects/val, a corpus folder, and scenes/val, a folder of fragments (N, 3); pictures of them stay as they
are without it. The curves are made by `make results`. Needs snake-cli, snake_rs, Pillow and, for the page, Chromium.

Clouds have the colour of the saliency at their points, from violet (0) to yellow (0.7). Keypoints are those of the default options: the
larger, the higher their confidence. Of a pair the target is grey and the source red.
"""

import argparse
import itertools
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import snake_rs

DOCS = Path(__file__).resolve().parent
WORK = DOCS.parent / "target/pictures"
PLANE = DOCS.parent / "samples/plane.ply"
OFFICE = "sun3d-mit_lab_hj-lab_hj_tea_nov_2_2012_scan1_erika__{:02}"
OBJECTS = dict(
    chair="Chair_1", armchair="Chair_3", stool="painted_wooden_stool_1k", skull="Skull", bolt="factory_bolt_m20_loose",
    windturbine="windturbine_tall_fan", cat="cat", bed="bedDouble",
)  # fmt: skip

SIDES = dict(cup="expresso-cup", skull="Skull", bolt="factory_bolt_m20_loose", cat="cat")

WIDTH, TITLE, MARGIN = 1000, 26, 12  # pixels
VIRIDIS = [(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)]
GREY, RED = (150, 150, 150), (229, 72, 77)
# Rotations to x right, y away and z up, by the axis that points up in a cloud; a camera has -y there.
UPRIGHT = {
    "z": np.eye(3),
    "y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "camera": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


class MissingError(Exception):
    """What a picture needs and is not there."""


def rotation(azimuth, elevation):
    """Rotation (3, 3) to the picture: right, up, towards the viewer; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.sin(e), np.cos(e)], [0, -np.cos(e), np.sin(e)]])
    return about_x @ about_z


def drawn(seen, colours, title, width, size=1, marks=(), radii=()):
    """The picture of points (N, 2) in their order, each a square of `size` pixels; `marks` (K, 2) have radii in pixels."""
    low, high = seen.min(axis=0), seen.max(axis=0)
    scale = (width - 2 * MARGIN) / max(high - low)
    height = int((high[1] - low[1]) * scale) + 2 * MARGIN + TITLE

    def pixels(points):
        across = width / 2 + (points[:, 0] - (low[0] + high[0]) / 2) * scale
        return np.column_stack([across, TITLE + MARGIN + (high[1] - points[:, 1]) * scale]).astype(int)

    canvas = np.full((height, width, 3), 255, np.uint8)
    for step in np.ndindex(size, size):
        column, row = np.minimum(pixels(seen) + step, (width - 1, height - 1)).T
        canvas[row, column] = colours
    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    for (x, y), radius in zip(pixels(np.reshape(marks, (-1, 2))), radii, strict=True):
        outline = "white" if radius > 3 else None
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill="#e5484d", outline=outline, width=1)
    draw.text((width / 2, TITLE / 2), title, fill="black", font=ImageFont.load_default(15), anchor="mm")
    return image


def keypoints(named, ups="z", columns=4, view=(35, 25), radius=np.inf, model=None, **options):
    """Panels of clouds, by name, with their keypoints; `radius`: only what is so near to the median point."""
    width = WIDTH // columns
    for (name, points), up in zip(named.items(), itertools.cycle(ups.split())):
        found = snake_rs.detect(points, model, **options)
        field = snake_rs.Model.builtin(found.model.split(",")[0]).encode(points)
        turn, middle = rotation(*view) @ UPRIGHT[up], np.median(points, axis=0)
        points = points[np.linalg.norm(points - middle, axis=1) < radius]
        points = points[np.argsort(points @ turn[2])]  # the nearest is drawn last
        stops, saliency = np.linspace(0, 0.7, len(VIRIDIS)), field.saliency(points)
        colours = np.stack([np.interp(saliency, stops, channel) for channel in zip(*VIRIDIS)], axis=1).astype(np.uint8)
        near = (np.linalg.norm(found.points - middle, axis=1) < radius).nonzero()[0][::-1]
        radii = width * (0.003 + 0.014 * found.confidence[near])
        marks = (found.points[near] @ turn.T)[:, :2]
        yield drawn((points @ turn.T)[:, :2], colours, f"{name}: {len(found)}", width, 2, marks, radii)


def answer(source, target):
    """The source on the target by `register`, from above."""
    result = snake_rs.register(source, target)
    colours = np.repeat([GREY, RED], [len(target), len(source)], axis=0)
    t = result.t_target_source
    both = np.concatenate([target, source @ t[:3, :3].T + t[:3, 3]])[:, :2]
    return drawn(both, colours, f"confidence {result.verdict.confidence:.2f}", WIDTH // 2)


def save(panels, name, columns=4, colours=64):
    """A picture of panels of equal width."""
    rows = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    heights = [max(image.height for image in row) for row in rows]
    picture = Image.new("RGB", (sum(image.width for image in rows[0]), sum(heights)), "white")
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            picture.paste(image, (j * image.width, sum(heights[:i]) + (heights[i] - image.height) // 2))
    picture.quantize(colours).save(DOCS / name, optimize=True)


def drive():
    """The sweep of the samples, and six of a made drive, aligned."""
    from snake_training.data.sensors import write_drives

    write_drives(WORK / "drive", drives=1, sweeps=6, step=5.0, seed=2)
    run("snake-cli", "align", WORK / "drive", "--merged", WORK / "merged.ply")
    merged = np.asarray(snake_rs.read_points(WORK / "merged.ply"))
    return {"sweep": np.asarray(snake_rs.read_points(PLANE.with_name("sweep.ply"))), "street": merged}


def objects(data):
    """Whole objects, and below them what a depth camera sees of some, by the default choice of a model."""
    from snake_training.data.views import one_sided

    numbers = {row["name"]: number for number, row in enumerate(json.loads((data / "index.json").read_text()))}
    points = np.load(data / "points.npy", mmap_mode="r")
    cloud, rng = lambda name: points[numbers[name]] / np.float32(32767), np.random.default_rng(3)
    whole = {name: cloud(full) for name, full in OBJECTS.items()}
    sides = {f"{name} from one side": one_sided(cloud(full), rng, "camera") for name, full in SIDES.items()}
    return [*keypoints(whole, "y", 4, (30, 20), model="compact"), *keypoints(sides, "camera", 4, (20, 10))]


def made_room():
    """Points 2 cm apart on a floor, two walls and a box, with noise of 3 mm."""
    rng, points = np.random.default_rng(0), []
    for corner, u, v in [
        ([0, 0, 0], [5, 0, 0], [0, 4, 0]), ([0, 0, 0], [5, 0, 0], [0, 0, 2.5]), ([0, 0, 0], [0, 4, 0], [0, 0, 2.5]),
        ([2, 1, 0.8], [1, 0, 0], [0, 0.6, 0]), ([2, 1, 0], [1, 0, 0], [0, 0, 0.8]), ([2, 1.6, 0], [1, 0, 0], [0, 0, 0.8]),
        ([2, 1, 0], [0, 0.6, 0], [0, 0, 0.8]), ([3, 1, 0], [0, 0.6, 0], [0, 0, 0.8]),
    ]:  # fmt: skip
        number = round(2500 * np.linalg.norm(np.cross(u, v)))
        points.append(corner + rng.uniform(size=(number, 2)) @ [u, v])
    points = np.concatenate(points)
    return points + rng.normal(0, 0.003, points.shape)


def places(points):
    """The nine best keypoints of a made room by the field alone, and those of the default."""
    words = dict(columns=2, view=(150, 35), model="scenes")
    field = keypoints({"by the field alone": points}, **words, mode_radius=0, max_keypoints=9, min_confidence=0)
    return [*field, *keypoints({"by the planes of the points": points}, **words)]


def sensors():
    """Two scans of a room in the coordinates of a site, the sensors that were found, and the half turn about their middle."""
    files = (PLANE.with_name("room") / f"{number}.ply" for number in (2, 1))
    clouds = [np.asarray(snake_rs.read_points(file)) + (30, -12, 4) for file in files]
    answer = snake_rs.register(*clouds)
    moved = lambda points, t: points @ t[:3, :3].T + t[:3, 3]
    eyes = np.array([cloud.position for cloud in answer.clouds])
    middle = (moved(eyes[0], answer.t_target_source) + eyes[1]) / 2
    turn = np.diag([-1.0, -1, 1, 1])
    turn[:3, 3] = middle * (2, 2, 0)
    half = snake_rs.register(*clouds, initial=turn @ answer.t_target_source)
    colours = np.repeat([GREY, RED], [len(clouds[1]), len(clouds[0])], axis=0)
    for name, result in ("the answer", answer), ("the half turn", half):
        source, eye = (moved(points, result.t_target_source) for points in (clouds[0], eyes[0]))
        title, both = f"{name}: confidence {result.verdict.confidence:.2f}", np.concatenate([clouds[1], source])[:, :2]
        yield drawn(both, colours, title, WIDTH // 2, 2, np.array([eye, eyes[1]])[:, :2], [7, 7])


def page(out):
    """The page of the sample, as Chromium shows it."""
    if not shutil.which("chromium"):
        raise MissingError("Chromium is not installed")
    run("snake-cli", "view", PLANE, "-o", WORK / "plane.html")
    flags = ["--no-sandbox", "--headless", "--log-level=3", "--enable-unsafe-swiftshader", "--window-size=960,580"]
    run("chromium", *flags, f"--screenshot={out}", WORK / "plane.html")


def run(*words):
    """Runs a command in the repository."""
    print(*words, flush=True)
    subprocess.run(list(map(str, words)), cwd=DOCS.parent, check=True, stdout=subprocess.DEVNULL)


def pictures(data):
    """What makes each picture, by its name."""

    def folder(name):
        if data is None:
            raise MissingError("it shows data: give --data")
        return data / name

    def fragment(name):
        (path,) = folder("scenes").glob(f"*/{name}.npy")
        return np.load(path)

    plane, office = np.asarray(snake_rs.read_points(PLANE)), lambda number: fragment(OFFICE.format(number))
    two = lambda name, named, *words, **others: save(list(keypoints(named, *words, 2, **others)), name, 2)
    return {
        "view.png": page,
        "gallery/field.png": lambda out: run("snake-cli", "field", PLANE, "-o", out),
        "gallery/objects.png": lambda out: save(objects(folder("objects/val")), out),
        "gallery/first.png": lambda out: two(out, {"plane": plane, "office": office(6)}, "z camera"),
        "gallery/rooms.png": lambda out: two(out, {"office": office(6), "corner": office(20)}, "camera"),
        "gallery/street.png": lambda out: two(out, drive(), "z", view=(60, 35), radius=30),
        "gallery/places.png": lambda out: save(places(made_room()), out, 2),
        "gallery/sensors.png": lambda out: save(list(sensors()), out, 2, colours=16),
        "gallery/overlap.png": lambda out: save([answer(office(8), office(2))], out, colours=16),
    }


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="such as view.png; all by default")
    parser.add_argument("--data", type=Path, help="folder of objects and scenes")
    arguments = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    makers = pictures(arguments.data)
    for name in arguments.names or makers:
        try:
            makers[name](DOCS / name)
        except MissingError as error:
            print(f"{name} stays as it is: {error}")


if __name__ == "__main__":
    main()
