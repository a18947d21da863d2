"""Writes the made clouds of this folder: python samples/generate.py. Needs NumPy.

`room/1.ply` to `room/3.ply` are scans of one furnished room from three places, each in the frame of its scanner. `sweep.ply` is a
turn of a LiDAR with 32 beams in a street. All are cast from boxes, with noise, from fixed seeds; in metres. `plane.ply` is of
another origin (see models/DATA.md).
"""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
SEED = 24


def box(center, size, degrees=0.0):
    """A box that stands about its centre, turned about z: centre, half of its size, and the angle in radians."""
    return np.asarray(center, float), np.asarray(size, float) / 2, np.radians(degrees)


def about_z(points, angle):
    """Points or directions (N, 3), rotated about z."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def ranges(boxes, origin, directions):
    """The distance to the first surface along each of the directions (N, 3); infinite where there is none."""
    nearest = np.full(len(directions), np.inf)
    for center, half, angle in boxes:
        start, along = about_z(origin - center, -angle), about_z(directions, -angle)
        with np.errstate(divide="ignore"):
            planes = np.stack([(-half - start) / along, (half - start) / along])
        enters, leaves = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
        # From inside of a box, the surface is where the ray leaves.
        surface = np.where(enters > 0, enters, leaves)
        nearest = np.where((enters <= leaves) & (surface > 0), np.minimum(nearest, surface), nearest)
    return nearest


def directions(elevations, columns):
    """Unit vectors (N, 3) of a turn: one of each elevation in each column."""
    elevation, azimuth = np.meshgrid(np.radians(elevations), np.arange(columns) / columns * 2 * np.pi, indexing="ij")
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


def scan(boxes, origin, degrees, rays, farthest, noise, rng):
    """The points (N, 3) that a scanner sees, in its own frame; it stands at the origin, turned about z."""
    distance = ranges(boxes, np.asarray(origin), about_z(rays, np.radians(degrees)))
    seen = distance < farthest
    return rays[seen] * (distance[seen] + rng.normal(0, noise, seen.sum()))[:, None]


def furnished_room(rng):
    """A room of 4.8 x 3.6 x 2.5 m with a doorpost, a shelf, a table with chairs, and smaller boxes on what stands there."""
    boxes = [
        box([2.4, 1.8, 1.25], [4.8, 3.6, 2.5]),
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
    rays = directions(np.linspace(-65, 65, 44), 106)
    for number, (origin, degrees) in enumerate(
        [([0.9, 1.6, 1.6], 0), ([1.5, 2.4, 1.7], 50), ([2.3, 2.6, 1.6], 160)], 1
    ):
        write_ply(FOLDER / f"room/{number}.ply", scan(room, origin, degrees, rays, 20, 0.003, rng))
    sweep = scan(street(rng), [0, 0, 1.8], 0, directions(np.linspace(-24, 7, 32), 216), 70, 0.01, rng)
    write_ply(FOLDER / "sweep.ply", sweep)


if __name__ == "__main__":
    main()
