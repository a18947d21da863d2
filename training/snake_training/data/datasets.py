"""Collections of clouds: `len(shapes)` and `shapes.cloud(rng) -> (M, 3) float32` for training, `shapes[i]` to evaluate."""

import json
from pathlib import Path

import numpy as np

from ..augment import choose, normalize
from ..progress import bar
from .official import Bodies, clouds_below, clouds_of_split
from .shapes import Procedural

# Errors of `numpy.load` for content that is no array.
NPY_ERRORS = (OSError, ValueError, EOFError, TypeError, OverflowError)


HELD_BACK = "animal", "character", "bone"  # categories of `kinds` in `write_halves`


class ShapeError(ValueError):
    """Data that hold no shapes to train or evaluate on; the message names the file or folder."""


class CloudError(ShapeError):
    """One file of a folder that holds no shape; the others can be used without it."""


class Corpus:
    """A folder with `points.npy`, int16 (S, M, 3), one unit sphere a row (p / 32767), and `index.json`."""

    def __init__(self, folder):
        folder = Path(folder)
        self.points = read_npy(folder / "points.npy")
        try:
            self.index = json.loads((folder / "index.json").read_text())
        except (OSError, ValueError) as error:
            raise ShapeError(f"{folder}/index.json: {error}") from error
        if self.points.dtype != np.int16 or self.points.ndim != 3 or self.points.shape[2] != 3 or not self.points.size:
            raise ShapeError(
                f"{folder}/points.npy: expected int16 (S, M, 3), found {self.points.dtype} {self.points.shape}"
            )
        if len(self.index) != len(self.points):
            raise ShapeError(f"{folder}: index.json has {len(self.index)} rows, points.npy has {len(self.points)}")

    def __len__(self):
        return len(self.points)

    def __getitem__(self, row):
        return self.points[row].astype(np.float32) / 32767

    def cloud(self, rng):
        """A random shape."""
        return self[rng.integers(len(self))]


class Folder:
    """All `.npy`, `.ply` and `.pcd` clouds below a folder, or those of a list, one shape a file; meshes are sampled on
    their surface."""

    def __init__(self, folder, mesh_points=8192, split=""):
        if not Path(folder).is_dir():
            raise ShapeError(f"{folder}: no such folder")
        try:
            self.files = clouds_of_split(folder, split) if split else clouds_below(folder)
        except (OSError, ValueError) as error:
            raise ShapeError(str(error)) from error
        self.mesh_points = mesh_points
        if not self.files:
            raise ShapeError(f"{folder}: neither points.npy + index.json nor any .npy, .ply or .pcd file")

    def __len__(self):
        return len(self.files)

    def __getitem__(self, row):
        path = self.files[row]
        kind = path.suffix.lower()
        try:
            points = (
                read_npy(path) if kind == ".npy" else read_pcd(path) if kind == ".pcd" else self.read_ply(path, row)
            )
            return finite_points(points, path)
        except ShapeError as error:
            raise CloudError(str(error)) from error

    def read_ply(self, path, seed):
        """The vertices of a cloud, or points drawn from a mesh's surface by area."""
        import trimesh  # the only use; a machine that trains on packed points need not have it

        try:
            shape = trimesh.load(path, process=False)
            if len(getattr(shape, "faces", ())) > 0:
                return trimesh.sample.sample_surface(shape, self.mesh_points, seed=seed)[0]
            return np.asarray(shape.vertices)
        except Exception as error:  # whatever trimesh's parser trips over
            raise ShapeError(f"{path}: not a readable PLY ({error})") from error

    def cloud(self, rng):
        """A random file's cloud."""
        return self[rng.integers(len(self))]


class Mixture:
    """A share of procedural shapes, the rest uniformly over all shapes of the other collections; rows are theirs."""

    def __init__(self, collections, procedural_share):
        self.collections = collections
        self.share = procedural_share if collections else 1.0
        self.procedural = Procedural()

    def cloud(self, rng):
        """A random shape."""
        if rng.random() < self.share:
            return self.procedural.cloud(rng)
        return self[rng.integers(len(self))]

    def __len__(self):
        return sum(map(len, self.collections))

    def __getitem__(self, row):
        for shapes in self.collections:
            if row < len(shapes):
                return shapes[row]
            row -= len(shapes)
        raise IndexError("row beyond the last collection")


