"""The collections of clouds that samples are made from."""

import json

import numpy as np
import pytest
import trimesh

from conftest import cloud, rng
from snake_training.data import Corpus, Folder, Mixture, Procedural, ShapeError, open_shapes


def test_points_in_columns_are_refused_as_detection_does(tmp_path):
    np.save(tmp_path / "columns.npy", cloud().T)
    with pytest.raises(ShapeError, match="transpose 600 points in 3 rows"):
        open_shapes(tmp_path)[0]


def test_georeferenced_clouds_keep_their_digits_and_lose_their_outliers(tmp_path):
    near, far = cloud(4000).astype(np.float64), np.array([500123.25, 5412345.75, 431.5])
    stored = {
        "near": near,
        "far": near + far,
        "zero": np.r_[near + far, [[0, 0, 0]]],
        "outlier": np.r_[near, [[1e4, 0, 0]]],
    }
    for name, points in stored.items():
        np.save(tmp_path / f"{name}.npy", points)
    read = {path.stem: Folder(tmp_path)[row] for row, path in enumerate(Folder(tmp_path).files)}
    assert np.array_equal(read["near"], near.astype(np.float32))
    assert np.array_equal(read["outlier"], read["near"])
    for name in ("far", "zero"):
        assert len(np.unique(read[name], axis=0)) == 4000
        shift = read[name] - read["near"]
        assert np.abs(shift - shift[0]).max() < 1e-5


def write_corpus(folder, shapes=3):
    folder.mkdir()
    points = rng(1).integers(-32767, 32768, (shapes, 50, 3)).astype(np.int16)
    np.save(folder / "points.npy", points)
    (folder / "index.json").write_text(json.dumps([{"name": str(i)} for i in range(shapes)]))
    return points


def test_corpus_rows_are_unit_spheres(tmp_path):
    points = write_corpus(tmp_path / "corpus")
    shapes = open_shapes(tmp_path / "corpus")
    assert isinstance(shapes, Corpus) and len(shapes) == 3
    assert np.array_equal(shapes[1], points[1].astype(np.float32) / 32767)
    drawn = shapes.cloud(rng())
    assert any(np.array_equal(drawn, shapes[row]) for row in range(3))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("points.npy", np.zeros((3, 50, 3), np.float32), "expected int16"),
        ("points.npy", np.zeros((3, 50, 2), np.int16), "expected int16"),
        ("points.npy", np.zeros((0, 50, 3), np.int16), "expected int16"),
        ("points.npy", np.zeros((4, 50, 3), np.int16), "index.json has 3 rows, points.npy has 4"),
        ("points.npy", b"not an array", "not a readable NPY"),
        ("index.json", b"[1, 2", "index.json"),
        ("index.json", None, "index.json"),
    ],
)
def test_a_bad_corpus_is_a_clear_error(tmp_path, name, content, message):
    write_corpus(tmp_path / "corpus")
    path = tmp_path / "corpus" / name
    path.unlink()
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content)
    with pytest.raises(ValueError, match=message):
        Corpus(tmp_path / "corpus")


def test_folder_reads_arrays_clouds_and_meshes_below_it(tmp_path):
    points = cloud(40)
    np.save(tmp_path / "a.npy", np.concatenate([points, np.full((1, 3), np.nan, np.float32)]))  # NaN rows are dropped
    np.save(tmp_path / "b.npy", np.concatenate([points, points], axis=1).astype(np.float64))  # x y z nx ny nz
    (tmp_path / "below").mkdir()
    trimesh.PointCloud(points).export(tmp_path / "below" / "c.ply")
    trimesh.creation.box((2, 2, 2)).export(tmp_path / "below" / "d.PLY")
    (tmp_path / "notes.txt").write_text("ignored")
    shapes = open_shapes(tmp_path)
    assert isinstance(shapes, Folder) and [p.name for p in shapes.files] == ["a.npy", "b.npy", "c.ply", "d.PLY"]
    for row in range(3):
        assert np.allclose(shapes[row], points, atol=1e-5) and shapes[row].dtype == np.float32
    mesh = shapes[3]
    assert mesh.shape == (8192, 3) and np.allclose(np.abs(mesh).max(axis=1), 1, atol=1e-5)  # on the surface
    assert np.array_equal(mesh, shapes[3])
    assert shapes.cloud(rng()).shape[1] == 3


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("x.npy", np.zeros((5, 2)), r"expected \(N, 3\) numbers, found float64 \(5, 2\)"),
        ("x.npy", np.zeros(9), r"expected \(N, 3\) numbers"),
        ("x.npy", np.zeros((5, 3), complex), "complex128"),
        ("x.npy", np.array([["a"] * 3]), "expected"),
        ("x.npy", np.array([{"pickled": 1}]), "not a readable NPY"),
        ("x.npy", np.full((5, 3), np.nan), "two different finite points"),
        ("x.npy", np.ones((5, 3)), "two different finite points"),
        ("x.npy", np.zeros((0, 3)), "NPY|two different"),
        ("x.npy", b"", "not a readable NPY"),
        ("x.npy", b"\x93NUMPY\x01\x00 nonsense", "not a readable NPY"),
        ("x.ply", b"", "x.ply"),
        ("x.ply", b"plyish", "x.ply"),
        ("x.ply", b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n0\n1\n", "x.ply"),
    ],
)
def test_a_bad_file_is_a_clear_error_with_its_name(tmp_path, name, content, message):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        np.save(tmp_path / name, content, allow_pickle=True)
    with pytest.raises(ValueError, match=message) as error:
        Folder(tmp_path)[0]
    assert name in str(error.value)


class Named:
    """Shapes that are their own name."""

    def __init__(self, *names):
        self.names = names

    def __len__(self):
        return len(self.names)

    def __getitem__(self, row):
        return self.names[row]


def test_mixture_draws_every_shape_equally_and_has_all_rows():
    shapes = Mixture([Named("a"), Named("b", "c", "d")], 0.0)
    assert len(shapes) == 4 and [shapes[row] for row in range(4)] == ["a", "b", "c", "d"]
    with pytest.raises(IndexError):
        shapes[4]
    generator = rng()
    drawn = [shapes.cloud(generator) for _ in range(2000)]
    assert all(abs(drawn.count(name) - 500) < 80 for name in "abcd")  # standard deviation 19


def test_mixture_share_of_procedural_shapes():
    shapes = Mixture([Named("a")], 0.25)
    shapes.procedural = Procedural(points=2)
    generator = rng()
    drawn = [isinstance(shapes.cloud(generator), str) for _ in range(400)]
    assert abs(np.mean(drawn) - 0.75) < 0.09  # four standard deviations
    assert Mixture([], 0.0).cloud(rng()).shape == (4096, 3)  # with no data, all shapes are procedural
