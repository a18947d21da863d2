"""Data sets and their layouts on disk: objects, pairs of clouds, annotated shapes, bodies, and scenes of fragments.

Opening a data set reads its lists; clouds are read when they are needed. What does not follow its layout is a ValueError.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..data import Folder, open_shapes
from ..data.official import Bodies, names_of_split
from .arrays import moved, transform_of
from .views import spaced, unit_radius

EVALUATION = "-evaluation"  # suffix of the folder with a scene's ground truth
# Whether the clouds of a pair meet: points that are looked at, how near the other cloud is in resolutions, and their least share. Of 97
# pairs of rooms with overlaps from 0.11 on, the least was 0.14, and 0.02 in the middle under wrong transforms.
MEETING_POINTS, REACH, MEETING_SHARE, MEETING_PAIRS = 500, 3.0, 0.05, 50
# The bodies of SMPL: their number, samples, and the widths of the ranges of random numbers from 0 to 1 about 0.
BODY_PAIRS, BODY_SAMPLES, POSE_RANGE, BETA_RANGE, BETAS = 100, 2048, 0.4, 0.06, 10


def read_cloud(path):
    """The finite points (N, 3) of a file, whose path may lack the extension."""
    import snake_rs

    path = Path(path)
    found = [path] if path.is_file() else sorted(path.parent.glob(f"{path.name}.*"))
    if not found:
        raise ValueError(f"{path}: no such cloud")
    points = snake_rs.read_points(found[0])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        raise ValueError(f"{found[0]}: a cloud without points")
    return points


def read_json(path):
    """The content of a JSON file."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def without_ending(name):
    """The name of a cloud's file without the extension of a known format."""
    stem, dot, ending = str(name).rpartition(".")
    return stem if dot and ending in ("npy", "ply", "pcd", "bin", "xyz", "las", "laz", "e57") else str(name)


@dataclass(frozen=True)
class ViewData:
    """Objects, or pairs of clouds, for repeatability."""

    scale: str  # the units: "object" of radius 1, "annotated" as KeypointNet has them, "room" in metres
    names: list  # of the pairs
    clouds: Callable  # row -> an object (N, 3), or (cloud 1, cloud 2, t_1_2)
    files: list = None  # of the two clouds of each pair, as keypoints of other programs name them; None for objects

    def __len__(self):
        return len(self.names)


def open_views(folder, split=""):
    """The data set of a folder, by its layout:

    | layout | content |
    |---|---|
    | pairs | `pairs.json`, in metres: [{"source": "a.ply", "target": "b.ply", "T": 4x4}, ..]; T maps the source to the target, view 1 |
    | Redwood (USIP) | `redwood_pair.txt` with lines `SCENE i j`, `SCENE/i.npy`, `transform.npy`, whose rows map cloud j to cloud i, view 1 |
    | ModelNet40 (USIP) | `original/i.npy`, `rotated/i.npy`, `transform.npy`, whose row i maps the rotated object to the original |
    | KeypointNet | with `split`, a file of names CLASS-SHAPE: the clouds `CLASS/SHAPE.pcd`, in the units of their files |
    | objects | all that `snake_training.data.open_shapes` opens, each scaled to radius 1 |
    """
    folder = Path(folder)
    if split:
        shapes = Folder(folder, split=split)
        return ViewData("annotated", [path.stem for path in shapes.files], shapes.__getitem__)
    if (folder / "pairs.json").exists():
        rows = [(pair["target"], pair["source"], pair["T"]) for pair in listed_pairs(folder)]
        return pairs_of(folder, "room", rows)
    if (folder / "redwood_pair.txt").exists():
        lines = [line.split() for line in names_of_split(folder / "redwood_pair.txt")]
        if any(len(line) != 3 for line in lines):
            raise ValueError(f"{folder}/redwood_pair.txt: expected lines SCENE i j")
        names = [(f"{scene}/{first}", f"{scene}/{second}") for scene, first, second in lines]
        return pairs_of(folder, "room", with_transforms(folder, names))
    if (folder / "original").exists() and (folder / "rotated").exists():
        number = len(np.load(folder / "transform.npy"))
        return pairs_of(
            folder, "object", with_transforms(folder, [(f"original/{i}", f"rotated/{i}") for i in range(number)])
        )
    shapes = open_shapes(folder)
    index = getattr(shapes, "index", None) or getattr(shapes, "files", None) or range(len(shapes))
    names = [row["name"] if isinstance(row, dict) else str(row) for row in index]
    return ViewData("object", names, lambda row: unit_radius(shapes[row]))


