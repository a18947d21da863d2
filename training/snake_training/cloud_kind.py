"""The weights by which a cloud is taken for a scene or for an object (`choose/rule.rs` in snake-core has them, `cloud/scene_signs.rs` the
signs that they weigh).

`python -m snake_training.cloud_kind CORPUS` fits them to the training objects of the corpus, whole and seen from one side, to its training
scenes and to made ones, and prints them, with the shares of these clouds that they take for scenes, and of the validation part's.
"""

import json
from pathlib import Path

import numpy as np

from snake_rs._core import scene_signs

from .arguments import option, parser_of
from .data.landmarks import landmarks
from .data.sensors import scene_cloud
from .data.shapes import Procedural, primitive, sample_surface
from .data.views import FRAMES, bare_room, one_sided, table_top
from .data.worlds import any_turn

LIMIT = 3.0  # standard deviations: signs beyond count as much
OBJECTS = 0.55  # weight of all objects; scenes have the rest, because whole ones are hardly ever taken for objects


def signs(clouds):
    """The signs (N, 13) of clouds, without those of clouds that are too small."""
    found = (scene_signs(np.ascontiguousarray(cloud, dtype=np.float32)) for cloud in clouds)
    return np.array([row for row in found if row is not None])


def objects(folder, start=0, step=1):
    """Objects of a corpus, every so many from one on."""
    points = np.load(folder / "points.npy", mmap_mode="r")
    return [points[index] / np.float32(32767) for index in range(start, len(points), step)]


def torus(rng, number=4000):
    """A ring: smooth and hollow, as no object of the corpus is."""
    one, other = rng.uniform(0, 2 * np.pi, (2, number))
    out = 1 + rng.uniform(0.1, 0.6) * np.cos(other)
    return np.column_stack([out * np.cos(one), out * np.sin(one), rng.uniform(0.1, 0.6) * np.sin(other)])


def scenes(folder):
    """The clouds of a folder of scenes, in metres."""
    return [np.load(folder / f"{row['name']}.npy") for row in json.loads((folder / "index.json").read_text())]


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


def solid(rng):
    """Points (N, 3) of a box, cone, ring, plate or tube in any frame."""
    number = int(np.exp(rng.uniform(np.log(600), np.log(60000))))
    return in_any_frame(sample_surface(primitive(rng, np.exp(rng.uniform(-2.3, 0, 3))), number, rng), rng)


