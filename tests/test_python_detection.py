"""Detection in Python: keypoints and options."""

import pickle
import signal
from pathlib import Path

import numpy as np
import pytest
from golden_network import EASY, GOLDEN, same

import snake_rs
from snake_rs._core import page


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


def test_keypoints_have_a_text_form_and_can_be_pickled(field, keypoints):
    low, high = keypoints.saliency[-1], keypoints.saliency[0]
    expected = f"Keypoints({len(keypoints)}, saliency {low:.2f}..{high:.2f}, counts {keypoints.counts})"
    assert repr(keypoints) == expected
    copy = pickle.loads(pickle.dumps(keypoints))
    assert same(copy, keypoints) and copy.timing_seconds == keypoints.timing_seconds
    nothing = field.detect(occupancy_threshold=1.0, query_resolution=4)
    assert len(nothing) == 0 and nothing.points.shape == (0, 3) and nothing.nearest_index.dtype == np.int64
    counts = {"queries": 64, "occupied": 0, "above_threshold": 0, "keypoints": 0}
    assert repr(nothing) == f"Keypoints(0, counts {counts})"


def test_keypoints_say_which_model_and_voxel_size_found_them(field, keypoints, points):
    assert (keypoints.model, keypoints.notes) == ("weights.safetensors", [])
    found = snake_rs.detect(points, voxel_size=0.25, max_keypoints=5)
    assert (found.model, found.voxel_size) == ("scenes, built-in", 0.25)
    assert "option `voxel_size` is for scenes" in found.notes[0]
    for other in (pickle.loads(pickle.dumps(found)), found[:2]):
        assert (other.model, other.voxel_size, other.notes) == (found.model, found.voxel_size, found.notes)
    assert snake_rs.detect(points, rotations=2, max_keypoints=5).model == "compact, built-in"


def test_a_room_has_the_model_of_rooms_in_every_function():
    room = snake_rs.read_points(Path(__file__).parents[1] / "samples" / "room" / "1.ply")
    assert "scenes, built-in" in page(room, max_keypoints=5)
    with pytest.warns(UserWarning, match="option `rotations` is for objects"):
        assert snake_rs.detect(room, rotations=2, max_keypoints=5).model == "compact, built-in"
    found = snake_rs.register(room, room, detector="snake", descriptor="field")
    named = snake_rs.register(room, room, "scenes", detector="snake", descriptor="field")
    assert np.array_equal(found.t_target_source, named.t_target_source)


def test_every_option_has_an_effect(model, field, keypoints, points):
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


def test_options_accept_numpy_numbers(field, keypoints):
    every = EASY | {"max_keypoints": np.int64(10**6), "nms_radius": np.float64(0.3), "snap": np.bool_(False)}
    assert same(field.detect(**every | {"query_resolution": np.uint8(12)}), keypoints)


def test_radii_can_be_multiples_of_the_resolution(field, points):
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
            "option `preset` is kitti: allowed is modelnet40, keypointnet, smpl, redwood or 3dmatch",
        ),
        ({"nms_radius": -1}, r"option `nms_radius` is -1: allowed is 0 or more \(cloud units, "),
        ({"nms_radius": float("nan")}, "option `nms_radius` is nan: expected finite numbers"),
        ({"nms_radius": "wide"}, "option `nms_radius` is wide: .*such as `6r`"),
        ({"saliency_threshold": 1.5}, "option `saliency_threshold` is 1.5: allowed is 0 to 1"),
        ({"query_resolution": 0}, "option `query_resolution` is 0: allowed is 1 to 256"),
        ({"query_resolution": 1024}, "option `query_resolution` is 1024: allowed is 1 to 256"),
        ({"refine_steps": 10_000_000}, "option `refine_steps` is 10000000: allowed is 0 to 10000"),
        ({"query_resolution": 256, "refine_steps": 100}, "option `query_resolution` is 256, with 100 refine_steps and"),
        ({"refine_steps": -1}, "option `refine_steps` is -1: .*expected a whole number, 0 or more"),
        ({"refine_steps": 2.5}, "option `refine_steps` is 2.5: .*expected a whole number, 0 or more"),
        ({"query_resolution": None}, "option `query_resolution` is None: .*expected a whole number, 0 or more"),
        ({"snap": 1}, "option `snap` is 1: .*expected a boolean"),
        ({"snap": [True]}, r"option `snap` is \[True\]: .*expected a boolean"),
    ],
)
def test_invalid_detection_options_are_refused(model, field, points, options, message):
    with pytest.raises(ValueError, match=message):
        field.detect(**options)
    with pytest.raises(ValueError, match=message):
        snake_rs.detect(points, model, **options)


