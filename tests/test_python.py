"""Behaviour of the package snake_rs: its API line by line, its errors, its threads (`pytest tests/test_python.py`).

The networks are those of tests/golden, so nothing depends on how good the built-in model is.
"""

import ast
import hashlib
import json
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save

import snake_rs

GOLDEN = Path(__file__).parent / "golden"
STUB = Path(__file__).parent.parent / "python" / "snake_rs" / "_core.pyi"
# Every query scores, so that detection has something to choose from whatever the network.
EASY = {"query_resolution": 12, "refine_steps": 3, "surface_threshold": 0.0, "saliency_threshold": 0.0}


@pytest.fixture(scope="module")
def points():
    """A bumpy sphere off the origin, (700, 3) float32 in metres."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(700, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = 2 + 0.3 * np.sin(5 * direction[:, :1]) + 0.2 * np.sign(direction[:, 1:2])
    return (direction * radius + [3, -1, 0.5]).astype(np.float32)


@pytest.fixture(scope="module")
def model():
    return snake_rs.Model.load(GOLDEN / "odd" / "weights.safetensors")


@pytest.fixture(scope="module")
def field(model, points):
    return model.encode(points)


@pytest.fixture(scope="module")
def keypoints(field):
    return field.detect(**EASY, max_keypoints=10**6, nms_radius=0.3)


def same(a, b):
    """Whether two Keypoints have the same bits."""
    names = ("points", "saliency", "occupancy", "nearest_index")
    return a.counts == b.counts and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def with_metadata(name, **metadata):
    """Bytes of a golden weight file with metadata added."""
    path = GOLDEN / name / "weights.safetensors"
    with safe_open(path, "np") as file:
        old = file.metadata()
    return save(load_file(path), metadata=old | metadata)


# Model


def test_model_describes_itself(model):
    assert model.config["resolution"] == (25, 25, 25)
    assert (model.config["c_dim"], model.config["padding"], model.config["unet_levels"]) == (32, 0.125, 3)
    assert model.metadata["format"] == "snake-field" and model.metadata["resolution"] == "[25, 25, 25]"
    # Files that do not name the scattering have the hard one.
    assert set(model.config) - {"scatter"} < set(model.metadata)
    tensors = load_file(GOLDEN / "odd" / "weights.safetensors")
    assert model.num_parameters == sum(tensor.size for tensor in tensors.values())
    assert repr(model) == f"Model({model.num_parameters} parameters, volume 25 x 25 x 25 x 32)"


def test_builtin_model_is_the_default(points):
    builtin = snake_rs.Model.builtin()
    options = builtin.recommended | {"query_resolution": 8, "refine_steps": 1}
    assert same(snake_rs.detect(points, **options), snake_rs.detect(points, builtin, **options))


def test_load_and_from_bytes_give_the_same_model(model, field, points):
    path = GOLDEN / "odd" / "weights.safetensors"
    for other in (snake_rs.Model.from_bytes(path.read_bytes()), snake_rs.Model.load(str(path))):
        assert other.metadata == model.metadata
        assert np.array_equal(other.encode(points).volume, field.volume)


def test_models_can_be_pickled(model, field, points):
    copy = pickle.loads(pickle.dumps(model))
    assert np.array_equal(copy.encode(points).volume, field.volume)
    builtin = pickle.dumps(snake_rs.Model.builtin())
    assert len(builtin) < 1000 and pickle.loads(builtin).config == snake_rs.Model.builtin().config


def test_the_built_in_models_have_names(points):
    rooms = snake_rs.Model.builtin("rooms")
    assert rooms.recommended["window_radius"] == 0.8 and rooms.metadata["name"] == "rooms"
    kept = pickle.dumps(rooms)
    assert len(kept) < 1000 and pickle.loads(kept).metadata == rooms.metadata
    assert snake_rs.Model.builtin("compact").metadata == snake_rs.Model.builtin().metadata != rooms.metadata
    assert len(snake_rs.detect(points, rooms)) > 0
    with pytest.raises(ValueError, match="compact, standard or rooms"):
        snake_rs.Model.builtin("potatoes")


def test_files_that_cannot_be_read_are_os_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match="No such file") as error:
        snake_rs.Model.load(tmp_path / "missing.safetensors")
    assert error.value.errno == 2 and error.value.filename == str(tmp_path / "missing.safetensors")
    with pytest.raises(IsADirectoryError):
        snake_rs.Model.load(tmp_path)
    with pytest.raises(ValueError, match="safetensors"):
        snake_rs.Model.from_bytes(b"not a weight file")


def test_recommended_options_are_the_defaults_and_presets_replace_them(points):
    encode = {"normalization": "unit-cube", "max_points": 300, "seed": 5}
    recommended = {"encode": encode, "detect": EASY | {"nms_radius": 0.5}}
    model = snake_rs.Model.from_bytes(with_metadata("odd", recommended_options=json.dumps(recommended)))
    assert model.recommended == model.recommended | recommended["encode"] | recommended["detect"]
    assert model.recommended["max_keypoints"] == 64 and model.recommended["saliency_threshold"] == 0.0
    field = model.encode(points)
    assert "300 of 700 points" in repr(field)
    assert np.ptp((points - field.normalization[0]) / field.normalization[1]) == pytest.approx(1.0, abs=0.2)
    found = field.detect()
    assert found.counts["queries"] == 12**3 and len(found) > 1
    assert same(found, snake_rs.detect(points, model))
    assert same(found, snake_rs.detect(points, model, **model.recommended))
    assert same(found, snake_rs.detect(points, model, preset=None))
    other = model.encode(points, preset="modelnet40")
    assert np.array_equal(other.volume, model.encode(points, normalization="unit-sphere", max_points=None).volume)
    assert not np.array_equal(other.volume, field.volume)
    named = field.detect(preset="keypointnet", query_resolution=9)
    assert named.counts["queries"] == 9**3
    plain = {"refine_steps": 10, "surface_threshold": 0.8, "saliency_threshold": 0.7, "nms_radius": 0.1}
    assert same(named, field.detect(**plain, query_resolution=9))


# Encoding


def test_any_layout_of_the_same_points_gives_the_same_bits(model, field, points):
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


def test_the_field_keeps_its_own_copy_of_the_points(model, field, points):
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


def test_max_points_draws_by_seed(model, field, points):
    volumes = [model.encode(points, max_points=200, seed=seed).volume for seed in (0, 0, 1)]
    assert np.array_equal(volumes[0], volumes[1]) and not np.array_equal(volumes[0], volumes[2])
    assert model.encode(points, max_points=200, seed=2**64 - 1).volume.any()
    assert np.array_equal(model.encode(points, max_points=None).volume, field.volume)
    assert repr(model.encode(points, max_points=200)).startswith("Field(200 of 700 points encoded, center [")


@pytest.mark.parametrize(
    "array, found",
    [
        (np.zeros((10, 2)), r"float64 of shape \(10, 2\)"),
        (np.zeros((10, 2), np.int64), r"int64 of shape \(10, 2\)"),
        (np.zeros((10, 3), complex), r"complex128 of shape \(10, 3\)"),
        (np.zeros((10, 3), object), r"object of shape \(10, 3\)"),
        (np.zeros((10, 3), bool), r"bool of shape \(10, 3\)"),
        (np.zeros(3), r"float64 of shape \(3,\)"),
        (np.zeros((1, 10, 3)), r"float64 of shape \(1, 10, 3\)"),
        ([], r"float64 of shape \(0,\)"),
        ("cloud.npy", r"<U9 of shape \(\)"),
        (None, r"object of shape \(\)"),
    ],
)
def test_arrays_of_another_kind_are_refused(model, field, array, found):
    expected = r"expected real numbers of shape \(N, 3\) or more columns, found " + found
    for call, what in ((model.encode, "points"), (field.occupancy, "queries"), (field.descriptors, "queries")):
        with pytest.raises(ValueError, match=f"^{what}: {expected}$"):
            call(array)
    with pytest.raises(ValueError, match=f"^points: {expected}$"):
        snake_rs.detect(array, model)


def test_points_that_cannot_be_encoded_are_refused(model, field, points):
    with pytest.raises(ValueError, match="^points: no points$"):
        model.encode(np.zeros((0, 3)))
    bad = points.copy()
    bad[[5, 9], 1] = np.nan, np.inf
    with pytest.raises(ValueError, match="^points: none of the 700 points is finite$"):
        model.encode(np.full((700, 3), np.nan))
    with pytest.raises(ValueError, match="^queries: 2 of 700 points are not finite"):
        field.saliency(bad)
    with pytest.raises(ValueError, match=r"all points \(10\) are at one place"):
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


def test_files_are_read(tmp_path):
    good = Path(__file__).parent / "data/io/good"
    cloud = np.array([[0, 0, 0], [1, -2, 0.5], [-0.25, 3, 100], [0.125, 0.001, -7]])
    for name in ("ascii.ply", "compressed.pcd", "stored.npz", "mesh.obj", "binary.stl", "format_6.laz"):
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
    with pytest.raises(ValueError, match="unknown extension"):
        snake_rs.read_points(tmp_path / "a.doc")


# Field


def test_fields_answer_queries(model, field, points):
    queries = points[:50]
    for value, both in (
        (field.occupancy, field.occupancy_and_gradient),
        (field.saliency, field.saliency_and_gradient),
    ):
        values, gradients = both(queries)
        assert value(queries).dtype == values.dtype == gradients.dtype == np.float32
        assert values.shape == (50,) and gradients.shape == (50, 3) and gradients.any()
        assert np.allclose(value(queries), values, atol=1e-6)
        assert 0 <= values.min() < values.max() <= 1
    assert not np.array_equal(field.occupancy(queries), field.saliency(queries))
    descriptors = field.descriptors(queries)
    assert descriptors.shape == (50, 32) and descriptors.dtype == np.float32
    assert np.linalg.norm(descriptors, axis=1) == pytest.approx(np.ones(50), abs=1e-5)


def test_no_queries_have_no_answers(field):
    for dtype in (np.float32, np.float64):
        none = np.zeros((0, 3), dtype)
        assert field.occupancy(none).shape == field.saliency(none).shape == (0,)
        for values, gradients in (field.occupancy_and_gradient(none), field.saliency_and_gradient(none)):
            assert values.shape == (0,) and gradients.shape == (0, 3)
        assert field.descriptors(none).shape == (0, 32)


@pytest.mark.parametrize("name", ["tiny", "odd", "anisotropic"])
def test_the_golden_networks_of_the_reference(name):
    golden = load_file(GOLDEN / name / "io.safetensors")
    with safe_open(GOLDEN / name / "io.safetensors", "np") as file:
        resolution = int(file.metadata()["query_resolution"])
    model = snake_rs.Model.load(GOLDEN / name / "weights.safetensors")
    field = model.encode(golden["points"], normalization="none")
    volume = field.volume
    x, y, z = model.config["resolution"]
    assert volume.shape == (model.config["c_dim"], z, y, x) and volume.dtype == np.float32
    flat = volume.reshape(len(volume), -1).T
    assert np.abs(flat[golden["volume_sample_index"]] - golden["volume_sample_values"]).max() < 1e-4
    for quantity in ("occupancy", "saliency"):
        values, gradients = getattr(field, f"{quantity}_and_gradient")(golden["queries"])
        assert np.abs(values - golden[quantity]).max() < 1e-4
        error = np.linalg.norm(gradients - golden[f"{quantity}_grad"], axis=1)
        assert np.percentile(error, 99) < 1e-3 * np.linalg.norm(golden[f"{quantity}_grad"], axis=1).max()
    found = field.detect(query_resolution=resolution, refine_steps=0)
    assert found.counts["occupied"] == pytest.approx(len(golden["refine_start"]), abs=1)


# Detection


def test_keypoints_have_their_arrays(field, keypoints, points):
    number = len(keypoints)
    assert number > 5 and keypoints.counts["keypoints"] == number
    assert keypoints.points.shape == (number, 3) and keypoints.points.dtype == np.float32
    assert keypoints.saliency.shape == keypoints.occupancy.shape == keypoints.nearest_index.shape == (number,)
    assert keypoints.saliency.dtype == keypoints.occupancy.dtype == np.float32
    assert keypoints.nearest_index.dtype == np.int64
    assert (np.diff(keypoints.saliency) <= 0).all()
    assert np.allclose(keypoints.occupancy, field.occupancy(keypoints.points), atol=1e-6)
    distance = np.linalg.norm(keypoints.points[:, None] - points, axis=2)
    assert np.allclose(distance[np.arange(number), keypoints.nearest_index], distance.min(axis=1), atol=1e-5)
    counts = [keypoints.counts[name] for name in ("queries", "occupied", "above_threshold", "keypoints")]
    assert counts == sorted(counts, reverse=True) and counts[0] == 12**3
    seconds = dict(keypoints.timing_seconds)
    assert set(seconds) == {"encode", "occupancy", "refine", "nms"} and seconds.pop("encode") == 0
    assert min(seconds.values()) > 0


def test_keypoints_print_and_pickle(field, keypoints):
    low, high = keypoints.saliency[-1], keypoints.saliency[0]
    expected = f"Keypoints({len(keypoints)}, saliency {low:.2f}..{high:.2f}, counts {keypoints.counts})"
    assert repr(keypoints) == expected
    copy = pickle.loads(pickle.dumps(keypoints))
    assert same(copy, keypoints) and copy.timing_seconds == keypoints.timing_seconds
    nothing = field.detect(occupancy_threshold=1.0, query_resolution=4)
    assert len(nothing) == 0 and nothing.points.shape == (0, 3) and nothing.nearest_index.dtype == np.int64
    counts = {"windows": 1, "queries": 64, "occupied": 0, "above_threshold": 0, "keypoints": 0}
    assert repr(nothing) == f"Keypoints(0, counts {counts})"


def test_every_option_does_something(model, field, keypoints, points):
    every = EASY | {"max_keypoints": 10**6, "nms_radius": 0.3}
    detect = lambda **options: field.detect(**every | options)
    assert same(detect(), keypoints)
    distance = np.linalg.norm(keypoints.points[:, None] - keypoints.points, axis=2)[~np.eye(len(keypoints), dtype=bool)]
    assert distance.min() > 0.3 and len(detect(nms_radius=0)) == keypoints.counts["above_threshold"]
    assert np.array_equal(detect(max_keypoints=3).points, keypoints.points[:3])
    snapped = detect(snap=True)
    assert np.array_equal(snapped.points, points[snapped.nearest_index])
    assert np.array_equal(snapped.nearest_index, keypoints.nearest_index)
    median = float(np.median(keypoints.saliency))
    assert len(detect(saliency_threshold=median)) == (keypoints.saliency > median).sum()
    assert detect(query_resolution=7).counts["queries"] == 7**3
    assert detect(occupancy_threshold=0.0).counts["occupied"] > keypoints.counts["occupied"]
    assert detect(surface_threshold=0.9).counts["above_threshold"] < keypoints.counts["above_threshold"]
    center, scale = field.normalization
    on_grid = (detect(refine_steps=0).points - center) / scale * 11 + 5.5
    assert np.allclose(on_grid, on_grid.round(), atol=1e-4)
    for options in ({"refine_steps": 0}, {"refine_step_size": 0.01}, {"refine_method": "gradient-descent"}):
        assert not same(detect(**options), keypoints)
    rough = {"refine_step_size": 0.1, "nms_radius": 0}
    assert not same(detect(**rough, selection="reference-final-position"), detect(**rough))
    for options in ({"normalization": "unit-cube"}, {"max_points": 100}, {"max_points": 100, "seed": 1}):
        encoded = {name: options.get(name, model.recommended[name]) for name in ("normalization", "max_points", "seed")}
        found = snake_rs.detect(points, model, **every, **options)
        assert same(found, model.encode(points, **encoded).detect(**every)) and not same(found, keypoints)


def test_a_cloud_may_be_seen_through_windows(model, keypoints, points):
    every = EASY | {"max_keypoints": 10**6, "nms_radius": 0.3}
    extent = np.ptp(points, axis=0).max()
    through = snake_rs.detect(points, model, **every, window_radius=extent / 3)
    assert through.counts["windows"] > 3 and len(through) > 5 and not same(through, keypoints)
    whole = snake_rs.detect(points, model, **every, window_radius=None)
    assert same(whole, snake_rs.detect(points, model, **every)) and whole.counts["windows"] == 1
    assert model.recommended["window_radius"] is None
    with pytest.raises(ValueError, match="option `window_radius` is -1: allowed is 1e-15 to 1e15"):
        snake_rs.detect(points, model, window_radius=-1)
    with pytest.raises(TypeError, match="unexpected keyword argument 'window_radius'"):
        model.encode(points, window_radius=1)


def test_options_take_the_numbers_of_numpy(field, keypoints):
    every = EASY | {"max_keypoints": np.int64(10**6), "nms_radius": np.float64(0.3), "snap": np.bool_(False)}
    assert same(field.detect(**every | {"query_resolution": np.uint8(12)}), keypoints)


def test_radii_may_be_multiples_of_the_resolution(field, points):
    exact = points.astype(np.float64)
    distance = np.linalg.norm(exact[:, None] - exact, axis=2)
    resolution = np.sort(distance, axis=1)[:, 1].mean()
    detect = lambda radius: field.detect(**EASY, max_keypoints=10**6, nms_radius=radius)
    assert same(detect("5r"), detect(5 * resolution)) and len(detect("5r")) < len(detect("3r"))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"refine_method": "sgd"}, "option `refine_method` is sgd: .*`adam` or `gradient-descent`"),
        ({"selection": 1}, "option `selection` is 1: "),
        ({"selection": "x"}, "option `selection` is x: .*`best-position` or `reference-final-position`"),
        (
            {"preset": "kitti"},
            "option `preset` is kitti: allowed is modelnet40, keypointnet, smpl, redwood, 3dmatch or standard",
        ),
        ({"nms_radius": -1}, r"option `nms_radius` is -1: allowed is 0 or more \(cloud units, "),
        ({"nms_radius": float("nan")}, "option `nms_radius` is nan: expected a finite number"),
        ({"nms_radius": "wide"}, "option `nms_radius` is wide: .*such as `6r`"),
        ({"saliency_threshold": 1.5}, "option `saliency_threshold` is 1.5: allowed is 0 to 1"),
        ({"query_resolution": 0}, "option `query_resolution` is 0: allowed is 1 to 256"),
        ({"query_resolution": 1024}, "option `query_resolution` is 1024: allowed is 1 to 256"),
        ({"refine_steps": 10_000_000}, "option `refine_steps` is 10000000: allowed is 0 to 10000"),
        ({"query_resolution": 256, "refine_steps": 100}, "option `query_resolution` is 256, with 100 refine_steps and"),
        ({"refine_steps": -1}, "option `refine_steps` is -1: .*expected a whole number, 0 or more"),
        ({"refine_steps": 2.5}, "option `refine_steps` is 2.5: .*expected a whole number, 0 or more"),
        ({"max_keypoints": None}, "option `max_keypoints` is None: .*expected a whole number, 0 or more"),
        ({"snap": 1}, "option `snap` is 1: .*expected a boolean"),
        ({"snap": [True]}, r"option `snap` is \[True\]: expected a finite number, a string or a bool"),
    ],
)
def test_wrong_values_of_detection_are_refused(model, field, points, options, message):
    with pytest.raises(ValueError, match=message):
        field.detect(**options)
    with pytest.raises(ValueError, match=message):
        snake_rs.detect(points, model, **options)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"normalization": "sphere"}, "option `normalization` is sphere: .*`unit-sphere`, `unit-cube`, `none`"),
        ({"max_points": 0}, "option `max_points` is 0: allowed is 1 or more"),
        ({"max_points": float("nan")}, "option `max_points` is nan: expected a finite number"),
        ({"seed": -1}, "option `seed` is -1: .*expected a whole number, 0 or more"),
    ],
)
def test_wrong_values_of_encoding_are_refused(model, points, options, message):
    for call in (model.encode, lambda cloud, **options: snake_rs.detect(cloud, model, **options)):
        with pytest.raises(ValueError, match=message):
            call(points, **options)


def test_unknown_options_are_type_errors(model, field, points):
    for call, arguments in ((snake_rs.detect, (points, model)), (model.encode, (points,)), (field.detect, ())):
        with pytest.raises(TypeError, match=r"unexpected keyword argument 'nms_radios'; its options are preset, "):
            call(*arguments, nms_radios=0.1)
    with pytest.raises(TypeError, match=r"^detect\(\) got an unexpected keyword argument 'seed'"):
        field.detect(seed=1)
    with pytest.raises(TypeError, match=r"^encode\(\) got an unexpected keyword argument 'snap'"):
        model.encode(points, snap=True)
    with pytest.raises(TypeError):
        snake_rs.detect(points, "modelnet40")


# Package, threads


def test_the_stub_lists_every_option(model):
    classes = [node for node in ast.parse(STUB.read_text()).body if isinstance(node, ast.ClassDef)]
    names = {c.name: [n.target.id for n in c.body if isinstance(n, ast.AnnAssign)] for c in classes}
    parts = names["_EncodeOptions"] + names["_DetectOptions"] + names["_Options"]
    assert parts == list(model.recommended)
    assert set(names["_Config"]) == set(model.config)


def test_the_stub_is_that_of_the_module():
    pytest.importorskip("mypy.stubtest")
    result = subprocess.run([sys.executable, "-m", "mypy.stubtest", "snake_rs"], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


def test_everything_public_is_documented():
    classes = (snake_rs.Model, snake_rs.Field, snake_rs.Keypoints, snake_rs.Mesh, snake_rs.Registration)
    functions = (snake_rs.detect, snake_rs.register, snake_rs.estimate_normals, snake_rs.fpfh, snake_rs.read_points)
    functions += (snake_rs.get_num_threads, snake_rs.set_num_threads)
    parts = (snake_rs.baselines, snake_rs.metrics)
    assert set(snake_rs.__all__) == {t.__name__.split(".")[-1] for t in classes + functions + parts} | {"__version__"}
    functions += tuple(getattr(part, name) for part in parts for name in part.__all__)
    members = [getattr(c, name) for c in classes for name in vars(c) if not name.startswith("_")]
    assert len(members) > 20
    assert all(thing.__doc__ for thing in (snake_rs, *parts, *functions, *classes, *members))
    assert {c.__module__ for c in classes} == {"snake_rs"}


def test_the_gil_is_released_while_computing(model, field, points):
    many = np.tile(points, (30, 1))
    calls = [
        lambda: model.encode(many),
        lambda: field.saliency(many),
        lambda: field.occupancy_and_gradient(many),
        lambda: field.descriptors(many),
        lambda: field.detect(query_resolution=24),
        lambda: field.mesh(resolution=24, level=0.5),
        lambda: snake_rs.detect(many, model, query_resolution=12),
        lambda: snake_rs.baselines.iss(many, salient_radius=0.1, non_max_radius=0.1),
        lambda: snake_rs.metrics.geodesic_distances(many, [0, 1]),
        lambda: snake_rs.register(points, points, max_keypoints=50),
        lambda: snake_rs.estimate_normals(many, 0.1),
        lambda: snake_rs.fpfh(points, points, 0.5),
    ]
    ticks, done = 0, threading.Event()

    def count():
        nonlocal ticks
        while not done.is_set():
            ticks += 1
            time.sleep(1e-4)

    interval = sys.getswitchinterval()
    thread = threading.Thread(target=count)
    thread.start()
    try:
        # With so long an interval the counter runs only while this thread gives the GIL up of its own accord.
        sys.setswitchinterval(60)
        for number, call in enumerate(calls):
            for _ in range(50):  # a busy machine may leave the counter asleep during one call
                before = ticks
                call()
                if ticks > before:
                    break
            else:
                pytest.fail(f"call {number} never released the GIL")
    finally:
        sys.setswitchinterval(interval)
        done.set()
        thread.join()


def digest():
    """One hash over all results on a golden network."""
    golden = load_file(GOLDEN / "odd" / "io.safetensors")
    model = snake_rs.Model.load(GOLDEN / "odd" / "weights.safetensors")
    field = model.encode(golden["points"], max_points=1000, seed=3)
    arrays = [field.volume, field.descriptors(golden["queries"])]
    arrays += [*field.occupancy_and_gradient(golden["points"]), *field.saliency_and_gradient(golden["points"])]
    for method in ("adam", "gradient-descent"):
        found = field.detect(**EASY | {"query_resolution": 16, "refine_method": method, "max_keypoints": 10**6})
        assert len(found) > 100
        arrays += [found.points, found.saliency, found.occupancy, found.nearest_index]
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def test_the_same_bits_for_any_number_of_threads():
    found = set()
    for threads in ("1", "2", "7"):
        command = [sys.executable, "-c", "import test_python; print(test_python.digest())"]
        environment = os.environ | {"RAYON_NUM_THREADS": threads}
        found.add(subprocess.check_output(command, cwd=Path(__file__).parent, env=environment, text=True))
    assert len(found) == 1 and len(found.pop().strip()) == 64
