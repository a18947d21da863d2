"""Clouds of one object and of scenes, whole, cut and in any frame, for the choice between their models."""

import numpy as np

from .sensors import View, depth_camera, standpoint, tripod_scan, whole_view
from .shapes import primitive, revolve, sample_surface, tube
from .solids import CUBE, ROOM, Solids, about_axis
from .views import bare_surface
from .worlds import FURNITURE, any_turn, car, clutter, room


def part(cloud, rng):
    """0.4 of a cloud, cut by a plane."""
    depth = cloud @ rng.normal(size=3)
    return cloud[depth < np.quantile(depth, 0.4)]


def varied(cloud, rng):
    """A cloud (N, 3) of a scene in metres, at times a part of it, or with noise of 2 cm, thinned, and in another frame."""
    chance = rng.random(3)
    if chance[0] < 0.25:
        cloud = part(cloud, rng)
    elif chance[0] < 0.35:
        cloud = cloud + rng.normal(0, 0.02, cloud.shape)
    if chance[1] < 0.4:
        number = int(np.exp(rng.uniform(np.log(600), np.log(max(len(cloud), 601)))))
        cloud = cloud[rng.permutation(len(cloud))[:number]]
    if chance[2] < 0.6:
        return cloud
    cloud = cloud - cloud.mean(axis=0)
    if chance[2] > 0.9:
        cloud = cloud @ any_turn(rng).T + rng.normal(size=3) * np.ptp(cloud, axis=0).max() * 10 ** rng.uniform(
            -0.5, 1.5
        )
    return cloud


def in_any_frame(cloud, rng):
    """The cloud (N, 3) about its middle, with a corner of its box at the origin, or elsewhere; at times turned."""
    cloud = cloud @ any_turn(rng).T if rng.random() < 0.5 else cloud
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return cloud - [(low + high) / 2, low, low + (high - low) * 10 * rng.normal(size=3)][rng.integers(3)]


