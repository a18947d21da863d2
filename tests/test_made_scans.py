"""Registration of made scans, and of the real sweeps of `../shared/data` where they are: true priors, scenes that repeat."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

import snake_rs

ROOT = Path(__file__).parents[1]
SWEEPS = ROOT.parent / "shared" / "data" / "sweeps"


def made_pairs(generate):
    """Pairs of scans of two furnished rooms: source, target, and the true `t_target_source` (4, 4). Up is z, the sensor the origin."""
    rays = generate.turn(np.linspace(-60, 40, 60), 180)
    pairs = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        room, scans = generate.furnished_room(rng), []
        for origin, degrees in (([1.0, 2.6, 1.5], 20), ([2.6, 2.9, 1.4], 130), ([3.9, 2.6, 1.6], 250)):
            pose = np.eye(4)
            c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
            pose[:2, :2], pose[:3, 3] = [[c, -s], [s, c]], origin
            scans.append((generate.scanned(room, origin, degrees, rays, 8, 0.004, rng).astype(np.float32), pose))
        for (source, from_source), (target, from_target) in itertools.combinations(scans, 2):
            pairs.append((source, target, np.linalg.inv(from_target) @ from_source))
    return pairs


def real_pairs(_):
    if not SWEEPS.is_dir():
        pytest.skip("the real sweeps are not public: they are not registered")
    cloud = {path.stem: np.load(path) for path in SWEEPS.glob("*.npy")}
    rows = json.loads((SWEEPS / "pairs.json").read_text())
    return [(cloud[row["source"]], cloud[row["target"]], np.array(row["T"])) for row in rows]


PRIORS = {
    "gravity": {"gravity": "z"},
    "viewpoints": {"source_viewpoint": [0, 0, 0], "target_viewpoint": [0, 0, 0]},
}


def counts(pairs, limit, prior):
    """The numbers of pairs that are right, within a limit (metres) and 5 degrees, and of right pairs that are reliable."""
    right = reliable = 0
    for source, target, truth in pairs:
        result = snake_rs.register(source, target, **prior)
        error = result.t_target_source @ np.linalg.inv(truth)
        degrees = np.degrees(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)))
        is_right = degrees < 5 and np.linalg.norm(error[:3, 3]) < limit
        right += is_right
        reliable += is_right and result.verdict.is_reliable
        assert is_right or not result.verdict.is_reliable
    return right, reliable


@pytest.mark.parametrize("pairs, limit", [(made_pairs, 0.1), (real_pairs, 0.6)], ids=["made rooms", "real sweeps"])
def test_pairs_with_a_true_prior_are_right_no_less_often(pairs, limit, generate):
    pairs = pairs(generate)
    without = counts(pairs, limit, {})
    assert without[0] > 0
    for name, prior in PRIORS.items():
        right, reliable = counts(pairs, limit, prior)
        assert right >= without[0] and reliable >= without[1], f"{name}: {right}, {reliable}; without {without}"


def windows(box):
    """A wall with windows every 1.5 m, and ground."""
    columns = itertools.product(np.arange(-19.5, 21, 1.5), (2, 5, 8))
    return [box([0, 9, 6], [80, 0.3, 12])] + [box([x, 8.7, z], [1.2, 0.3, 1.5]) for x, z in columns]


def fence(box):
    """A fence with posts every 2 m, and ground."""
    posts = [box([x, 4, 0.9], [0.2, 0.2, 1.8]) for x in np.arange(-19, 20, 2)]
    return posts + [box([0, 4, z], [80, 0.06, 0.1]) for z in (0.5, 1.5)]


@pytest.mark.parametrize(
    "scene, columns, metres",
    [
        *((windows, 500, metres) for metres in (1.05, 1.5, 3.0)),
        # The first two put the sensors at one point, where their rays coincide on the ground.
        *((fence, 800, metres) for metres in (1.2, 2.15, 2.65)),
    ],
)
def test_places_that_repeat_are_ambiguous_wherever_the_sensor_stood(scene, columns, metres, generate):
    boxes = [generate.box([0, 0, -0.1], [80, 30, 0.2]), *scene(generate.box)]
    rays, rng = generate.turn(np.linspace(-45, 45, 48), columns), np.random.default_rng(0)
    source, target = (generate.scanned(boxes, [x, 0, 1.4], 0, rays, 14, 0.008, rng) for x in (0, metres))
    result = snake_rs.register(source, target)
    assert not result.verdict.is_reliable and result.verdict.is_ambiguous
    assert any("repeats itself" in note for note in result.verdict.notes)
