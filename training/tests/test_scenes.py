"""Rooms seen by a depth camera, and objects seen from one side."""

import json

import numpy as np
import pytest

from snake_training.augment import BOUND, facing, random_rotation, visible
from snake_training.data import Corpus, Procedural, write_corpus
from snake_training.data.procedural import box, sample_surface
from snake_training.data.scenes import (
    RANGE,
    VOXEL,
    Places,
    Scenes,
    depth_image,
    fragment,
    fused,
    look_at,
    main,
    one_in_each,
    room,
    standpoint,
    within,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def distances(points, others):
    """Of each point to the nearest of others."""
    return np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1)


def test_a_nearer_point_hides_those_behind_it():
    points = np.array([[0, 0, 1], [0, 0, 2], [0.001, 0, 1.01], [1, 0, 2], [0, 0, -1], [0, 0, 0]], float)
    assert visible(points, 0.05, 0.04).tolist() == [True, False, True, True, False, False]
    assert visible(points[:0], 0.05, 0.04).shape == (0,)


def test_a_camera_sees_its_target_on_its_axis_and_the_floor_below():
    turn = look_at(np.array([1.0, 2, 1.5]), np.array([3.0, 4, 1.5]))
    assert np.allclose(turn @ turn.T, np.eye(3)) and np.linalg.det(turn) == pytest.approx(1)
    assert np.allclose(turn @ (2, 2, 0), (0, 0, np.sqrt(8)))
    assert np.allclose(turn @ (0, 0, -1), (0, 1, 0))  # y is down


def test_of_a_box_at_most_three_faces_are_seen_from_one_side():
    points = sample_surface(box((0.5, 0.5, 0.5)), 4000, rng())
    front = facing(points, rng())
    assert (np.abs(points[front, 2] + 0.25) < 0.1).all() and front.sum() > 500  # the camera looks along z
    for seed in range(10):
        turned = points @ random_rotation(rng(seed)).T
        assert 0.1 < facing(turned, rng(seed)).mean() < 0.65


def test_a_depth_image_is_within_range_and_view_and_its_noise_lies_along_the_ray():
    points = rng().uniform(-6, 6, (40000, 3))
    seen = depth_image(points, rng(3))
    assert 100 < len(seen) < len(points)
    assert (seen[:, 2] > RANGE[0] * 0.9).all() and (seen[:, 2] < RANGE[1] * 1.1).all()
    ray = lambda p: p[:, :2] / p[:, 2:]
    distance = np.abs(ray(seen)[:50, None] - ray(points[points[:, 2] > 0.1])[None]).sum(axis=2).min(axis=1)
    assert distance.max() < 1e-9


def test_a_room_holds_what_stands_in_it():
    points, places = room(Procedural(), rng(4))
    low, high = points.min(axis=0), points.max(axis=0)
    assert (high - low < 8).all() and len(places) > 8
    assert (places > low - 0.01).all() and (places < high + 0.01).all()


def test_a_fragment_is_a_part_of_the_room_in_the_frame_of_its_first_camera():
    points, places = room(Procedural(), rng(5))
    seen = fragment(points, places, rng(6))
    assert len(seen) > 500 and np.median(seen[:, 2]) > RANGE[0]
    seen = fused(points, standpoint(points, rng(6)), places[0], rng(7))
    voxels = np.floor(seen / VOXEL).astype(int)
    assert len(np.unique(voxels, axis=0)) == len(seen)


def test_scenes_are_seeded_and_kept_in_a_corpus_folder(tmp_path):
    scenes = Scenes(Procedural(8, 500), 3, points=600, partial_share=0.4)
    write_corpus(tmp_path, scenes, 600)
    corpus = Corpus(tmp_path)
    assert len(corpus) == len(scenes) == 3 and len(json.loads((tmp_path / "index.json").read_text())) == 3
    for row in range(3):
        cloud = scenes[row].astype(np.float64)
        assert np.array_equal(cloud, scenes[row])
        cloud -= cloud.mean(axis=0)
        cloud /= np.linalg.norm(cloud, axis=1).max()
        gaps = np.linalg.norm(corpus[row][:, None] - cloud[None], axis=2)
        assert gaps.min(axis=0).max() < 1e-4 and gaps.min(axis=1).max() < 1e-4
    assert not np.array_equal(scenes[0], Scenes(Procedural(8, 500), 3, points=600, seed=2)[0])


def test_command_line(tmp_path, capsys):
    main(["-o", str(tmp_path / "rooms"), "--number", "1", "--points", "300"])
    assert Corpus(tmp_path / "rooms")[0].shape == (300, 3)
    for wrong in (["--number", "0"], ["--partial-share", "2"], ["--data", str(tmp_path / "none")]):
        with pytest.raises(SystemExit):
            main(["-o", str(tmp_path / "other"), *wrong])
    assert "no such folder" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_views_of_a_place_show_parts_of_one_surface():
    places = Places(Procedural(), 4, views=3, points=400, seed=2, places=2)
    assert len(places) == 4
    for row in (0, 3):
        views, surface = places[row]
        assert views.shape == (3, 400, 3) and np.linalg.norm(views, axis=2).max() < BOUND
        again = Places(Procedural(), 4, views=3, points=400, seed=2, places=2)[row]
        assert np.array_equal(views, again.views) and np.array_equal(surface, again.surface)
        assert np.percentile(distances(views.reshape(-1, 3), surface), 90) < 0.06
        gap = distances(views[0], views[1])
        assert np.percentile(gap, 25) < 0.06 < gap.max()


def test_points_within_a_voxel_of_others():
    points = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0, -0.05], [0.2, 0, 0]])
    assert within(points, np.array([[0.005, 0.005, 0.005]]), side=0.03).tolist() == [True, True, False, False]
    assert len(one_in_each(points, 0.03)) == 3
