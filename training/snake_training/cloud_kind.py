"""The networks by which a cloud is taken for a scene or for an object (`choose/kind.json` in snake-core has them, `cloud/scene_signs.rs` the
signs that they weigh).

`python -m snake_training.cloud_kind CORPUS -o crates/snake-core/src/choose/kind.json` fits them to the training objects of the corpus, whole
and seen from one side, to its training scenes and to made ones, in 30 minutes, and prints how many of these clouds they take for scenes,
and of the validation part's.
"""

import json
from pathlib import Path

import numpy as np
import torch

from snake_rs._core import scene_signs

from .arguments import option, parser_of
from .data.kinds import empty_room, even_room, in_any_frame, lattice, part, solid, terrain, thing, torus, varied, vessel
from .data.landmarks import landmarks
from .data.sensors import drive, scene_cloud
from .data.shapes import Procedural
from .data.views import FRAMES, bare_room, one_sided, table_top
from .export import replacing

LIMIT = 3.0  # standard deviations: signs beyond count as much
OBJECTS = 0.6  # weight of all objects; scenes have the rest, because whole ones are hardly ever taken for objects
NETWORKS, HIDDEN, STEPS, DECAY, RATE = 4, 32, 2000, 0.05, 0.01


def signs(clouds):
    """The signs (N, 16) of clouds, without those of clouds that are too small."""
    found = (scene_signs(np.ascontiguousarray(cloud, dtype=np.float32)) for cloud in clouds)
    return np.array([row for row in found if row is not None])


def objects(folder, start=0, step=1):
    """Objects of a corpus, every so many from one on."""
    points = np.load(folder / "points.npy", mmap_mode="r")
    return [points[index] / np.float32(32767) for index in range(start, len(points), step)]


def scenes(folder):
    """The clouds of a folder of scenes, in metres."""
    return [np.load(folder / f"{row['name']}.npy") for row in json.loads((folder / "index.json").read_text())]


def any_solid(rng):
    """Points (N, 3) of a solid in any frame."""
    return in_any_frame(solid(rng, int(np.exp(rng.uniform(np.log(600), np.log(60000))))), rng)


