"""Sweeps of made drives, for measuring: `python -m snake_training.data.drives -o DRIVES` writes clouds and `pairs.json`.

A car drives along a made street with a LiDAR of 64 beams 1.8 m above it. Cars that move have moved from sweep to sweep. A cloud (N, 3)
is in metres in the sensor's frame: x is ahead, z is up.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from .crops import spinning_lidar, upright
from .frames import pose
from .worlds import street

NEAREST, FURTHEST, NOISE = 1.5, 100.0, 0.02  # metres
SECTORS = 24


def sweep(world, eye, turn, beams, rng):
    """The points (N, 3) that directions (R, 3) in the sensor's frame meet from `eye`; `turn` (3, 3) maps to the street's frame."""
    rays, points = beams @ turn.T, []
    sector = (np.arctan2(rays[:, 1], rays[:, 0]) / (2 * np.pi) * SECTORS).round() % SECTORS
    for number in range(SECTORS):
        some = rays[sector == number]
        middle = some.mean(axis=0) * (1, 1, 0)
        middle /= np.linalg.norm(middle)
        near = world.toward(eye[None], eye + middle * FURTHEST, FURTHEST * np.linalg.norm(some - middle, axis=1).max())
        reach, which, slope = near.cast(np.broadcast_to(eye, some.shape), some)
        kept = (reach > NEAREST) & (reach < FURTHEST) & (rng.random(len(some)) < 0.15 + 2.5 * slope)
        reach = (
            reach + NOISE * rng.standard_normal(len(reach)) + near.arrays()[3][which] * rng.exponential(0.7, len(reach))
        )
        points.append(some[kept] * reach[kept, None])
    return (np.concatenate(points) @ turn).astype(np.float32)


def drive(seed, number, step):
    """`number` sweeps (N, 3), `step` metres apart, with the matrices (4, 4) from their frames to the street's."""
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
        shift = (rng.uniform(0.3, 1.0), 0, 0)
        world = type(world)((k, c + shift if moving else c, a, fuzz, moving) for k, c, a, fuzz, moving in world.rows)


def write(folder, drives, sweeps, step, seed):
    """Sweeps of `drives` streets, `sweeps` of each, `step` metres apart, with the list of neighbouring pairs."""
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


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.data.drives", description="Write sweeps of made drives and the pairs of neighbours.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )  # fmt: skip
    parser.add_argument("-o", "--output", required=True, help="folder of .npy clouds (N, 3) and pairs.json")
    parser.add_argument("--drives", type=int, default=10, help="streets")
    parser.add_argument("--sweeps", type=int, default=3, help="of each")
    parser.add_argument("--step", type=float, default=6.0, help="metres between sweeps")
    parser.add_argument("--seed", type=int, default=1, help="of the first street; the others follow")
    arguments = parser.parse_args(argv)
    if min(arguments.drives, arguments.sweeps - 1) < 1:
        parser.error("--drives must be 1 or more, --sweeps 2 or more")
    write(Path(arguments.output), arguments.drives, arguments.sweeps, arguments.step, arguments.seed)


if __name__ == "__main__":
    main()
