"""Calls for robots: frame after frame, in time, watched, from organised arrays; parts of results are printed and pickled."""

import pickle
import warnings

import numpy as np
import pytest
from test_python_notes import room, thing

import snake_rs


def test_frames_have_the_keypoints_of_detect():
    frames = snake_rs.FrameDetector("compact", max_keypoints=20)
    stray = np.vstack([thing(), [[900, 0, 0], [0, -800, 0]]])
    for points in (thing(), thing(1000).astype(np.float32) + 5, thing() + [5e5, 4e6, 0], stray):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = frames.detect(points)
        expected = snake_rs.detect(points, "compact", max_keypoints=20)
        assert found.notes == expected.notes == [str(warning.message) for warning in told]
        assert bool(found.notes) == (points is stray)
        for name in ("points", "saliency", "nearest_index", "descriptors"):
            assert np.array_equal(getattr(found, name), getattr(expected, name)), name
        assert found.points.dtype == expected.points.dtype and found.model == expected.model
    with pytest.raises(ValueError, match="none of the 3 points is finite"):
        frames.detect(np.full((3, 3), np.nan))
    assert len(frames.detect(thing())) > 5 and "FrameDetector(Model(compact" in repr(frames)
    for call in (frames.detect, snake_rs.Model.builtin("compact").encode):
        with pytest.raises(ValueError, match="points: expected one cloud, found a list of 2"):
            call([thing(), thing()])
    with pytest.raises(TypeError, match="unexpected keyword argument 'frames'"):
        snake_rs.FrameDetector("compact", frames=3)


CALLS = {
    "detect": lambda **watch: snake_rs.detect(room(), **watch),
    "detect of several": lambda **watch: snake_rs.detect([thing(), thing()], **watch),
    "frames": lambda **watch: snake_rs.FrameDetector("scenes").detect(room(), **watch),
    "register": lambda **watch: snake_rs.register(thing(), thing(), **watch),
    "map": lambda **watch: snake_rs.PreparedMap(thing(), voxel_size=0.01).register(thing(), **watch),
    "align": lambda **watch: snake_rs.align([thing(), thing(1500)], **watch),
}


@pytest.mark.parametrize("name", CALLS)
def test_calls_end_in_time_and_tell_their_progress(name):
    call, told = CALLS[name], []
    with pytest.raises(TimeoutError, match="the deadline passed before the call ended"):
        call(deadline=0)
    for wrong in (-1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="deadline: expected a number of seconds"):
            call(deadline=wrong)
    call(deadline=1000, progress=lambda stage, done, total: told.append((stage, done, total)))
    assert told and all(isinstance(stage, str) and 0 <= done <= total for stage, done, total in told)

    def stop(*stage):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        call(progress=stop)


def test_organised_arrays_are_their_rows():
    points = thing().reshape(50, 80, 3).astype(np.float32)
    points[3, 5] = np.nan
    with_rgb = np.concatenate([points, np.zeros((50, 80, 1), np.float32)], axis=2)
    expected = snake_rs.detect(points.reshape(-1, 3))
    for given in (points, with_rgb, points[::-1][::-1], np.asfortranarray(points)):
        found = snake_rs.detect(given)
        assert np.array_equal(found.points, expected.points)
        assert np.array_equal(found.nearest_index, expected.nearest_index)
    assert np.allclose(points.reshape(-1, 3)[expected.nearest_index[0]], expected.points[0], atol=0.05)
    for wrong in ((3, 50, 80), (50, 80, 2), (2, 50, 80, 3)):
        with pytest.raises(ValueError, match=r"\(N, 3\) or more columns, or \(H, W, 3\)"):
            snake_rs.detect(np.zeros(wrong))


def test_parts_print_their_values_and_are_pickled():
    source, target = room(), room(3500)
    registration = snake_rs.register(source, target)
    edge = snake_rs.align([source, target]).edges[0]
    for part in (registration, registration.verdict, registration.clouds[0], edge):
        again = pickle.loads(pickle.dumps(part))
        assert repr(again) == repr(part) and type(again) is type(part)
    cloud = registration.clouds[0]
    place = f"position={cloud.position!r}, visible={cloud.visible!r}"
    assert repr(cloud) == f"CloudReport(viewpoint={cloud.viewpoint!r}, {place}, num_skipped=0)"
    assert f"Verdict(confidence={registration.verdict.confidence!r}, is_reliable=True, " in repr(registration.verdict)
    assert "information=array of shape (6, 6))" in repr(registration.fit)
