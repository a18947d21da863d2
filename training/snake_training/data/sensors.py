"""Sensors in made worlds: a depth camera, a spinning LiDAR, a scanner on a tripod, and the clouds that they give.

`write_frames` and `write_drives` write pairs for measuring, `pairs.json` and clouds (N, 3) in metres: `snake_training.evaluation repeatability`
reads them. `scene_cloud` gives whole clouds, to which the choice between a model of objects and one of scenes is fitted.
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from .solids import about_axis, directions, dot
from .worlds import room, street

RAYS = 9000  # of a view, at most
# Pairs of depth frames: a sensor's reach in metres, and the standard deviation NOISE + QUADRATIC z^2 of a depth z.
NEAREST, FURTHEST, NOISE, QUADRATIC = 0.4, 4.5, 0.001, 0.0015
WIDTH, HEIGHT, BLOCK = 640, 480, 40  # pixels
NEAR = 0.05  # metres within which a point of the other frame shows the same point of the surface
# Drives: a LiDAR's reach and noise in metres; sectors that are cast apart.
LIDAR_NEAREST, LIDAR_FURTHEST, LIDAR_NOISE, SECTORS = 1.5, 100.0, 0.02, 24
SCENE_KINDS = "depth frame", "fragment", "tripod in a room", "tripod in a street", "aerial tile", "sweep"


class View:
    """Rays of a sensor: origins and directions (R, 3), noise NOISE + QUADRATIC t^2 and range of distances t, in metres."""

    def __init__(self, origins, directions, noise, quadratic=0.0, furthest=np.inf, nearest=0.3):
        self.origins, self.directions = origins, directions
        self.noise, self.quadratic, self.furthest, self.nearest = noise, quadratic, furthest, nearest


def reaching(origins, directions, center, radius):
    """Which rays (R, 3) pass within `radius` of `center`, ahead of their origins."""
    offset = center - origins
    along = dot(offset, directions)
    return (along > 0) & (dot(offset, offset) - along**2 < radius**2)


def depth_camera(eye, target, rng, step=None):
    """Rays of a hand-held camera of 640 x 480 pixels: directions (R, 3) in the world, row by row, and the rotation (3, 3) from the
    camera's frame to the world. `step`: every so many pixels, a random 2 or 3 by default."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0, 0, 1) + rng.normal(size=3) * 0.1)
    right /= np.linalg.norm(right)
    step = step or rng.integers(2, 4)
    u, v = np.meshgrid(np.arange(0, 640, step) - 319.5, np.arange(0, 480, step) - 239.5)
    rays = np.stack([u, v], axis=-1).reshape(-1, 2) / 575
    down = np.cross(forward, right)
    directions = forward + rays[:, :1] * right + rays[:, 1:] * down
    return directions / np.linalg.norm(directions, axis=1, keepdims=True), np.stack([right, down, forward], axis=1)


def spinning_lidar(rng, beams=None):
    """Directions (R, 3) of a LiDAR of 16 to 128 beams, in its frame."""
    beams = beams or rng.choice([16, 32, 64, 64, 128])
    low, high = {16: (-15, 15), 32: (-30.7, 10.7), 64: (-24.8, 2), 128: (-25, 15)}[beams]
    if rng.random() < 0.3:
        low, high = -22.5, 22.5
    azimuths = rng.integers(900, 2400)
    elevation = np.radians(np.linspace(low, high, beams) + rng.normal(size=beams) * 0.05)
    return directions(elevation, np.linspace(0, 2 * np.pi, azimuths, endpoint=False), "ij")


def upright(rng, tilt=0.03):
    """A rotation about z by any angle, then a small tilt."""
    return about_axis(0, rng.normal() * tilt) @ about_axis(1, rng.normal() * tilt) @ about_axis(2, rng.uniform(0, 7))


def toward_ball(eye, center, radius, number, rng):
    """Directions (number, 3) from `eye`, uniform over those that reach a ball: a dense scan, or part of one."""
    axis, distance = center - eye, np.linalg.norm(center - eye)
    least = np.cos(np.arcsin(min(radius / distance, 0.999))) if distance > radius else -1
    cosine, angle = rng.uniform(least, 1, number), rng.uniform(0, 2 * np.pi, number)
    one = np.cross(axis, rng.normal(size=3))
    frame = np.stack([one / np.linalg.norm(one), np.cross(axis, one) / distance / np.linalg.norm(one), axis / distance])
    sine = np.sqrt(1 - cosine**2)
    return np.column_stack([sine * np.cos(angle), sine * np.sin(angle), cosine]) @ frame


