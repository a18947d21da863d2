"""Made rooms and streets of solids, for crops (`snake_training.data.crops`). Metres; z is up; the floor is near z = 0."""

import numpy as np

from .solids import BALL, CUBE, CYLINDER, Solids, about_axis


def any_turn(rng):
    """A rotation matrix, uniform."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def clutter(rng, size):
    """A thing of one to five solids that meet, standing on z = 0, about `size` high."""
    thing = Solids()
    at = np.zeros(3)
    for _ in range(rng.integers(1, 6)):
        half = size * np.exp(rng.uniform(-1.6, -0.4, 3))
        if rng.random() < 0.4:
            half[:2] = half[:2].mean()
        turn = any_turn(rng) if rng.random() < 0.25 else about_axis(2, rng.uniform(0, np.pi))
        thing.add(rng.choice([CUBE, CUBE, BALL, CYLINDER]), at + (0, 0, half[2] * 0.98), half, turn)
        at = np.array(
            [*(at[:2] + rng.uniform(-1, 1, 2) * half[:2]), (at[2] + 2 * half[2] * 0.97) * (rng.random() < 0.7)]
        )
    return thing


def table_like(rng):
    """A top on legs, at times with a back or a lower board: tables, chairs, benches."""
    thing, (a, b) = Solids(), rng.uniform(0.2, 0.9, 2)
    height, thick, leg = rng.uniform(0.35, 0.95), rng.uniform(0.01, 0.04), rng.uniform(0.012, 0.04)
    thing.add(CUBE, (0, 0, height), (a, b, thick))
    kind = rng.choice([CUBE, CYLINDER])
    if rng.random() < 0.8:
        for x in (-1, 1):
            for y in (-1, 1):
                thing.add(kind, (x * (a - leg), y * (b - leg), height / 2 - 0.01), (leg, leg, height / 2))
    else:
        thing.add(CYLINDER, (0, 0, height / 2 - 0.01), (2 * leg, 2 * leg, height / 2))
        thing.add(CYLINDER, (0, 0, 0.02), (a * 0.6, a * 0.6, 0.02))
    if rng.random() < 0.5:
        back = rng.uniform(0.15, 0.4)
        thing.add(CUBE, (0, b - thick, height + back), (a, thick, back))
    if rng.random() < 0.3:
        thing.add(CUBE, (0, 0, rng.uniform(0.1, height * 0.7)), (a * 0.97, b * 0.97, thick))
    return thing, height + thick


def cabinet(rng):
    """A body with boards, drawers or handles, or an open shelf."""
    thing = Solids()
    a, b, c = rng.uniform((0.2, 0.15, 0.25), (0.8, 0.4, 1.1))
    if rng.random() < 0.5:
        thing.add(CUBE, (0, 0, c - 0.01), (a, b, c))
        for level in np.arange(rng.uniform(0.1, 0.3), 2 * c - 0.1, rng.uniform(0.2, 0.5)):
            thing.add(CUBE, (0, -b, level), (a * 0.95, rng.uniform(0.01, 0.03), rng.uniform(0.05, 0.12)))
            thing.add(CUBE, (rng.uniform(-0.5, 0.5) * a, -b - 0.03, level), (rng.uniform(0.02, 0.1), 0.03, 0.012))
    else:
        wall = rng.uniform(0.01, 0.03)
        for side in (-1, 1):
            thing.add(CUBE, (side * a, 0, c), (wall, b, c))
        thing.add(CUBE, (0, b, c), (a, wall, c))
        for level in np.linspace(wall, 2 * c, rng.integers(2, 7)):
            thing.add(CUBE, (0, 0, level), (a, b, wall))
            for x in rng.uniform(-0.8, 0.8, rng.integers(0, 4)) * a:
                thing.add(CUBE, (x, 0, level + 0.1), (*rng.uniform(0.02, 0.12, 2), rng.uniform(0.05, 0.12)))
    return thing, 2 * c


def sofa(rng):
    """A padded seat with arms and a back, edges rounded by cylinders."""
    thing = Solids()
    a, b, height = rng.uniform((0.4, 0.35, 0.3), (1.1, 0.5, 0.5))
    thing.add(CUBE, (0, 0, height / 2 - 0.01), (a, b, height / 2))
    thing.add(CYLINDER, (0, -b, height - 0.06), (0.06, 0.06, a), about_axis(1, np.pi / 2))
    thing.add(CUBE, (0, b, height), (a, 0.12, height * 0.9))
    for side in (-1, 1):
        thing.add(CUBE, (side * a, 0, height * 0.6), (0.1, b, height * 0.7))
        thing.add(CYLINDER, (side * a, 0, height * 1.3), (0.11, 0.11, b), about_axis(0, np.pi / 2))
    for _ in range(rng.integers(0, 4)):
        thing.add(BALL, (*rng.uniform(-0.8, 0.8, 2) * (a, b), height + 0.08), rng.uniform(0.08, 0.25, 3), any_turn(rng))
    return thing, height


FURNITURE = (table_like, table_like, cabinet, sofa)


def room(rng):
    """A furnished room about the origin: (solids, size (3,))."""
    world, size = Solids(), rng.uniform((2.8, 2.8, 2.2), (7, 7, 3.2))
    x, y, z = size / 2
    for axis in range(3):
        for side in (-1, 1):
            half, at = size / 2 + 0.4, np.array([0, 0, z])
            half[axis], at[axis] = 0.25, at[axis] + side * (size[axis] / 2 + 0.25)
            world.add(CUBE, at, half)
    for _ in range(rng.integers(6, 18)):  # boards, frames, pipes, beams and pillars on the walls
        axis, side = rng.integers(2), rng.choice([-1, 1])
        half = np.exp(rng.uniform(np.log(0.03), np.log(0.7), 3))
        half[axis] = np.exp(rng.uniform(np.log(0.012), np.log(0.2)))
        if rng.random() < 0.25:
            half[rng.choice([1 - axis, 2])] = 4
        at = rng.uniform(-1, 1, 3) * (size / 2 - np.minimum(half, size / 2)) + (0, 0, z)
        at[axis] = side * (size[axis] / 2 - half[axis] * 0.9)
        world.add(CUBE, at, half)
        if rng.random() < 0.4 and half.max() < 1:  # a frame about it: a window or a door
            inner = half * 0.85
            inner[axis] = half[axis] * 1.3
            world.add(CUBE, at, inner)
    stands = [(np.zeros(2), np.array([x, y]) - 0.1, 0.0)]
    for _ in range(rng.integers(5, 14)):
        thing, top = FURNITURE[rng.integers(len(FURNITURE))](rng)
        yaw = rng.choice([0, np.pi / 2, np.pi, -np.pi / 2, rng.uniform(0, 7)])
        position = rng.uniform(-1, 1, 2) * (np.array([x, y]) - 0.4)
        if rng.random() < 0.5:
            axis = rng.integers(2)
            position[axis] = rng.choice([-1, 1]) * (size[axis] / 2 - 0.4)
        world.group(thing, (*position, -0.005), yaw)
        stands.append((position, np.array([0.35, 0.35]), top))
    for _ in range(rng.integers(15, 50)):
        position, half, height = stands[rng.integers(len(stands))]
        thing = clutter(rng, rng.uniform(0.08, 0.35 if height > 0 else 0.9))
        world.group(thing, (*(position + rng.uniform(-1, 1, 2) * half), height - 0.005), rng.uniform(0, 7))
    return world, size


def house(rng, length, depth, height):
    """A building whose front lies on y = 0 and faces -y: windows in a wall, ledges, a roof, an entrance."""
    thing, a = Solids(), length / 2
    deep = rng.uniform(0.1, 0.4)
    thing.add(CUBE, (0, depth / 2 + deep, height / 2 - 0.1), (a, depth / 2, height / 2))
    storey, column = rng.uniform(2.6, 3.6), rng.uniform(1.6, 4.5)
    sill, lintel, width = rng.uniform(0.7, 1.2), rng.uniform(0.3, 0.8), rng.uniform(0.25, 0.6) * column
    if rng.random() < 0.85:
        for level in np.arange(0, height, storey):
            bottom, top = level - lintel, min(level + sill, height)
            thing.add(CUBE, (0, deep / 2, (bottom + top) / 2), (a, deep / 2 + 0.01, (top - bottom) / 2))
        for x in np.arange(-a, a + 0.01, column):
            thing.add(CUBE, (x, deep / 2, height / 2), ((column - width) / 2, deep / 2, height / 2))
    for _ in range(rng.integers(0, 5)):  # ledges, balconies, signs
        half = rng.uniform((0.3, 0.1, 0.05), (min(a, 3), 0.7, 0.6))
        thing.add(CUBE, (rng.uniform(-a, a), -half[1] * 0.9, rng.uniform(0.5, height)), half)
    if rng.random() < 0.6:
        slope = rng.uniform(0.3, 0.8)
        half = depth / 2 / np.cos(slope) + 0.3
        for side in (-1, 1):
            at = (0, depth / 2 + deep + side * depth / 4, height + depth / 4 * np.tan(slope) - 0.2)
            thing.add(CUBE, at, (a + 0.3, half / 2, 0.12), about_axis(0, -side * slope))
    for _ in range(rng.integers(0, 4)):
        thing.add(CUBE, (*rng.uniform((-a, 0.5), (a, depth)), height), rng.uniform(0.2, 1.2, 3))
    if rng.random() < 0.5:
        steps = rng.integers(1, 5)
        for step in range(steps):
            thing.add(CUBE, (0, -0.15 * step, 0.08 * (steps - step)), (1.0, 0.3, 0.09 * (steps - step)))
    return thing


def car(rng):
    """A body, a cabin and wheels along x."""
    thing, (length, width, height) = Solids(), rng.uniform((1.7, 0.8, 0.6), (2.6, 1.0, 0.85))
    thing.add(CUBE, (0, 0, height * 0.9), (length, width, height * 0.55))
    if rng.random() < 0.75:
        thing.add(CUBE, (rng.uniform(-0.4, 0.2), 0, height * 1.7), (length * 0.55, width * 0.9, height * 0.45))
    else:
        thing.add(CUBE, (0.2 * length, 0, height * 2), (length * 0.75, width, height * 0.9))
    for x in (-0.65, 0.65):
        for y in (-1, 1):
            thing.add(CYLINDER, (x * length, y * width * 0.95, 0.32), (0.32, 0.32, 0.1), about_axis(0, np.pi / 2))
    return thing


def tree(rng):
    """A trunk, branches, and a crown that rays go into."""
    thing, height, thick = Solids(), rng.uniform(1.5, 4), rng.uniform(0.06, 0.3)
    tilt = about_axis(0, rng.normal() * 0.06)
    thing.add(CYLINDER, tilt @ (0, 0, height / 2), (thick, thick, height / 2 + 0.4), tilt)
    for _ in range(rng.integers(0, 4)):
        turn = about_axis(2, rng.uniform(0, 7)) @ about_axis(0, rng.uniform(0.4, 1.2))
        thing.add(CYLINDER, np.array([0, 0, height]) + turn @ (0, 0, 0.7), (thick / 3, thick / 3, 0.8), turn)
    for _ in range(rng.integers(0, 6)):
        half = rng.uniform(0.5, 2, 3)
        thing.add(BALL, (*rng.uniform(-1.2, 1.2, 2), height + rng.uniform(0.3, 2.5)), half, fuzz=rng.uniform(0.3, 1))
    return thing


def pole(rng):
    """A mast, at times with an arm, a lamp, a sign or a box."""
    thing, height, thick = Solids(), rng.uniform(1, 7), rng.uniform(0.03, 0.15)
    thing.add(CYLINDER if rng.random() < 0.8 else CUBE, (0, 0, height / 2 - 0.1), (thick, thick, height / 2))
    if rng.random() < 0.4:
        arm = rng.uniform(0.3, 1.2)
        thing.add(CUBE, (arm, 0, height - 0.2), (arm, 0.05, 0.05))
        thing.add(CUBE, (2 * arm, 0, height - 0.25), (0.3, 0.12, 0.08))
    if rng.random() < 0.4:
        thing.add(
            CUBE,
            (0, thick + 0.02, height - rng.uniform(0.2, 0.6)),
            (*rng.uniform(0.15, 0.5, 1), 0.02, rng.uniform(0.15, 0.4)),
        )
    if rng.random() < 0.3:
        thing.add(CUBE, (0, 0, 0.3), (0.2, 0.2, 0.5))
    return thing


def fence(rng):
    """A wall, a hedge or posts with rails, along x."""
    thing, a, height = Solids(), rng.uniform(2, 8), rng.uniform(0.4, 1.1)
    kind = rng.integers(3)
    if kind == 0:
        thing.add(CUBE, (0, 0, height - 0.1), (a, rng.uniform(0.08, 0.25), height))
    elif kind == 1:
        thing.add(CUBE, (0, 0, height - 0.1), (a, rng.uniform(0.3, 0.7), height), fuzz=0.2)
    else:
        for x in np.arange(-a, a, rng.uniform(1, 3)):
            thing.add(CYLINDER, (x, 0, height - 0.1), (0.06, 0.06, height))
        for level in rng.uniform(0.3, 2 * height, 2):
            thing.add(CUBE, (0, 0, level), (a, 0.03, 0.05))
    return thing


def street(rng):
    """A street along x about the origin: (solids, half its width)."""
    world, half = Solids(), rng.uniform(3, 7)
    slope = about_axis(0, rng.normal() * 0.01) @ about_axis(1, rng.normal() * 0.015)
    world.add(CUBE, (0, 0, -1), (120, half, 1), slope)
    kerb = rng.choice([0.02, rng.uniform(0.08, 0.2)])
    for side in (-1, 1):
        bank = about_axis(0, side * abs(rng.normal()) * 0.04)
        world.add(CUBE, (0, side * (half + 20), -1 + kerb), (120, 20, 1), slope @ bank)
        setback = rng.uniform(1.5, 10)
        for _ in range(rng.integers(0, 40)):  # the terrain off the road
            at = rng.uniform((-80, half + 0.5), (80, half + 25)) * (1, side)
            world.add(BALL, (*at, kerb - 0.1), rng.uniform((0.6, 0.6, 0.12), (4, 4, 0.6)))
        x = -90 + rng.uniform(0, 10)
        while x < 90:
            length, depth, height = rng.uniform((5, 6, 3), (25, 14, 16))
            if rng.random() < 0.85:
                front = side * (half + setback + rng.uniform(0, 1.5))
                world.group(house(rng, length, depth, height), (x + length / 2, front, 0), 0 if side > 0 else np.pi)
            x += length + rng.choice([0, rng.uniform(1, 12)])
        things = (
            (car, 14, half - 1.1),
            (tree, rng.integers(0, 20), half + 1),
            (pole, 12, half + 0.5),
            (fence, 6, half + setback - 0.5),
        )
        for make, number, y in things:
            for x in rng.uniform(-70, 70, rng.integers(number // 3, number + 1)):
                at = x, side * (y + rng.normal() * (0.15 if make is car else 0.6)), kerb * (make is not car) - 0.01
                yaw = rng.normal() * 0.05 + np.pi * rng.integers(2)
                world.group(make(rng), at, yaw, moving=make is car and rng.random() < 0.15)
        for x in rng.uniform(-50, 50, 25):
            size, y = rng.uniform(0.3, 1.8), half + rng.uniform(0.5, setback + 1)
            world.group(clutter(rng, size), (x, side * y, kerb - 0.02), rng.uniform(0, 7))
    return world, half
