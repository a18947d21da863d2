"""Pairs of made scans whose surroundings look alike elsewhere, or that moved in part, with the transforms that are right.

A scan is in its sensor's frame. All lengths are metres. The kinds of HELD_OUT chose no constant: they only measure.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from verdict_pairs import camera, lidar

from snake_training.data.solids import CUBE, CYLINDER, Solids, about_axis

HELD_OUT = (
    "trees",
    "rotunda",
    "stadium",
    "terrace",
    "station",
    "forest",
    "bridge",
    "desks",
    "lobby",
    "silo",
    "carriage",
)


class AlikePair(NamedTuple):
    """Two clouds (N, 3) and the right transforms (4, 4); one is right within `degrees` and `metres`."""

    source: np.ndarray
    target: np.ndarray
    right: list[np.ndarray]
    degrees: float
    metres: float

    def is_right(self, found: np.ndarray) -> bool:
        def is_near(wanted: np.ndarray) -> bool:
            error = found @ np.linalg.inv(wanted)
            angle = np.degrees(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)))
            return angle < self.degrees and np.linalg.norm(found[:3, 3] - wanted[:3, 3]) < self.metres

        return any(is_near(wanted) for wanted in self.right)


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


def ground(world: Solids, size: float = 400.0) -> None:
    box(world, [0, 0, -0.1], [size, size, 0.2])


def hall(world: Solids, low, high) -> None:
    """Six slabs about a space from `low` to `high`."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    middle, size = (low + high) / 2, high - low + 0.2
    for axis in range(3):
        for side in (low, high):
            slab, at = size.copy(), middle.copy()
            slab[axis], at[axis] = 0.1, side[axis] + (0.05 if side is high else -0.05)
            box(world, at, slab)


def furniture(world: Solids, rng, size, count: int) -> None:
    for _ in range(count):
        half = rng.uniform([0.3, 0.3, 0.3], [1.3, 0.8, 1.7])
        x, y = rng.uniform([0.4, 0.4], [size[0] - 0.4, size[1] - 0.4])
        turn = yaw(rng.choice([0.0, 90.0, rng.uniform(0, 90)]))
        if rng.random() < 0.75:
            box(world, [x, y, half[2] / 2], half, turn)
        else:
            post(world, x, y, 0, half[2], half[0] / 2)
        if rng.random() < 0.5:
            box(world, [x, y, half[2] + 0.12], [0.25, 0.3, 0.24], turn)


def seen(world: Solids, t: np.ndarray, rays: np.ndarray, rng, noise: float, most: float) -> np.ndarray:
    """What a sensor sees, in its frame (N, 3)."""
    found, _, _ = world.about(t[:3, 3], most).cast(np.tile(t[:3, 3], (len(rays), 1)), rays @ t[:3, :3].T)
    hit = found < most
    return rays[hit] * (found[hit] + noise * rng.normal(size=hit.sum()))[:, None]


def between(
    worlds, poses, rays, rng, noise: float, most: float, degrees: float = 5.0, metres: float = 0.3
) -> AlikePair:
    source, target = (seen(w, t, rays, rng, noise, most) for w, t in zip(worlds, poses, strict=True))
    return AlikePair(source, target, [np.linalg.inv(poses[1]) @ poses[0]], degrees, metres)


def twice(world: Solids, poses, rays, rng, noise: float, most: float, **limits) -> AlikePair:
    return between([world, world], poses, rays, rng, noise, most, **limits)


def stairs(rng) -> AlikePair:
    """Spiral stairs about a column, from two steps."""
    world, rise, turn, radius = Solids(), rng.uniform(0.16, 0.2), rng.choice([15.0, 18.0, 22.5]), rng.uniform(1.4, 2.0)
    post(world, 0, 0, -3, 22, 0.15)
    for k in range(24):
        at = yaw(15 * k) @ [radius + 0.05, 0, 7]
        box(world, at, [0.1, 2.2 * radius * np.tan(np.radians(7.5)), 22], yaw(15 * k))
    for k in range(-10, 80):
        box(world, yaw(turn * k) @ [radius / 2, 0, 0] + [0, 0, rise * k], [radius - 0.3, 0.3, 0.05], yaw(turn * k))
    first = 30
    at = lambda k: pose(yaw(turn * (k + 0.5)) @ [0.6 * radius, 0, 0] + [0, 0, rise * k + 1.5], turn * (k + 0.5))
    return twice(world, [at(first), at(first + rng.integers(3, 12))], lidar(64, 240, -80, 80), rng, 0.006, 30.0)


