"""Collections of clouds: `len(shapes)` and `shapes.cloud(rng) -> (M, 3) float32` for training, `shapes[i]` for evaluation."""

import json
from pathlib import Path

import numpy as np
import trimesh

from .procedural import Procedural


class Corpus:
    """A folder with `points.npy`, int16 (S, M, 3), one unit sphere a row (p / 32767), and `index.json`."""

    def __init__(self, folder):
        folder = Path(folder)
        self.points = np.load(folder / "points.npy", mmap_mode="r")
        self.index = json.loads((folder / "index.json").read_text())
        if self.points.dtype != np.int16 or self.points.ndim != 3 or self.points.shape[2] != 3:
            raise ValueError(f"{folder}/points.npy: expected int16 (S, M, 3), found {self.points.dtype} {self.points.shape}")
        if len(self.index) != len(self.points):
            raise ValueError(f"{folder}: index.json has {len(self.index)} rows, points.npy has {len(self.points)}")

    def __len__(self):
        return len(self.points)

    def __getitem__(self, row):
        return self.points[row].astype(np.float32) / 32767

    def cloud(self, rng):
        """A random shape."""
        return self[rng.integers(len(self))]


class Folder:
    """All `.npy` and `.ply` clouds below a folder, one shape a file; meshes are sampled on their surface."""

    def __init__(self, folder, mesh_points=8192):
        self.files = sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() in (".npy", ".ply"))
        self.mesh_points = mesh_points
        if not self.files:
            raise ValueError(f"{folder}: neither points.npy + index.json nor any .npy or .ply file")

    def __len__(self):
        return len(self.files)

    def __getitem__(self, row):
        path = self.files[row]
        if path.suffix.lower() == ".npy":
            points = np.load(path)
        else:
            shape = trimesh.load(path, process=False)
            has_faces = len(getattr(shape, "faces", ())) > 0
            points = trimesh.sample.sample_surface(shape, self.mesh_points, seed=row)[0] if has_faces else shape.vertices
        points = np.asarray(points, dtype=np.float32)
        if points.ndim != 2 or points.shape[1] < 3:
            raise ValueError(f"{path}: expected (N, 3) points, found {points.shape}")
        points = points[np.isfinite(points[:, :3]).all(axis=1), :3]
        if len(points) < 2 or (points == points[0]).all():
            raise ValueError(f"{path}: needs at least two different finite points")
        return points

    def cloud(self, rng):
        """A random file's cloud."""
        return self[rng.integers(len(self))]


class Mixture:
    """A share of procedural shapes, the rest uniformly over all shapes of the other collections."""

    def __init__(self, collections, procedural_share):
        self.collections = collections
        self.share = procedural_share if collections else 1.0
        self.procedural = Procedural()

    def cloud(self, rng):
        """A random shape."""
        if rng.random() < self.share:
            return self.procedural.cloud(rng)
        row = rng.integers(sum(map(len, self.collections)))
        for shapes in self.collections:
            if row < len(shapes):
                return shapes[row]
            row -= len(shapes)


def open_shapes(folder):
    """A corpus if the folder holds one, else a folder of clouds."""
    return Corpus(folder) if (Path(folder) / "points.npy").exists() else Folder(folder)
