"""Rooms as a depth camera sees them, made from primitives and objects, and objects seen from one side.

`python -m snake_training.data.scenes -o rooms/ --number 500 --data corpus/` writes a corpus folder of them, which
`train --data` and `targets --data` read like any other. Real scans are kept for evaluation.

In a room x, y are horizontal, z is up, lengths are metres; in a camera's frame x is right, y down, z forward.
"""

import argparse
from typing import NamedTuple

import numpy as np

from ..augment import BOUND, choose, facing, normalize, numbered, random_rotation, visible
from .datasets import Mixture, open_shapes, write_corpus
from .procedural import RECIPES, about, box, moved, sample_surface, shelf, table

FIELD_OF_VIEW = np.tan(np.radians((29, 23)))  # half of it, horizontally and vertically, as tangents
RANGE = 0.4, 4.5  # of the depth camera, metres
VOXEL = 0.02  # views are fused to one point in each voxel, metres
DENSITY = 1500  # points a square metre of a room's surfaces


class Scenes:
    """Fragments of random rooms, `points` points each; a share of all is objects, each seen from one side."""

    def __init__(self, objects, length, points=8192, partial_share=0.3, seed=1):
        self.objects, self.length, self.points = objects, length, points
        self.partial_share, self.seed = partial_share, seed

    def __len__(self):
        return self.length

    def __getitem__(self, row):
        """(M, 3) float32; the same on every machine with the same numpy and objects."""
        rng = np.random.default_rng([self.seed, row])
        while True:
            if rng.random() < self.partial_share:
                cloud = normalize(self.objects.cloud(rng))[0] @ random_rotation(rng).T
                cloud = cloud[facing(cloud, rng)]
            else:
                cloud = fragment(*room(self.objects, rng), rng)
            # A camera that looks at a bare wall sees nothing to learn from.
            if len(cloud) > self.points // 4 and np.linalg.svd(cloud - cloud.mean(axis=0), compute_uv=False)[2] > 1:
                return choose(rng, cloud, self.points)


class Place(NamedTuple):
    """A place of a room in units of twice a window's radius, within the padded volume: as fragments of different cameras
    show it, `views` (V, N, 3), and what they see of its surface without noise and holes, `surface` (M, 3). float32."""

    views: np.ndarray
    surface: np.ndarray


class Places:
    """Places about the furniture of random rooms, for windows of 0.4 to 1.2 m radius; `places[i]` is a `Place`."""

    def __init__(self, objects, length, views=4, points=1024, seed=1, places=6):
        self.objects, self.length, self.views, self.points = objects, length, views, points
        self.seed, self.places = seed, places
        self.room = None, None  # number and content of the last one

    def __len__(self):
        return self.length

    def __getitem__(self, row):
        number = row // self.places
        if self.room[0] != number:
            self.room = number, room(self.objects, np.random.default_rng([self.seed, number, 0x200]))
        points, places = self.room[1]
        rng = np.random.default_rng([self.seed, row, 0x201])
        while True:
            place = places[rng.integers(len(places))] + rng.normal(size=3) * 0.2
            radius = np.exp(rng.uniform(*np.log((0.4, 1.2))))
            near = points[np.linalg.norm(points - place, axis=1) < BOUND * 2 * radius]
            views, seen = [], []
            for _ in range(4 * self.views):  # furniture or a wall may hide the place
                eye, target = standpoint(points, rng), place + rng.normal(size=3) * 0.3
                if np.linalg.norm(eye - place) < max(RANGE[0], 0.7 * radius):
                    continue
                view = (fused(points, eye, target, rng) - place) / (2 * radius)
                view = view[np.linalg.norm(view, axis=1) < BOUND]
                if len(view) > 100 and np.linalg.svd(view - view.mean(axis=0), compute_uv=False)[2] > 0.5:
                    views.append(choose(rng, view, self.points))
                    seen.append(view)
                if len(views) == self.views:
                    surface = one_in_each(near, VOXEL)
                    surface = ((surface - place) / (2 * radius))[
                        within(surface, np.concatenate(seen) * 2 * radius + place)
                    ]
                    return Place(*(a.astype(np.float32) for a in (np.stack(views), surface)))


def one_in_each(points, side):
    """One of the points (N, 3) in each voxel of that side."""
    _, first = np.unique(numbered(np.floor(points / side)), return_index=True)
    return points[first]


def within(points, others, side=1.5 * VOXEL):
    """Which of the points (N, 3) lie in or beside a voxel, of that side, with one of the others (M, 3)."""
    step = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3), axis=-1).reshape(-1, 1, 3)
    beside = numbered(np.floor(one_in_each(others, side) / side) + step)
    return np.isin(numbered(np.floor(points / side)), beside)


def look_at(eye, target, up=(0, 0, 1)):
    """Rotation (3, 3) from the room to the frame of a camera at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right) + 1e-9
    return np.stack([right, np.cross(forward, right), forward])


def standpoint(points, rng):
    """Where a camera may be in a room."""
    low, high = points.min(axis=0), points.max(axis=0)
    eye = rng.uniform(low + (high - low) * 0.15, high - (high - low) * 0.15)
    eye[2] = rng.uniform(1, 1.8)
    return eye


def fragment(points, places, rng):
    """What one to six views of a moving depth camera see of a `room`, in the first camera's frame.

    It walks about the room and looks towards one of its places.
    """
    eye, target = standpoint(points, rng), places[rng.integers(len(places))]
    return ((fused(points, eye, target, rng) - eye) @ look_at(eye, target).T).astype(np.float32)


def fused(points, eye, target, rng):
    """What one to six views see from about `eye` when they look at about `target`, in the room's frame, (M, 3)."""
    parts = []
    for _ in range(rng.integers(1, 7)):
        turn = look_at(eye, target)
        parts.append(depth_image((points - eye) @ turn.T, rng) @ turn + eye)
        eye, target = eye + rng.normal(size=3) * (0.15, 0.15, 0.05), target + rng.normal(size=3) * 0.35
    return one_in_each(np.concatenate(parts), VOXEL)