def ramp(rng) -> AlikePair:
    """A helical ramp of a car park between two rings of pillars."""
    world, radius, rise, count = Solids(), rng.uniform(8, 11), rng.uniform(2.7, 3.3), 40
    tilt = about_axis(0, np.arctan2(rise, 2 * np.pi * radius))
    for k in range(-count, 2 * count):
        turn = yaw(360 * k / count)
        along, z = 2 * np.pi * radius / count, rise * k / count
        box(world, turn @ [radius, 0, 0] + [0, 0, z - 0.1], [5, 1.35 * along, 0.2], turn @ tilt)
        for side in (-2.5, 2.5):
            at = turn @ [radius + side, 0, 0] + [0, 0, z + 0.4]
            box(world, at, [0.15, 1.15 * along * (radius + side) / radius, 0.9], turn @ tilt)
    number = rng.choice([8, 12])
    for k in range(number):
        for side in (-2.8, 2.8):
            x, y, _ = yaw(360 * k / number) @ [radius + side, 0, 0]
            post(world, x, y, -8, 20, 0.25)
    at = lambda degrees: pose(yaw(degrees) @ [radius, 0, 0] + [0, 0, rise * degrees / 360 + 1.3], degrees)
    return twice(world, [at(10), at(10 + rng.uniform(20, 70))], lidar(32, 400, -30, 30), rng, 0.01, 40.0)


def stairwell(rng) -> AlikePair:
    """A stairwell of equal storeys, two flights each, some with different boxes on the walls."""
    world, width, depth, storey, steps = Solids(), 2.6, 5.0, rng.uniform(2.8, 3.2), 9
    hall(world, [0, 0, -2 * storey], [width, depth, 5 * storey])
    rise = storey / 2 / steps
    for floor in range(-2, 5):
        for half in range(2):
            z = floor * storey + half * storey / 2
            box(world, [width / 2, depth - 0.6 if half else 0.6, z - 0.08], [width, 1.2, 0.16])
            for k in range(steps):
                y = 1.35 + 0.29 * k
                x = width / 4 if half == 0 else 3 * width / 4
                box(world, [x, y if half == 0 else depth - y, z + rise * (k + 0.5)], [width / 2 - 0.1, 0.29, rise])
    if rng.random() < 0.5:
        for _ in range(30):
            side, size = rng.choice([0.0, width]), rng.uniform(0.15, 0.6, 3)
            box(world, [side, rng.uniform(0.3, depth - 0.3), rng.uniform(-storey, 4 * storey)], size)
    at = lambda floor: pose([width / 2 + rng.uniform(-0.6, 0.6), 0.6, floor * storey + 1.4], rng.uniform(0, 360))
    other = at(2)
    if rng.random() < 0.5:
        other = pose([width / 2, depth - 0.6, 1.5 * storey + 1.4], rng.uniform(0, 360))
    return twice(world, [at(1), other], lidar(64, 240, -80, 80), rng, 0.006, 30.0)


def motorway(rng) -> AlikePair:
    """Vehicles that keep pace with the sensor on a motorway with posts at its sides, which stand still."""
    still, by = Solids(), rng.uniform(8, 25)
    box(still, [0, 0, -0.1], [600, 120, 0.2])
    for side in (-11, 11):
        box(still, [0, side, 0.4], [600, 0.2, 0.8])
    for _ in range(40):
        post(still, rng.uniform(-70, 95), rng.choice([-12.5, 12.5]), 0, 6, 0.12)
    before, after = Solids(still.rows), Solids(still.rows)
    count = 0
    while count < 10:
        x, y, length = rng.uniform(-45, 55), rng.choice([-5.2, -1.8, 1.8, 5.2]), rng.choice([4.5, 12.0])
        if abs(x) < length / 2 + 4 and abs(y + 1.8) < 2:
            continue
        size = [length, 1.8 if length < 5 else 2.5, 1.5 if length < 5 else 3.8]
        box(before, [x, y, size[2] / 2], size)
        box(after, [x + by + 0.5 * rng.normal(), y, size[2] / 2], size)
        count += 1
    poses = [pose([0, -1.8, 1.9]), pose([by, -1.8, 1.9])]
    return between([before, after], poses, lidar(32, 700, -25, 10), rng, 0.015, 90.0, metres=1.0)