@pytest.mark.parametrize(
    "options, message",
    [
        (
            {"normalization": "sphere"},
            "option `normalization` is sphere: .*`unit-sphere`, `principal-axes`, `unit-cube`, `half`, `none`",
        ),
        ({"max_points": 0}, "option `max_points` is 0: allowed is 1 or more"),
        ({"max_points": float("nan")}, "option `max_points` is nan: expected finite numbers"),
        ({"seed": -1}, "option `seed` is -1: .*expected a whole number, 0 or more"),
    ],
)
def test_invalid_encoding_options_are_refused(model, points, options, message):
    for call in (model.encode, lambda cloud, **options: snake_rs.detect(cloud, model, **options)):
        with pytest.raises(ValueError, match=message):
            call(points, **options)


def test_unknown_options_raise_type_errors(model, field, points):
    for call, arguments in ((snake_rs.detect, (points, model)), (model.encode, (points,)), (field.detect, ())):
        with pytest.raises(TypeError, match=r"unexpected keyword argument 'nms_radios'; its options are preset, "):
            call(*arguments, nms_radios=0.1)
    with pytest.raises(TypeError, match=r"^detect\(\) got an unexpected keyword argument 'seed'"):
        field.detect(seed=1)
    with pytest.raises(TypeError, match=r"^encode\(\) got an unexpected keyword argument 'snap'"):
        model.encode(points, snap=True)
    with pytest.raises(ValueError, match="no built-in model modelnet40"):
        snake_rs.detect(points, "modelnet40")


def test_clouds_with_the_same_fault_have_one_warning(model, recwarn):
    sweep = np.random.default_rng(0).normal(size=(900, 3))
    sweep[0] = 1e4
    for seed in range(3):
        np.random.default_rng(seed).shuffle(sweep)
        snake_rs.detect(sweep, model, query_resolution=8)
    assert len(recwarn) == 1, "Python says the same words once"


def test_the_warning_comes_before_a_long_detection():
    def interrupt(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 2)
    ground = np.random.default_rng(1).uniform((-18, -18, 0), (18, 18, 0.01), (20_000, 3))
    ground[0] = 1e5
    try:
        with pytest.warns(UserWarning, match="an outlier, left out"), pytest.raises(TimeoutError):
            snake_rs.detect(
                ground, "compact", query_resolution=128, query_band=0, occupancy_threshold=0, refine_steps=100
            )
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_the_covariance_of_a_corner_is_known_and_that_of_an_edge_is_infinite(tmp_path):
    grid = np.stack(np.meshgrid(*[np.arange(0, 2, 0.025)] * 2), axis=-1).reshape(-1, 2)
    faces = [np.insert(grid, axis, 0, axis=1) for axis in range(3)]
    room = np.concatenate(faces) + np.random.default_rng(0).normal(0, 0.003, (3 * len(grid), 3))
    found = snake_rs.detect(room, "scenes", min_confidence=0)
    assert found.covariance.shape == (len(found), 3, 3) and found.covariance.dtype == np.float32
    corner = np.linalg.norm(found.points, axis=1).argmin()
    error, covariance = found.points[corner], found.covariance[corner].astype(float)
    assert np.linalg.norm(error) < 0.015 and found.confidence[corner] == found.confidence.max()
    assert error @ np.linalg.solve(covariance, error) < 16  # 99.9 % of three degrees of freedom
    assert np.isinf(found.covariance).any()
    assert np.array_equal(found[corner].covariance, found.covariance[corner])
    found.save(tmp_path / "keypoints.json")
    read = snake_rs.Keypoints.load(tmp_path / "keypoints.json").covariance
    assert (
        np.array_equal(read[corner], found.covariance[corner]) and (np.isinf(read) == np.isinf(found.covariance)).all()
    )


def test_confidence_rises_with_saliency_and_min_confidence_keeps_the_good(points):
    found = snake_rs.detect(points)
    assert found.confidence.dtype == np.float32 and (np.diff(found.confidence) <= 0).all()
    least = float(np.median(found.confidence))
    kept = snake_rs.detect(points, min_confidence=least)
    assert (
        np.array_equal(kept.points, found.points[found.confidence >= least])
        and kept[0].confidence == kept.confidence[0]
    )
    without = snake_rs.Model.load(GOLDEN / "tiny" / "weights.safetensors")
    assert np.isnan(without.encode(points).detect().confidence).all()
    with pytest.raises(ValueError, match="no map of confidences"):
        snake_rs.detect(points, without, min_confidence=0.5)
