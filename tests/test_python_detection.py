"""Detection in Python: keypoints and options."""

import json
import pickle
import signal

import numpy as np
import pytest
from golden_network import GOLDEN

import snake_rs


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


def test_keypoints_say_which_model_and_voxel_size_found_them(field, keypoints, points):
    assert (keypoints.model, keypoints.notes) == ("weights.safetensors", [])
    found = snake_rs.detect(points, voxel_size=0.25, max_keypoints=5)
    assert (found.model, found.voxel_size) == ("scenes, built-in", 0.25)
    assert "option `voxel_size` is for scenes" in found.notes[0]
    for other in (pickle.loads(pickle.dumps(found)), found[:2]):
        assert (other.model, other.voxel_size, other.notes) == (found.model, found.voxel_size, found.notes)
    assert snake_rs.detect(points, rotations=2, max_keypoints=5).model == "compact, built-in"


@pytest.mark.parametrize(
    "options, message",
    [
        ({"refine_method": "sgd"}, "option `refine_method` is sgd: .*`adam` or `gradient-descent`"),
        ({"preset": "kitti"}, "option `preset` is kitti: allowed is modelnet40, keypointnet, smpl, redwood or 3dmatch"),
        ({"nms_radius": float("nan")}, "option `nms_radius` is nan: expected finite numbers"),
        ({"query_resolution": 0}, "option `query_resolution` is 0: allowed is 1 to 256"),
        ({"refine_steps": 2.5}, "option `refine_steps` is 2.5: .*expected a whole number, 0 or more"),
        ({"query_resolution": None}, "option `query_resolution` is None: .*expected a whole number, 0 or more"),
        ({"snap": [True]}, r"option `snap` is \[True\]: .*expected a boolean"),
    ],
)
def test_invalid_detection_options_are_refused(model, field, points, options, message):
    with pytest.raises(ValueError, match=message):
        field.detect(**options)
    with pytest.raises(ValueError, match=message):
        snake_rs.detect(points, model, **options)


def test_unknown_options_raise_type_errors(model, field, points):
    for call, arguments in ((snake_rs.detect, (points, model)), (model.encode, (points,)), (field.detect, ())):
        with pytest.raises(TypeError, match=r"unexpected keyword argument 'nms_radios'; its options are preset, "):
            call(*arguments, nms_radios=0.1)
    with pytest.raises(TypeError, match=r"^detect\(\) got an unexpected keyword argument 'seed'"):
        field.detect(seed=1)
    with pytest.raises(TypeError, match=r"^encode\(\) got an unexpected keyword argument 'snap'"):
        model.encode(points, snap=True)


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
    written = json.loads((tmp_path / "keypoints.json").read_text())["keypoints"]
    rows = np.array([keypoint["covariance"] for keypoint in written], float)  # null is not a number
    assert np.allclose(rows[corner], found.covariance[corner]) and (np.isnan(rows) == np.isinf(found.covariance)).all()


def test_keypoints_have_their_confidence(points):
    found = snake_rs.detect(points)
    assert found.confidence.dtype == np.float32 and found[0].confidence == found.confidence[0] > 0
    assert np.isnan(snake_rs.detect(points, GOLDEN / "tiny" / "weights.safetensors").confidence).all()