def slope(rng) -> AlikePair:
    """A slope with rocks of which one half slid as a block; the pose of either half is right."""
    tilt, by = about_axis(1, np.radians(rng.uniform(15, 30))), rng.choice([1.5, 3.0])
    still, slid = Solids(), Solids()
    for world, move in ((still, 0.0), (slid, by)):
        box(world, [0, -40, -0.5], [160, 80, 1.0])
        box(world, [move, 40, -0.5 - 0.1 * move], [160, 80, 1.0])
    for _ in range(260):
        x, y = rng.uniform(-40, 40, 2)
        size, turn = rng.uniform(0.4, 2.2, 3), yaw(rng.uniform(0, 90)) @ about_axis(0, rng.uniform(-0.4, 0.4))
        box(still, [x, y, 0.2], size, turn)
        box(slid, [x + (by if y > 0 else 0), y, 0.2 - (0.1 * by if y > 0 else 0)], size, turn)
    turned = lambda world: Solids((k, tilt @ c, tilt @ a, f, m) for k, c, a, f, m in world.rows)
    at = lambda x, y: pose(tilt @ [x, y, 6.0], rng.uniform(0, 360))
    poses, rays = [at(-8, rng.uniform(-3, 3)), at(4, rng.uniform(-3, 3))], lidar(48, 500, -60, 30)
    made = between([turned(still), turned(slid)], poses, rays, rng, 0.01, 60.0, metres=0.5)
    move = np.eye(4)
    move[:3, 3] = tilt @ [by, 0, -0.1 * by]
    return made._replace(right=[*made.right, np.linalg.inv(poses[1]) @ move @ poses[0]])


def fence(rng) -> AlikePair:
    """A fence of equal posts and rails on open ground."""
    world, period, y = Solids(), rng.uniform(1.5, 3.0), rng.uniform(4, 7)
    ground(world)
    for k in range(-60, 60):
        box(world, [period * k, y, 0.75], [0.15, 0.15, 1.5])
    for z in (0.5, 1.2):
        box(world, [0, y + 0.1, z], [200, 0.04, 0.12])
    poses = [
        pose([0, 0, 1.7]),
        pose([rng.uniform(0.7, 2.3) * period, rng.uniform(-0.5, 0.5), 1.7], rng.uniform(-20, 20)),
    ]
    return twice(world, poses, lidar(32, 900, -25, 15), rng, 0.01, 40.0)


def facade(rng) -> AlikePair:
    """A wall with equal windows, ground before it."""
    world, period, far = Solids(), rng.uniform(1.4, 3.0), rng.uniform(7, 11)
    ground(world)
    box(world, [0, far, 6], [80, 0.3, 12])
    for x in np.arange(-39, 40, period):
        for z in (2, 5, 8):
            box(world, [x, far - 0.2, z], [0.6 * period, 0.3, 1.5])
    poses = [pose([0, 0, 1.4]), pose([rng.uniform(0.7, 2.3) * period, rng.uniform(-0.5, 0.5), 1.4])]
    return twice(world, poses, lidar(48, 500, -45, 45), rng, 0.008, 16.0)


def rack(rng) -> AlikePair:
    """An aisle between racks with equal bays, most of them filled alike."""
    world, bay, level = Solids(), rng.uniform(2.0, 2.8), 1.8
    box(world, [0, 0, -0.1], [80, 20, 0.2])
    filled = rng.choice([0.0, 1.0])
    for side in (-1, 1):
        for k in range(-14, 15):
            box(world, [bay * k, 1.6 * side, 3], [0.1, 0.1, 6])
            for z in range(3):
                if rng.random() < filled:
                    box(world, [bay * (k + 0.5), 2.1 * side, level * z + 0.55], [0.8 * bay, 0.9, 1.0])
        for z in range(3):
            box(world, [0, 2.1 * side, level * z], [28 * bay, 1.1, 0.1])
    poses = [pose([0.4 * bay, 0, 1.5]), pose([(0.4 + rng.uniform(0.8, 2.2)) * bay, rng.uniform(-0.3, 0.3), 1.5])]
    return twice(world, poses, lidar(48, 600, -40, 40), rng, 0.01, 20.0)