def depth_image(points, rng):
    """The points (M, 3) in a camera's frame that it sees, with its noise along the ray and its holes."""
    depth = points[:, 2]
    in_view = (depth > RANGE[0]) & (depth < RANGE[1])
    in_view &= (np.abs(points[:, :2]) < FIELD_OF_VIEW * depth[:, None]).all(axis=1)
    points = points[in_view]
    points = points[visible(points, 2 * FIELD_OF_VIEW[0] / 60, 0.03)]
    for _ in range(rng.integers(0, 5)):
        center, radius = rng.uniform(-FIELD_OF_VIEW, FIELD_OF_VIEW), rng.uniform(0.02, 0.12)
        points = points[np.linalg.norm(points[:, :2] / points[:, 2:] - center, axis=1) > radius]
    # The error of a structured-light camera grows with the square of the depth.
    return points * (1 + rng.uniform(0, 0.003) * points[:, 2:] * rng.standard_normal((len(points), 1)))


def room(objects, rng):
    """A furnished room: points (M, 3), uniform by area but for the objects, which have their own, and the places of the
    furniture and objects (P, 3)."""
    size = rng.uniform((2.5, 2.5, 2.2), (6, 6, 3))
    patches = moved(box(size), (0, 0, size[2] / 2))
    clouds, places = [], []
    stands = [(np.zeros(2), size[:2] / 2, 0.0)]  # where objects may stand: middle, half extents, height
    for _ in range(rng.integers(2, 8)):
        patches += on_a_wall(size, rng)
    for _ in range(rng.integers(4, 12)):
        part = (table, shelf, RECIPES[rng.integers(len(RECIPES))])[rng.integers(3)](rng)
        part, place, half, top = standing(part, size, rng)
        patches += part
        places.append((*place, top / 2))
        stands.append((place, half * 0.8, top))
    for _ in range(rng.integers(5, 25)):
        place, half, height = stands[rng.integers(len(stands))]
        cloud = objects.cloud(rng) @ np.linalg.matrix_power(about(rng.integers(3), np.pi / 2), rng.integers(4)).T
        scale = rng.uniform(0.08, 0.25 if height > 0 else 0.6) / np.linalg.norm(cloud, axis=1).max()
        cloud = cloud @ about(2, rng.uniform(0, 2 * np.pi)).T * scale
        places.append((*(place + rng.uniform(-1, 1, 2) * half), height - cloud[:, 2].min()))
        clouds.append(cloud + places[-1])
    area = 2 * (size[0] * size[1] + size[0] * size[2] + size[1] * size[2])
    return np.concatenate([sample_surface(patches, int(1.5 * area * DENSITY), rng), *clouds]), np.array(places)


def on_a_wall(size, rng):
    """A board, frame or beam flat on one of the walls of a room of `size`."""
    axis, side = rng.integers(2), rng.choice([-1, 1])
    extent = rng.uniform(0.1, 1.2, 3)
    extent[axis] = rng.uniform(0.02, 0.25)
    offset = rng.uniform(-0.5, 0.5, 3) * (size - extent)
    offset[axis] = side * (size[axis] - extent[axis]) / 2
    offset[2] = rng.uniform(0, size[2] - extent[2]) + extent[2] / 2
    return moved(box(extent), offset)


def standing(part, size, rng):
    """A part turned about z and set on the floor of a room: (part, place (2,), half its extents (2,), its top)."""
    part = moved(part, rotation=about(2, rng.choice([0, np.pi / 2, rng.uniform(0, 2 * np.pi)])))
    vertices = np.concatenate([patch.reshape(-1, 3) for patch in part])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    half = (high - low)[:2] / 2
    place = rng.uniform(-1, 1, 2) * np.maximum(size[:2] / 2 - half, 0)
    center = (low + high)[:2] / 2
    return moved(part, (*(place - center), -low[2])), place, half, high[2] - low[2]


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.data.scenes",
        description="Write a corpus folder of rooms seen by a depth camera, and of objects seen from one side.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("-o", "--output", required=True, help="folder to write: points.npy and index.json")
    parser.add_argument("--number", type=int, default=500, help="clouds")
    parser.add_argument("--points", type=int, default=8192, help="points of each")
    parser.add_argument("--partial-share", type=float, default=0.3, help="share of objects seen from one side")
    parser.add_argument("--data", nargs="*", default=[], help="objects in the rooms; without it, procedural ones")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args(argv)
    if arguments.number < 1 or arguments.points < 16:
        parser.error("--number must be 1 or more, --points 16 or more")
    if not 0 <= arguments.partial_share <= 1:
        parser.error("--partial-share must be within [0, 1]")
    try:
        objects = Mixture([open_shapes(folder) for folder in arguments.data], 0.25)
        scenes = Scenes(objects, arguments.number, arguments.points, arguments.partial_share, arguments.seed)
        write_corpus(arguments.output, scenes, arguments.points)
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
