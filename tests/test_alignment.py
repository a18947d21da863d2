"""snake_rs.align (`pytest tests/test_alignment.py`)."""

import numpy as np
import pytest
from transforms import SAMPLE, moved, rigid

import snake_rs


@pytest.fixture(scope="module")
def scans():
    """Two samplings of the sample that share half of their points, with their poses, and a sphere, which fits none of them."""
    sphere = np.random.default_rng(1).normal(size=(1500, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    poses = [rigid(2), rigid(3)]
    kept = [SAMPLE[np.arange(len(SAMPLE)) % 3 != start] for start in range(2)]
    clouds = [moved(pose, points) for points, pose in zip(kept, poses, strict=True)]
    return [clouds[0], sphere, clouds[1]], poses


def test_poses_and_parts(scans):
    clouds, poses = scans
    found = snake_rs.align(clouds)
    assert found.parts == [[0, 2], [1]] and found.num_pairs == 3
    np.testing.assert_array_equal(found.poses[0].t_part_cloud, np.eye(4))
    np.testing.assert_allclose(found.poses[2].t_part_cloud, poses[0] @ np.linalg.inv(poses[1]), atol=0.05)
    (edge,) = found.edges
    assert (edge.source, edge.target) == (2, 0) and edge.belief >= edge.confidence >= 0.5
    # The poses fit the points again after the edge was measured.
    assert edge.information.shape == (6, 6) and edge.residual < 2e-3
    assert np.all(np.linalg.eigvalsh(found.poses[2].covariance) > 0) and not found.poses[0].covariance.any()
    assert "parts=[[0, 2], [1]], edges=[Edge(source=2, target=0, " in repr(found)


def test_initial_poses_leave_out_what_contradicts_them(scans):
    clouds, poses = scans
    truth, elsewhere = map(np.linalg.inv, poses)
    elsewhere[:3, 3] += 0.5
    far = snake_rs.align(clouds, initial_poses=[truth, None, elsewhere])
    (at,) = far.contradictions
    assert far.parts == [[0], [1], [2]] and (at.source, at.target) == (2, 0) and at.distance > 0.8 > at.tolerance
    assert snake_rs.align(clouds, initial_poses=[truth, None, elsewhere], pose_tolerance=2).parts == [[0, 2], [1]]


def test_bad_arguments_are_refused(scans):
    clouds, _ = scans
    with pytest.raises(ValueError, match="initial_poses"):
        snake_rs.align(clouds, initial_poses=[None])
    with pytest.raises(ValueError, match="initial_poses"):
        snake_rs.align(clouds, initial_poses=[None, None, np.eye(3)])
    with pytest.raises(ValueError, match="cloud 1"):
        snake_rs.align([clouds[0], np.zeros((5, 3))])
    # `align` refuses options that only `register` has.
    for option in ("hypotheses", "initial", "source_viewpoint"):
        with pytest.raises(TypeError, match=rf"align\(\) got an unexpected keyword argument '{option}'.*max_partners"):
            snake_rs.align(clouds, **{option: 3})
    with pytest.raises(TypeError, match="sharpness"):
        snake_rs.align(clouds, sharpness=3)
    assert snake_rs.align(clouds, max_partners=1, viewpoints=[(9, 9, 9), None, (9, 0, 0)], seed=3).num_pairs >= 2
