"""Pairs that are made from other data: parts of objects, and sweeps of a simulated LiDAR in a street.

    python tests/bench/made_pairs.py FOLDER --sweeps 8

writes pairs of sweeps in metres with their transforms, for `snake_training.evaluation repeatability`.
"""

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from verdict_pairs import box, houses, lidar

from snake_training.data.solids import Solids, about_axis, scan
from snake_training.data.worlds import any_turn

# The peers' voxels are 3, 5 and 8 cm: objects are 4 m across, and sweeps are in units of 10 m.
OBJECT_DIAMETER, SWEEP_UNIT = 4.0, 10.0
OBJECT_LIMIT = 0.02 * OBJECT_DIAMETER
SWEEP_DEGREES, SWEEP_METRES = 5.0, 0.6


class MadePair(NamedTuple):
    """Two clouds (N, 3) and their transform; `whole` has points of the whole object in the source's frame."""

    name: str
    source: np.ndarray
    target: np.ndarray
    t_target_source: np.ndarray
    whole: np.ndarray | None

    def is_right(self, found: np.ndarray) -> bool:
        """Objects have symmetries: their points need only come close to any point of the object (ADD-S)."""
        if self.whole is None:
            error = np.linalg.inv(self.t_target_source) @ found
            cosine = np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)
            metres = SWEEP_UNIT * np.linalg.norm(found[:3, 3] - self.t_target_source[:3, 3])
            return bool(np.degrees(np.arccos(cosine)) <= SWEEP_DEGREES and metres <= SWEEP_METRES)
        wanted, moved = (self.whole @ m[:3, :3].T + m[:3, 3] for m in (self.t_target_source, found))
        return bool(cKDTree(wanted).query(moved)[0].mean() < OBJECT_LIMIT)


def objects(folder: Path, count: int, seed: int = 0) -> list[MadePair]:
    """Two parts of an object, each cut by a plane that leaves 30 to 70 % of its own half of the points, any rotation.
    At least 0.3 of the source is within 2 % of the diameter of the target."""
    clouds, rng, found = np.load(folder / "val" / "points.npy", mmap_mode="r"), np.random.default_rng(seed), []
    for index in rng.permutation(len(clouds)):
        points = rng.permutation(np.asarray(clouds[index], float))
        points -= points.mean(axis=0)
        points *= OBJECT_DIAMETER / (2 * np.linalg.norm(points, axis=1).max())
        halves, parts = (points[::2], points[1::2]), []
        for half in halves:
            height = half @ any_turn(rng)[0]
            parts.append(half[height < np.quantile(height, rng.uniform(0.3, 0.7))])
        source, target = parts
        if np.mean(cKDTree(target).query(source)[0] < OBJECT_LIMIT) < 0.3:
            continue
        truth = np.eye(4)
        truth[:3, :3], truth[:3, 3] = any_turn(rng), rng.uniform(-2, 2, 3)
        target = target @ truth[:3, :3].T + truth[:3, 3]
        found.append(MadePair(f"object {index}", source.astype("f4"), target.astype("f4"), truth, points[::4]))
        if len(found) == count:
            break
    return found


def street(rng: np.random.Generator) -> Solids:
    """A street along the x axis in metres: buildings, cars and poles on z = 0."""
    world = Solids()
    for side in (-1, 1):
        houses(world, rng, side, -90.0, ([8, 6, 6, 4], [25, 12, 15, 18]))
        for at in rng.uniform(-80, 90, 12):
            y = side * rng.uniform(3, 5)
            box(world, [at, y - 0.9, 0], [at + 4.2, y + 0.9, 1.5])
        for at in rng.uniform(-80, 90, 10):
            box(world, [at, side * 5.5 - 0.15, 0], [at + 0.3, side * 5.5 + 0.15, 6])
    return world


def sweep(world: Solids, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The points (N, 3) of 64 beams of 900 directions each from a pose (4, 4), in the sensor's frame, with a noise of 2 cm. The world
    gets a ground at z = 0."""
    grounded = Solids(world.rows)
    box(grounded, [-200, -200, -1], [200, 200, 0])
    return scan(grounded, pose, lidar(64, 900, -24.8, 2), 0.02, 80.0, rng)


def sweeps(count: int, seed: int = 0) -> list[MadePair]:
    """Sweeps from two positions 10 m apart along a street; the sensor's heading is random and its tilt up to 2 degrees."""
    found = []
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        world, clouds, poses = street(rng), [], []
        for x in (-5.0, 5.0):
            yaw, (roll, pitch) = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(-2, 2, 2))
            tilt = np.array([[1, 0, pitch], [0, 1, -roll], [-pitch, roll, 1]])
            u, _, v = np.linalg.svd(about_axis(2, yaw) @ tilt)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = u @ v, [x, rng.uniform(-1.5, 1.5), 1.8]
            poses.append(pose)
            clouds.append(sweep(world, pose, rng))
        truth = np.linalg.inv(poses[1]) @ poses[0]
        truth[:3, 3] /= SWEEP_UNIT
        source, target = ((cloud / SWEEP_UNIT).astype("f4") for cloud in clouds)
        found.append(MadePair(f"sweep {index}", source, target, truth, None))
    return found


def write(pairs: list[MadePair], folder: Path) -> None:
    """Writes pairs of sweeps in metres: a file for each cloud, and `pairs.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for number, pair in enumerate(pairs):
        names = f"{number:02}-source.npy", f"{number:02}-target.npy"
        for name, cloud in zip(names, (pair.source, pair.target), strict=True):
            np.save(folder / name, SWEEP_UNIT * cloud)
        transform = pair.t_target_source.copy()
        transform[:3, 3] *= SWEEP_UNIT
        rows.append({"source": names[0], "target": names[1], "T": transform.tolist()})
    (folder / "pairs.json").write_text(json.dumps(rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sweeps", type=int, required=True, help="number of pairs")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    write(sweeps(arguments.sweeps, arguments.seed), arguments.folder)


if __name__ == "__main__":
    main()
