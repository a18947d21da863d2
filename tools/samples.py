"""Writes the made clouds of `samples/`: python tools/samples.py. Needs the package of training/.

`room/1.ply` to `room/3.ply` are scans of one furnished room from three positions, each in the frame of its scanner. `sweep.ply` is a
turn of a LiDAR with 48 beams in a street. All are cast from boxes, with noise, from fixed seeds; in metres. `plane.ply` is of
another origin (see models/DATA.md).
"""

from pathlib import Path

import numpy as np

from snake_training.data.solids import CUBE, ROOM, Solids, about_axis, directions, scan

FOLDER = Path(__file__).parents[1] / "samples"
SEED = 24


def box(center, size, degrees=0.0, kind=CUBE):
    """A row of `Solids`: a box that stands about its centre, turned about z."""
    return (
        kind,
        np.asarray(center, float),
        about_axis(2, np.radians(degrees)) * (np.asarray(size, float) / 2),
        0.0,
        False,
    )


def turn(elevations, columns):
    """Unit vectors (N, 3) of a turn: one of each elevation, in degrees, in each column."""
    return directions(np.radians(elevations), np.arange(columns) / columns * 2 * np.pi, "ij")


def scanned(boxes, origin, degrees, rays, farthest, noise, rng):
    """The points (N, 3) of a scanner in its own frame; it stands at the origin, turned about z."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = about_axis(2, np.radians(degrees)), origin
    return scan(Solids(boxes), pose, rays, noise, farthest, rng)


def furnished_room(rng):
    """A room of 4.8 x 3.6 x 2.5 m with a doorpost, a shelf, a table with chairs, and smaller boxes on what stands there."""
    boxes = [
        box([2.4, 1.8, 1.25], [4.8, 3.6, 2.5], kind=ROOM),
        box([4.7, 0.9, 1.05], [0.2, 0.9, 2.1]),
        box([1.6, 3.4, 0.9], [1.5, 0.4, 1.8]),
    ]
    boxes += [box([2.6, 1.5, 0.72], [1.4, 0.8, 0.06], 20)]
    for x, y in ((1.9, 0.9), (3.3, 2.0), (2.3, 2.3)):
        degrees = rng.uniform(0, 90)
        boxes += [box([x, y, 0.22], [0.42, 0.42, 0.44], degrees), box([x, y + 0.2, 0.7], [0.42, 0.06, 0.5], degrees)]
    for _ in range(7):
        size = rng.uniform([0.3, 0.3, 0.3], [0.9, 0.6, 1.4])
        x, y = rng.uniform([0.4, 0.3], [4.4, 3.3])
        degrees = rng.uniform(0, 90)
        boxes += [box([x, y, size[2] / 2], size, degrees), box([x, y, size[2] + 0.1], [0.2, 0.25, 0.2], degrees + 30)]
    return boxes


def street(rng):
    """A street of 160 m with houses, parked cars and lamps on both sides."""
    boxes = [box([0, 0, -0.1], [160, 60, 0.2])]
    for side in (-1, 1):
        x = -80.0
        while x < 80:
            length, depth, height, gap = rng.uniform([6, 6, 5, 0], [14, 10, 14, 4])
            boxes.append(box([x + length / 2, side * (10 + depth / 2), height / 2], [length, depth, height]))
            x += length + gap
        for x in rng.uniform(-50, 50, 9):
            boxes += [box([x, side * 4.5, 0.55], [4.2, 1.8, 0.7]), box([x - 0.2, side * 4.5, 1.15], [2.2, 1.6, 0.5])]
        boxes += [box([x, side * 7, 3], [0.25, 0.25, 6]) for x in rng.uniform(-50, 50, 7)]
    return boxes


def write_ply(path, points):
    """A binary PLY file of float32 coordinates."""
    path.parent.mkdir(exist_ok=True)
    names = "".join(f"property float {name}\n" for name in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{names}end_header\n"
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def main():
    rng = np.random.default_rng(SEED)
    room = furnished_room(rng)
    rays = turn(np.linspace(-65, 65, 44), 106)
    for number, (origin, degrees) in enumerate(
        [([0.9, 1.6, 1.6], 0), ([1.5, 2.4, 1.7], 50), ([2.3, 2.6, 1.6], 160)], 1
    ):
        write_ply(FOLDER / f"room/{number}.ply", scanned(room, origin, degrees, rays, 20, 0.003, rng))
    sweep = scanned(street(rng), [0, 0, 1.8], 0, turn(np.linspace(-24, 7, 48), 320), 70, 0.01, rng)
    write_ply(FOLDER / "sweep.ply", sweep)


if __name__ == "__main__":
    main()