def seen(world, view, center, radius, rng):
    """Points of a view within a ball (2, M, 3): with noise and gaps, and without noise. The latter are NaN on foliage and on solids that
    move."""
    chosen = reaching(view.origins, view.directions, center, radius)
    if chosen.sum() > RAYS:
        chosen[rng.permutation(np.flatnonzero(chosen))[RAYS:]] = False
    o, d = view.origins[chosen], view.directions[chosen]
    eyes = o if len(o) < 3 else o[:: max(len(o) // 4, 1)]
    if len(o) == 0:
        return np.empty((2, 0, 3))
    near = world.toward(eyes, center, radius)
    if not near.rows:
        return np.empty((2, 0, 3))
    t, which, slope = near.cast(o, d)
    _, _, _, fuzz, moving = near.arrays()
    keep = (t > view.nearest) & (t < view.furthest) & (rng.random(len(t)) < 0.15 + 2.5 * slope)
    o, d, t, which = o[keep], d[keep], t[keep], which[keep]
    error = (view.noise + view.quadratic * t**2) * rng.standard_normal(len(t))
    into = fuzz[which] * rng.exponential(0.7, len(t))
    clean = o + d * t[:, None]
    clean[(fuzz[which] > 0) | moving[which]] = np.nan
    points = o + d * (t + error + into)[:, None]
    ball = dot(points - center, points - center) < radius**2
    return np.stack([points[ball], clean[ball]])


def holes(points, eye, rng):
    """A mask (M,) of the points (M, 3) that lie in none of a depth camera's holes."""
    kept = np.ones(len(points), bool)
    directions = (points - eye) / np.linalg.norm(points - eye, axis=1, keepdims=True)
    for _ in range(rng.integers(0, 6)):
        if len(points):
            kept &= np.linalg.norm(directions - directions[rng.integers(len(points))], axis=1) > rng.uniform(0.01, 0.12)
    return kept


def fused(points, clean, side):
    """Means (2, C, 3) of the points (M, 3) in each cell of `side` metres, and of the same points without noise."""
    _, cell, count = np.unique(
        np.floor(points / side).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    mean = np.zeros((2, len(count), 3))
    for out, values in zip(mean, (points, clean), strict=True):
        np.add.at(out, cell.ravel(), values)
    return mean / count[:, None]


def standpoint(size, rng):
    """A random position (3,) of a camera in a room of a size (3,)."""
    return np.array([*rng.uniform(-0.4, 0.4, 2) * size[:2], rng.uniform(0.7, min(size[2] - 0.4, 1.9))])


def frame(world, eye, target, rng):
    """The points (N, 3) that a camera at `eye` which looks at `target` sees in its frame, x right, y down, z forward, and the
    rotation (3, 3) from it to the room's. A frame is one image of 640 x 480 pixels: slanted surfaces and holes are missing."""
    rays, turn = depth_camera(eye, target, rng, step=1)
    blocks = rays.reshape(HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK, 3).swapaxes(1, 2).reshape(-1, BLOCK * BLOCK, 3)
    points = []
    for block in blocks:
        middle = block.mean(axis=0) / np.linalg.norm(block.mean(axis=0))
        radius = FURTHEST * np.linalg.norm(block - middle, axis=1).max()
        near = world.toward(eye[None], eye + middle * FURTHEST, radius)
        if not near.rows:
            continue
        reach, _, slope = near.cast(np.broadcast_to(eye, block.shape), block)
        kept = (reach > NEAREST) & (reach < FURTHEST) & (rng.random(len(block)) < 0.15 + 2.5 * slope)
        reach = reach[kept]
        error = (NOISE + QUADRATIC * reach**2) * rng.standard_normal(len(reach))
        points.append(eye + block[kept] * (reach + error)[:, None])
    points = np.concatenate([np.empty((0, 3)), *points])
    return (points[holes(points, eye, rng)] - eye) @ turn, turn


def pose(eye, turn):
    """The matrix (4, 4) from a camera's frame to the room's."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, eye
    return matrix


def pair(rng):
    """Two frames of a room, 10 to 40 cm apart: clouds (N, 3), the matrix (4, 4) from the first to the second, and the share of the
    first that the second shows."""
    while True:
        world, size = room(rng)
        eye, target = standpoint(size, rng), rng.uniform(-0.5, 0.5, 3) * size + (0, 0, size[2] / 2)
        step = rng.normal(size=3) * (1, 1, 0.3)
        other = eye + step / np.linalg.norm(step) * rng.uniform(0.1, 0.4)
        if world.inside(np.stack([eye, other]), -0.25).any():
            continue
        (first, turn_1), (second, turn_2) = (
            frame(world, at, target + rng.normal(size=3) * 0.3, rng) for at in (eye, other)
        )
        matrix = np.linalg.inv(pose(other, turn_2)) @ pose(eye, turn_1)
        if min(len(first), len(second)) < WIDTH * HEIGHT / 4 or np.median(first[:, 2]) < 1:
            continue
        moved = first[::10] @ matrix[:3, :3].T + matrix[:3, 3]
        overlap = float((cKDTree(second).query(moved)[0] < NEAR).mean())
        if overlap > 0.3:
            return first.astype(np.float32), second.astype(np.float32), matrix, overlap


def write_frames(folder, pairs=30, seed=1):
    """`pairs` pairs of frames, and their list. A ValueError for less than one."""
    write_pairs(folder, pairs, seed, pair)


def write_pairs(folder, pairs, seed, make):
    """`write_frames` of pairs that `make` makes."""
    if pairs < 1:
        raise ValueError("pairs must be 1 or more")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in range(pairs):
        first, second, matrix, overlap = make(np.random.default_rng([seed, row, 0xF4A3]))
        names = [f"room{row:03d}_{view}" for view in range(2)]
        for name, cloud in zip(names, (first, second), strict=True):
            np.save(folder / f"{name}.npy", cloud)
        rows.append({"source": names[0], "target": names[1], "T": matrix.tolist(), "overlap": round(overlap, 4)})
    (folder / "pairs.json").write_text(json.dumps(rows, indent=1))


def sweep(world, eye, turn, beams, rng):
    """The points (N, 3) that directions (R, 3) in the sensor's frame meet from `eye`; `turn` (3, 3) maps to the street's frame."""
    rays, points = beams @ turn.T, []
    sector = (np.arctan2(rays[:, 1], rays[:, 0]) / (2 * np.pi) * SECTORS).round() % SECTORS
    for number in range(SECTORS):
        some = rays[sector == number]
        middle = some.mean(axis=0) * (1, 1, 0)
        middle /= np.linalg.norm(middle)
        near = world.toward(
            eye[None], eye + middle * LIDAR_FURTHEST, LIDAR_FURTHEST * np.linalg.norm(some - middle, axis=1).max()
        )
        reach, which, slope = near.cast(np.broadcast_to(eye, some.shape), some)
        kept = (reach > LIDAR_NEAREST) & (reach < LIDAR_FURTHEST) & (rng.random(len(some)) < 0.15 + 2.5 * slope)
        reach = (
            reach
            + LIDAR_NOISE * rng.standard_normal(len(reach))
            + near.arrays()[3][which] * rng.exponential(0.7, len(reach))
        )
        points.append(some[kept] * reach[kept, None])
    return (np.concatenate(points) @ turn).astype(np.float32)


def drive(seed, number, step):
    """`number` sweeps (N, 3) of a car along a street, `step` metres apart, with the matrices (4, 4) from their frames to the street's.

    The LiDAR has 64 beams and stands 1.8 m above the road; in its frame x is ahead, z up. Other cars move from sweep to sweep.
    """
    rng = np.random.default_rng([seed, 0xD21E])
    world, half = street(rng)
    beams = spinning_lidar(rng, 64)
    eye, yaw = np.array([-number * step / 2, rng.uniform(-0.4, 0.4) * half, 1.8]), rng.normal() * 0.05
    for _ in range(number):
        turn = upright(np.random.default_rng(seed), 0.01)  # as the sensor is mounted
        yaw += rng.normal() * 0.02
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]) @ turn
        yield sweep(world, eye, turn, beams, rng), pose(eye, turn)
        eye = eye + step * np.array([np.cos(yaw), np.sin(yaw), rng.normal() * 0.005])
        world = world.later(rng.uniform(0.3, 1.0))


def write_drives(folder, drives=10, sweeps=3, step=6.0, seed=1):
    """Sweeps of `drives` streets from a seed on, `sweeps` of each, `step` metres apart, and the list of neighbouring pairs.

    Raises ValueError for less than one drive or two sweeps.
    """
    if min(drives, sweeps - 1) < 1:
        raise ValueError("drives must be 1 or more, sweeps 2 or more")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for number in range(seed, seed + drives):
        poses = []
        for view, (points, matrix) in enumerate(drive(number, sweeps, step)):
            np.save(folder / f"drive{number:03d}_{view}.npy", points)
            poses.append(matrix)
        for view in range(1, len(poses)):
            matrix = np.linalg.inv(poses[view - 1]) @ poses[view]
            names = {"source": f"drive{number:03d}_{view}", "target": f"drive{number:03d}_{view - 1}"}
            rows.append(names | {"T": matrix.tolist()})
    (folder / "pairs.json").write_text(json.dumps(rows, indent=1))


def scene_cloud(rng):
    """(kind, points (N, 3) in metres): one image or several fused ones of a depth camera, a scan from a tripod, a tile of an
    aerial scan, or a sweep of a spinning LiDAR."""
    kind = SCENE_KINDS[rng.integers(len(SCENE_KINDS))]
    if kind in SCENE_KINDS[:3]:
        world, size = room(rng)
        eye = standpoint(size, rng)
        if kind == "tripod in a room":
            return kind, tripod_scan(world, eye, 15.0, rng)
        target = standpoint(size, rng) + rng.normal(size=3) * 0.3
        images, quadratic = [], rng.uniform(0.0008, 0.004)
        for _ in range(1 if kind == "depth frame" else rng.integers(4, 12)):
            rays, _ = depth_camera(eye, target, rng)
            images.append(
                whole_view(world, View(np.broadcast_to(eye, rays.shape), rays, 0.001, quadratic, 4.5, 0.4), rng)
            )
            eye, target = eye + rng.normal(size=3) * (0.2, 0.2, 0.1), target + rng.normal(size=3) * 0.5
        points = np.concatenate(images)
        return kind, points if kind == "depth frame" else fused(points, points, rng.uniform(0.01, 0.03))[0]
    world, half = street(rng)
    eye = np.array([rng.uniform(-30, 30), rng.normal() * half / 3, rng.uniform(1.5, 2.0)])
    if kind == "tripod in a street":
        return kind, tripod_scan(world, eye, 100.0, rng)
    if kind == "sweep":
        rays = spinning_lidar(rng) @ upright(rng).T
        return kind, whole_view(world, View(np.broadcast_to(eye, rays.shape), rays, 0.02, 0, 100, 1.5), rng)
    side = rng.uniform(8, 40)
    rays = np.array([0, 0, -1]) + rng.normal(size=(20000, 3)) * rng.uniform(0.01, 0.2)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    below = np.column_stack([rng.uniform(-side, side, (len(rays), 2)) + eye[:2], np.zeros(len(rays))])
    return kind, whole_view(world, View(below - rays * 60, rays, 0.03), rng)


def tripod_scan(world, eye, furthest, rng):
    """The points (N, 3) of a scanner on a tripod, which hides the ground below it."""
    rays = rng.normal(size=(20000, 3))
    rays = rays[rays[:, 2] > -1.2 * np.hypot(rays[:, 0], rays[:, 1])]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return whole_view(world, View(np.broadcast_to(eye, rays.shape), rays, 0.004, 0, furthest), rng)


def whole_view(world, view, rng):
    """All points (N, 3) of a view, by parts of 8000 rays: `seen` leaves out rays above RAYS."""
    points, limits = [], (view.noise, view.quadratic, view.furthest, view.nearest)
    for start in range(0, len(view.directions), 8000):
        rays = slice(start, start + 8000)
        part = View(view.origins[rays], view.directions[rays], *limits)
        points.append(seen(world, part, np.zeros(3), 300.0, rng)[0])
    return np.concatenate(points)
