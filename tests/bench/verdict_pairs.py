"""Pairs of made clouds on which a verdict can fail: surfaces that slide, shapes that turn, things that are not in the other
cloud, missing returns at a sentinel distance; and pairs of the same making that overlap.

A pair's kind is in its name. All lengths are metres.
"""

import itertools
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from snake_training.data.solids import BALL, CUBE, CYLINDER, ROOM, TUNNEL, Solids, about_axis, directions, scan
from snake_training.data.worlds import any_turn

SENTINELS = (0.0, 20.0, 30.0, 65.535, 1e4)


class VerdictPair(NamedTuple):
    """Two clouds (N, 3). `t_target_source` (4, 4) is None if no transform is right; a right one moves the source's points
    by less than `limit` (median) from where the true one does, or from any of them if objects may be symmetric."""

    name: str
    source: np.ndarray
    target: np.ndarray
    t_target_source: np.ndarray | None
    limit: float
    is_symmetric: bool = False

    @property
    def kind(self) -> str:
        return self.name.rsplit(" ", 1)[0]

    def is_right(self, found: np.ndarray) -> bool:
        if self.t_target_source is None:
            return False
        if self.is_symmetric:
            wanted, there = (self.source @ m[:3, :3].T + m[:3, 3] for m in (self.t_target_source, found))
            return bool(cKDTree(wanted).query(there)[0].mean() < self.limit)
        difference = found[:3] - self.t_target_source[:3]
        moved = self.source @ difference[:, :3].T + difference[:, 3]
        return bool(np.median(np.linalg.norm(moved, axis=1)) < self.limit)


def box(world: Solids, low, high, kind: int = CUBE) -> None:
    low, high = np.asarray(low, float), np.asarray(high, float)
    world.add(kind, (low + high) / 2, (high - low) / 2)


def column(world: Solids, x: float, y: float, radius: float, height: float) -> None:
    world.add(CYLINDER, [x, y, height / 2], [radius, radius, height / 2])


@cache
def camera(width: int = 128, height: int = 96, degrees: float = 70.0) -> np.ndarray:
    """The rays (R, 3) of a depth camera that looks along x, z up."""
    focal = width / 2 / np.tan(np.radians(degrees / 2))
    y, z = np.meshgrid(np.arange(width) - width / 2 + 0.5, np.arange(height) - height / 2 + 0.5)
    rays = np.column_stack([np.ones(width * height), -y.ravel() / focal, -z.ravel() / focal])
    return rays / np.linalg.norm(rays, axis=1)[:, None]


@cache
def lidar(beams: int = 32, columns: int = 720, low: float = -30.0, high: float = 30.0) -> np.ndarray:
    """The rays (R, 3) of a spinning LiDAR, z up."""
    elevation, azimuth = np.radians(np.linspace(low, high, beams)), np.linspace(0, 2 * np.pi, columns, endpoint=False)
    return directions(elevation, azimuth)


def pose(at: list[float], yaw: float = 0.0, pitch: float = 0.0) -> np.ndarray:
    """A sensor at a position, turned left by `yaw` and down by `pitch` (degrees)."""
    made = np.eye(4)
    made[:3, :3] = about_axis(2, np.radians(yaw)) @ about_axis(1, np.radians(pitch))
    made[:3, 3] = at
    return made


Made = tuple[np.ndarray, np.ndarray, np.ndarray | None, float]


def seen_twice(world: Solids, poses: list[np.ndarray], *sensor, limit: float) -> Made:
    """Two scans with a sensor, which is rays, noise, range and random numbers as `scan` takes them."""
    source, target = (scan(world, t, *sensor) for t in poses)
    return source, target, np.linalg.inv(poses[1]) @ poses[0], limit