ROOM = (6.0, 5.0, 2.8)


def furnished(rng, size=ROOM, count: int = 14) -> Solids:
    world = Solids()
    hall(world, [0, 0, 0], size)
    furniture(world, rng, size, count)
    return world


def clear(world: Solids, rng, size, height: float = 1.5) -> np.ndarray:
    """A place in a room that no furniture holds."""
    for _ in range(200):
        at = np.array([*rng.uniform([0.6, 0.6], [size[0] - 0.6, size[1] - 0.6]), height])
        if not world.inside(at + 0.3 * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])).any():
            break
    return at


def room(rng) -> AlikePair:
    world = furnished(rng)
    poses = [pose(clear(world, rng, ROOM), rng.uniform(0, 360)) for _ in range(2)]
    return twice(world, poses, lidar(48, 400, -60, 60), rng, 0.005, 30.0)


def camera_room(rng) -> AlikePair:
    """Two views of a depth camera with about the same direction."""
    world, turn = furnished(rng), rng.uniform(0, 360)
    first = clear(world, rng, ROOM)
    second = next((p for p in (clear(world, rng, ROOM) for _ in range(40)) if np.linalg.norm(p - first) < 1.2), first)
    poses = [pose(first, turn), pose(second, turn + rng.uniform(-12, 12))]
    return twice(world, poses, camera(), rng, 0.004, 10.0)


def changed(rng) -> AlikePair:
    """A room in which half of the furniture is new."""
    same, size = furnished(rng, count=7), ROOM
    worlds = [Solids(same.rows), Solids(same.rows)]
    for world in worlds:
        furniture(world, rng, size, 7)
    poses = [pose(clear(world, rng, size), rng.uniform(0, 360)) for world in worlds]
    return between(worlds, poses, lidar(48, 400, -60, 60), rng, 0.005, 30.0)


def mirrored(rng) -> AlikePair:
    """A room of which one scan has a flipped axis: no transform is right."""
    made = room(rng)
    flip = np.ones(3)
    flip[rng.integers(3)] = -1
    return made._replace(target=made.target * flip, right=[])


def houses(world: Solids, rng, length: float = 120.0) -> None:
    ground(world)
    for side in (-1, 1):
        x = -length / 2
        while x < length / 2:
            w, d, h = rng.uniform([6, 6, 5], [14, 10, 14])
            box(world, [x + w / 2, side * (9 + rng.uniform(0, 2) + d / 2), h / 2], [w, d, h])
            x += w + rng.uniform(0, 4)
        for _ in range(6):
            box(world, [rng.uniform(-length / 3, length / 3), side * rng.uniform(5, 6), 0.75], [4.2, 1.8, 1.5])
            post(world, rng.uniform(-length / 3, length / 3), 7.5 * side, 0, 6, 0.12)


def street(rng) -> AlikePair:
    world = Solids()
    houses(world, rng)
    poses = [pose([x, rng.uniform(-2, 2), 1.8], rng.uniform(0, 360)) for x in (0, rng.uniform(4, 12))]
    return twice(world, poses, lidar(32, 700, -25, 12), rng, 0.015, 60.0, metres=0.6)


def boxes(rng) -> AlikePair:
    """A heap of boxes without surroundings, sampled on two overlapping parts."""
    heap = Solids()
    for _ in range(12):
        turn = yaw(rng.uniform(0, 90)) @ about_axis(0, rng.uniform(0, 1.5))
        box(heap, rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 0.6]), rng.uniform(0.15, 0.6, 3), turn)
    points = heap.surface(np.zeros(3), 3.0, 4000.0, rng)
    direction = np.append(rng.normal(size=2), 0.0)
    height = points @ direction / np.linalg.norm(direction) + 0.02 * rng.normal(size=len(points))
    low, high = np.quantile(height, [0.25, 0.75])
    chosen = rng.random(len(points)) < 0.5
    parts = [points[chosen & (height < high)], points[~chosen & (height > low)]]
    t = pose(rng.uniform(-2, 2, 3), rng.uniform(0, 360))
    return AlikePair(parts[0], parts[1] @ t[:3, :3].T + t[:3, 3], [t], 5.0, 0.06)