def read_npy(path):
    """An array, mapped from its file: its header is checked against its length, nothing is unpickled."""
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except NPY_ERRORS as error:
        raise ShapeError(f"{path}: not a readable NPY ({error})") from error


def read_pcd(path):
    """The points (N, 3) of a PCD file."""
    try:
        import snake_rs  # the only use
    except ImportError as error:
        raise OSError(f"{path}: PCD files need the module snake_rs, see README.md: {error}") from error
    try:
        return snake_rs.read_points(path)
    except Exception as error:  # whatever the reader refuses
        raise ShapeError(str(error)) from error


def finite_points(points, name):
    """The finite points (N, 3) of an array that may have further columns, near zero and without outliers."""
    if points.dtype.kind not in "fiu" or points.ndim != 2 or points.shape[1] < 3:
        raise ShapeError(f"{name}: expected (N, 3) numbers, found {points.dtype} {points.shape}")
    if len(points) in (3, 4) and points.shape[1] > 16:
        raise ShapeError(f"{name}: a point is a row, so transpose {points.shape[1]} points in {len(points)} rows")
    points = points[:, :3].astype(np.float64)
    points = near_zero(points[np.isfinite(points).all(axis=1)]).astype(np.float32)
    if len(points) < 2 or (points == points[0]).all():
        raise ShapeError(f"{name}: needs at least two different finite points")
    return points


def near_zero(points):
    """Finite points (N, 3) float64 without outliers, and about their middle if float32 would lose digits where they lie.

    Outliers and "far" are those of `snake_core`: more than 5 times as far from the middle as 0.95 of the points, and a
    middle at more than 16 times the cloud's size.
    """
    if len(points) == 0:
        return points
    middle = np.median(points, axis=0)
    distance = np.linalg.norm(points - middle, axis=1)
    common = np.quantile(distance, 0.95, method="inverted_cdf")
    if len(points) >= 20 and common > 0:
        points, distance = points[distance <= 5 * common], distance[distance <= 5 * common]
    is_far = np.abs(middle).max() > 16 * 2 * distance.max()
    return points - middle if is_far else points


def open_shapes(folder, split=""):
    """A corpus or a body model if the folder holds it, else a folder of clouds; a list may name some of them."""
    folder = Path(folder)
    bodies = [path for path in (folder / "model.npz", folder / "model.pkl") if path.exists()]
    if not split and (folder / "points.npy").exists():
        return Corpus(folder)
    if not split and bodies:
        try:
            return Bodies(bodies[0])
        except ValueError as error:
            raise ShapeError(str(error)) from error
    return Folder(folder, split=split)


def open_all(folders, splits):
    """The shapes of folders, each with its list, if lists are given."""
    if splits and len(splits) != len(folders):
        raise ShapeError(f"{len(splits)} lists for {len(folders)} folders: give a list for each")
    return [open_shapes(folder, split) for folder, split in zip(folders, splits or [""] * len(folders))]


def write_corpus(folder, shapes, points=8192):
    """A corpus folder of shapes: each about its mean, its farthest point at distance 1, `points` of its points."""
    folder = Path(folder)
    stored = np.empty((len(shapes), points, 3), np.int16)
    for row in bar(range(len(shapes)), unit="shape"):
        cloud = choose(np.random.default_rng(row), shapes[row], points)
        stored[row] = (normalize(cloud)[0] * 2 * 32767).round()
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "points.npy", stored)
    (folder / "index.json").write_text(json.dumps([{"name": f"shape-{row}"} for row in range(len(shapes))]))


def write_halves(folder, corpus):
    """Three corpus folders from one, by the order of its rows; returns the numbers of their objects as a line.

    `choose` and `judge` hold every other object of the common categories: settings and weights are chosen by the first, reported by
    the second. `kinds` holds the objects of categories that take part in no choice.
    """
    corpus = Corpus(corpus)
    kinds = [row for row, entry in enumerate(corpus.index) if entry.get("category") in HELD_BACK]
    common = [row for row, entry in enumerate(corpus.index) if entry.get("category") not in HELD_BACK]
    parts = {"choose": common[::2], "judge": common[1::2], "kinds": kinds}
    for name, rows in parts.items():
        part = Path(folder) / name
        part.mkdir(parents=True, exist_ok=True)
        np.save(part / "points.npy", corpus.points[rows])
        (part / "index.json").write_text(json.dumps([corpus.index[row] for row in rows]))
    return [json.dumps({name: len(rows) for name, rows in parts.items()})]
