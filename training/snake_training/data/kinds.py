"""Made clouds of scenes, whole as sensors give them: what the choice between a model of objects and one of scenes is fitted to.

`scene_cloud(rng)` is one of them.
"""

import numpy as np

from .crops import View, depth_camera, fused, seen, spinning_lidar, standpoint, upright
from .worlds import room, street

KINDS = ("depth frame", "fragment", "tripod in a room", "tripod in a street", "aerial tile", "sweep")


def scene_cloud(rng):
    """(kind, points (N, 3) in metres): one image or several fused ones of a depth camera, a scan from a tripod, a tile of an
    aerial scan, or a sweep of a spinning LiDAR."""
    kind = KINDS[rng.integers(len(KINDS))]
    if kind in KINDS[:3]:
        world, size = room(rng)
        eye = standpoint(size, rng)
        if kind == "tripod in a room":
            return kind, _scan(world, eye, 15.0, rng)
        target = standpoint(size, rng) + rng.normal(size=3) * 0.3
        images, quadratic = [], rng.uniform(0.0008, 0.004)
        for _ in range(1 if kind == "depth frame" else rng.integers(4, 12)):
            rays, _ = depth_camera(eye, target, rng)
            images.append(_seen(world, View(np.broadcast_to(eye, rays.shape), rays, 0.001, quadratic, 4.5, 0.4), rng))
            eye, target = eye + rng.normal(size=3) * (0.2, 0.2, 0.1), target + rng.normal(size=3) * 0.5
        points = np.concatenate(images)
        return kind, points if kind == "depth frame" else fused(points, points, rng.uniform(0.01, 0.03))[0]
    world, half = street(rng)
    eye = np.array([rng.uniform(-30, 30), rng.normal() * half / 3, rng.uniform(1.5, 2.0)])
    if kind == "tripod in a street":
        return kind, _scan(world, eye, 100.0, rng)
    if kind == "sweep":
        rays = spinning_lidar(rng) @ upright(rng).T
        return kind, _seen(world, View(np.broadcast_to(eye, rays.shape), rays, 0.02, 0, 100, 1.5), rng)
    side = rng.uniform(8, 40)
    rays = np.array([0, 0, -1]) + rng.normal(size=(20000, 3)) * rng.uniform(0.01, 0.2)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    below = np.column_stack([rng.uniform(-side, side, (len(rays), 2)) + eye[:2], np.zeros(len(rays))])
    return kind, _seen(world, View(below - rays * 60, rays, 0.03), rng)


def _scan(world, eye, furthest, rng):
    rays = rng.normal(size=(20000, 3))
    rays = rays[rays[:, 2] > -1.2 * np.hypot(rays[:, 0], rays[:, 1])]  # the tripod hides what is below it
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return _seen(world, View(np.broadcast_to(eye, rays.shape), rays, 0.004, 0, furthest), rng)


def _seen(world, view, rng):
    everything = np.zeros(3), 300.0
    return np.concatenate([seen(world, part, *everything, rng)[0] for part in _parts(view)])


def _parts(view, most=8000):
    """The view in parts of rays that `seen` casts all of."""
    for start in range(0, len(view.directions), most):
        rays = slice(start, start + most)
        yield View(view.origins[rays], view.directions[rays], view.noise, view.quadratic, view.furthest, view.nearest)
