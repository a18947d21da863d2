"""Encoding in Python: arrays, normalisation, files."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from golden_network import EASY, same

import snake_rs


def test_every_array_layout_gives_identical_results(model, field, points):
    wide = np.zeros((700, 7), np.float32)
    wide[:, 1:7:2] = points
    packed = np.zeros(700, np.dtype([("tag", "u1"), ("xyz", "f4", 3)]))  # rows of 13 bytes
    packed["xyz"] = points
    unaligned = np.frombuffer(b"x" + points.tobytes(), np.float32, offset=1).reshape(-1, 3)
    assert not unaligned.flags.aligned and unaligned.flags.c_contiguous
    layouts = [points.astype(np.float64), np.asfortranarray(points), wide[:, 1:7:2], points[::-1].copy()[::-1]]
    for array in [*layouts, packed["xyz"], unaligned, points.astype(">f4"), points.astype(">f8"), points.tolist()]:
        assert np.array_equal(model.encode(array).volume, field.volume)
        assert np.array_equal(field.saliency(array), field.saliency(points))


def test_a_field_copies_the_points(model, field, points):
    array = points.copy()
    mine = model.encode(array)
    array[:] = 0
    options = EASY | {"snap": True, "max_keypoints": 5}
    assert same(mine.detect(**options), field.detect(**options))


def test_normalization(model, points):
    center, scale = model.encode(points, normalization="unit-sphere").normalization
    assert center.dtype == np.float32 and isinstance(scale, float)
    assert center == pytest.approx(points.mean(axis=0, dtype=np.float64), abs=1e-5)
    assert np.linalg.norm((points - center) / scale, axis=1).max() == pytest.approx(0.5, abs=1e-5)
    center, scale = model.encode(points, normalization="unit-cube").normalization
    assert np.abs((points - center) / scale).max() == pytest.approx(0.5, abs=1e-5)
    center, scale = model.encode(points, normalization="none").normalization
    assert center.tolist() == [0, 0, 0] and scale == 1.0


def test_half_is_the_released_codes_rule_for_modelnet40(model, points):
    """A cloud of radius 1 is divided by 2 and neither centred nor scaled anew, whatever its noise: all bits are those of half the
    cloud in the network's frame."""
    noisy = (points / 3 + np.random.default_rng(0).normal(0, 0.1, points.shape)).astype(np.float32)
    field, expected = model.encode(noisy, normalization="half"), model.encode(noisy / 2, normalization="none")
    assert field.normalization[0].tolist() == [0, 0, 0] and field.normalization[1] == 2.0
    assert np.array_equal(field.volume, expected.volume)
    assert np.array_equal(field.saliency(noisy), expected.saliency(noisy / 2))
    found, halved = field.detect(nms_radius=0.02), expected.detect(nms_radius=0.01)
    assert len(found) > 0 and np.array_equal(found.points, 2 * halved.points)


def test_principal_axes(model, points):
    field = model.encode(points, normalization="principal-axes")
    center, scale = field.normalization
    turned = (points - center) @ field.orientation.T
    covariance = turned.T @ turned / len(points)
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 1e-4 * covariance.max()
    assert np.all(np.diff(np.diag(covariance)) < 0) and np.linalg.det(field.orientation) == pytest.approx(1, abs=1e-5)
    as_given = model.encode(points, normalization="unit-sphere")
    assert np.array_equal(as_given.orientation, np.eye(3)) and as_given.normalization[1] == scale
    again = pickle.loads(pickle.dumps(field))
    assert np.array_equal(again.volume, field.volume) and np.array_equal(again.orientation, field.orientation)


def test_max_points_samples_by_seed(model, field, points):
    volumes = [model.encode(points, max_points=200, seed=seed).volume for seed in (0, 0, 1)]
    assert np.array_equal(volumes[0], volumes[1]) and not np.array_equal(volumes[0], volumes[2])
    assert model.encode(points, max_points=200, seed=2**64 - 1).volume.any()
    assert np.array_equal(model.encode(points, max_points=None).volume, field.volume)
    assert repr(model.encode(points, max_points=200)).startswith("Field(200 of 700 points encoded, center [")


PLANE = r": points of a plane need a third column, numpy.c_\[points, numpy.zeros\(len\(points\)\)\]"