def listed_pairs(folder):
    """The rows of pairs.json."""
    pairs = read_json(Path(folder) / "pairs.json")
    is_row = isinstance(pairs, list) and all({"source", "target", "T"} <= set(row) for row in pairs)
    if not is_row or not pairs:
        raise ValueError(f"{folder}/pairs.json: expected a list of pairs with source, target and T")
    return pairs


def with_transforms(folder, names):
    """Pairs of names, each with its row of transform.npy (S, 3, 4) or (S, 4, 4)."""
    transforms = np.load(folder / "transform.npy")
    if (
        transforms.ndim != 3
        or transforms.shape[1:] not in ((3, 4), (4, 4))
        or len(transforms) != len(names)
        or not names
    ):
        raise ValueError(f"{folder}/transform.npy: shape {transforms.shape} for {len(names)} pairs")
    bottom = np.broadcast_to([[0, 0, 0, 1]], (len(names), 1, 4))
    return [(*pair, row) for pair, row in zip(names, np.concatenate([transforms[:, :3], bottom], axis=1))]


def pairs_of(folder, scale, rows):
    """The pairs (cloud of view 1, cloud of view 2, transform) of a folder."""
    transforms = [transform_of(f"{folder}: {second} to {first}", transform) for first, second, transform in rows]
    return ViewData(
        scale,
        [f"{second} to {first}" for first, second, _ in rows],
        lambda row: (read_cloud(folder / rows[row][0]), read_cloud(folder / rows[row][1]), transforms[row]),
        [(without_ending(first), without_ending(second)) for first, second, _ in rows],
    )