def trees(rng) -> AlikePair:
    """An avenue of equal trees at equal distances."""
    world, period = Solids(), rng.uniform(5, 8)
    ground(world)
    for k in range(-12, 13):
        for side in (-1, 1):
            post(world, period * k, 4.5 * side, 0, 3, 0.2)
            world.add(1, [period * k, 4.5 * side, 4.2], [1.6, 1.6, 1.8], fuzz=0.0)
    poses = [pose([0, 0, 1.8], rng.uniform(0, 360)), pose([rng.uniform(0.6, 2.4) * period, rng.uniform(-1, 1), 1.8])]
    return twice(world, poses, lidar(32, 700, -25, 30), rng, 0.02, 50.0, metres=0.6)


def rotunda(rng) -> AlikePair:
    """A round hall whose columns stand at equal angles."""
    world, number, radius = Solids(), rng.integers(6, 13), rng.uniform(5, 8)
    box(world, [0, 0, -0.1], [40, 40, 0.2])
    box(world, [0, 0, 6.1], [40, 40, 0.2])
    for k in range(48):
        box(
            world,
            yaw(7.5 * k) @ [radius + 2, 0, 3],
            [0.2, 2.1 * (radius + 2) * np.tan(np.radians(3.75)), 6],
            yaw(7.5 * k),
        )
    for k in range(number):
        x, y, _ = yaw(360 * k / number) @ [radius, 0, 0]
        post(world, x, y, 0, 6, 0.35)
    poses = [pose([*rng.uniform(-0.5, 0.5, 2) * radius, 1.6], rng.uniform(0, 360)) for _ in range(2)]
    return twice(world, poses, lidar(48, 500, -50, 50), rng, 0.01, 40.0)


def stadium(rng) -> AlikePair:
    """Tiers of seats in an arc: rows repeat up the slope, seats along the arc."""
    world, rise, tread, radius = Solids(), 0.4, 0.8, rng.uniform(18, 26)
    angle = np.degrees(0.6 / radius)
    for row in range(14):
        for k in range(-36, 37, 4):
            along = radius + tread * row
            box(world, yaw(k) @ [along, 0, rise * row - 1], [tread, along * np.radians(4.2), 2], yaw(k))
        for k in range(-25, 26):
            at = yaw(k * angle) @ [radius + tread * row, 0, rise * row + 0.2]
            box(world, at, [0.4, 0.42, 0.4], yaw(k * angle))
    at = lambda row, k: pose(yaw(k * angle) @ [radius + tread * row, 0, rise * row + 1.2], k * angle)
    poses = [at(5, 0), at(5 + rng.integers(0, 3), rng.integers(2, 8))]
    return twice(world, poses, lidar(40, 500, -50, 20), rng, 0.01, 25.0)


def terrace(rng) -> AlikePair:
    """A street of equal terraced houses with equal porches."""
    world, width = Solids(), rng.uniform(5, 8)
    ground(world)
    for side in (-1, 1):
        box(world, [0, 12 * side, 4], [160, 8, 8])
        for k in range(-9, 10):
            box(world, [width * (k + 0.3), 7.4 * side, 1.5], [1.6, 1.4, 3.0])
            box(world, [width * (k + 0.7), 7.9 * side, 2.0], [1.4, 0.4, 1.4])
            box(world, [width * k, 6.0 * side, 0.5], [0.2, 3.6, 1.0])
    poses = [pose([0, 0, 1.8]), pose([rng.uniform(0.6, 2.2) * width, rng.uniform(-1, 1), 1.8], rng.uniform(-20, 20))]
    return twice(world, poses, lidar(32, 700, -25, 15), rng, 0.015, 40.0, metres=0.6)


