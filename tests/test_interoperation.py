"""Points of other libraries go in as they are, and none of those libraries is imported for it."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import snake_rs

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def points():
    return snake_rs.read_points(ROOT / "samples" / "plane.ply")[:300]


@pytest.fixture(scope="module")
def field(points):
    return snake_rs.Model.builtin().encode(points)


@pytest.fixture(scope="module")
def same(field, points):
    """Whether points from elsewhere are those of `points`, up to what float32 holds."""
    expected = field.saliency(points)
    return lambda other: np.array_equal(field.saliency(other), expected)


def test_no_other_library_is_imported():
    code = "import snake_rs, sys; print(sorted({'torch', 'open3d', 'trimesh', 'scipy'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_whole_numbers_and_halves(field):
    whole = np.arange(30).reshape(10, 3) % 7
    expected = field.saliency(whole.astype(np.float32))
    for kind in (np.int8, np.uint16, np.int64, np.float16, np.longdouble):
        assert np.array_equal(field.saliency(whole.astype(kind)), expected), kind


def test_torch_tensors(same, points):
    torch = pytest.importorskip("torch")
    tensor = torch.from_numpy(points.copy())
    transposed = tensor.T.contiguous().T
    assert not transposed.is_contiguous()
    for other in (tensor, tensor.double(), transposed, torch.cat([tensor, tensor], 1)[:, :3]):
        assert same(other)


def test_torch_tensors_that_numpy_cannot_see_are_refused(field, points):
    torch = pytest.importorskip("torch")
    tensor = torch.from_numpy(points.copy())
    assert np.array_equal(field.saliency(tensor.clone().requires_grad_()), field.saliency(tensor))
    with pytest.raises(TypeError, match="BFloat16"):
        snake_rs.detect(tensor.bfloat16())
    with pytest.raises(
        ValueError,
        match=r"^points: expected real numbers of shape \(N, 3\) or more columns, or \(H, W, 3\), found bool",
    ):
        snake_rs.detect(tensor > 0)


@pytest.mark.parametrize("method", ["__array__", "__dlpack__"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError("no disk"), ValueError("no points")], ids=type)
def test_an_exception_of_the_callers_conversion_is_passed_on_as_it_is(field, method, error):
    def refuse(*_, **__):
        raise error

    refusing = type("Refusing", (), {method: refuse, "__dlpack_device__": lambda _: (1, 0)})()
    for value in (refusing, SimpleNamespace(points=refusing)):
        with pytest.raises(type(error)) as caught:
            field.saliency(value)
        assert caught.value is error and error.__cause__ is None


def test_trimesh(same, points):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(points, [[0, 1, 2]], process=False)
    for other in (mesh.vertices, trimesh.PointCloud(points), mesh):
        assert same(other)


def test_open3d(same, points):
    # Without libraries of the system its import fails although it is installed.
    open3d = pytest.importorskip("open3d", reason="Open3D is not installed", exc_type=ImportError)
    vector = open3d.utility.Vector3dVector(points.astype(np.float64))
    tensor = open3d.core.Tensor(points)
    for other in (vector, open3d.geometry.PointCloud(vector), tensor, open3d.t.geometry.PointCloud(tensor)):
        assert same(other)
    keypoints = snake_rs.detect(open3d.geometry.PointCloud(vector))
    back = keypoints.to_open3d()
    assert isinstance(back, open3d.geometry.PointCloud)
    assert len(keypoints) > 0 and np.array_equal(np.asarray(back.points), keypoints.points)


def test_laspy(points):
    laspy = pytest.importorskip("laspy", reason="laspy is not installed")
    scan = laspy.create(point_format=3, file_version="1.2")
    scan.header.scales = [1e-6] * 3
    scan.x, scan.y, scan.z = points.T
    assert np.abs(scan.xyz - points).max() < 1e-6
    found, expected = snake_rs.detect(scan), snake_rs.detect(scan.xyz)
    assert len(found) > 0 and np.array_equal(found.points, expected.points)


def test_without_open3d_the_error_says_what_to_do(field, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(ImportError, match="pip install open3d"):
        field.detect().to_open3d()


def test_keypoints_are_points_too(field):
    keypoints = field.detect(saliency_threshold=0.0)
    assert len(keypoints) > 0
    assert np.array_equal(snake_rs.estimate_normals(keypoints, 1.0), snake_rs.estimate_normals(keypoints.points, 1.0))
