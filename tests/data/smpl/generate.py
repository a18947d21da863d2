"""Makes the small body models beside it, in the structure of those that are published.

    python tests/data/smpl/generate.py

`model.pkl` is as SMPL's authors pickled theirs with Python 2: protocol 2, byte strings, chumpy arrays and a sparse joint
regressor. chumpy itself is not needed: classes of the same names, pickled the same way, stand for its own. The others
are the same without chumpy: `model_py3.pkl` as Python 3 pickles it for Python 2, with bytes as Latin-1 text,
`model_py3_protocol5.pkl` as it does for itself, and `model.npz`. `posed.npz` is a pose of it, by the definition in NumPy. The body is an arm of three boxes along x with two elbows.
"""

import io
import pickle
import sys
import types
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.sparse
import scipy.spatial

FOLDER = Path(__file__).parent


def chumpy() -> tuple[type, type]:
    """Classes by the names of chumpy's: `Ch(x)` holds an array, `Select` items of one in another shape."""
    made = []
    for module, name in [("chumpy.ch", "Ch"), ("chumpy.reordering", "Select")]:
        made.append(type(name, (), {"__module__": module}))
        sys.modules.setdefault("chumpy", types.ModuleType("chumpy"))
        sys.modules[module] = types.ModuleType(module)
        setattr(sys.modules[module], name, made[-1])
    return made[0], made[1]


def arm() -> dict[str, np.ndarray]:
    """Boxes of length 1 with square ends, 16 vertices; joints at 0, 1 and 2."""
    rng = np.random.default_rng(0)
    ends = np.array([[-0.1, -0.1], [-0.1, 0.1], [0.1, 0.1], [0.1, -0.1]])
    rings = [np.column_stack([np.full(4, float(x)), ends]) for x in range(4)]
    vertices = np.concatenate(rings)
    faces = []
    for ring in range(3):
        for side in range(4):
            a, b = 4 * ring + side, 4 * ring + (side + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    faces += [[0, 1, 2], [0, 2, 3], [12, 14, 13], [12, 15, 14]]
    weights = np.zeros((16, 3))
    for ring, row in enumerate([[1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 1]]):
        weights[4 * ring : 4 * ring + 4] = row
    regressor = np.zeros((3, 16))
    for joint in range(3):
        regressor[joint, 4 * joint : 4 * joint + 4] = 0.25
    return {
        "v_template": vertices,
        "shapedirs": rng.normal(size=(16, 3, 10)) * 0.01,
        "posedirs": rng.normal(size=(16, 3, 18)) * 0.001,
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": np.array([[4294967295, 0, 1], [0, 1, 2]], dtype=np.uint32),
        "f": np.array(faces, dtype=np.uint32),
    }


def skinned(model: dict[str, np.ndarray], pose: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """Vertices (V, 3) by linear blend skinning, with matrices throughout; `pose` (K, 3) in radians."""
    shaped = model["v_template"] + model["shapedirs"] @ betas
    joints = model["J_regressor"] @ shaped
    turns = scipy.spatial.transform.Rotation.from_rotvec(pose).as_matrix()
    posed = shaped + model["posedirs"] @ (turns[1:] - np.eye(3)).ravel()
    to_world = np.zeros((len(pose), 4, 4))
    for joint, parent in enumerate(model["kintree_table"][0]):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turns[joint], joints[joint] - (joints[parent] if joint else 0)
        to_world[joint] = to_world[parent] @ local if joint else local
    for joint, matrix in zip(joints, to_world, strict=True):
        matrix[:3, 3] -= matrix[:3, :3] @ joint
    blended = np.einsum("vk,kij->vij", model["weights"], to_world)
    return np.einsum("vij,vj->vi", blended, np.column_stack([posed, np.ones(len(posed))]))[:, :3]


class Python2Pickler(pickle._Pickler):
    """Writes bytes as Python 2 does, as its plain strings, and the modules' old names."""

    dispatch: ClassVar = dict(pickle._Pickler.dispatch)

    def save_string(self, value: bytes | str) -> None:
        data = value.encode() if isinstance(value, str) else value
        short = len(data) < 256
        self.write(pickle.SHORT_BINSTRING if short else pickle.BINSTRING)
        self.write(len(data).to_bytes(1 if short else 4, "little") + data)
        self.memoize(value)

    dispatch[bytes] = save_string
    dispatch[str] = save_string


def old_names(pickled: bytes) -> bytes:
    """Modules as they were called then."""
    changed = [(b"numpy._core.multiarray", b"numpy.core.multiarray"), (b"scipy.sparse._csc", b"scipy.sparse.csc")]
    for new, old in changed:
        pickled = pickled.replace(b"c" + new + b"\n", b"c" + old + b"\n")
    return pickled


def main() -> None:
    Ch, Select = chumpy()
    plain = arm()
    sparse = dict(plain, J_regressor=scipy.sparse.csc_matrix(plain["J_regressor"]))
    published = dict(sparse, bs_type="lrotmin", bs_style="lbs")
    # More directions than are wanted, of which the first are selected.
    more = np.concatenate([plain["shapedirs"], np.ones((16, 3, 2))], axis=2)
    indices = np.arange(more.size).reshape(more.shape)[:, :, :10]
    source, published["shapedirs"], published["v_template"] = Ch(), Select(), Ch()
    source.x = more
    published["shapedirs"].__dict__.update(a=source, idxs=indices.ravel(), preferred_shape=indices.shape)
    published["v_template"].x = np.asfortranarray(plain["v_template"])
    buffer = io.BytesIO()
    Python2Pickler(buffer, protocol=2).dump(published)
    (FOLDER / "model.pkl").write_bytes(old_names(buffer.getvalue()))
    (FOLDER / "model_py3.pkl").write_bytes(pickle.dumps(sparse, protocol=2))
    (FOLDER / "model_py3_protocol5.pkl").write_bytes(pickle.dumps(sparse, protocol=5))
    np.savez_compressed(FOLDER / "model.npz", **plain)
    rng = np.random.default_rng(1)
    pose, betas = rng.normal(size=(3, 3)), rng.normal(size=10)
    np.savez_compressed(FOLDER / "posed.npz", pose=pose, betas=betas, vertices=skinned(plain, pose, betas))


if __name__ == "__main__":
    main()