def station(rng) -> AlikePair:
    """A train passes a platform: the sensor stands still on it, or rides on the train."""
    still, by = Solids(), rng.uniform(3, 9)
    ground(still)
    box(still, [0, -4, 0.5], [200, 5, 1.0])
    for _ in range(14):
        post(still, rng.uniform(-50, 50), rng.uniform(-6, -3), 1.0, 3.0, 0.15)
        box(still, [rng.uniform(-50, 50), rng.uniform(-6, -4), 1.3], rng.uniform(0.4, 1.8, 3))
    worlds = [Solids(still.rows), Solids(still.rows)]
    for world, move in zip(worlds, (0.0, by), strict=True):
        for k in range(-3, 4):
            box(world, [18 * k + move, 1.2, 2.4], [17, 2.8, 3.4])
            for door in (-6, 0, 6):
                box(world, [18 * k + door + move, -0.25, 2.0], [1.4, 0.15, 2.0])
    poses = [pose([0, -2.2, 2.6]), pose([rng.uniform(0.5, 2.0), -2.4, 2.6], rng.uniform(-20, 20))]
    return between(worlds, poses, lidar(32, 700, -25, 15), rng, 0.01, 50.0)


def forest(rng) -> AlikePair:
    """Trunks at random on uneven ground: nothing repeats."""
    world = Solids()
    ground(world)
    for x, y in rng.uniform(-40, 40, (220, 2)):
        if np.hypot(x, y) > 1.5 and np.hypot(x - 4, y) > 1.5:
            post(world, x, y, 0, rng.uniform(6, 15), rng.uniform(0.12, 0.35))
    for x, y in rng.uniform(-40, 40, (60, 2)):
        if np.hypot(x, y) > 3 and np.hypot(x - 4, y) > 3:
            box(world, [x, y, 0], rng.uniform(0.5, 2.5, 3), yaw(rng.uniform(0, 90)))
    poses = [pose([0, 0, 1.7], rng.uniform(0, 360)), pose([4 + rng.uniform(-1, 1), rng.uniform(-1, 1), 1.7])]
    return twice(world, poses, lidar(32, 700, -25, 25), rng, 0.015, 45.0)


def still(rng) -> AlikePair:
    """A sensor that stands in a street while one car passes, or in a room in which one thing moved."""
    is_street = rng.random() < 0.5
    worlds = [Solids(), Solids()]
    same = Solids()
    if is_street:
        houses(same, rng)
    else:
        same = furnished(rng)
    t = pose([0, 0, 1.8], 30.0) if is_street else pose(clear(same, rng, ROOM), 30.0)
    for number, world in enumerate(worlds):
        world.rows += same.rows
        if is_street:
            box(world, [8 - 20 * number, 3, 0.75], [4.2, 1.8, 1.5])
        else:
            box(world, [1.5 + 2.5 * number, 2.5, 0.5], [0.6, 0.6, 1.0])
    rays = lidar(32, 700, -25, 12) if is_street else lidar(48, 400, -60, 60)
    return between(worlds, [t, t], rays, rng, 0.01, 60.0)


def bridge(rng) -> AlikePair:
    """A deck between two trusses of equal bays, over water that returns nothing."""
    world, bay, high = Solids(), rng.uniform(4, 7), rng.uniform(4, 6)
    box(world, [0, 0, -0.2], [160, 8, 0.4])
    for side in (-4.2, 4.2):
        box(world, [0, side, high], [160, 0.3, 0.3])
        for k in range(-12, 13):
            box(world, [bay * k, side, high / 2], [0.3, 0.3, high])
            length, lean = np.hypot(bay, high), np.arctan2(high, bay) * (-1) ** k
            box(world, [bay * (k + 0.5), side, high / 2], [length, 0.2, 0.2], about_axis(1, -lean))
    poses = [pose([0, 0, 1.8]), pose([rng.uniform(0.6, 2.4) * bay, rng.uniform(-1, 1), 1.8], rng.uniform(-20, 20))]
    return twice(world, poses, lidar(32, 700, -25, 25), rng, 0.015, 50.0, metres=0.6)


