"""Where default keypoints of made rooms lie: at the corners, as far off as the covariance says, or far from any edge; and which model
the views of objects get.

    python -m snake_training.evaluation.places [--objects CORPUS/objects/val] [--seeds 0 10]
"""

import itertools
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import snake_rs

from ..arguments import option, parser_of
from ..data.kinds import bare_world, free_place, on_grid
from ..data.sensors import depth_camera, pose
from ..data.shapes import box, moved
from ..data.solids import directions, scan
from ..data.views import FRAMES, one_sided

CORNERS = {0.01: 0.015, 0.02: 0.015, 0.04: 0.04}  # metres between points, and from a corner to its keypoint at most
NOISES = 0.0, 0.0015, 0.003  # of depth frames, metres at a metre
FAR, FEW = 0.2, 8  # metres; keypoints
WITHIN = 7.815  # 95 % of a chi-squared distribution of three degrees of freedom


def corner_row(spacing, seeds):
    """Rooms of a floor, two walls and a box, points on grids with noise of 3 mm: keypoints, corners found, and how many within 95 %."""
    number = found = within = 0
    for rng in map(np.random.default_rng, seeds):
        size, half = rng.uniform([2, 1.5, 1.1], [3, 2.5, 1.5]), rng.uniform([0.3, 0.25, 0.25], [0.6, 0.45, 0.5])
        at = np.array([*rng.uniform(-0.5, 0.5, 2) - 0.5, half[2]])
        x_low, _, y_low, _, z_low, _ = moved(box(2 * size), (0, 0, size[2]))
        cupboard = moved(box(2 * half), at)
        points = on_grid([x_low, y_low, z_low, *cupboard[:4], cupboard[5]], spacing, rng)
        corners = [at + half * signs for signs in itertools.product((-1, 1), repeat=3)] + [(*-size[:2], 0)]
        keypoints = snake_rs.detect(points + rng.normal(0, 0.003, points.shape))
        number += len(keypoints)
        away, nearest = cKDTree(keypoints.points).query(corners) if len(keypoints) else (np.full(9, np.inf), [])
        for row in np.flatnonzero(away < CORNERS[spacing]):
            off = keypoints.points[nearest[row]] - corners[row]
            within += off @ np.linalg.pinv(keypoints.covariance[nearest[row]]) @ off < WITHIN
            found += 1
    return [f"points {spacing} m apart", number, f"{found} of {9 * len(seeds)}", f"{within} of {found}", ""]


def edges_of(world):
    """The starts and ends (E, 3) of the edges of boxes and rooms."""
    rows = []
    for _, center, axes, *_ in world.rows:
        for axis, one, other in itertools.product(range(3), (-1, 1), (-1, 1)):
            middle = center + one * axes[:, (axis + 1) % 3] + other * axes[:, (axis + 2) % 3]
            rows.append([middle - axes[:, axis], middle + axes[:, axis]])
    return np.array(rows).swapaxes(0, 1)


def from_edges(points, world):
    """The distance (N,) of points (N, 3) to the nearest edge."""
    start, end = edges_of(world)
    along = ((points[:, None] - start) * (end - start)).sum(axis=2) / ((end - start) ** 2).sum(axis=1)
    nearest = start + along.clip(0, 1)[:, :, None] * (end - start)
    return np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)


def scan_row(quadratic, seeds):
    """Keypoints of depth frames with noise of `quadratic` z², or of tripods with 5 mm, and how many are far from edges."""
    number = far = 0
    for rng in map(np.random.default_rng, seeds):
        world, size = bare_world(rng)
        eye = free_place(world, size, rng)
        rays, turn = depth_camera(eye, rng.normal(size=3) * 0.3 + (0, 0, 0.5), rng, step=2)
        if quadratic is None:
            rays, turn = directions(np.radians(np.arange(-60, 90)), np.radians(np.arange(360))), np.eye(3)
        else:
            rays = rays @ turn
        at = pose(eye, turn)
        points = scan(world, at, rays, 0.005 if quadratic is None else 0.0, 8.0, rng)
        points *= 1 + (quadratic or 0.0) * points[:, 2:] * rng.normal(size=(len(points), 1))
        keypoints = snake_rs.detect(points, model="scenes").points
        number += len(keypoints)
        far += sum(from_edges(keypoints @ turn.T + eye, world) > FAR) if len(keypoints) else 0
    return ["tripods" if quadratic is None else f"depth frames, {quadratic} z²", number, "", "", f"{far} of {number}"]


def main(argv=None):
    words = {
        "--objects": dict(type=Path, help="folder with points.npy: each 14th object is seen from one side"),
        "--seeds": option([0, 10], "first seed of rooms, and the one after the last", int, nargs=2),
    }
    arguments = parser_of("evaluation.places", __doc__, words).parse_args(argv)
    seeds = range(*arguments.seeds)
    print(f"| rooms | keypoints | corners found | within 95 % | beyond {FAR} m of edges |\n|---|---|---|---|---|")
    rows = [corner_row(spacing, seeds) for spacing in CORNERS] + [scan_row(noise, seeds) for noise in (*NOISES, None)]
    print(*(f"| {' | '.join(map(str, row))} |" for row in rows), sep="\n")
    if arguments.objects:
        clouds = np.load(arguments.objects / "points.npy", mmap_mode="r")[seeds.start % 14 :: 14] / np.float32(32767)
        rng = np.random.default_rng(seeds.start)
        found = [snake_rs.detect(one_sided(cloud, rng, frame)) for frame in FRAMES for cloud in clouds]
        scenes, few = sum("scenes" in one.model for one in found), sum(len(one) < FEW for one in found)
        print(f"\n{len(found)} views of objects: {scenes} are taken for scenes, {few} have fewer than {FEW} keypoints")


if __name__ == "__main__":
    main()
