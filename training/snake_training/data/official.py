"""The data of the paper in the layouts they come in: lists of a split, and the bodies of SMPL.

| data | folder | a line of its list |
|---|---|---|
| KeypointNet | CLASS/SHAPE.pcd, here or in pcds/; annotations/ | CLASS-SHAPE |
| ModelNet40 | CLASS/CLASS_0001.npy | CLASS_0001 |
| 3DMatch, Redwood | SCENE/NUMBER.npy or other clouds | SCENE/NUMBER, with or without the ending |
| SMPL | model.pkl or model.npz | (none: bodies are made) |
"""

import pickle
from io import BytesIO
from pathlib import Path

import numpy as np

CLOUDS = ".npy", ".ply", ".pcd"
# Arrays of the layouts of evaluation that are no clouds.
NO_CLOUDS = {"transform.npy", "pose_test_100.npy", "beta_test_100.npy"}


def clouds_below(folder):
    """All files of clouds below a folder, sorted."""
    files = (path for path in Path(folder).rglob("*") if path.suffix.lower() in CLOUDS)
    return sorted(path for path in files if path.name not in NO_CLOUDS)


def clouds_of_split(folder, split):
    """The files of the shapes that a list names, one a line, in its order."""
    names = names_of_split(split)
    if not names:
        raise ValueError(f"{split}: an empty list")
    return [find(roots_of(folder), name) or refuse(folder, split, name) for name in names]


def names_of_split(split):
    """The names of a list, one a line."""
    return [line.strip() for line in Path(split).read_text(encoding="utf-8-sig").splitlines() if line.strip()]


def roots_of(folder):
    """Where the classes of a data set may lie."""
    return [root for root in (Path(folder), Path(folder) / "pcds") if root.is_dir()]


def find(roots, name):
    """The file of a name of a list; None if there is none."""
    kind, _, shape = name.partition("-")
    for stem in (name, f"{kind}/{shape}", f"{name.rpartition('_')[0]}/{name}"):
        for root in roots:
            for ending in ("", *CLOUDS):
                path = root / f"{stem}{ending}"
                if path.suffix.lower() in CLOUDS and path.is_file():
                    return path
    return None


def refuse(folder, split, name):
    """The error for a name without a file."""
    raise ValueError(f"{split}: {name!r} is no cloud below {folder}; is --split the list of this --data?")


class Bodies:
    """Bodies of SMPL in random poses and shapes, (5000, 3), as the released code draws them for training."""

    def __init__(self, path, number=1000, points=5000):
        arrays = body_arrays(path)
        self.template, self.shape, self.pose, self.weights, self.regressor, tree, faces = arrays.values()
        self.faces = faces.astype(int)
        names = tree[1].astype(np.int64).tolist()
        self.parents = [names.index(parent) for parent in tree[0, 1:].astype(np.int64).tolist()]
        self.number, self.points = number, points

    def __len__(self):
        return self.number

    def __getitem__(self, row):
        return self.cloud(np.random.default_rng([row, 0x5317]))

    def cloud(self, rng):
        """A random body: rotation vectors within 0.2 radians, the first ten shape parameters within 0.03."""
        pose = (rng.random((len(self.parents) + 1, 3)) - 0.5) * 0.4
        betas = (rng.random(10) - 0.5) * 0.06
        corners = self.vertices(pose, betas)[self.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        corners = corners[rng.choice(len(area), self.points, p=area / area.sum())]
        u, v = rng.random((2, self.points, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        return (corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v).astype(np.float32)

    def vertices(self, pose, betas):
        """Vertices (V, 3) by linear blend skinning (Loper et al. 2015): pose (K, 3) in radians, betas (B,)."""
        shaped = self.template + self.shape[..., : len(betas)] @ betas
        joints = self.regressor @ shaped
        turns = np.stack([rotation_matrix(vector) for vector in pose])
        posed = shaped + self.pose @ (turns[1:] - np.eye(3)).ravel()
        linear, offset = [turns[0]], [joints[0]]
        for joint, parent in enumerate(self.parents, 1):
            linear.append(linear[parent] @ turns[joint])
            offset.append(linear[parent] @ (joints[joint] - joints[parent]) + offset[parent])
        offset = [o - turn @ joint for o, turn, joint in zip(offset, linear, joints)]
        moved = np.einsum("kij,vj->vki", np.stack(linear), posed) + np.stack(offset)
        return np.einsum("vk,vki->vi", self.weights, moved)


def rotation_matrix(vector):
    """The rotation about a vector by its length in radians (Rodrigues)."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / max(angle, 1e-12)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


BODY_ARRAYS = "v_template", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table", "f"


def body_arrays(path):
    """The arrays of a body model of SMPL, SMPL+H or SMPL-X by name, from its pickle or its .npz file."""
    try:
        stored = (
            np.load(path) if Path(path).suffix == ".npz" else BodyUnpickler(BytesIO(Path(path).read_bytes())).load()
        )
        return {name: dense(stored[name]) for name in BODY_ARRAYS}
    except (OSError, KeyError, ValueError, EOFError, pickle.UnpicklingError, AttributeError, IndexError) as error:
        raise ValueError(f"{path}: not a body model ({error})") from error


class Held:
    """Stands for a class of chumpy or SciPy in a pickle: it holds the state and computes nothing."""

    def __init__(self, *arguments):
        self.arguments = arguments

    def __setstate__(self, state):
        self.__dict__ |= state


NUMPY = {
    ("_reconstruct", "multiarray"), ("scalar", "multiarray"), ("_frombuffer", "numeric"), ("ndarray", "numpy"),
    ("dtype", "numpy"),
}  # fmt: skip


class BodyUnpickler(pickle.Unpickler):
    """Reads a pickled body model; of a pickle's classes and functions only NumPy's arrays are made."""

    def __init__(self, file):
        super().__init__(file, encoding="latin1")

    def find_class(self, module, name):
        package = module.partition(".")[0]
        if package == "numpy" and (name, module.rpartition(".")[2]) in NUMPY:
            return super().find_class(module, name)
        if package in ("chumpy", "scipy"):
            return Held
        if (module, name) == ("copy_reg", "_reconstructor"):
            return lambda kind, _base, _state: kind()
        if (module, name) == ("_codecs", "encode"):
            return lambda text, encoding: text.encode(encoding)
        if name == "object":
            return object
        raise ValueError(f"{module}.{name} is not a class of body models")


def dense(value):
    """The array of an entry: NumPy's own, chumpy's, or a sparse one of SciPy."""
    state = getattr(value, "__dict__", {})
    if "indptr" in state:
        rows, columns = state["_shape"] if "_shape" in state else state["shape"]
        by_column = len(state["indptr"]) == columns + 1
        full = np.zeros((columns, rows) if by_column else (rows, columns))
        for line in range(len(full)):
            part = slice(state["indptr"][line], state["indptr"][line + 1])
            np.add.at(full[line], state["indices"][part], state["data"][part])
        return full.T if by_column else full
    if "a" in state and "idxs" in state:  # chumpy's Select
        return dense(state["a"]).ravel()[dense(state["idxs"]).astype(int)].reshape(state["preferred_shape"])
    if "x" in state:  # chumpy's Ch
        return dense(state["x"])
    return np.asarray(value, float)
