"""Fits the map from a keypoint to the probability that another view finds it again, and writes it into a weight file:

    python -m snake_training.confidence compact.safetensors --objects CORPUS/val --rotations 1 4
    python -m snake_training.confidence scenes.safetensors --pairs ROOMS STREETS --test SCENES

The score counts, and how well the points determine the place: each halving of the standard deviation along a direction adds to the
score, but for the direction that is known best, as across a wall. So does each doubling of the reach in voxels.
Pairs are used as they are, thinned, with noise, and downsampled to one point a cell. Half of the objects or of the pairs is for the fit, the other half for the
expected calibration error that is printed; folders of `--test` are only for that. Detection is that of snake-rs with the options
that the file recommends. A keypoint is found again if one of the other view lies within 4 % of the radius of an object, or two
voxels of a scene, at most a 104th of its diagonal. In a scene only keypoints count whose place the other view saw: one of its points
lies within a voxel. The tensors and their digest stay.
"""

import json
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import load_file, save, save_file
from scipy.spatial import cKDTree

from .arguments import option, parser_of
from .augment import choose
from .data import open_shapes
from .evaluation.views import view_pairs
from .export import replacing

OBJECT_REACH, SCENE_REACH, SEEN = 0.04, 2.0, 1.0  # radii; voxels; voxels
SCENE_SHARE = 104  # the reach is at most this part of a scene's diagonal: sparse points have large voxels
PROBE = {"knots": [[-1.0, 0.0], [63.0, 1.0]], "precision": 1.0}  # with it, confidences say what the map is given
MIN_SCORE_WEIGHT = 0.1  # of the logistic function
# One point in so many is left, or for 0 the first in each cell; standard deviation of noise, metres.
DEGRADED = (1, 0.0), (8, 0.0), (4, 0.01), (32, 0.0), (0, 0.0)
CELL = 1.5  # side of these cells, in voxels of the whole cloud: users downsample sweeps so
MIN_POINTS = 2000  # of a thinned cloud
RIDGE = 1e-6


def repeated(points, others, reach):
    """Whether each of the keypoints (K, 3) has one of the others (L, 3) within `reach`: (K,)."""
    return cKDTree(others).query(points)[0] <= reach if len(others) else np.zeros(len(points), bool)


def features_of(keypoints, reach=1.0):
    """The score, how often the standard deviations are halved, and the reach doubled, of keypoints of a `probe`: (K, 3)."""
    (low, _), (high, _) = PROBE["knots"]
    evidence = low + (high - low) * keypoints.confidence
    doublings = np.full(len(keypoints), np.log2(reach))
    return np.column_stack([keypoints.saliency, evidence - keypoints.saliency, doublings])


def of_objects(model, shapes, number, points, rotations):
    """A list of (features (K, 3), whether found again (K,)) of objects, both of whose views are turned and sampled anew."""
    rows = []
    for views in view_pairs(shapes, number, points, 0):
        clouds = views.view_1, views.view_2
        found = [model.encode(cloud.astype(np.float32), rotations=rotations).detect() for cloud in clouds]
        moved = found[1].points @ views.t_1_2[:3, :3].T
        hits = repeated(found[0].points, moved, OBJECT_REACH), repeated(moved, found[0].points, OBJECT_REACH)
        rows.append((np.concatenate([features_of(view) for view in found]), np.concatenate(hits)))
    return rows


