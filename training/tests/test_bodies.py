"""Bodies with known correspondences."""

import json

import numpy as np
import pytest

from snake_training.data import bodies, write_corpus
from snake_training.data.bodies import annotated, bent, bent_pair, body_pair, posed, surface_pair
from snake_training.data.shapes import triangles
from snake_training.data.skeletons import CLASSES, capsule, ellipsoid
from snake_training.evaluation.__main__ import evaluate
from snake_training.make import main


def two_poses(name, points=2000):
    """The same body in two poses: both, and the same points of the surface on each, with their bones."""
    rng = np.random.default_rng(5)
    bones = CLASSES[name](rng.random(bodies.NUM_PROPORTIONS))
    pair = [posed(bones, rng.uniform(-1, 1, (len(bones), 3))) for _ in range(2)]
    return *pair, *surface_pair(*pair, points, rng)


def rigid(source, target):
    """How far the best rigid motion (Kabsch) leaves points (N, 3) from their partners, at most."""
    centers = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - centers[0]).T @ (target - centers[1]))
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return np.abs((source - centers[0]) @ turn + centers[1] - target).max()


@pytest.mark.parametrize("name", CLASSES)
def test_the_pose_moves_each_point_to_its_partner(name):
    first, second, one, other, bone = two_poses(name)
    for number in range(len(first.bones)):
        part = bone == number
        local = (one[part] - first.positions[number]) @ first.rotations[number]
        np.testing.assert_allclose(
            local @ second.rotations[number].T + second.positions[number], other[part], atol=1e-9
        )
        if part.sum() > 10:
            assert rigid(one[part], other[part]) < 1e-6
    # The pose is more than one motion of the whole.
    assert rigid(one, other) > 0.01


@pytest.mark.parametrize("name", CLASSES)
def test_joints_hold_and_no_point_is_hidden(name):
    first, second, one, other, bone = two_poses(name)
    for body in (first, second):
        for number, limb in enumerate(body.bones):
            if limb.parent >= 0:
                joint = body.moved(np.array([limb.parent]), np.array([limb.offset], float))
                np.testing.assert_allclose(joint[0], body.positions[number])
            np.testing.assert_allclose(body.rotations[number] @ body.rotations[number].T, np.eye(3), atol=1e-12)
    assert not first.is_inside(one, bone).any() and not second.is_inside(other, bone).any()


def test_a_solid_contains_what_lies_below_its_surface():
    for solid in (capsule(0.6, 0.2), ellipsoid((0.4, 0.6, 1), (0, 0, 0.3))):
        center = np.array([0, 0, 0.3])
        surface = triangles(solid.patches).reshape(-1, 3)
        assert solid.contains(center + (surface - center) * 0.97).all()
        assert not solid.contains(center + (surface - center) * 1.001).any()


@pytest.mark.parametrize("name", CLASSES)
def test_landmarks_are_tips_that_move_with_the_pose(name):
    first, second, *_ = two_poses(name)
    (positions, bone), (moved, _) = first.landmarks(), second.landmarks()
    local = np.einsum("nji,nj->ni", first.rotations[bone], positions - first.positions[bone])
    np.testing.assert_allclose(second.moved(bone, local), moved, atol=1e-12)
    cloud, indices = annotated(name, 2048, 1, 0)
    assert cloud.dtype == np.float32 and 4 <= len(set(indices.tolist())) <= 16
    assert np.linalg.norm(np.ptp(cloud, axis=0)) == pytest.approx(1, abs=1e-5)
    again, _ = annotated(name, 2048, 1, 0)
    other, _ = annotated(name, 2048, 2, 0)
    assert (cloud == again).all() and (cloud != other).any()


def test_an_annotated_point_lies_at_its_landmark():
    rng = np.random.default_rng([1, 0, 0xA770])
    bones = CLASSES["person"](rng.random(bodies.NUM_PROPORTIONS))
    body = posed(bones, rng.uniform(-1, 1, (len(bones), 3)))
    cloud, _, _ = surface_pair(body, body, 2048, rng)
    positions, _ = body.landmarks()
    points, indices = annotated("person", 2048, 1, 0)
    scale = np.linalg.norm(np.ptp(cloud, axis=0))
    np.testing.assert_allclose(np.ptp(points, axis=0) * scale, np.ptp(cloud, axis=0), rtol=1e-4)
    assert np.linalg.norm(cloud[indices] - positions, axis=1).max() < 0.06


def test_pairs_have_the_scale_of_the_first_body_and_a_seed():
    one, other = body_pair("chair", 512, 1, 2)
    assert np.linalg.norm(one, axis=1).max() == pytest.approx(1, abs=1e-5) and one.dtype == other.dtype == np.float32
    assert 0.6 < np.linalg.norm(other, axis=1).max() < 1.6 and np.abs(one - other).max() > 0.05
    again, _ = body_pair("chair", 512, 1, 2)
    assert (one == again).all() and (one != body_pair("chair", 512, 1, 10)[0]).any()
    # Neighbours on one body are neighbours on the other.
    near = np.linalg.norm(one[:, None] - one, axis=2) < 0.05
    assert np.linalg.norm(other[:, None] - other, axis=2)[near].max() < 0.3


def test_a_bend_keeps_lengths_along_its_axis_and_a_twist_those_across():
    axis = np.zeros((101, 3))
    axis[:, 2] = np.linspace(-1, 1, 101)
    curved = bent(axis, 0.4, 0.7)
    steps = np.linalg.norm(np.diff(curved, axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.02, rtol=1e-4)
    assert np.linalg.norm(curved[0] - curved[-1]) == pytest.approx(2 / 0.7 * np.sin(0.7))
    points = np.random.default_rng(1).uniform(-0.6, 0.6, (200, 3))
    twisted = bent(points, 0.6, 0)
    np.testing.assert_allclose(np.hypot(*twisted[:, :2].T), np.hypot(*points[:, :2].T))
    assert (twisted[:, 2] == points[:, 2]).all() and (bent(points, 0, 0) == points).all()
    np.testing.assert_allclose(bent(points, 0, 1e-9), points, atol=1e-6)


def test_a_bent_copy_is_another_shape_and_one_to_one():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    one, other = bent_pair(points, rng)
    assert rigid(one, other) > 0.02
    distances = [np.linalg.norm(body[:, None] - body, axis=2)[np.triu_indices(500, 1)] for body in (one, other)]
    assert 0.2 < (distances[1] / distances[0]).min() and (distances[1] / distances[0]).max() < 3


def test_the_command_writes_what_the_evaluation_reads(tmp_path):
    cloud = np.random.default_rng(1).normal(size=(300, 3))
    write_corpus(tmp_path / "corpus", [cloud, cloud, cloud], 300)
    index = [{"category": name} for name in ("animal", "chair", "character")]
    (tmp_path / "corpus/index.json").write_text(json.dumps(index))
    words = ["--number", "8", "--points", "256", "--corpus", str(tmp_path / "corpus"), "--bends", "2"]
    main(["bodies", "-o", str(tmp_path / "made"), *words])
    assert [np.load(tmp_path / f"made/bent/body_{body}.npy").shape for body in (1, 2)] == [(4, 256, 3)] * 2
    assert {path.stem for path in (tmp_path / "made/annotated/annotations").glob("*.json")} == set(CLASSES)
    for name, number in (("annotated", 8), ("posed", 8), ("bent", 4)):
        words = "semantic", tmp_path / "made" / name, "--methods", "fps", "--threshold", "0.1"
        assert evaluate([*map(str, words)])["unit"].nunique() == number