def in_unit_ball(cloud):
    """The cloud (N, 3) about the middle of its box, in units of its radius."""
    cloud = cloud - (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    return cloud / np.linalg.norm(cloud, axis=1).max()


def torus(rng, number=4000):
    """A ring: smooth and hollow, as no object of the corpus is."""
    one, other = rng.uniform(0, 2 * np.pi, (2, number))
    out = 1 + rng.uniform(0.1, 0.6) * np.cos(other)
    return np.column_stack([out * np.cos(one), out * np.sin(one), rng.uniform(0.1, 0.6) * np.sin(other)])


def solid(rng, number):
    """Points (number, 3) of a box, cone, ring, plate or tube, in the unit ball."""
    return in_unit_ball(sample_surface(primitive(rng, np.exp(rng.uniform(-2.3, 0, 3))), number, rng))


def vessel(rng, number=6000):
    """Points (number, 3) of a cup, bowl, bottle or bin that is open at the top, at times with a handle, in the unit ball."""
    height, thick, level = rng.uniform(0.3, 3), rng.uniform(0.02, 0.12), np.linspace(0, 1, 7)
    outer = np.interp(level, np.linspace(0, 1, 4), rng.uniform(0.4, 1, 4) if rng.random() < 0.3 else [0.8, 1, 1, 1])
    radius = np.concatenate([[0], outer, (1 - thick) * outer[::-1], [0]])
    at = np.concatenate([[0], level, np.maximum(level[::-1], thick), [thick]]) * height
    patches = revolve(radius, at, segments=rng.choice([5, 25, 25]))
    if rng.random() < 0.5:
        turn = np.linspace(-np.pi / 2, np.pi / 2, 12)
        path = np.column_stack([outer[3] + 0.5 * np.cos(turn), 0 * turn, height * (0.5 + 0.3 * np.sin(turn))])
        patches += tube(path, rng.uniform(0.03, 0.1))
    return in_unit_ball(sample_surface(patches, number, rng))


def thing(rng, number=6000):
    """About so many points (N, 3) of a piece of furniture, a car, or a few solids that meet, in the unit ball."""
    pieces = *FURNITURE, car, clutter, clutter
    make = pieces[rng.integers(len(pieces))]
    made = make(rng, 0.3) if make is clutter else make(rng)
    world = made[0] if isinstance(made, tuple) else made
    sparse = world.surface(np.zeros(3), 50.0, 100.0, rng)
    return in_unit_ball(world.surface(np.zeros(3), 50.0, 100.0 * number / len(sparse), rng))


def on_grid(patches, spacing, rng, jitter=0.0):
    """Points (N, 3) at every place of a grid on each rectangle of the patches, beside it by up to so many spacings."""
    rows = []
    for patch in patches:
        sides = np.array([patch[-1, 0] - patch[0, 0], patch[0, -1] - patch[0, 0]])
        length = np.linalg.norm(sides, axis=1)
        places = np.stack(np.meshgrid(*[np.arange(0, side, spacing) for side in length]), axis=-1).reshape(-1, 2)
        rows.append(patch[0, 0] + (places + rng.uniform(-jitter, jitter, places.shape) * spacing) / length @ sides)
    return np.concatenate(rows)


def lattice(rng):
    """The points (N, 3) of a bare surface on grids, in metres: exact ones, or each point beside its place."""
    patches = bare_surface(rng, closed=rng.random() < 0.3)
    points = on_grid(patches, 10 ** rng.uniform(-1.7, -1), rng, rng.choice([0, 0.4]))
    return points + rng.normal(0, 10 ** rng.uniform(-3, -2), points.shape)


def bare_world(rng):
    """A room about the vertical axis with a box at most in each quarter, so that none meets another: solids, and the size (3,)."""
    size = rng.uniform((3, 3, 2.2), (8, 8, 3.5))
    world = Solids([(ROOM, np.array([0, 0, size[2] / 2]), np.diag(size / 2), 0.0, False)])
    for quarter in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        half = rng.uniform((0.1, 0.1, 0.1), (0.5, 0.4, 0.9))
        at = quarter * size[:2] / 4 + rng.uniform(-0.1, 0.1, 2)
        if rng.random() < 0.4:
            world.add(CUBE, (*at, half[2]), half, about_axis(2, rng.uniform(0, 7)))
    return world, size


def free_place(world, size, rng):
    """A standpoint (3,) that no solid holds."""
    while world.inside((eye := standpoint(size, rng))[None], -0.25).any():
        pass
    return eye


def empty_room(rng):
    """Scans (N, 3) of a bare world, one or several, by a tripod or a depth camera, in metres."""
    world, size = bare_world(rng)
    scans, is_tripod = [], rng.random() < 0.5
    for _ in range(rng.choice([1, 1, 2, 3])):
        eye = free_place(world, size, rng)
        if is_tripod:
            scans.append(tripod_scan(world, eye, 15.0, rng))
        else:
            rays, _ = depth_camera(eye, standpoint(size, rng) + rng.normal(size=3) * 0.3, rng)
            limits = 0.001, rng.uniform(0.0008, 0.004), 6.0, 0.4
            scans.append(whole_view(world, View(np.broadcast_to(eye, rays.shape), rays, *limits), rng))
    return np.concatenate(scans)


def even_room(rng):
    """The points (N, 3) of a furnished room, sampled evenly, in metres."""
    world, size = room(rng)
    middle = np.array([0, 0, size[2] / 2])
    points = world.surface(middle, size.max(), 10 ** rng.uniform(1.5, 2.7), rng)
    return points[(np.abs(points - middle) < size / 2 + 0.01).all(axis=1)]


def terrain(rng):
    """The points (N, 3) of waves of ground, at times with buildings, at random or on a grid, 10 to 200 metres wide."""
    number, side = int(np.exp(rng.uniform(np.log(3000), np.log(40000)))), 10 ** rng.uniform(1, 2.3)
    places = rng.uniform(-0.5, 0.5, (number, 2))
    if rng.random() < 0.5:
        steps = np.linspace(-0.5, 0.5, int(number**0.5))
        places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        places += rng.uniform(-0.4, 0.4, places.shape) / len(steps)
    height = np.zeros(len(places))
    for _ in range(rng.integers(2, 7)):
        length, angle = rng.uniform(0.2, 1.5), rng.uniform(0, 7)
        along = places @ (np.cos(angle), np.sin(angle)) / length
        height += length * rng.uniform(0.005, 0.06) * np.sin(2 * np.pi * along + rng.uniform(0, 7))
    for _ in range(rng.integers(0, 12) * (rng.random() < 0.7)):
        inside = (np.abs(places - rng.uniform(-0.45, 0.45, 2)) < rng.uniform(0.01, 0.08, 2)).all(axis=1)
        if inside.any():
            height[inside] = height[inside].mean() + rng.uniform(0.02, 0.1)
    return side * np.column_stack([places, height + rng.normal(0, 0.0005, len(places))])
