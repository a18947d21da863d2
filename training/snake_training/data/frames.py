"""Single depth frames of made rooms, for measuring: `python -m snake_training.data.frames -o FRAMES` writes clouds and `pairs.json`,
and `snake-cli eval repeatability FRAMES --model scenes` reads them.

A frame is an image of 640 x 480 pixels, not fused: its error grows with the square of the distance, slanted surfaces and holes
are missing. Both frames of a pair are of one room, from places 10 to 40 cm apart. A cloud `(N, 3)` is in metres in its camera's
frame: x is right, y down, z forward.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from .crops import depth_camera, holes, standpoint
from .worlds import room

NEAREST, FURTHEST = 0.4, 4.5  # metres, of the sensor
NOISE, QUADRATIC = 0.001, 0.0015  # standard deviation of a depth z: NOISE + QUADRATIC z^2, metres
WIDTH, HEIGHT, BLOCK = 640, 480, 40  # pixels
NEAR = 0.05  # metres within which a point of the other frame shows the same place


def frame(world, eye, target, rng):
    """The points (N, 3) that a camera at `eye` which looks at `target` sees, and its frame's rotation (3, 3) to the room's."""
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
    """Two frames of a room: clouds (N, 3), the matrix from the first to the second, and the share of the first that the second
    shows."""
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


def write(folder, number, seed):
    """Pairs of frames with their list."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in range(number):
        first, second, matrix, overlap = pair(np.random.default_rng([seed, row, 0xF4A3]))
        names = [f"room{row:03d}_{view}" for view in range(2)]
        for name, cloud in zip(names, (first, second), strict=True):
            np.save(folder / f"{name}.npy", cloud)
        rows.append({"source": names[0], "target": names[1], "T": matrix.tolist(), "overlap": round(overlap, 4)})
    (folder / "pairs.json").write_text(json.dumps(rows, indent=1))


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.data.frames", description="Write pairs of neighbouring depth frames of made rooms.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )  # fmt: skip
    parser.add_argument("-o", "--output", required=True, help="folder of .npy clouds (N, 3) and pairs.json")
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args(argv)
    if arguments.pairs < 1:
        parser.error("--pairs must be 1 or more")
    write(Path(arguments.output), arguments.pairs, arguments.seed)


if __name__ == "__main__":
    main()