def passage(rng: np.random.Generator, is_round: bool, is_lidar: bool) -> Made:
    """A corridor or a round tunnel from two positions along it: its surface leaves the way along it open."""
    world, height = Solids(), rng.uniform(2.2, 3.5)
    if is_round:
        radius = rng.uniform(1.5, 4.0)
        middle = [0, 0, radius - 0.5 * rng.random()]
        world.add(TUNNEL, middle, [radius, radius, 300], about_axis(1, np.pi / 2))
        if rng.random() < 0.5:
            box(world, [-300, -9, -1], [300, 9, 0])
    else:
        width = rng.uniform(1.8, 4.0)
        box(world, [-300, -width / 2, 0], [300, width / 2, height], ROOM)
    turn = rng.uniform(-8, 8) * (rng.random() < 0.5)
    along = rng.uniform(0.2, 3.0)
    poses = [
        pose([0, rng.uniform(-0.3, 0.3), 1.3], 0, 0),
        pose([along, rng.uniform(-0.3, 0.3), 1.3 + rng.uniform(-0.2, 0.2)], turn, 0),
    ]
    if is_lidar:
        beams = [lidar(32, 720, -40, 40), lidar(16, 900, -15, 15), lidar(64, 900, -25, 5)][rng.integers(3)]
        return seen_twice(world, poses, beams, 0.02, rng.choice([20.0, 40.0]), rng, limit=0.15)
    noise, furthest = rng.choice([0, 0.002, 0.01]), rng.choice([6.0, 12.0])
    return seen_twice(world, poses, camera(), noise, furthest, rng, limit=0.15)


def pillars(rng: np.random.Generator) -> Made:
    """A row of equal pillars, between walls or in the open, from positions one or two periods apart."""
    period, size, height = rng.uniform(1.0, 2.5), rng.uniform(0.15, 0.5), rng.uniform(2.0, 5.0)
    at = np.arange(-60, 60) * period
    rows = (-1.0, 1.0) if rng.random() < 0.5 else (1.0,)
    side = rng.uniform(1.5, 3.0)
    world = Solids()
    box(world, [-500, -50, -1], [500, 50, 0])
    is_square = rng.random() < 0.5
    for x, y in itertools.product(at, rows):
        if is_square:
            box(world, [x - size, y * side - size, 0], [x + size, y * side + size, height])
        else:
            column(world, x, y * side, size, height)
    if rng.random() < 0.5:
        box(world, [-500, -side - 1, -0.5], [500, side + 1, height], ROOM)
    # A view of a single pillar does not show that there are others.
    start, yaw = rng.uniform(0, period), rng.choice([0.0, 20.0])
    poses = [pose([start + k * period, 0, 1.4], yaw) for k in (0, rng.integers(1, 3))]
    if rng.random() < 0.5:
        return seen_twice(world, poses, lidar(), 0.02, 25.0, rng, limit=0.15)
    return seen_twice(world, poses, camera(), 0.005, 12.0, rng, limit=0.15)


def shape(rng: np.random.Generator, name: str, count: int) -> np.ndarray:
    """Points on a shape with more than one pose."""
    directions = rng.normal(size=(count, 3))
    if name == "ball":
        return directions / np.linalg.norm(directions, axis=1)[:, None]
    if name == "cube":
        points = rng.uniform(-1, 1, (count, 3))
        points[np.arange(count), rng.integers(0, 3, count)] = rng.choice([-1, 1], count)
        return points
    flat = directions[:, :2] / np.linalg.norm(directions[:, :2], axis=1)[:, None]
    return np.column_stack([flat, rng.uniform(-3, 3, count)])


