"""Encoding in Python: arrays, normalisation, files."""

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


def test_queries_that_are_not_finite_and_uneven_rows_are_refused(model, field, points):
    bad = points.copy()
    bad[[5, 9], 1] = np.nan, np.inf
    with pytest.raises(ValueError, match="^queries: 2 of 700 points are not finite"):
        field.saliency(bad)
    with pytest.raises(ValueError, match="inhomogeneous"):
        model.encode([[1.0, 2.0, 3.0], [4.0]])


def test_read_points_samples_meshes_and_names_what_it_cannot_read(tmp_path):
    good = Path(__file__).parent / "data/io/good"
    samples = snake_rs.read_points(str(good / "mesh.off"), sample=1000, seed=3)
    assert samples.shape == (1000, 3) and samples.dtype == np.float64
    with pytest.raises(FileNotFoundError):
        snake_rs.read_points(tmp_path / "none.ply")
    with pytest.raises(ValueError, match="no faces to draw samples from"):
        snake_rs.read_points(good / "plain.xyz", sample=10)
