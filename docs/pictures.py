"""Makes every picture of the pages: `make pictures DATA=FOLDER`, or `python docs/pictures.py [NAME..] [--data FOLDER]`.

FOLDER holds objects/val, a corpus folder, and scenes/val and scenes/train, folders of fragments (N, 3) with `pairs.json`; pictures of
them stay as they are without it. The curves are made by `make results`. Needs snake-cli, snake_rs, Pillow and, for the page, Chromium.
"""

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np

DOCS = Path(__file__).resolve().parent
WORK = DOCS.parent / "target/pictures"
PLANE = DOCS.parent / "samples/plane.ply"
OFFICE = "sun3d-mit_lab_hj-lab_hj_tea_nov_2_2012_scan1_erika__{:02}"

# The commands of each picture. {NAME} is the file of a cloud of CLOUDS, {out} the picture.
OBJECTS = "chair", "armchair", "stool", "skull", "bolt", "windturbine", "cat", "bed"
GALLERY, PAIRS = "python docs/gallery.py {out}", "python docs/pairs.py {out}"
CHROMIUM = "chromium --no-sandbox --headless --log-level=3 --enable-unsafe-swiftshader --window-size=960,580"
PICTURES = {
    "view.png": [f"snake-cli view {PLANE} -o {WORK}/plane.html", CHROMIUM + f" --screenshot={{out}} {WORK}/plane.html"],
    "gallery/first.png": [f"{GALLERY} {PLANE} {{office}} --up z camera --columns 2"],
    "gallery/objects.png": [
        f"{GALLERY} {' '.join(f'{{{name}}}' for name in OBJECTS)} --up y --view 30 20 --model compact"
    ],
    "gallery/rooms.png": [f"{GALLERY} {{office}} {{corner}} --up camera --columns 2"],
    "gallery/street.png": [f"{GALLERY} {{sweep}} {{street}} --columns 2 --view 60 35 --radius 30"],
    "gallery/aerial.png": [f"{GALLERY} {{aerial}} {{tabletop}} --up z camera --columns 2 --view 15 60"],
    "gallery/facade.png": [f"{PAIRS} {{facade_moved}} {{facade}} --hypotheses 3"],
    "gallery/stairs.png": [f"{PAIRS} {{stairs_above}} {{stairs}} --hypotheses 2 --side"],
    "gallery/map.png": [f"{PAIRS} {{room}} {{rooms}} --map 0.05"],
    "gallery/overlap.png": [f"{PAIRS} {{overlapping}} {{overlapped}}"],
    "gallery/field.png": [f"snake-cli field {PLANE} -o {{out}}"],
}


def samples():
    """The script `samples/generate.py`."""
    spec = importlib.util.spec_from_file_location("generate", DOCS.parent / "samples/generate.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def facade(shift):
    """A scan of a wall with a window every 1.5 m, from `shift` metres along it."""
    made = samples()
    boxes = [made.box([0, 0, -0.1], [80, 30, 0.2]), made.box([0, 9, 6], [80, 0.3, 12])]
    boxes += [made.box([x, 8.7, z], [1.2, 0.3, 1.5]) for x in np.arange(-19.5, 21, 1.5) for z in (2, 5, 8)]
    rays = made.turn(np.linspace(-45, 45, 48), 500)
    return made.scanned(boxes, [shift, 0, 1.4], 0, rays, 14, 0.008, np.random.default_rng(int(shift)))


def stairs(end):
    """A scan of spiral stairs, the source or the target of a pair of `tests/bench/alike_pairs.py`."""
    sys.path.append(str(DOCS.parent / "tests/bench"))
    import alike_pairs

    points = getattr(alike_pairs.make("stairs", 62), end)
    return points[np.abs(points[:, 2]) < 2.5]


def sweeps(name):
    """One of six sweeps of a made drive, or all, aligned."""
    from snake_training.data.sensors import write_drives

    write_drives(WORK / "drive", drives=1, sweeps=6, step=5.0, seed=2)
    if name == "sweep":
        return np.load(WORK / "drive/drive002_0.npy")
    import snake_rs

    run(f"snake-cli align {WORK}/drive --merged {WORK}/merged.ply")
    return np.asarray(snake_rs.read_points(WORK / "merged.ply"))


def aerial():
    """A crop of an aerial scan of a made street."""
    from snake_training.data.sensors import scene_cloud

    return scene_cloud(np.random.default_rng(3))[1]


def an_object(name, data):
    """The points of an object of the corpus."""
    rows = {row["name"]: number for number, row in enumerate(json.loads((data / "objects/val/index.json").read_text()))}
    return np.load(data / "objects/val/points.npy", mmap_mode="r")[rows[name]] / np.float32(32767)


def a_fragment(name, data):
    """A fragment of a scene."""
    (path,) = (data / "scenes").glob(f"*/{name}.npy")
    return np.load(path)


def many_fragments(data):
    """Every tenth fragment of the training scenes, 20 of them, 8 m apart."""
    paths = sorted((data / "scenes/train").glob("*.npy"))[::10][:20]
    return np.concatenate([np.load(path) + (8.0 * (i % 5), 8.0 * (i // 5), 0) for i, path in enumerate(paths)])


MADE = {
    "facade": partial(facade, 0), "facade_moved": partial(facade, 3.0), "stairs": partial(stairs, "target"), "stairs_above": partial(stairs, "source"),
    "sweep": partial(sweeps, "sweep"), "street": partial(sweeps, "street"), "aerial": aerial,
}  # fmt: skip
NAMES = dict(
    chair="Chair_1", armchair="Chair_3", stool="painted_wooden_stool_1k", skull="Skull", bolt="factory_bolt_m20_loose",
    windturbine="windturbine_tall_fan", cat="cat", bed="bedDouble",
)  # fmt: skip
READ = {name: partial(an_object, NAMES[name]) for name in OBJECTS} | {
    "office": partial(a_fragment, OFFICE.format(6)), "corner": partial(a_fragment, OFFICE.format(20)),
    "overlapping": partial(a_fragment, OFFICE.format(8)), "overlapped": partial(a_fragment, OFFICE.format(2)),
    "tabletop": partial(a_fragment, "tabletop_learn__00"), "room": partial(a_fragment, "7-scenes-redkitchen__47"),
    "rooms": many_fragments,
}  # fmt: skip


def run(command):
    """Runs a command of ours or Chromium."""
    print(command, flush=True)
    words = [sys.executable if word == "python" else word for word in command.split()]
    subprocess.run(words, cwd=DOCS.parent, check=True, stdout=subprocess.DEVNULL)


def make(name, data):
    """Makes a picture; returns why not, if what it needs is missing."""
    commands, files = PICTURES[name], {}
    needed = [cloud for cloud in MADE | READ if any(f"{{{cloud}}}" in command for command in commands)]
    if data is None and any(cloud in READ for cloud in needed):
        return "it shows data: give --data"
    if any(command.startswith("chromium") for command in commands) and not shutil.which("chromium"):
        return "Chromium is not installed"
    for cloud in needed:
        files[cloud] = WORK / f"{cloud}.npy"
        np.save(files[cloud], (MADE[cloud]() if cloud in MADE else READ[cloud](data)).astype(np.float32))
    for command in commands:
        run(command.format(out=DOCS / name, **files))
    return ""


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="such as view.png; all by default")
    parser.add_argument("--data", type=Path, help="folder of objects and scenes")
    arguments = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or PICTURES:
        if reason := make(name, arguments.data):
            print(f"{name} stays as it is: {reason}")


if __name__ == "__main__":
    main()
