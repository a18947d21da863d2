"""Clouds far from zero, masked arrays and arrays with more columns (`pytest tests/test_origins.py`)."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import snake_rs

FAR = np.array([691_000.0, 5_336_000.0, 512.0])


@pytest.fixture(scope="module")
def points():
    """The sample, (4096, 3) float32."""
    data = (Path(__file__).parent.parent / "samples" / "plane.ply").read_bytes()
    return np.frombuffer(data.split(b"end_header\n", 1)[1], dtype="<f4").reshape(-1, 3).copy()


@pytest.fixture(scope="module")
def far(points):
    return points.astype(np.float64) + FAR


@pytest.fixture(scope="module")
def model():
    return snake_rs.Model.builtin()


def test_keypoints_of_far_clouds_keep_their_digits(points, far, tmp_path):
    near, found = snake_rs.detect(points), snake_rs.detect(far)
    assert len(found) == len(near) > 10
    assert (near.points.dtype, found.points.dtype) == (np.float32, np.float64)
    assert np.abs(found.points - FAR - near.points).max() < 1e-4
    assert np.array_equal(found.nearest_index, near.nearest_index)
    assert np.array_equal(pickle.loads(pickle.dumps(found)).points, found.points)
    np.save(tmp_path / "utm.npy", far)
    assert np.array_equal(snake_rs.detect(snake_rs.read_points(tmp_path / "utm.npy")).points, found.points)
    snapped = snake_rs.detect(far, snap=True)
    assert np.abs(snapped.points - far[snapped.nearest_index]).max() < 1e-6


def test_positions_have_the_type_of_the_points(points, model):
    for dtype in (np.float16, np.float32):
        assert model.encode(points.astype(dtype)).detect().points.dtype == np.float32
    for array in (points.astype(np.float64), (points * 1000).astype(np.int64), points.tolist()):
        field = model.encode(array)
        assert field.detect().points.dtype == field.mesh(resolution=16).vertices.dtype == np.float64
    near = model.encode(points).detect().points
    assert np.array_equal(near, model.encode(points.astype(np.float64)).detect().points)


def test_fields_and_meshes_of_far_clouds_keep_their_digits(points, far, model):
    near, field = model.encode(points), model.encode(far)
    queries = points[::7]
    for quantity in ("occupancy", "saliency", "descriptors"):
        values = [getattr(near, quantity)(queries), getattr(field, quantity)(queries.astype(np.float64) + FAR)]
        assert np.allclose(*values, atol=1e-3), quantity
    (center, scale), (far_center, far_scale) = near.normalization, field.normalization
    assert np.allclose(center + FAR, far_center, rtol=0, atol=1e-4) and scale == pytest.approx(far_scale)
    mesh, far_mesh = near.mesh(resolution=24), field.mesh(resolution=24)
    assert len(mesh.vertices) == len(far_mesh.vertices)
    assert np.abs(mesh.vertices + FAR - far_mesh.vertices).max() < 1e-3
    assert np.array_equal(pickle.loads(pickle.dumps(far_mesh)).vertices, far_mesh.vertices)


def test_masked_points_are_skipped_and_counted(points):
    mask = np.zeros(points.shape, bool)
    mask[::10, 1] = True
    hidden = points.copy()
    hidden[::10] = np.nan
    for dtype in (np.float32, np.float64):
        found = snake_rs.detect(np.ma.masked_array(points.astype(dtype), mask))
        expected = snake_rs.detect(hidden)
        assert found.num_skipped == expected.num_skipped == 410
        assert np.array_equal(found.points, expected.points)
        assert np.array_equal(found.nearest_index, expected.nearest_index)
    whole = np.ma.masked_array((points * 1000).astype(np.int32), mask)
    assert snake_rs.detect(whole).num_skipped == 410
    assert snake_rs.detect(np.ma.masked_array(points, False)).num_skipped == 0
    with pytest.raises(ValueError, match="not finite"):
        snake_rs.Model.builtin().encode(points).saliency(np.ma.masked_array(points, mask))


def test_columns_are_told_or_chosen(points, tmp_path):
    path = tmp_path / "table.csv"
    np.savetxt(path, np.hstack([points[:, :1] * 0, points]), delimiter=",", header="t,e,n,h", comments="")
    with pytest.raises(ValueError, match="`columns` x,y,z.* 2 `e`"):
        snake_rs.read_points(path)
    for columns in (("e", "n", "h"), (2, "n", 4)):
        assert np.allclose(snake_rs.read_points(path, columns=columns), points, atol=1e-6)
    with pytest.raises(TypeError):
        snake_rs.read_points(path, columns=(1.5, 2, 3))
