"""snake_rs.register and its parts; FPFH and normals against Open3D (`pytest tests/test_registration.py`)."""

import dataclasses
import pickle

import numpy as np
import pytest
from transforms import SAMPLE, moved, rigid

import snake_rs


@pytest.fixture(scope="module")
def cloud():
    return SAMPLE.copy()


@pytest.fixture(scope="module")
def found(cloud):
    return snake_rs.register(cloud[:2048], moved(rigid(), cloud[2048:]))


def test_register_finds_the_transform(cloud, found):
    assert found.t_target_source.shape == (4, 4) and found.t_target_source.dtype == np.float64
    assert np.abs(moved(found.t_target_source, cloud) - moved(rigid(), cloud)).max() < 0.05
    matches, fit = found.matches, found.fit
    assert 3 <= matches.num_inliers <= matches.num_matches and 3 <= matches.num_agreeing <= matches.num_matches
    assert 0 < matches.rmse < 0.1 and matches.spread > 0 and found.seconds > 0
    assert 0 < fit.fitness <= 1 and 0 < fit.rmse < fit.inlier_distance and fit.information.shape == (6, 6)
    assert found.verdict.is_reliable and found.verdict.confidence > 0.5 and not found.verdict.is_ambiguous
    assert [cloud.num_skipped for cloud in found.clouds] == [0, 0]


def values(result):
    """A registration as text, without its time."""
    return repr(dataclasses.asdict(result) | {"seconds": 0})


def test_a_prepared_map_registers_scans_and_can_be_pickled(cloud):
    lengths = {"voxel_size": 0.05, "normal_radius": 0.1, "feature_radius": 0.25, "inlier_distance": 0.075}
    scan, floor = moved(rigid(), cloud[:2048]), cloud[2048:] + [700_000.0, 5_000_000, 0]
    prepared = snake_rs.PreparedMap(floor, **lengths)
    once = snake_rs.register(scan, floor, **lengths)
    for one in (prepared, pickle.loads(pickle.dumps(prepared))):
        found = one.register(scan)
        assert found.verdict.is_reliable and values(found) == values(once)
        assert np.array_equal(found.t_target_source, once.t_target_source)
    assert prepared.voxel_size == 0.05 and "2048 points" in repr(prepared)
    with pytest.raises(ValueError, match="`voxel_size` is none"):
        snake_rs.PreparedMap(floor)
    with pytest.raises(TypeError, match="'gravity'"):
        prepared.register(scan, gravity="z")


def test_model_and_options_reach_the_core(cloud, found):
    again = {"model": snake_rs.Model.builtin(), "voxel_size": None, "seed": np.int64(0)}
    args = (cloud[:2048], moved(rigid(), cloud[2048:]))
    assert np.array_equal(snake_rs.register(*args, **again).t_target_source, found.t_target_source)
    for options in ({"detector": "iss"}, {"descriptor": "field"}, {"icp_steps": 0}, {"feature_radius": 0.5}):
        other = snake_rs.register(*args, **(again | options))
        assert values(other) != values(found), options


def test_guess_axis_and_viewpoints(cloud, found):
    truth = rigid()
    guessed = snake_rs.register(cloud[:2048], moved(truth, cloud[2048:]), initial=truth, hypotheses=3)
    assert np.abs(moved(guessed.t_target_source, cloud) - moved(truth, cloud)).max() < 0.05
    assert np.array_equal(
        guessed.hypotheses[0].t_target_source, guessed.t_target_source
    ) and guessed.fit.information.shape == (6, 6)
    shifted = cloud[2048:] + np.float32([1, 2, 3])
    upright = snake_rs.register(
        cloud[:2048], shifted, gravity="z", source_viewpoint=(0, 0, 9), target_viewpoint=[1, 2, 12]
    )
    assert [cloud.viewpoint for cloud in upright.clouds] == ["given", "given"]
    assert np.allclose(upright.t_target_source[2, :3], [0, 0, 1], atol=0.02) and 0 <= upright.verdict.confidence <= 1


@pytest.mark.parametrize(
    "options, message",
    [
        ({"detector": "orb"}, "harris3d"),
        ({"voxel_size": "big"}, "a number"),
        ({"seed": -1}, "whole number"),
        ({"initial": np.zeros((4, 4))}, "initial"),
        ({"source_viewpoint": [0, 1]}, "source_viewpoint"),
    ],
)
def test_options_outside_their_range_are_named(cloud, options, message):
    with pytest.raises(ValueError, match=message):
        snake_rs.register(cloud, cloud, **options)


def test_bad_arguments_are_refused(cloud):
    with pytest.raises(TypeError, match=r"register\(\) got an unexpected keyword argument 'voxel'.*voxel_size"):
        snake_rs.register(cloud, cloud, voxel=1)
    with pytest.raises(ValueError, match="target: expected"):
        snake_rs.register(cloud, cloud[:, :2])
    with pytest.raises(ValueError, match="radius"):
        snake_rs.estimate_normals(cloud, 0.0)
    with pytest.raises(ValueError, match="normals: 4095 for 4096 points"):
        snake_rs.fpfh(cloud, cloud[1:], 0.1)
