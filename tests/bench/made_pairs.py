"""Pairs of made scans with the transforms that are right: scenes that repeat, slide, turn or changed, and plain ones.

A scan is in its sensor's frame. All lengths are metres. The kinds of HELD_OUT chose no constant: they only measure.
"""

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from snake_training.data.solids import CUBE, CYLINDER, Solids, about_axis, directions, scan

HELD_OUT = "rotunda", "stadium", "desks", "lobby"
SIZE = 6.0, 5.0, 2.8  # of a furnished room


class Pair(NamedTuple):
    """Two clouds (N, 3) and the right transforms (4, 4); one is right within `degrees` and `metres`."""

    source: np.ndarray
    target: np.ndarray
    right: list[np.ndarray]
    degrees: float = 5.0
    metres: float = 0.3

    def is_right(self, transform: np.ndarray) -> bool:
        near = (errors(transform, wanted) for wanted in self.right)
        return any(degrees < self.degrees and metres < self.metres for degrees, metres in near)


def errors(transform: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Degrees between the rotations and metres between the translations."""
    cosine = (np.trace(transform[:3, :3].T @ truth[:3, :3]) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), float(np.linalg.norm(transform[:3, 3] - truth[:3, 3]))


def yaw(degrees: float) -> np.ndarray:
    return about_axis(2, np.radians(degrees))


def pose(at, degrees: float = 0.0) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = yaw(degrees), at
    return made


def box(world: Solids, middle, size, turn=None) -> None:
    world.add(CUBE, middle, np.asarray(size, float) / 2, turn)


def post(world: Solids, x: float, y: float, bottom: float, height: float, radius: float) -> None:
    world.add(CYLINDER, [x, y, bottom + height / 2], [radius, radius, height / 2])


def open_ground() -> Solids:
    return Solids([(CUBE, np.array([0, 0, -0.1]), np.diag([200, 200, 0.1]), 0.0, False)])


def hall(low, high) -> Solids:
    """Six slabs about a space from `low` to `high`."""
    world, low, high = Solids(), np.asarray(low, float), np.asarray(high, float)
    middle, size = (low + high) / 2, high - low + 0.2
    for axis in range(3):
        for side, beyond in ((low, -0.05), (high, 0.05)):
            slab, at = size.copy(), middle.copy()
            slab[axis], at[axis] = 0.1, side[axis] + beyond
            box(world, at, slab)
    return world


def furniture(world: Solids, rng, count: int) -> None:
    for _ in range(count):
        size = rng.uniform([0.3, 0.3, 0.3], [1.3, 0.8, 1.7])
        x, y = rng.uniform([0.4, 0.4], [SIZE[0] - 0.4, SIZE[1] - 0.4])
        turn = yaw(rng.choice([0.0, 90.0, rng.uniform(0, 90)]))
        if rng.random() < 0.75:
            box(world, [x, y, size[2] / 2], size, turn)
        else:
            post(world, x, y, 0, size[2], size[0] / 2)
        if rng.random() < 0.5:
            box(world, [x, y, size[2] + 0.12], [0.25, 0.3, 0.24], turn)


def furnished(rng, count: int = 14) -> Solids:
    world = hall([0, 0, 0], SIZE)
    furniture(world, rng, count)
    return world


def clear(world: Solids, rng, size=SIZE, height: float = 1.5) -> np.ndarray:
    """A place in a room that no furniture holds."""
    for _ in range(200):
        at = np.array([*rng.uniform([0.6, 0.6], [size[0] - 0.6, size[1] - 0.6]), height])
        if not world.inside(at + 0.3 * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])).any():
            break
    return at


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
    return directions(np.radians(np.linspace(low, high, beams)), np.linspace(0, 2 * np.pi, columns, endpoint=False))


def between(worlds, poses, rays, rng, noise: float, furthest: float, **limits) -> Pair:
    """Scans of two worlds by one sensor."""
    source, target = (scan(w, t, rays, noise, furthest, rng) for w, t in zip(worlds, poses, strict=True))
    return Pair(source, target, [np.linalg.inv(poses[1]) @ poses[0]], **limits)


def twice(world: Solids, *sensor, **limits) -> Pair:
    return between([world, world], *sensor, **limits)


def stairs(rng) -> Pair:
    """Spiral stairs about a column, from two steps."""
    world, rise, turn, radius = Solids(), rng.uniform(0.16, 0.2), rng.choice([15.0, 18.0, 22.5]), rng.uniform(1.4, 2.0)
    post(world, 0, 0, -3, 22, 0.15)
    for k in range(24):
        at = yaw(15 * k) @ [radius + 0.05, 0, 7]
        box(world, at, [0.1, 2.2 * radius * np.tan(np.radians(7.5)), 22], yaw(15 * k))
    for k in range(-10, 80):
        box(world, yaw(turn * k) @ [radius / 2, 0, 0] + [0, 0, rise * k], [radius - 0.3, 0.3, 0.05], yaw(turn * k))
    at = lambda k: pose(yaw(turn * (k + 0.5)) @ [0.6 * radius, 0, 0] + [0, 0, rise * k + 1.5], turn * (k + 0.5))
    return twice(world, [at(30), at(30 + rng.integers(3, 12))], lidar(64, 240, -80, 80), rng, 0.006, 30.0)


def ramp(rng) -> Pair:
    """A helical ramp of a car park between two rings of pillars."""
    world, radius, rise, count = Solids(), rng.uniform(8, 11), rng.uniform(2.7, 3.3), 40
    tilt, along = about_axis(0, np.arctan2(rise, 2 * np.pi * radius)), 2 * np.pi * radius / count
    for k in range(-count, 2 * count):
        turn, z = yaw(360 * k / count), rise * k / count
        box(world, turn @ [radius, 0, 0] + [0, 0, z - 0.1], [5, 1.35 * along, 0.2], turn @ tilt)
        for side in (-2.5, 2.5):
            at = turn @ [radius + side, 0, 0] + [0, 0, z + 0.4]
            box(world, at, [0.15, 1.15 * along * (radius + side) / radius, 0.9], turn @ tilt)
    number = rng.choice([8, 12])
    for k, side in itertools.product(range(number), (-2.8, 2.8)):
        x, y, _ = yaw(360 * k / number) @ [radius + side, 0, 0]
        post(world, x, y, -8, 20, 0.25)
    at = lambda degrees: pose(yaw(degrees) @ [radius, 0, 0] + [0, 0, rise * degrees / 360 + 1.3], degrees)
    return twice(world, [at(10), at(10 + rng.uniform(20, 70))], lidar(32, 400, -30, 30), rng, 0.01, 40.0)


def stairwell(rng) -> Pair:
    """A stairwell of equal storeys, two flights each, some with different boxes on the walls."""
    width, depth, storey, steps = 2.6, 5.0, rng.uniform(2.8, 3.2), 9
    world, rise = hall([0, 0, -2 * storey], [width, depth, 5 * storey]), storey / 2 / steps
    for flight in range(-4, 10):
        is_second, z = flight % 2, flight * storey / 2
        box(world, [width / 2, depth - 0.6 if is_second else 0.6, z - 0.08], [width, 1.2, 0.16])
        for k in range(steps):
            x, y = (3 * width / 4, depth - 1.35 - 0.29 * k) if is_second else (width / 4, 1.35 + 0.29 * k)
            box(world, [x, y, z + rise * (k + 0.5)], [width / 2 - 0.1, 0.29, rise])
    if rng.random() < 0.5:
        for _ in range(30):
            side, size = rng.choice([0.0, width]), rng.uniform(0.15, 0.6, 3)
            box(world, [side, rng.uniform(0.3, depth - 0.3), rng.uniform(-storey, 4 * storey)], size)
    at = lambda floor: pose([width / 2 + rng.uniform(-0.6, 0.6), 0.6, floor * storey + 1.4], rng.uniform(0, 360))
    other = at(2)
    if rng.random() < 0.5:
        other = pose([width / 2, depth - 0.6, 1.5 * storey + 1.4], rng.uniform(0, 360))
    return twice(world, [at(1), other], lidar(64, 240, -80, 80), rng, 0.006, 30.0)


def motorway(rng) -> Pair:
    """Vehicles that keep pace with the sensor on a motorway with posts at its sides, which stand still."""
    still, by = Solids(), rng.uniform(8, 25)
    box(still, [0, 0, -0.1], [600, 120, 0.2])
    for side in (-11, 11):
        box(still, [0, side, 0.4], [600, 0.2, 0.8])
    for _ in range(40):
        post(still, rng.uniform(-70, 95), rng.choice([-12.5, 12.5]), 0, 6, 0.12)
    before, after = Solids(still.rows), Solids(still.rows)
    while len(before.rows) < len(still.rows) + 10:
        x, y, length = rng.uniform(-45, 55), rng.choice([-5.2, -1.8, 1.8, 5.2]), rng.choice([4.5, 12.0])
        if abs(x) >= length / 2 + 4 or abs(y + 1.8) >= 2:
            size = [length, 1.8, 1.5] if length < 5 else [length, 2.5, 3.8]
            box(before, [x, y, size[2] / 2], size)
            box(after, [x + by + 0.5 * rng.normal(), y, size[2] / 2], size)
    poses = [pose([0, -1.8, 1.9]), pose([by, -1.8, 1.9])]
    return between([before, after], poses, lidar(32, 700, -25, 10), rng, 0.015, 90.0, metres=1.0)


def slope(rng) -> Pair:
    """A slope with rocks of which one half slid as a block; the pose of either half is right."""
    tilt, by = about_axis(1, np.radians(rng.uniform(15, 30))), rng.choice([1.5, 3.0])
    still, slid, move = Solids(), Solids(), np.array([by, 0, -0.1 * by])
    for world, shift in ((still, 0 * move), (slid, move)):
        box(world, [0, -40, -0.5], [160, 80, 1.0])
        box(world, [0, 40, -0.5] + shift, [160, 80, 1.0])
    for _ in range(260):
        x, y = rng.uniform(-40, 40, 2)
        size, turn = rng.uniform(0.4, 2.2, 3), yaw(rng.uniform(0, 90)) @ about_axis(0, rng.uniform(-0.4, 0.4))
        box(still, [x, y, 0.2], size, turn)
        box(slid, [x, y, 0.2] + (y > 0) * move, size, turn)
    tilted = lambda world: Solids((k, tilt @ c, tilt @ a, f, m) for k, c, a, f, m in world.rows)
    at = lambda x, y: pose(tilt @ [x, y, 6.0], rng.uniform(0, 360))
    poses = [at(-8, rng.uniform(-3, 3)), at(4, rng.uniform(-3, 3))]
    made = between([tilted(still), tilted(slid)], poses, lidar(48, 500, -60, 30), rng, 0.01, 60.0, metres=0.5)
    return made._replace(right=[*made.right, np.linalg.inv(poses[1]) @ pose(tilt @ move) @ poses[0]])


def fence(rng) -> Pair:
    """A fence of equal posts and rails on open ground."""
    world, period, y = open_ground(), rng.uniform(1.5, 3.0), rng.uniform(4, 7)
    for k in range(-60, 60):
        box(world, [period * k, y, 0.75], [0.15, 0.15, 1.5])
    for z in (0.5, 1.2):
        box(world, [0, y + 0.1, z], [200, 0.04, 0.12])
    other = pose([rng.uniform(0.7, 2.3) * period, rng.uniform(-0.5, 0.5), 1.7], rng.uniform(-20, 20))
    return twice(world, [pose([0, 0, 1.7]), other], lidar(32, 900, -25, 15), rng, 0.01, 40.0)


def changed(rng) -> Pair:
    """A room in which half of the furniture is new."""
    rows = furnished(rng, count=7).rows
    worlds = [Solids(rows), Solids(rows)]
    for world in worlds:
        furniture(world, rng, 7)
    poses = [pose(clear(world, rng), rng.uniform(0, 360)) for world in worlds]
    return between(worlds, poses, lidar(48, 400, -60, 60), rng, 0.005, 30.0)


def room(rng) -> Pair:
    world = furnished(rng)
    poses = [pose(clear(world, rng), rng.uniform(0, 360)) for _ in range(2)]
    return twice(world, poses, lidar(48, 400, -60, 60), rng, 0.005, 30.0)


def camera_room(rng, size: tuple = (128, 96), noise: float = 0.004) -> Pair:
    """Two views of a depth camera with about the same direction."""
    world, turn = furnished(rng), rng.uniform(0, 360)
    first = clear(world, rng)
    second = next((p for p in (clear(world, rng) for _ in range(40)) if np.linalg.norm(p - first) < 1.2), first)
    poses = [pose(first, turn), pose(second, turn + rng.uniform(-12, 12))]
    return twice(world, poses, camera(*size), rng, noise, 10.0)


def houses(rng, length: float = 120.0) -> Solids:
    """A street along x between houses, with cars and posts."""
    world = open_ground()
    for side in (-1, 1):
        x = -length / 2
        while x < length / 2:
            w, d, h = rng.uniform([6, 6, 5], [14, 10, 14])
            box(world, [x + w / 2, side * (9 + rng.uniform(0, 2) + d / 2), h / 2], [w, d, h])
            x += w + rng.uniform(0, 4)
        for _ in range(6):
            box(world, [rng.uniform(-length / 3, length / 3), side * rng.uniform(5, 6), 0.75], [4.2, 1.8, 1.5])
            post(world, rng.uniform(-length / 3, length / 3), 7.5 * side, 0, 6, 0.12)
    return world


def street(rng, low: float = 4.0, high: float = 12.0, metres: float = 0.6) -> Pair:
    """Two sweeps along a street, from `low` to `high` apart."""
    apart = rng.uniform(low, high)
    world = houses(rng, 120.0 + apart)
    poses = [pose([x, rng.uniform(-2, 2), 1.8], rng.uniform(0, 360)) for x in (-apart / 2, apart / 2)]
    return twice(world, poses, lidar(32, 700, -25, 12), rng, 0.015, 60.0, metres=metres)


def rotunda(rng) -> Pair:
    """A round hall whose columns stand at equal angles."""
    world, number, radius = hall([-20, -20, 0], [20, 20, 6]), rng.integers(6, 13), rng.uniform(5, 8)
    for k in range(48):
        size = [0.2, 2.1 * (radius + 2) * np.tan(np.radians(3.75)), 6]
        box(world, yaw(7.5 * k) @ [radius + 2, 0, 3], size, yaw(7.5 * k))
    for k in range(number):
        x, y, _ = yaw(360 * k / number) @ [radius, 0, 0]
        post(world, x, y, 0, 6, 0.35)
    poses = [pose([*rng.uniform(-0.5, 0.5, 2) * radius, 1.6], rng.uniform(0, 360)) for _ in range(2)]
    return twice(world, poses, lidar(48, 500, -50, 50), rng, 0.01, 40.0)


def stadium(rng) -> Pair:
    """Tiers of seats in an arc: rows repeat up the slope, seats along the arc."""
    world, rise, tread, radius = Solids(), 0.4, 0.8, rng.uniform(18, 26)
    angle = np.degrees(0.6 / radius)
    for row in range(14):
        along = radius + tread * row
        for k in range(-36, 37, 4):
            box(world, yaw(k) @ [along, 0, rise * row - 1], [tread, along * np.radians(4.2), 2], yaw(k))
        for k in range(-25, 26):
            box(world, yaw(k * angle) @ [along, 0, rise * row + 0.2], [0.4, 0.42, 0.4], yaw(k * angle))
    at = lambda row, k: pose(yaw(k * angle) @ [radius + tread * row, 0, rise * row + 1.2], k * angle)
    poses = [at(5, 0), at(5 + rng.integers(0, 3), rng.integers(2, 8))]
    return twice(world, poses, lidar(40, 500, -50, 20), rng, 0.01, 25.0)


def desks(rng) -> Pair:
    """A hall with a grid of equal desks and chairs."""
    size, step = [rng.uniform(12, 16), rng.uniform(9, 12), 3.0], rng.uniform([1.8, 1.5], [2.4, 2.0])
    world = hall([0, 0, 0], size)
    for x, y in itertools.product(np.arange(1.5, size[0] - 1, step[0]), np.arange(1.2, size[1] - 1, step[1])):
        box(world, [x, y, 0.72], [0.7, 1.2, 0.05])
        box(world, [x - 0.3, y, 0.36], [0.05, 1.1, 0.7])
        box(world, [x + 0.7, y, 0.45], [0.42, 0.42, 0.06])
        box(world, [x + 0.9, y, 0.7], [0.06, 0.42, 0.5])
    at = lambda: pose([rng.uniform(3, size[0] - 3), rng.uniform(3, size[1] - 3), 1.6], rng.uniform(0, 360))
    return twice(world, [at(), at()], lidar(48, 500, -60, 40), rng, 0.008, 30.0)


def lobby(rng) -> Pair:
    """A lobby that looks the same after half a turn, but for a few small things."""
    size = np.array([10.0, 7.0, 3.2])
    world, middle = hall([0, 0, 0], size), [5, 3.5, 0]
    for _ in range(6):
        half = rng.uniform([0.4, 0.4, 0.5], [1.5, 1.0, 2.2])
        at = np.array([*rng.uniform([1, -3], [4.6, 3]), 0])
        for sign in (-1, 1):
            box(world, middle + sign * at + [0, 0, half[2] / 2], half)
    for _ in range(rng.integers(0, 4)):
        box(world, middle + np.array([*rng.uniform(-3, 3, 2), 0.25]), rng.uniform(0.3, 0.6, 3))
    poses = [pose(clear(world, rng, size), rng.uniform(0, 360)) for _ in range(2)]
    return twice(world, poses, lidar(48, 400, -60, 60), rng, 0.006, 30.0)


def corners(rng) -> Pair:
    """Opposite corners of a bare room, seen by a depth camera in its middle."""
    size = rng.uniform([5, 4, 2.5], [8, 6, 3])
    look = np.degrees(np.arctan2(size[1], size[0])) + rng.uniform(-5, 5)
    at = lambda: [*(size[:2] / 2 + rng.uniform(-0.3, 0.3, 2)), 1.0]
    return twice(hall([0, 0, 0], size), [pose(at(), look), pose(at(), look + 180)], camera(), rng, 0.004, 10.0)


def house(rng) -> Pair:
    """A plain house from two corners, next to each other or opposite."""
    world, size, degrees = open_ground(), rng.uniform([10, 6, 5], [14, 8, 7]), rng.uniform(37, 53)
    box(world, [0, 0, size[2] / 2], size)
    corner = lambda degrees: pose(yaw(degrees) @ [rng.uniform(12.5, 15.5), 0, 1.7], rng.uniform(0, 360))
    poses = [corner(degrees), corner(degrees + rng.choice([90, 180]))]
    return twice(world, poses, lidar(75, 400, -40, 35), rng, 0.005, 25.0)


def apart(rng, *kinds) -> Pair:
    """Two scans of two worlds: no transform is right."""
    return Pair(*(kind(rng).source for kind in kinds), [])


NAMED = stairs, ramp, stairwell, motorway, slope, fence, changed, room, camera_room, street
NAMED += rotunda, stadium, desks, lobby
KINDS = {make.__name__: make for make in NAMED} | {
    "two rooms": lambda rng: apart(rng, camera_room, camera_room),
    "two streets": lambda rng: apart(rng, street, street),
    "room and street": lambda rng: apart(rng, camera_room, street),
    "far along a street": lambda rng: street(rng, 60, 100, metres=2.0),
    "corners": corners,
    "house": house,
}


def make(kind: str, seed: int) -> Pair:
    made = KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))
    return made._replace(source=made.source.astype("f4"), target=made.target.astype("f4"))