def training_groups(corpus, made, rng):
    """(signs (N, 13), whether these are scenes) of the clouds of the fit, by name."""
    whole = [in_any_frame(cloud, rng) for cloud in objects(corpus / "objects/train")]
    thin = [cloud[:600] + rng.normal(0, 0.02, (600, 3)) for cloud in whole[::4]]
    others = [torus(rng) for _ in range(made // 4)] + [landmarks("box", rng)[0] for _ in range(made // 10)]
    views = [one_sided(cloud, rng) for cloud in objects(corpus / "objects/train", 1)]
    views += [one_sided(landmarks(name, rng)[0], rng) for name in ("box", "nut") for _ in range(made // 2)]
    views += [one_sided(cloud / 2, rng) for cloud, _ in zip(Procedural(), range(made))]
    worlds = []
    for number in range(made):
        make = {0: bare_room, 1: table_top, 4: bare_room}.get(number % 8, lambda rng: scene_cloud(rng)[1])
        cloud = make(rng)
        worlds += [varied(cloud, rng) for _ in range(2)] if len(cloud) > 300 else []
    solids = (solid(rng) for _ in range(made))
    closed = (varied(bare_room(rng, closed=True), rng) for _ in range(made // 10))
    rooms = (varied(cloud, rng) for cloud in scenes(corpus / "scenes/train") * 4)
    return {
        "objects": (signs(whole + thin + others), False),
        "views of objects": (signs(views), False),
        "solids": (signs(solids), False),
        "made scenes": (signs(worlds), True),
        "closed rooms": (signs(closed), True),
        "scenes": (signs(rooms), True),
    }


def judging_groups(corpus, rng):
    """The same of clouds that judge the fit: three views of every 14th validation object, all of them whole, and scenes."""
    folder = corpus / "objects/val"
    chosen = objects(folder, 7, 14)
    groups = {f"judging: views, {frame}": (signs(one_sided(c, rng, frame) for c in chosen), False) for frame in FRAMES}
    groups["judging: objects"] = (signs(in_any_frame(cloud, rng) for cloud in objects(folder)), False)
    groups["judging: solids"] = (signs(solid(rng) for _ in range(100)), False)
    clouds = scenes(corpus / "scenes/val")
    groups["judging: scenes"] = (signs(clouds), True)
    groups["judging: closed rooms"] = (signs(bare_room(rng, closed=True) for _ in range(60)), True)
    groups["judging: parts of scenes"] = (signs(part(cloud, rng) for cloud in clouds[:36:2]), True)
    return groups


class Rule:
    """The log-odds that a cloud is a scene: a quadratic form in its signs (K), each less a mean and in units of a deviation (K,)."""

    def __init__(self, mean, deviation, weights):
        self.mean, self.deviation, self.weights = mean, deviation, weights

    def columns(self, rows):
        """The terms of a quadratic form (N, K + K (K + 1) / 2): the scaled signs (N, K), their products in pairs and squares."""
        scaled = ((rows - self.mean) / self.deviation).clip(-LIMIT, LIMIT)
        products = [scaled[:, [i]] * scaled[:, : i + 1] for i in range(rows.shape[1])]
        return np.column_stack([scaled, *products])

    def score(self, rows):
        """Above 0 a cloud is a scene: (N,) of signs (N, K)."""
        return self.columns(rows) @ self.weights[:-1] + self.weights[-1]


def fit(groups, penalty=3e-4):
    """The rule by groups of signs (N, K) and whether these are scenes.

    A group counts by the root of its number of clouds, and objects by OBJECTS.
    """
    signs = np.concatenate([rows for rows, _ in groups])
    truth = np.concatenate([np.full(len(rows), is_scene) for rows, is_scene in groups])
    rule = Rule(signs.mean(axis=0), signs.std(axis=0), None)
    rows = rule.columns(signs)
    mean, deviation = rows.mean(axis=0), rows.std(axis=0)
    scaled = np.column_stack([(rows - mean) / deviation, np.ones(len(rows))])
    importance = np.concatenate([np.full(len(rows), len(rows) ** -0.5) for rows, _ in groups])
    for is_scene, share in ((False, OBJECTS), (True, 1 - OBJECTS)):
        importance[truth == is_scene] *= share * len(rows) / importance[truth == is_scene].sum()
    pull = penalty * len(rows) * np.r_[np.ones(rows.shape[1]), 0]
    weights = np.zeros(scaled.shape[1])
    for _ in range(30):
        chance = 1 / (1 + np.exp(-scaled @ weights))
        slope = scaled.T @ (importance * (chance - truth)) + pull * weights
        curve = (scaled * (importance * chance * (1 - chance))[:, None]).T @ scaled + np.diag(pull)
        weights -= np.linalg.solve(curve, slope)
    unscaled = weights[:-1] / deviation
    rule.weights = np.r_[unscaled, weights[-1] - unscaled @ mean]
    return rule


def main(argv=None):
    words = {
        "corpus": dict(type=Path, help="folder with objects and scenes, train and val"),
        "--made": option(400, "made scenes, and views of made objects"),
        "--seed": option(1, "of the choices"),
    }
    arguments = parser_of("cloud_kind", __doc__, words).parse_args(argv)
    rng = np.random.default_rng(arguments.seed)
    groups = training_groups(arguments.corpus, arguments.made, rng)
    rule = fit(list(groups.values()))
    for values in (rule.mean, rule.deviation, rule.weights):
        print("[" + ", ".join(f"{value:.4g}" for value in values) + "]")
    for name, (rows, _) in (groups | judging_groups(arguments.corpus, rng)).items():
        print(f"{name}: {np.sum(rule.score(rows) > 0)} of {len(rows)} are taken for scenes")


if __name__ == "__main__":
    main()