def desks(rng) -> AlikePair:
    """A hall with a grid of equal desks and chairs."""
    world, size, step = Solids(), [rng.uniform(12, 16), rng.uniform(9, 12), 3.0], rng.uniform([1.8, 1.5], [2.4, 2.0])
    hall(world, [0, 0, 0], size)
    for x in np.arange(1.5, size[0] - 1, step[0]):
        for y in np.arange(1.2, size[1] - 1, step[1]):
            box(world, [x, y, 0.72], [0.7, 1.2, 0.05])
            box(world, [x - 0.3, y, 0.36], [0.05, 1.1, 0.7])
            box(world, [x + 0.7, y, 0.45], [0.42, 0.42, 0.06])
            box(world, [x + 0.9, y, 0.7], [0.06, 0.42, 0.5])
    places = [[rng.uniform(3, size[0] - 3), rng.uniform(3, size[1] - 3), 1.6] for _ in range(2)]
    poses = [pose(at, rng.uniform(0, 360)) for at in places]
    return twice(world, poses, lidar(48, 500, -60, 40), rng, 0.008, 30.0)


def lobby(rng) -> AlikePair:
    """A lobby that looks the same after half a turn, but for a few small things."""
    world, size = Solids(), [10.0, 7.0, 3.2]
    hall(world, [-5, -3.5, 0], [5, 3.5, 3.2])
    for _ in range(6):
        half = rng.uniform([0.4, 0.4, 0.5], [1.5, 1.0, 2.2])
        x, y = rng.uniform([1, -3], [4.6, 3])
        for sign in (-1, 1):
            box(world, [sign * x, sign * y, half[2] / 2], half)
    for _ in range(rng.integers(0, 4)):
        box(world, [*rng.uniform(-3, 3, 2), 0.25], rng.uniform(0.3, 0.6, 3))
    poses = [pose(clear(world, rng, size) - [5, 3.5, 0], rng.uniform(0, 360)) for _ in range(2)]
    return twice(world, poses, lidar(48, 400, -60, 60), rng, 0.006, 30.0)


def silo(rng) -> AlikePair:
    """A round shaft with rings at equal heights and one ladder."""
    world, radius, step = Solids(), rng.uniform(2, 3.5), rng.uniform(1.0, 2.0)
    for k in range(36):
        side = 2.1 * radius * np.tan(np.radians(5))
        box(world, yaw(10 * k) @ [radius, 0, 0], [0.1, side, 40], yaw(10 * k))
        for ring in range(-10, 11):
            box(world, yaw(10 * k) @ [radius - 0.15, 0, 0] + [0, 0, ring * step], [0.2, side, 0.15], yaw(10 * k))
    for k in range(-60, 60):
        box(world, [radius - 0.4, 0, 0.3 * k], [0.04, 0.5, 0.04])
    up = rng.uniform(0.6, 2.4) * step
    poses = [pose([*rng.uniform(-0.5, 0.5, 2), z], rng.uniform(0, 360)) for z in (0, up)]
    return twice(world, poses, lidar(64, 240, -80, 80), rng, 0.008, 30.0)


def carriage(rng) -> AlikePair:
    """A train carriage with rows of equal seats and windows."""
    world, pitch = Solids(), rng.uniform(0.85, 1.0)
    hall(world, [-10, -1.4, 0], [10, 1.4, 2.3])
    for k in range(-10, 10):
        for y in (-1.1, -0.6, 0.6, 1.1):
            box(world, [pitch * k, y, 0.45], [0.45, 0.45, 0.1])
            box(world, [pitch * k + 0.25, y, 0.75], [0.1, 0.45, 0.8])
    for k in range(-5, 5):
        for side in (-1, 1):
            box(world, [2 * pitch * k, 1.37 * side, 1.4], [0.3, 0.1, 0.9])
    poses = [pose([0, 0, 1.6]), pose([rng.uniform(0.7, 4.5) * pitch, rng.uniform(-0.2, 0.2), 1.6], rng.uniform(0, 360))]
    return twice(world, poses, lidar(48, 500, -50, 50), rng, 0.006, 20.0)


KINDS: dict[str, Callable[[np.random.Generator], AlikePair]] = {
    make.__name__: make
    for make in (stairs, ramp, stairwell, motorway, slope, fence, facade, rack, mirrored, changed, room, camera_room)
    + (street, boxes, trees, rotunda, stadium, terrace, station, forest, still)
    + (bridge, desks, lobby, silo, carriage)
}


def make(kind: str, seed: int) -> AlikePair:
    made = KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))
    return made._replace(source=made.source.astype("f4"), target=made.target.astype("f4"))
