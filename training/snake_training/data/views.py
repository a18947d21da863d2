"""What a depth camera sees of one object, from one side, and of a table top with several, and bare rooms, for the choice of a model and its confidences."""

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from .sensors import View, depth_camera, whole_view, write_pairs
from .shapes import box, moved, sample_surface
from .solids import CUBE, Solids, about_axis
from .worlds import any_turn, clutter

FRAMES = "camera", "centred", "turned", "moved"


def one_sided(surface, rng, frame=None):
    """One image (N, 3) of an object from 2 to 12 radii away, given points `surface` (M, 3) in the unit ball.

    250 to 20 000 points, at times partly hidden, with noise of the depth, in any unit. In a frame of `FRAMES`, a random one by default:
    the camera's, about the mean, the camera's rotated, or about any other origin.
    """
    eye = rng.normal(size=3)
    eye *= np.exp(rng.uniform(np.log(2), np.log(12))) / np.linalg.norm(eye)
    points = visible(surface - eye, rng)
    number = int(np.exp(rng.uniform(np.log(250), np.log(20000))))
    points = denser(points, 3 * number, rng)
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, rng.normal(size=3))
    right /= np.linalg.norm(right)
    points = pixels(points @ np.stack([right, np.cross(forward, right), forward], axis=1), number)
    if rng.random() < 0.35:  # something stands before it: all on one side of a line, or a disc
        image = points[:, :2] / points[:, 2:]
        is_line = rng.random() < 0.5
        order = image @ rng.normal(size=2) if is_line else -((image - image[rng.integers(len(image))]) ** 2).sum(axis=1)
        points = points[order < np.quantile(order, rng.uniform(0.5 if is_line else 0.6, 0.9))]
    if rng.random() < 0.7:
        points *= 1 + 10 ** rng.uniform(-3, -1.5) * rng.normal(size=(len(points), 1)) / points[:, 2:]
    frame = frame or FRAMES[rng.integers(len(FRAMES))]
    if frame in ("turned", "moved"):
        points = points @ any_turn(rng).T
    if frame in ("centred", "moved"):
        points = points - points.mean(axis=0) + (3 * rng.normal(size=3) if frame == "moved" else 0)
    return (points * 10 ** rng.uniform(-2, 2)).astype(np.float32)


def visible(points, rng):
    """The points (N, 3) that are not hidden from the origin, by the hull of their inversion (Katz, Tal and Basri 2007)."""
    distance = np.linalg.norm(points, axis=1, keepdims=True)
    flipped = points * (2 * 10 ** rng.uniform(2, 3) * distance.max() / distance - 1)
    return points[[row for row in ConvexHull(np.vstack([flipped, np.zeros(3)])).vertices if row < len(points)]]


def denser(points, number, rng):
    """Points (number, 3) on triangles of one of the points (N, 3) and two of its neighbours."""
    first = rng.integers(len(points), size=number)
    near = cKDTree(points).query(points, 6)[1][first]
    edges = [points[near[range(number), rng.integers(1, 6, number)]] - points[first] for _ in range(2)]
    low, high = np.sort(rng.random((2, number, 1)), axis=0)
    return points[first] + low * edges[0] + (high - low) * edges[1]


def pixels(points, number):
    """The nearest of the points (N, 3) in each pixel of a camera with about so many pixels on them."""
    image = points[:, :2] / points[:, 2:]
    side = np.sqrt(np.ptp(image, axis=0).prod() * 0.6 / number)
    nearest_first = np.argsort(points[:, 2], kind="stable")
    _, first = np.unique(np.floor(image[nearest_first] / side), axis=0, return_index=True)
    return points[nearest_first[first]]


def table_top(rng):
    """A depth image (N, 3) of two to eleven things on a table, in the camera's frame, in metres."""
    world, half, height = Solids(), rng.uniform(0.3, 0.9, 2), 0.75
    world.add(CUBE, (0, 0, height - 0.02), (*half, 0.02))
    if rng.random() < 0.7:
        world.add(CUBE, (0, 0, -0.1), (5, 5, 0.1))
    if rng.random() < 0.5:
        world.add(CUBE, (0, half[1] + rng.uniform(0.05, 1.5), 1), (5, 0.1, 3))
    for _ in range(rng.integers(2, 12)):
        at = rng.uniform(-0.6, 0.6, 2) * half
        world.group(clutter(rng, rng.uniform(0.06, 0.3)), (*at, height - 0.002), rng.uniform(0, 7))
    eye = np.array([rng.normal() * 0.3, rng.normal() * 0.3 - rng.uniform(0.5, 1.2), height + rng.uniform(0.3, 1.2)])
    target = np.array([*rng.normal(size=2) * 0.15 * half, height])
    rays, _ = depth_camera(eye, target, rng, step=3)
    limits = 0.001, rng.uniform(0.0008, 0.004), rng.choice([1.2, 2, 4.5]), 0.3
    return whole_view(world, View(np.broadcast_to(eye, rays.shape), rays, *limits), rng) - eye


def bare_surface(rng, closed=False):
    """The patches of a floor with one to three walls and one to six boxes, or closed: with a ceiling and up to six, in metres."""
    x, y, height = rng.uniform((1, 1, 2), (3.5, 3.5, 3))
    bottom = np.array([(x, -y, 0), (-x, -y, 0), (-x, y, 0), (x, y, 0)])
    floor = bottom[[[0, 1], [3, 2]]]
    sides = [bottom[[side, (side + 1) % 4]] for side in range(4)]
    walls = [np.stack([side, side + (0, 0, height)]) for side in sides]
    patches = [floor, floor + (0, 0, height), *walls] if closed else [floor, *walls[: rng.integers(1, 4)]]
    for _ in range(rng.integers(not closed, 7)):
        half = rng.uniform(0.1, 0.6, 3)
        at = rng.uniform(half[:2] - (x, y), (x, y) - half[:2])
        patches += moved(box(2 * half), (*at, half[2]))
    return patches


def bare_room(rng, closed=False):
    """Points (N, 3) of all of a bare surface, in metres, with noise of 5 mm."""
    patches = bare_surface(rng, closed)
    number = int(np.exp(rng.uniform(np.log(3000), np.log(60000))))
    return sample_surface(patches, number, rng) + rng.normal(0, 0.005, (number, 3))


def bare_pair(rng):
    """Two samples of a bare surface, the second one turned about the vertical: clouds (N, 3) with points 1 to 4 cm apart and noise of
    1 to 10 mm, the matrix (4, 4) from the first to the second, and their overlap."""
    patches, matrix = bare_surface(rng), np.eye(4)
    matrix[:3] = np.column_stack([about_axis(2, rng.uniform(0, 2 * np.pi)), rng.uniform(-3, 3, 3)])
    area = sum(np.linalg.norm(np.cross(p[1, 0] - p[0, 0], p[0, 1] - p[0, 0])) for p in patches)
    spacing, noise = (np.exp(rng.uniform(np.log(low), np.log(high))) for low, high in ((0.01, 0.04), (0.001, 0.01)))
    number = int(area / spacing**2)
    first, second = (sample_surface(patches, number, rng) + rng.normal(0, noise, (number, 3)) for _ in range(2))
    return first.astype(np.float32), (second @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32), matrix, 1.0


def write_bare(folder, pairs=30, seed=1):
    """`pairs` pairs of samples of bare rooms, and their list."""
    write_pairs(folder, pairs, seed, bare_pair)
