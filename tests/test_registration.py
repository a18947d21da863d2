"""snake_rs.register and its parts; FPFH and normals against Open3D (`pytest tests/test_registration.py`)."""

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
    assert f"{matches.num_inliers} of {matches.num_matches}" in repr(found) and "reliable" in repr(found)


def values(result):
    """All values of a registration, as numbers, texts and lists."""
    groups = {"verdict": result.verdict, "fit": result.fit, "matches": result.matches}
    groups |= {f"cloud {place}": cloud for place, cloud in enumerate(result.clouds)}
    rows = {
        f"{group} {name}": np.asarray(getattr(part, name)).tolist()
        for group, part in groups.items()
        for name in dir(part)
        if not name.startswith("_")
    }
    transforms = [result.t_target_source.tolist(), [t.tolist() for t in result.hypotheses]]
    return rows | {"transforms": transforms, "seconds": result.seconds}


def test_results_can_be_pickled(cloud, found):
    many = snake_rs.register(cloud[:2048], moved(rigid(), cloud[2048:]), hypotheses=5)
    for result in (found, many):
        assert values(pickle.loads(pickle.dumps(result))) == values(result)
    assert len(values(found)) == 25
    for state in ({}, {"verdict": 1}, {"t_target_source": [[[[[[[1]]]]]]]}):
        with pytest.raises(ValueError, match="the state of a registration"):
            snake_rs.Registration(state)


def test_a_prepared_map_registers_scans_and_can_be_pickled(cloud):
    lengths = {"voxel_size": 0.05, "normal_radius": 0.1, "feature_radius": 0.25, "inlier_distance": 0.075}
    scan, floor = moved(rigid(), cloud[:2048]), cloud[2048:] + [700_000.0, 5_000_000, 0]
    prepared = snake_rs.PreparedMap(floor, **lengths)
    once = snake_rs.register(scan, floor, **lengths)
    for one in (prepared, pickle.loads(pickle.dumps(prepared))):
        found = one.register(scan)
        assert found.verdict.is_reliable and values(found) | {"seconds": 0} == values(once) | {"seconds": 0}
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
        # ICP can bring different matches to the same transform.
        is_same = (
            np.array_equal(other.t_target_source, found.t_target_source)
            and values(other)["matches rmse"] == values(found)["matches rmse"]
        )
        assert not is_same, options


def test_keypoints_of_surface_variation_register_a_moved_copy(cloud):
    moved_copy = snake_rs.register(cloud, moved(rigid(), cloud), detector="surface-variation")
    assert np.abs(moved(moved_copy.t_target_source, cloud) - moved(rigid(), cloud)).max() < 0.01
    assert moved_copy.matches.num_matches < 100  # voxels, the default, have thousands


def test_few_keypoints_are_spread(cloud):
    truth = rigid()
    few = snake_rs.register(cloud[:2048], moved(truth, cloud[2048:]), num_keypoints=250)
    assert np.abs(moved(few.t_target_source, cloud) - moved(truth, cloud)).max() < 0.05
    assert 3 <= few.matches.num_matches <= 500


def test_endless_and_nested_values_are_refused(cloud):
    nested = []
    nested.append(nested)
    for guess in (nested, range(10**9), [[[1.0]]]):
        with pytest.raises(ValueError, match="option `initial` is .*expected finite numbers"):
            snake_rs.register(cloud, cloud, initial=guess)


def test_guess_axis_and_viewpoints(cloud, found):
    truth = rigid()
    guessed = snake_rs.register(cloud[:2048], moved(truth, cloud[2048:]), initial=truth, hypotheses=3)
    assert np.abs(moved(guessed.t_target_source, cloud) - moved(truth, cloud)).max() < 0.05
    assert np.array_equal(guessed.hypotheses[0], guessed.t_target_source) and guessed.fit.information.shape == (6, 6)
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
        ({"descriptor": "shot"}, "expected `fpfh` or `field`"),
        ({"voxel_size": "big"}, "a number"),
        ({"voxel_size": -1.0}, "voxel_size"),
        ({"max_keypoints": 2}, "3 or more"),
        ({"seed": -1}, "whole number"),
        ({"max_matches": 2}, "3 to 20000"),
        ({"num_keypoints": 2}, "3 or more"),
        ({"gravity": "w"}, "gravity"),
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
    with pytest.raises(ValueError, match="source: no points"):
        snake_rs.register(cloud[:0], cloud)
    with pytest.raises(ValueError, match="target: none of the 4096 points is finite"):
        snake_rs.register(cloud, np.full_like(cloud, np.nan))
    with pytest.raises(ValueError, match="correspondences"):
        snake_rs.register(cloud[:2], cloud[:2])
    with pytest.raises(ValueError, match="radius"):
        snake_rs.estimate_normals(cloud, 0.0)
    with pytest.raises(ValueError, match="normals: 4095 for 4096 points"):
        snake_rs.fpfh(cloud, cloud[1:], 0.1)


@pytest.mark.parametrize("seed", range(5))
def test_normals_and_fpfh_are_those_of_open3d(cloud, seed):
    o3d = pytest.importorskip(
        "open3d", reason="open3d is not installed; tests/data/fpfh has a stored case", exc_type=ImportError
    )
    points = moved(rigid(seed), cloud[seed::2]).astype(np.float32)
    pc = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))
    pc.estimate_normals(o3d.geometry.KDTreeSearchParamRadius(0.1))
    pc.orient_normals_towards_camera_location(points.astype(float).mean(0))
    theirs, ours = np.asarray(pc.normals), snake_rs.estimate_normals(points, 0.1)
    assert ours.dtype == np.float32 and ours.shape == points.shape
    crowded = np.linalg.norm(ours, axis=1) > 0  # Open3D gives lone points (0, 0, 1)
    assert crowded.mean() > 0.9
    # Where two directions vary equally little, or the mean lies on the surface, the normal is anyone's guess.
    differ = np.abs(theirs - ours).max(axis=1)[crowded] > 1e-3
    assert differ.mean() < 0.01
    pc.normals = o3d.utility.Vector3dVector(ours.astype(float))
    feature = o3d.pipelines.registration.compute_fpfh_feature(pc, o3d.geometry.KDTreeSearchParamRadius(0.15))
    descriptors = snake_rs.fpfh(points, ours, 0.15)
    assert descriptors.dtype == np.float32 and descriptors.shape == (len(points), 33)
    # A pair of points whose angle is next to the edge of a bin may be in the other bin; a bin holds up to 200. The plain FPFH
    # of the crate's tests is that of Open3D to 1e-3.
    assert (np.abs(descriptors - feature.data.T) < 1).mean() > 0.999