def moved(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return points @ any_turn(rng).T + rng.uniform(-2, 2, 3)


def symmetric(rng: np.random.Generator, name: str) -> Made:
    count, noise = rng.choice([2000, 5000, 10_000]), rng.choice([0.0, 0.0, 0.01])
    source, target = (shape(rng, name, count) + noise * rng.normal(size=(count, 3)) for _ in range(2))
    return source, moved(target, rng), None, 0.0


class Room(NamedTuple):
    """A room with furniture of 6 to 14 boxes, columns and balls; its size (3,) and the corners (B, 6) of its boxes."""

    world: Solids
    size: np.ndarray
    boxes: np.ndarray


def room(rng: np.random.Generator) -> Room:
    world, size_of_room = Solids(), rng.uniform([4, 3, 2.3], [8, 6, 3.2])
    length, width, _ = size_of_room
    boxes = []
    for _ in range(rng.integers(6, 15)):
        size = rng.uniform([0.25, 0.25, 0.3], [2.0, 1.0, 2.0])
        x, y = rng.uniform([0, 0], [length - size[0], width - size[1]])
        if rng.random() < 0.6:
            y = rng.choice([0.0, width - size[1]])
        boxes.append([x, y, 0, x + size[0], y + size[1], size[2]])
        if rng.random() < 0.5:
            low = size * rng.uniform(0.1, 0.4, 3)
            boxes.append(
                [x + low[0], y + low[1], size[2], x + 0.6 * size[0], y + 0.7 * size[1], size[2] + rng.uniform(0.1, 0.5)]
            )
    for corners in boxes:
        box(world, corners[:3], corners[3:])
    box(world, np.zeros(3), size_of_room, ROOM)
    for _ in range(2):
        x, y = rng.uniform([0.3, 0.3], [length - 0.3, width - 0.3])
        column(world, x, y, rng.uniform(0.05, 0.25), rng.uniform(0.6, 2.3))
    for _ in range(2):
        middle = rng.uniform([0.3, 0.3, 0.2], [length - 0.3, width - 0.3, 1.6])
        world.add(BALL, middle, np.full(3, rng.uniform(0.1, 0.3)))
    return Room(world, size_of_room, np.array(boxes))


def free_position(room: Room, rng: np.random.Generator, height: float) -> np.ndarray:
    """A position in a room at least 0.4 m from its walls and boxes."""
    for _ in range(1000):
        at = np.r_[rng.uniform(0.4, room.size[:2] - 0.4), height]
        if not ((at > room.boxes[:, :3] - 0.4) & (at < room.boxes[:, 3:] + 0.4)).all(axis=1).any():
            break
    return at


def towards(at: np.ndarray, look: np.ndarray) -> np.ndarray:
    x, y, z = look - at
    return pose(at, np.degrees(np.arctan2(y, x)), -np.degrees(np.arctan2(z, np.hypot(x, y))))


def room_views(rng: np.random.Generator) -> Made:
    """Two views of one part of a room, from positions up to 1.5 m apart."""
    made = room(rng)
    first = free_position(made, rng, 1.4)
    others = [free_position(made, rng, rng.uniform(1.2, 1.6)) for _ in range(40)]
    second = next((p for p in others if np.linalg.norm(p - first) < 1.5), first + 0.1)
    corner = [rng.choice([0, 1]), rng.choice([0, 1]), 0.3] * made.size
    poses = [towards(p, corner + rng.uniform(-0.5, 0.5, 3)) for p in (first, second)]
    return seen_twice(made.world, poses, camera(), rng.choice([0.002, 0.004, 0.01]), 10.0, rng, limit=0.1)


def room_view(rng: np.random.Generator) -> np.ndarray:
    made = room(rng)
    at = free_position(made, rng, 1.4)
    return scan(made.world, towards(at, made.size * rng.random(3)), camera(), 0.004, 10.0, rng)


def houses(world: Solids, rng: np.random.Generator, side: int, x: float, sizes: tuple[list, list]) -> None:
    """Houses at a side of a street from x to 100 m; their least and largest length, setback, depth and height."""
    while x < 100:
        length, setback, depth, height = rng.uniform(*sizes)
        y = sorted((side * setback, side * (setback + depth)))
        box(world, [x, y[0], 0], [x + length, y[1], height])
        x += length + rng.uniform(0, 8)


def street(rng: np.random.Generator) -> Solids:
    world = Solids()
    box(world, [-150, -150, -1], [150, 150, 0])
    for side in (-1, 1):
        houses(world, rng, side, -100.0, ([6, 8, 6, 4], [25, 13, 15, 18]))
        for at in rng.uniform(-90, 90, 10):
            y = side * rng.uniform(4, 6.5)
            box(world, [at, y - 0.9, 0], [at + 4.2, y + 0.9, 1.5])
    for x in rng.uniform(-90, 90, 16):
        column(world, x, rng.choice([-7.5, 7.5]), 0.15, 6.0)
    return world


def street_views(rng: np.random.Generator, low: float, high: float) -> Made:
    world, distance = street(rng), rng.uniform(low, high)
    poses = [pose([x, rng.uniform(-2, 2), 1.8], rng.uniform(-180, 180)) for x in (-distance / 2, distance / 2)]
    limit = 0.6 if high < 30 else 2.0
    return seen_twice(world, poses, lidar(40, 720, -25, 5), 0.02, 80.0, rng, limit=limit)


def street_view(rng: np.random.Generator) -> np.ndarray:
    world = street(rng)
    at = pose([0, rng.uniform(-2, 2), 1.8], rng.uniform(-180, 180))
    return scan(world, at, lidar(40, 720, -25, 5), 0.02, 80.0, rng)


@cache
def object_points(folder: Path, split: str) -> np.ndarray:
    return np.load(folder / split / "points.npy", mmap_mode="r")


def an_object(rng: np.random.Generator, folder: Path, split: str) -> np.ndarray:
    """An object of 0.5 to 1.5 m, turned at random."""
    clouds = object_points(folder, split)
    points = np.asarray(clouds[rng.integers(len(clouds))][:4096], float) / 32767.0
    return moved(points * rng.uniform(0.25, 0.75), rng)


def object_parts(rng: np.random.Generator, folder: Path, split: str) -> Made:
    """Two samplings of an object, each without a part."""
    clouds = object_points(folder, split)
    points = rng.permutation(np.asarray(clouds[rng.integers(len(clouds))], float) / 32767.0)
    half, truth = len(points) // 2, np.eye(4)
    parts = []
    for sample in (points[:half], points[half:]):
        height = sample @ any_turn(rng)[0]
        parts.append(sample[height < np.quantile(height, rng.uniform(0.7, 0.95))])
    truth[:3, :3], truth[:3, 3] = any_turn(rng), rng.uniform(-2, 2, 3)
    return parts[0], parts[1] @ truth[:3, :3].T + truth[:3, 3], truth, 0.06


def with_sentinels(made: Made, rng: np.random.Generator) -> Made:
    """The same rays of both clouds have no return, which their sensor writes as a distance."""
    source, target, truth, limit = made
    distance = rng.choice(SENTINELS)
    is_depth = rng.random() < 0.3
    width, high = rng.uniform(0.1, 0.5), rng.uniform(0.2, 1.0)
    azimuth, elevation = rng.uniform(-0.5, 0.5), rng.uniform(-0.3, 0.3)

    def fill(points: np.ndarray) -> np.ndarray:
        lengths = np.linalg.norm(points, axis=1)
        along, up = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(points[:, 2] / lengths)
        lost = (np.abs(along - azimuth) < width) & (np.abs(up - elevation) < high)
        filled, rays = points.copy(), points[lost] / lengths[lost, None]
        filled[lost] = distance * (rays / np.abs(rays[:, :1]) if is_depth else rays)
        return filled.astype("f4")

    return fill(source), fill(target), truth, limit


def kinds(objects: Path | None, split: str) -> dict[str, Callable[[np.random.Generator], Made]]:
    """How each kind is made; kinds with objects need their folder."""

    def absent(source: Callable, target: Callable) -> Callable[[np.random.Generator], Made]:
        def make(rng: np.random.Generator) -> Made:
            clouds = [source(rng), target(rng)]
            return *(clouds if rng.random() < 0.5 else clouds[::-1]), None, 0.0

        return make

    made = {
        "corridor, camera": lambda rng: passage(rng, False, False),
        "corridor, lidar": lambda rng: passage(rng, False, True),
        "tunnel, camera": lambda rng: passage(rng, True, False),
        "tunnel, lidar": lambda rng: passage(rng, True, True),
        "pillars": pillars,
        "ball": lambda rng: symmetric(rng, "ball"),
        "cube": lambda rng: symmetric(rng, "cube"),
        "cylinder": lambda rng: symmetric(rng, "cylinder"),
        "two rooms": absent(room_view, room_view),
        "two streets": absent(street_view, street_view),
        "room and street": absent(room_view, street_view),
        "far along a street": lambda rng: street_views(rng, 60, 100),
        "room with sentinels": lambda rng: with_sentinels(room_views(rng), rng),
        "room": room_views,
        "street": lambda rng: street_views(rng, 3, 12),
    }
    if objects is not None:
        one = lambda rng: an_object(rng, objects, split)
        made |= {
            "object and room": absent(one, room_view),
            "object and street": absent(one, street_view),
            "two objects": absent(one, one),
            "object": lambda rng: object_parts(rng, objects, split),
        }
    return made


def pairs(
    count: int, seed: int, objects: Path | None, split: str, only: list[str] | None = None
) -> list[Callable[[], VerdictPair]]:
    """`count` pairs of each kind, made when called."""
    made = kinds(objects, split)

    def make(name: str, index: int) -> VerdictPair:
        number = list(made).index(name)
        source, target, truth, limit = made[name](np.random.default_rng([seed, number, index]))
        return VerdictPair(
            f"{name} {seed}/{index}", source.astype("f4"), target.astype("f4"), truth, limit, name == "object"
        )

    return [lambda name=name, index=index: make(name, index) for name in (only or made) for index in range(count)]