def meeting_shares(source, target, t_target_source):
    """The shares of the source points (N, 3) near the target (M, 3) under a transform and under its inverse."""
    trees = cKDTree(source), cKDTree(target)
    gaps = [tree.query(tree.data, 2)[0][:, 1].mean() if tree.n > 1 else 0.0 for tree in trees]
    some = source[:: -(-len(source) // MEETING_POINTS)]
    shares = (
        trees[1].query(moved(some, t))[0] <= REACH * max(gaps)
        for t in (t_target_source, np.linalg.inv(t_target_source))
    )
    return tuple(float(share.mean()) for share in shares)


def apart_note(names, clouds, rows):
    """A sentence that names pairs whose clouds do not meet, of at most 50 of the rows; None if all do.

    clouds: row -> (target, source, t_target_source). The figures of such pairs are near zero for every method.
    """
    looked_at = [rows[i] for i in spaced(len(rows), MEETING_PAIRS)]
    apart, inverse = [], 0
    for row in looked_at:
        target, source, transform = clouds(row)
        share, other = meeting_shares(source, target, transform)
        is_inverse = other >= 2 * MEETING_SHARE and other > 2 * share
        if is_inverse or share < MEETING_SHARE:
            apart.append(f"{names[row]} (share of points that meet {share:.2f}, under the inverse {other:.2f})")
            inverse += is_inverse
    if not apart:
        return None
    advice = (
        "the transforms map the wrong way: they must map the source to the target, into the first view"
        if 2 * inverse > len(apart)
        else "are the transforms of these pairs, from the source to the target, and in the clouds' unit?"
    )
    more = f", and {len(apart) - 3} more" if len(apart) > 3 else ""
    return (
        f"the clouds of {len(apart)} of {len(looked_at)} pairs do not overlap: {', '.join(apart[:3])}{more}; {advice}"
    )


@dataclass(frozen=True)
class Shape:
    """A cloud of KeypointNet with the indices of its annotated points."""

    name: str  # CLASS-SHAPE
    kind: str  # the name of the annotation file, such as chair
    path: Path
    keypoints: list


def open_semantic(folder, split=""):
    """The data set of semantic consistency of a folder, by its layout: a list of `Shape`, or a function row, rng -> two bodies with its
    number of pairs.

    | layout | content |
    |---|---|
    | KeypointNet | `annotations/CLASS.json` and the clouds `CLASS_ID/MODEL_ID.pcd`, in `pcds/` or in the folder itself; `split` lists names |
    | SMPL | `model.npz` or `model.pkl`, also of SMPL+H and SMPL-X; `pose_test_100.npy`, `beta_test_100.npy` where they are |
    | bodies | `body_1.npy`, `body_2.npy` (S, N, 3): row i of both is the same point of the surface |
    """
    folder = Path(folder)
    if (folder / "annotations").is_dir():
        return annotated_shapes(folder, split)
    if split:
        raise ValueError(f"{folder}: a split is for KeypointNet, and this is another data set")
    models = (
        [folder]
        if folder.is_file()
        else [path for path in (folder / "model.npz", folder / "model.pkl") if path.exists()]
    )
    if models:
        return posed_bodies(models[0])
    files = [folder / "body_1.npy", folder / "body_2.npy"]
    if not all(path.exists() for path in files):
        raise ValueError(
            f"{folder}: neither annotations/ (KeypointNet) nor model.npz or body_1.npy and body_2.npy (SMPL)"
        )
    first, second = (np.load(path, mmap_mode="r") for path in files)
    if first.shape != second.shape or first.ndim != 3 or not first.size:
        raise ValueError(f"{folder}: body_1.npy {first.shape}, body_2.npy {second.shape}; expected (S, N, 3) twice")
    return (lambda row, _rng: (first[row], second[row])), len(first)


def annotated_shapes(folder, split=""):
    """The annotated shapes of KeypointNet, class by class."""
    pcds = folder / "pcds"
    clouds, shapes = pcds if pcds.is_dir() else folder, []
    for path in sorted((folder / "annotations").glob("*.json")):
        if path.stem == "all":
            continue
        try:
            for row in read_json(path):
                keypoints = [mark["pcd_info"]["point_index"] for mark in row["keypoints"]]
                kind, model = row["class_id"], row["model_id"]
                shapes.append(Shape(f"{kind}-{model}", path.stem, clouds / kind / f"{model}.pcd", keypoints))
        except (KeyError, TypeError) as error:
            raise ValueError(f"{path}: an entry lacks {error}") from error
    if split:
        known = {shape.name: shape for shape in reversed(shapes)}
        names = set(names_of_split(split))
        if not names <= set(known):
            raise ValueError(f"{split}: {min(names - set(known))} is not among the annotations")
        shapes = [shape for shape in shapes if shape.name in names and known[shape.name] is shape]
    if not shapes:
        raise ValueError(f"{folder}/annotations: no annotated shapes")
    return shapes


def posed_bodies(path):
    """Pairs of bodies in metres of a body model, sampled at the same points, uniform over the area of the first (SNAKE section 4.1).

    The parameters are numbers from 0 to 1: those of the released code where they lie beside the model, else random ones of 100 pairs.
    """
    model = Bodies(path)
    joints, stored = len(model.parents) + 1, None
    files = [Path(path).parent / name for name in ("pose_test_100.npy", "beta_test_100.npy")]
    if all(file.exists() for file in files):
        stored = [np.load(file) for file in files]
        for file, array, count in zip(files, stored, (3 * joints, BETAS)):
            if array.shape[:2] != (len(stored[0]), 2) or array[0, 0].size != count or not np.isfinite(array).all():
                raise ValueError(
                    f"{file}: shape {array.shape}; expected {count} numbers for each of two bodies of each pair"
                )

    def parameters(row, body, rng):
        if stored:
            return [array[row, body].reshape(-1) for array in stored]
        return [rng.random(3 * joints), rng.random(BETAS)]

    def bodies(row, rng):
        vertices = []
        for body in range(2):
            pose, betas = parameters(row, body, rng)
            vertices.append(model.vertices((pose.reshape(-1, 3) - 0.5) * POSE_RANGE, (betas - 0.5) * BETA_RANGE))
        corners = vertices[0][model.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        faces = model.faces[rng.choice(len(area), BODY_SAMPLES, p=area / area.sum())]
        u, v = rng.random((2, BODY_SAMPLES, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        weights = np.stack([1 - u - v, u, v], axis=1)
        return tuple((some[faces] * weights).sum(axis=1).astype(np.float32) for some in vertices)

    return bodies, len(stored[0]) if stored else BODY_PAIRS


@dataclass(frozen=True)
class ScenePair:
    """Two fragments of a scene."""

    scene: str
    source: Path
    target: Path
    fragments: tuple  # their numbers; those without have two that are not consecutive
    t_target_source: np.ndarray
    information: np.ndarray = None  # of gt.info; None if it follows from the overlap

    def __str__(self):
        return f"{self.source} to {self.target}"


def open_scenes(folder):
    """The pairs of a folder with pairs.json, of a scene of the 3DMatch benchmark, or of a folder of scenes.

    A scene has the fragments `cloud_bin_0.ply`, .. and the files `gt.log` and `gt.info`, beside them or in the folder `SCENE-evaluation`. In
    pairs.json a fragment named `SCENE_NUMBER` belongs to that scene.
    """
    folder = Path(folder)
    if (folder / "pairs.json").exists():
        return [listed_scene_pair(folder, row) for row in listed_pairs(folder)]
    inner = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.endswith(EVALUATION))
    scenes = [folder] if ground_truth(folder) else [scene for scene in inner if ground_truth(scene)]
    pairs = [pair for scene in scenes for pair in scene_pairs(scene, ground_truth(scene))]
    if not pairs:
        raise ValueError(f"{folder}: no pairs (looked for pairs.json, gt.log, and folders with gt.log)")
    return pairs


def listed_scene_pair(folder, row):
    """A pair of pairs.json."""
    (first, i), (second, j) = (fragment(row[side]) for side in ("source", "target"))
    is_scene = first == second and i is not None and j is not None
    scene, numbers = (first, (i, j)) if is_scene else (folder.name, (0, 2))
    transform = transform_of(f"{folder}/pairs.json: T of {row['source']}", row["T"])
    return ScenePair(scene, folder / row["source"], folder / row["target"], numbers, transform)


def fragment(name):
    """The scene and the number in a fragment's name, such as SCENE_7 or SCENE_7.ply; the number may be None."""
    stem = Path(without_ending(name)).name
    scene = stem.rstrip("0123456789")
    return scene.rstrip("_-"), int(stem[len(scene) :]) if len(scene) < len(stem) else None


def ground_truth(scene):
    """The folder that holds a scene's gt.log, or None."""
    places = scene, scene.with_name(scene.name + EVALUATION)
    return next((place for place in places if (place / "gt.log").is_file()), None)


def scene_pairs(scene, truth):
    """The pairs of gt.log: its entry `i j n` has the transform from fragment j to fragment i."""
    information = dict(entries(truth / "gt.info", 6))
    for (target, source), matrix in entries(truth / "gt.log", 4):
        if (target, source) not in information:
            raise ValueError(f"{truth}/gt.info: no entry for the pair {target} {source} of gt.log")
        transform = transform_of(f"{truth}/gt.log: pair {target} {source}", matrix)
        files = [scene / f"cloud_bin_{number}" for number in (source, target)]
        yield ScenePair(scene.name, *files, (target, source), transform, information[target, source])


def entries(path, size):
    """The entries of a .log or .info file: the numbers of two fragments, a third number, and a matrix."""
    words = path.read_text(encoding="utf-8-sig").split()
    if len(words) % (3 + size * size):
        raise ValueError(f"{path}: ends within an entry")
    try:
        rows = np.array(words, np.float64).reshape(-1, 3 + size * size)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return [((int(row[0]), int(row[1])), row[3:].reshape(size, size)) for row in rows]
