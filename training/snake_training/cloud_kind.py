"""The weights by which a cloud is taken for a scene or for an object (`choose/rule.rs` in snake-core has them, `cloud/scene_signs.rs` the
signs that they weigh).

`python -m snake_training.cloud_kind --objects CORPUS/objects/train --scenes CORPUS/scenes/train --leave-out SCENE` fits them to made
clouds of scenes and those of the corpus, parts of rooms included, and prints them, with the shares of clouds that they take for scenes,
also of the scenes that are left out.
"""

import json
from pathlib import Path

import numpy as np

from snake_rs._core import scene_signs

from .arguments import option, parser_of
from .data.sensors import scene_cloud

KEPT = 0.99  # share of the scenes of the corpus that are taken for scenes: a scene taken for an object costs far more than the reverse


def signs(clouds):
    """The signs (N, 8) of clouds, without those of clouds that are too small."""
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


def fragments(folder, left_out, rng):
    """The clouds of a folder of scenes by whether they are left out, in metres.

    Of every other one also 0.4, cut by a plane, and of every third one also a copy with noise of 2 cm.
    """
    clouds = {False: [], True: []}
    for index, row in enumerate(json.loads((folder / "index.json").read_text())):
        cloud = np.load(folder / f"{row['name']}.npy")
        kept = clouds[row["scene"] in left_out]
        kept.append(cloud)
        if index % 2:
            depth = cloud @ rng.normal(size=3)
            kept.append(cloud[depth < np.quantile(depth, 0.4)])
        if index % 3 == 0:
            kept.append(cloud + rng.normal(0, 0.02, cloud.shape))
    return clouds


def columns(rows):
    """The weighed columns (N, 16): the signs (N, 8) and their squares."""
    return np.column_stack([rows, rows**2])


def fit(groups, penalty=1e-2):
    """The weights (16 and one) of the log-odds that a cloud is a scene.

    Each class is as important as the other, and a group of a class counts by the root of its number of clouds.
    """
    rows = columns(np.concatenate([rows for rows, _ in groups]))
    truth = np.concatenate([np.full(len(rows), is_scene) for rows, is_scene in groups])
    mean, deviation = rows.mean(0), rows.std(0)
    scaled = np.column_stack([(rows - mean) / deviation, np.ones(len(rows))])
    importance = np.concatenate([np.full(len(rows), len(rows) ** -0.5) for rows, _ in groups])
    for is_scene in (False, True):
        importance[truth == is_scene] *= 0.5 * len(rows) / importance[truth == is_scene].sum()
    pull = penalty * len(rows) * np.r_[np.ones(rows.shape[1]), 0]
    weights = np.zeros(scaled.shape[1])
    for _ in range(30):
        chance = 1 / (1 + np.exp(-scaled @ weights))
        slope = scaled.T @ (importance * (chance - truth)) + pull * weights
        curve = (scaled * (importance * chance * (1 - chance))[:, None]).T @ scaled + np.diag(pull)
        weights -= np.linalg.solve(curve, slope)
    unscaled = weights[:-1] / deviation
    return np.r_[unscaled, weights[-1] - unscaled @ mean]


def score(rows, weights):
    """Above 0 a cloud is a scene: (N,) of signs (N, 8)."""
    return columns(rows) @ weights[:-1] + weights[-1]


def main(argv=None):
    words = {
        "--objects": dict(type=Path, required=True),
        "--scenes": dict(type=Path, nargs="*", default=[], help="folders with index.json"),
        "--leave-out": dict(nargs="*", default=[], metavar="SCENE", help="scenes to judge the weights by"),
        "--made": option(200, "made scenes"),
        "--step": option(2, "take every so many of the objects"),
        "--seed": option(1, "of the choices"),
    }
    parser = parser_of("cloud_kind", __doc__, words)
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
    judging = {}
    for folder in arguments.scenes:
        clouds = fragments(folder, arguments.leave_out, rng)
        groups[str(folder)] = (signs(clouds[False]), True)
        judging |= {f"{folder}, left out": (signs(clouds[True]), True)} if clouds[True] else {}
    weights = fit(list(groups.values()))
    scenes = [rows for name, (rows, _) in groups.items() if name in map(str, arguments.scenes)]
    scores = score(np.concatenate(scenes or [rows for rows, is_scene in groups.values() if is_scene]), weights)
    weights[-1] -= np.quantile(scores, 1 - KEPT)
    print("[" + ", ".join(f"{weight:.4g}" for weight in weights) + "]")
    for name, (rows, _) in (groups | judging).items():
        print(f"{name}: {np.mean(score(rows, weights) > 0):.3f} of {len(rows)} are taken for scenes")


if __name__ == "__main__":
    main()
