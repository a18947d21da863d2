"""The weights by which a cloud is taken for a scene or for an object (`models/builtin.rs` in snake-core has them, `models/signs.rs` their meaning).

`python -m snake_training.cloud_kind --objects CORPUS/objects/train --scenes CORPUS/scenes/train` fits them to made clouds of
scenes and those of the corpus, and prints them, with the shares of clouds that they take for scenes.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from snake_rs._core import scene_signs

from .data.kinds import scene_cloud

MARGIN = 1.0  # an object is more often taken for a scene than a scene for an object where the score is near 0


def signs(clouds):
    """The signs (N, 8) of clouds; those that are too small are left out."""
    found = (scene_signs(np.ascontiguousarray(cloud, dtype=np.float32)) for cloud in clouds)
    return np.array([row for row in found if row is not None])


def objects(folder, step, rng):
    """Objects of a corpus, whole, and every other one as few noisy points."""
    points = np.load(folder / "points.npy", mmap_mode="r")
    for index in range(0, len(points), step):
        cloud = points[index] / np.float32(32767)
        yield cloud
        if index // step % 2:
            yield cloud[:600] + rng.normal(0, 0.02, (600, 3))


def torus(rng, number=4000):
    """A ring: smooth and hollow, as no object of the corpus is."""
    one, other = rng.uniform(0, 2 * np.pi, (2, number))
    out = 1 + rng.uniform(0.1, 0.6) * np.cos(other)
    return np.column_stack([out * np.cos(one), out * np.sin(one), rng.uniform(0.1, 0.6) * np.sin(other)])


def fragments(folder):
    """The clouds of a folder of scenes."""
    for row in json.loads((folder / "index.json").read_text()):
        yield np.load(folder / f"{row['name']}.npy")


def fit(groups, penalty=1e-3):
    """The weights (8 and one) of the log-odds that a cloud is a scene, each class as important as the other."""
    rows = np.concatenate([rows for rows, _ in groups])
    truth = np.concatenate([np.full(len(rows), is_scene) for rows, is_scene in groups])
    mean, deviation = rows.mean(0), rows.std(0)
    columns = np.column_stack([(rows - mean) / deviation, np.ones(len(rows))])
    importance = np.where(truth, 0.5 / truth.mean(), 0.5 / (1 - truth.mean()))
    pull = penalty * len(rows) * np.r_[np.ones(rows.shape[1]), 0]
    weights = np.zeros(columns.shape[1])
    for _ in range(30):
        chance = 1 / (1 + np.exp(-columns @ weights))
        slope = columns.T @ (importance * (chance - truth)) + pull * weights
        curve = (columns * (importance * chance * (1 - chance))[:, None]).T @ columns + np.diag(pull)
        weights -= np.linalg.solve(curve, slope)
    scaled = weights[:-1] / deviation
    return np.r_[scaled, weights[-1] - scaled @ mean - MARGIN]


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--scenes", type=Path, nargs="*", default=[], help="folders with index.json")
    parser.add_argument("--made", type=int, default=200, help="made scenes")
    parser.add_argument("--step", type=int, default=2, help="take every so many of the objects")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args(argv)
    rng = np.random.default_rng(arguments.seed)
    made = {}
    for _ in range(arguments.made):
        kind, cloud = scene_cloud(rng)
        made.setdefault(kind, []).append(cloud)
    groups = {"objects": (signs(objects(arguments.objects, arguments.step, rng)), False)}
    rounded = [torus(rng) for _ in range(arguments.made // 4)]
    groups["rings"] = (signs(rounded), False)
    groups |= {kind: (signs(clouds), True) for kind, clouds in sorted(made.items())}
    groups |= {str(folder): (signs(fragments(folder)), True) for folder in arguments.scenes}
    weights = fit(list(groups.values()))
    print("[" + ", ".join(f"{weight:.4g}" for weight in weights) + "]")
    for name, (rows, _) in groups.items():
        score = rows @ weights[:-1] + weights[-1]
        print(f"{name}: {np.mean(score > 0):.3f} of {len(rows)} are taken for scenes")


if __name__ == "__main__":
    main()