@pytest.mark.parametrize(
    "array, found",
    [
        (np.zeros((10, 2)), r"float64 of shape \(10, 2\)" + PLANE),
        (np.zeros((10, 2), np.int64), r"int64 of shape \(10, 2\)" + PLANE),
        (np.zeros((10, 3), complex), r"complex128 of shape \(10, 3\)"),
        (np.zeros((10, 3), object), r"object of shape \(10, 3\)"),
        (np.zeros((10, 3), bool), r"bool of shape \(10, 3\)"),
        (np.zeros(3), r"float64 of shape \(3,\)"),
        (np.zeros((1, 10, 2)), r"float64 of shape \(1, 10, 2\)"),
        ([], r"float64 of shape \(0,\)"),
        (np.array("cloud.npy"), r"<U9 of shape \(\)"),
        (None, r"object of shape \(\)"),
    ],
)
def test_arrays_of_wrong_shape_or_type_are_refused(model, field, array, found):
    expected = r"expected real numbers of shape \(N, 3\) or more columns, or \(H, W, 3\), found " + found
    for call, what in ((model.encode, "points"), (field.occupancy, "queries"), (field.descriptors, "queries")):
        with pytest.raises(ValueError, match=f"^{what}: {expected}$"):
            call(array)
    with pytest.raises(ValueError, match=f"^points: {expected}$"):
        snake_rs.detect(array, model)


def test_degenerate_clouds_are_refused(model, field, points):
    with pytest.raises(ValueError, match="^points: no points$"):
        model.encode(np.zeros((0, 3)))
    bad = points.copy()
    bad[[5, 9], 1] = np.nan, np.inf
    with pytest.raises(ValueError, match="^points: none of the 700 points is finite$"):
        model.encode(np.full((700, 3), np.nan))
    with pytest.raises(ValueError, match="^queries: 2 of 700 points are not finite"):
        field.saliency(bad)
    with pytest.raises(ValueError, match=r"all points \(10\) are equal"):
        model.encode(np.ones((10, 3)))
    with pytest.raises(ValueError, match="inhomogeneous"):
        model.encode([[1.0, 2.0, 3.0], [4.0]])


def test_points_that_are_not_finite_are_skipped(model, points):
    holes = np.full((2 * len(points), 3), np.nan)
    holes[1::2] = points
    clean, found = snake_rs.detect(points, model), snake_rs.detect(holes, model)
    assert (clean.num_skipped, found.num_skipped) == (0, len(points))
    assert np.array_equal(found.points, clean.points) and np.array_equal(found.saliency, clean.saliency)
    assert np.array_equal(found.nearest_index, 2 * clean.nearest_index + 1)
    assert pickle.loads(pickle.dumps(found)).num_skipped == len(points)
    index, score = snake_rs.baselines.iss(holes)
    expected, expected_score = snake_rs.baselines.iss(points)
    assert np.array_equal(index, 2 * expected + 1) and np.array_equal(score, expected_score)


def test_read_points_reads_every_format(tmp_path):
    good = Path(__file__).parent / "data/io/good"
    cloud = np.array([[0, 0, 0], [1, -2, 0.5], [-0.25, 3, 100], [0.125, 0.001, -7]])
    names = ("ascii.ply", "upper_case.ply", "compressed.pcd", "stored.npz", "mesh.obj", "binary.stl", "format_6.laz")
    for name in (*names, "../velodyne/000000.bin"):
        points = snake_rs.read_points(good / name)
        assert points.dtype == np.float64 and np.allclose(points, cloud, atol=1e-6), name
    np.save(tmp_path / "far.npy", cloud + [5e5, 5e6, 0])
    assert np.allclose(snake_rs.read_points(tmp_path / "far.npy"), cloud + [5e5, 5e6, 0], rtol=0, atol=1e-5)
    samples = snake_rs.read_points(str(good / "mesh.off"), sample=1000, seed=3)
    assert samples.shape == (1000, 3) and len(np.unique(samples, axis=0)) == 1000
    assert (samples.min(axis=0) >= cloud.min(axis=0)).all() and (samples.max(axis=0) <= cloud.max(axis=0)).all()
    with pytest.raises(FileNotFoundError):
        snake_rs.read_points(tmp_path / "none.ply")
    with pytest.raises(ValueError, match="no faces to draw samples from"):
        snake_rs.read_points(good / "plain.xyz", sample=10)
    (tmp_path / "a.doc").touch()
    with pytest.raises(ValueError, match="unknown extension"):
        snake_rs.read_points(tmp_path / "a.doc")