def of_pairs(model, folder, number, degraded=DEGRADED):
    """A list of (features (K, 3), whether found again (K,)) for pairs of scenes, from a folder with `pairs.json`, in turn as they are and
    degraded."""
    listed, rows = json.loads((folder / "pairs.json").read_text()), []
    for row in np.linspace(0, len(listed) - 1, min(number, len(listed))).round().astype(int):
        pair = listed[row]
        matrix, features, hits = np.array(pair.get("T_icp") or pair["T"]), [], []
        for share, noise in degraded:
            rng = np.random.default_rng([row, share])
            both = []
            for end in ("source", "target"):
                points = np.load(folder / f"{pair[end]}.npy")[:, :3].astype(np.float32)
                if share:
                    points = choose(rng, points, max(len(points) // share, min(len(points), MIN_POINTS)))
                else:
                    cells = np.floor(points / (CELL * model.encode(points).detect().voxel_size))
                    points = points[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
                points += rng.normal(0, noise, points.shape).astype(np.float32)
                both.append((model.encode(points).detect(), cKDTree(points)))
            for (view, own), (other, tree), t in zip(both, both[::-1], (matrix, np.linalg.inv(matrix)), strict=True):
                moved = view.points @ t[:3, :3].T + t[:3, 3]
                is_seen = tree.query(moved)[0] <= SEEN * other.voxel_size
                diagonal = np.linalg.norm(np.ptp(own.data, axis=0))
                reach = min(SCENE_REACH * view.voxel_size, diagonal / SCENE_SHARE)
                features.append(features_of(view, reach / view.voxel_size)[is_seen])
                hits.append(repeated(moved[is_seen], other.points, reach))
        rows.append((np.concatenate(features), np.concatenate(hits)))
    return rows


def worths_of(features, hits, weights):
    """What each feature (K, F) is worth beside the first one, by a logistic function of them, fitted by Newton's method: (F,)."""
    columns, found = np.column_stack([np.ones(len(features)), features]), np.zeros(features.shape[1] + 1)
    for _ in range(50):
        probability = 1 / (1 + np.exp(-columns @ found))
        slope = columns.T @ (weights * (hits - probability)) - RIDGE * found
        curvature = (columns * (weights * probability * (1 - probability))[:, None]).T @ columns
        found += np.linalg.solve(curvature + RIDGE * np.eye(len(found)), slope)
    return np.array([1.0, *(found[2:].clip(0) / max(found[1], MIN_SCORE_WEIGHT)).round(4)])


def isotonic(values, weights):
    """The non-decreasing sequence nearest to `values` (N,) by weighted squares: pool adjacent violators."""
    blocks = []
    for value, weight in zip(values, weights, strict=True):
        blocks.append([value, weight, 1])
        while len(blocks) > 1 and blocks[-2][0] >= blocks[-1][0]:
            value, weight, length = blocks.pop()
            last = blocks[-1]
            last[0] = (last[0] * last[1] + value * weight) / (last[1] + weight)
            last[1] += weight
            last[2] += length
    return np.concatenate([np.full(length, value) for value, _, length in blocks])


def fit(scores, hits, weights, number=40):
    """At most `number` rising knots (K, 2) of score and probability: scores in bins of equal weight, isotonic; bins of one
    probability are joined."""
    order = scores.argsort()
    share = np.cumsum(weights[order]) / weights.sum()
    bins = np.minimum((share * number).astype(int), number - 1)
    mean = lambda values, of: (values * of).sum() / of.sum()
    rows = [order[bins == one] for one in range(number) if (bins == one).any()]
    found = isotonic([mean(hits[row], weights[row]) for row in rows], [weights[row].sum() for row in rows])
    knots = []
    for probability in np.unique(found):
        row = np.concatenate([row for row, one in zip(rows, found, strict=True) if one == probability])
        knots.append([round(float(mean(scores[row], weights[row])), 4), round(float(probability), 4)])
    return [knot for knot, last in zip(knots, [None, *knots]) if last is None or knot[0] > last[0]]


def calibration_error(knots, scores, hits, bins=10):
    """The expected calibration error: the mean distance of mean confidence and share found again, in bins of equal number."""
    confidence = np.interp(scores, *np.transpose(knots))
    parts = np.array_split(scores.argsort(), bins)
    return sum(len(part) * abs(confidence[part].mean() - hits[part].mean()) for part in parts if len(part)) / len(
        scores
    )


def joined(rows):
    """Features and hits of all rows."""
    return tuple(np.concatenate(column) for column in zip(*rows, strict=True))


def write_map(path, fitted):
    """Writes the map into a weight file's metadata; nothing else changes."""
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    with replacing(path) as temporary:
        save_file(tensors, temporary, metadata=metadata | {"confidence": json.dumps(fitted)})


def probe(path):
    """The model of a weight file with the map `PROBE`, and without the `min_confidence` that it recommends: the map is fitted to all
    keypoints."""
    import snake_rs

    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
    options = json.loads(metadata.get("recommended_options") or "{}")
    options.get("detect", {}).pop("min_confidence", None)
    metadata |= {"recommended_options": json.dumps(options), "confidence": json.dumps(PROBE)}
    return snake_rs.Model.from_bytes(save(load_file(path), metadata))


def fit_map(path, objects="", pairs=(), test=(), number=200, num_points=5000, rotations=(1,), write=True):
    """Fits the map of a weight file and writes it there; returns it, and of each set of clouds the number of keypoints, the share
    that is found again, and the calibration error. Without keypoints there is no map.

    objects: a corpus folder or a folder of clouds, each measured with all `rotations`. pairs, test: folders of scenes.
    """
    model = probe(path)
    sets = {str(folder): of_pairs(model, Path(folder), number) for folder in pairs}
    if objects:
        shapes = open_shapes(objects)
        for copies in rotations:
            sets[f"{objects}, {copies} rotations"] = of_objects(model, shapes, number, num_points, copies)
    tests = {
        f"{folder}, 1 in {share}, noise {noise}": of_pairs(model, Path(folder), number, [(share, noise)])
        for folder in test
        for share, noise in DEGRADED[:3]
    }
    for name, rows in sets.items():
        if len(rows) < 2:
            raise ValueError(f"{name}: two objects or pairs are needed: half of them are left for measuring")
    fitted = [joined(rows[::2]) for rows in sets.values()]
    features, hits = joined(fitted)
    if not len(features):
        return {"map": None, "sets": {}}
    weights = np.concatenate([np.full(len(part), 1 / max(len(part), 1)) for part, _ in fitted])  # sets count alike
    worths = worths_of(features, hits, weights)
    knots = fit(features @ worths, hits, weights)
    report = {"map": {"knots": knots, "precision": worths[1], "reach": worths[2]}, "sets": {}}
    for name, rows in ({name: rows[1::2] for name, rows in sets.items()} | tests).items():
        features, hits = joined(rows)
        error = calibration_error(knots, features @ worths, hits)
        figures = {"keypoints": len(features), "found_again": float(hits.mean()), "calibration_error": float(error)}
        report["sets"][name] = figures
    if write:
        write_map(path, report["map"])
    return report


def main(argv=None):
    """Command line."""
    arguments = {
        "weights": dict(help="weight file, which gets the map"),
        "--objects": dict(help="corpus folder, or folder of clouds"),
        "--pairs": option([], "folders of scenes with pairs.json", str, nargs="*"),
        "--test": option([], "folders of scenes that are only measured", str, nargs="*"),
        "--number": option(200, "objects, or pairs of a folder, at most"),
        "--num-points": option(5000, "points of an object's view"),
        "--rotations": option([1], "of objects; one map serves all", int, nargs="+"),
        "--dry-run": dict(action="store_true", help="do not write"),
    }
    parser = parser_of("confidence", __doc__, arguments)
    given = vars(parser.parse_args(argv))
    if not given["objects"] and not given["pairs"]:
        parser.error("--objects or --pairs is needed")
    try:
        report = fit_map(given.pop("weights"), write=not given.pop("dry_run"), **given)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    if not report["map"]:
        print("no keypoints were found: the file gets no map")
        return
    print("map", json.dumps(report["map"]))
    for name, found in report["sets"].items():
        print(
            f"{name}: {found['keypoints']} keypoints, {found['found_again']:.3f} found again, "
            f"calibration error {found['calibration_error']:.3f}"
        )


if __name__ == "__main__":
    main()