def training_groups(corpus, made, rng):
    """(signs (N, 16), whether these are scenes) of the clouds of the fit, by name."""
    train = objects(corpus / "objects/train")
    whole = [in_any_frame(cloud, rng) for cloud in train]
    thin = [cloud[:600] + rng.normal(0, 0.02, (600, 3)) for cloud in whole[::4]]
    others = [torus(rng) for _ in range(made // 4)] + [landmarks("box", rng)[0] for _ in range(made // 10)]
    views = [one_sided(cloud, rng) for cloud in train * 4]
    views += [one_sided(landmarks(name, rng)[0], rng) for name in ("box", "nut") for _ in range(made // 2)]
    views += [one_sided(cloud / 2, rng) for cloud, _ in zip(Procedural(), range(made))]
    things = [make(thing(rng), rng) for _ in range(made // 2) for make in (in_any_frame, *4 * (one_sided,))]
    solids = (any_solid(rng) for _ in range(made))
    sides = (one_sided(solid(rng, 6000), rng) for _ in range(made))
    worlds = []
    for number in range(made):
        make = {0: bare_room, 1: table_top, 4: bare_room}.get(number % 8, lambda rng: scene_cloud(rng)[1])
        worlds += [make(rng)] * 2
    real = scenes(corpus / "scenes/train")
    several = lambda make: [make(rng) for _ in range(made // 4)]
    changed = lambda clouds: signs(varied(cloud, rng) for cloud in clouds if len(cloud) > 300)
    return {
        "objects": (signs(whole + thin + others), False),
        "views of objects": (signs(views), False),
        "things": (signs(things), False),
        "solids": (signs(solids), False),
        "views of solids": (signs(sides), False),
        "made scenes": (changed(worlds), True),
        "closed rooms": (changed(several(lambda rng: bare_room(rng, closed=True))), True),
        "lattices": (changed(several(lattice)), True),
        "empty rooms": (changed(several(empty_room)), True),
        "terrain": (changed(several(terrain)), True),
        "drives": (changed(several(lambda rng: next(drive(rng.integers(10**6), 1, 0.0))[0])), True),
        "scenes": (changed(real * 8), True),
        "parts of scenes": (signs(part(cloud, rng) for cloud in real * 6), True),
        "vessels": (
            signs(make(vessel(rng), rng) for _ in range(made // 2) for make in (in_any_frame, *2 * (one_sided,))),
            False,
        ),
        "whole rooms": (changed(several(even_room)), True),
    }


def judging_groups(corpus, rng):
    """The same of clouds that judge the fit: a view of every 14th validation object in each frame, all of them whole, and scenes."""
    folder = corpus / "objects/val"
    chosen = objects(folder, 7, 14)
    groups = {f"judging: views, {frame}": (signs(one_sided(c, rng, frame) for c in chosen), False) for frame in FRAMES}
    groups["judging: objects"] = (signs(in_any_frame(cloud, rng) for cloud in objects(folder)), False)
    groups["judging: solids"] = (signs(any_solid(rng) for _ in range(100)), False)
    clouds = scenes(corpus / "scenes/val")
    groups["judging: scenes"] = (signs(clouds), True)
    groups["judging: closed rooms"] = (signs(bare_room(rng, closed=True) for _ in range(60)), True)
    groups["judging: parts of scenes"] = (signs(part(cloud, rng) for cloud in clouds[:36:2]), True)
    return groups


class Rule:
    """The log-odds that a cloud is a scene: the mean of networks of its signs (K), each less a mean and in units of a deviation (K,).

    The layers of a network have rows of weights with the constant at the end; between them values v become v / (1 + |v|).
    """

    def __init__(self, mean, deviation, networks):
        self.mean, self.deviation = np.asarray(mean), np.asarray(deviation)
        self.networks = [[np.asarray(layer) for layer in layers] for layers in networks]

    def scaled(self, rows):
        """The signs (N, K) as the networks see them."""
        return ((rows - self.mean) / self.deviation).clip(-LIMIT, LIMIT)

    def score(self, rows):
        """Above 0 a cloud is a scene: (N,) of signs (N, K)."""
        scores = np.zeros(len(rows))
        for layers in self.networks:
            values = self.scaled(rows)
            for number, layer in enumerate(layers):
                values = values / (1 + np.abs(values)) if number else values
                values = values @ layer[:, :-1].T + layer[:, -1]
            scores += values[:, 0] / len(self.networks)
        return scores

    def write(self, path):
        """The networks as JSON, with three digits."""
        short = lambda values: float(f"{values:.3g}") if np.ndim(values) == 0 else [short(v) for v in values]
        networks = [[short(layer) for layer in layers] for layers in self.networks]
        rows = {"mean": short(self.mean), "deviation": short(self.deviation), "networks": networks}
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(rows).replace("], [", "],\n[") + "\n")


def fit(groups, networks=NETWORKS, steps=STEPS):
    """The rule by groups of signs (N, K) and whether these are scenes; its networks begin with other random weights.

    A group counts by the root of its number of clouds, and objects by OBJECTS.
    """
    rows = np.concatenate([rows for rows, _ in groups])
    truth = np.concatenate([np.full(len(rows), is_scene) for rows, is_scene in groups])
    importance = np.concatenate([np.full(len(rows), len(rows) ** -0.5) for rows, _ in groups])
    for is_scene, share in ((False, OBJECTS), (True, 1 - OBJECTS)):
        importance[truth == is_scene] *= share / importance[truth == is_scene].sum()
    rule = Rule(rows.mean(axis=0), rows.std(axis=0), [])
    given = [torch.tensor(values, dtype=torch.float32) for values in (rule.scaled(rows), truth, importance)]
    for seed in range(networks):
        torch.manual_seed(seed)
        linear = [torch.nn.Linear(*size) for size in ((rows.shape[1], HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, 1))]
        network = torch.nn.Sequential(linear[0], torch.nn.Softsign(), linear[1], torch.nn.Softsign(), linear[2])
        train(network, *given, steps)
        layers = [torch.column_stack([one.weight, one.bias]).detach().double().numpy() for one in linear]
        rule.networks.append(layers)
    return rule


def train(network, values, wanted, weight, steps):
    """Fits a network to values (N, K) and whether these are of scenes (N,), by cross entropy with weights (N,)."""
    optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    loss_of = torch.nn.functional.binary_cross_entropy_with_logits
    for _ in range(steps):
        loss = loss_of(network(values)[:, 0], wanted, weight, reduction="sum")
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()


def main(argv=None):
    words = {
        "corpus": dict(type=Path, help="folder with objects and scenes, train and val"),
        "-o": dict(dest="output", required=True, help="file of the networks"),
        "--made": option(1000, "made scenes, and views of made objects"),
        "--seed": option(1, "of the choices"),
    }
    arguments = parser_of("cloud_kind", __doc__, words).parse_args(argv)
    rng = np.random.default_rng(arguments.seed)
    groups = training_groups(arguments.corpus, arguments.made, rng)
    rule = fit(list(groups.values()))
    rule.write(arguments.output)
    for name, (rows, _) in (groups | judging_groups(arguments.corpus, rng)).items():
        print(f"{name}: {np.sum(rule.score(rows) > 0)} of {len(rows)} are taken for scenes")


if __name__ == "__main__":
    main()
