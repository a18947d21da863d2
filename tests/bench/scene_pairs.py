"""The scene pairs on which registration is measured: overlapping pairs with their transforms, and pairs that do not overlap."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

# A registration is right within these limits.
MAX_DEGREES, MAX_METRES = 15.0, 0.3
# A published transform is not exact: what is not right but this near may be.
NEAR_DEGREES, NEAR_METRES = 20.0, 0.7


class Pair(NamedTuple):
    """Two clouds of a split; `t_target_source` (4, 4) is None where they do not overlap."""

    name: str
    source: Path
    target: Path
    t_target_source: np.ndarray | None
    overlap: float

    def clouds(self) -> tuple[np.ndarray, np.ndarray]:
        """The points (N, 3) of source and target."""
        return np.load(self.source), np.load(self.target)


def overlapping(scenes: Path, split: str) -> list[Pair]:
    """All published pairs of a split."""
    folder = scenes / split
    rows = json.loads((folder / "pairs.json").read_text())
    return [
        Pair(
            f"{row['source']}>{row['target']}",
            folder / f"{row['source']}.npy",
            folder / f"{row['target']}.npy",
            np.array(row["T"]),
            row["overlap"],
        )
        for row in rows
    ]


def poses(pairs: list[Pair]) -> dict[str, tuple[str, np.ndarray]]:
    """Each cloud's pose (4, 4) in the frame of the first cloud of its connected group, as (that cloud, pose)."""
    neighbors: dict[str, list[tuple[str, np.ndarray]]] = {}
    for pair in pairs:
        source, target = pair.source.stem, pair.target.stem
        neighbors.setdefault(target, []).append((source, pair.t_target_source))
        neighbors.setdefault(source, []).append((target, np.linalg.inv(pair.t_target_source)))
    found: dict[str, tuple[str, np.ndarray]] = {}
    for root in neighbors:
        if root in found:
            continue
        found[root], queue = (root, np.eye(4)), [root]
        while queue:
            at = queue.pop(0)
            for other, t_at_other in neighbors[at]:
                if other not in found:
                    found[other] = (root, found[at][1] @ t_at_other)
                    queue.append(other)
    return found


def not_overlapping(scenes: Path, split: str, count: int, seed: int = 0) -> list[Pair]:
    """Random pairs of clouds of one scene without a point of the one within 10 cm of 1 % of the other."""
    folder = scenes / split
    known = poses(overlapping(scenes, split))
    names = sorted(known)
    trees, clouds = {}, {}
    for name in names:
        points = np.load(folder / f"{name}.npy")
        pose = known[name][1]
        clouds[name] = (points @ pose[:3, :3].T + pose[:3, 3])[:: max(1, len(points) // 2000)]
        trees[name] = cKDTree(clouds[name])
    candidates = [(a, b) for a in names for b in names if a < b and known[a][0] == known[b][0]]
    found = []
    for index in np.random.default_rng(seed).permutation(len(candidates)):
        source, target = candidates[index]
        distances = trees[target].query(clouds[source], distance_upper_bound=0.1)[0]
        if np.mean(np.isfinite(distances)) < 0.01:
            found.append(Pair(f"{source}!{target}", folder / f"{source}.npy", folder / f"{target}.npy", None, 0.0))
        if len(found) == count:
            break
    return found


def subset(pairs: list[Pair], count: int, seed: int = 0) -> list[Pair]:
    """The first `count` pairs of a fixed random order."""
    return [pairs[i] for i in np.random.default_rng(seed).permutation(len(pairs))[:count]]


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Degrees between the rotations and metres between the translations."""
    cosine = (np.trace(found[:3, :3].T @ truth[:3, :3]) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), float(np.linalg.norm(found[:3, 3] - truth[:3, 3]))


def is_right(found: np.ndarray, truth: np.ndarray) -> bool:
    degrees, metres = errors(found, truth)
    return degrees <= MAX_DEGREES and metres <= MAX_METRES
