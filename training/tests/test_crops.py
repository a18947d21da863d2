"""Rays, surfaces and responses of made worlds against what geometry says."""

import numpy as np
import pytest
import torch

from snake_training.data.crops import DENSITY, corner_response, levels, make_crop, read
from snake_training.data.solids import BALL, CUBE, CYLINDER, ROOM, Solids
from snake_training.data.worlds import any_turn


def solid(kind, half=(3.0, 2.0, 1.0), seed=1):
    """One turned solid off the origin."""
    rng, world = np.random.default_rng(seed), Solids()
    world.add(kind, (0.5, -1, 2), half, any_turn(rng))
    return world


@pytest.mark.parametrize("kind", [CUBE, BALL, CYLINDER])
def test_rays_end_on_the_surface(kind):
    """Where a ray ends, a step back is outside and a step on is inside; what is aimed at the middle hits."""
    world, rng = solid(kind), np.random.default_rng(2)
    origins = rng.normal(size=(400, 3)) * 10 + (30, 0, 0)
    directions = (0.5, -1, 2) + rng.normal(size=(400, 3)) * 0.3 - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    t, which, cosine = world.cast(origins, directions)
    hit = np.isfinite(t)
    assert hit.mean() > 0.95 and (which == 0).all() and (cosine <= 1 + 1e-9).all()
    t, cosine, origins, directions = t[hit], cosine[hit], origins[hit], directions[hit]
    assert not world.inside(origins + (t - 0.01)[:, None] * directions, 0).any()
    grazing = cosine < 0.1
    assert world.inside(origins + (t + 0.01)[:, None] * directions, 0)[~grazing].all()


@pytest.mark.parametrize(
    ("kind", "half", "area"),
    [(CUBE, (3, 2, 1), 88.0), (BALL, (2, 2, 2), 16 * np.pi), (CYLINDER, (1, 1, 3), 14 * np.pi)],
)
def test_a_surface_is_sampled_by_area(kind, half, area):
    points = solid(kind, half).surface(np.array([0.5, -1, 2]), 10, 20, np.random.default_rng(3))
    assert len(points) == pytest.approx(20 * area, rel=0.1)


def test_of_two_solids_the_nearer_one_is_seen_and_inner_surfaces_are_left_out():
    world = Solids()
    world.add(CUBE, (5, 0, 0), (1, 1, 1))
    world.add(CUBE, (8, 0, 0), (1, 5, 5))
    t, which, _ = world.cast(np.zeros((2, 3)), np.array([[1.0, 0, 0], [0.96, 0.28, 0]]))
    assert t[0] == pytest.approx(4) and which.tolist() == [0, 1]
    world.add(BALL, (5, 0, 0), (0.5, 0.5, 0.5))
    surface = world.surface(np.array([5.0, 0, 0]), 1.2, 50, np.random.default_rng(1))
    assert np.linalg.norm(surface - (5, 0, 0), axis=1).min() > 0.9


def test_corners_respond_and_edges_and_planes_do_not():
    world, turn = Solids(), any_turn(np.random.default_rng(4))
    world.add(CUBE, (-15, -15, -15), (15, 15, 15))
    surface = world.surface(np.zeros(3), 22, DENSITY, np.random.default_rng(5)) @ turn.T
    response, mass = corner_response(surface, 22.0)
    positions = np.array([[0, 0, 0], [-9, 0, 0], [-9, -9, 0], [5, 5, 5]]) @ turn.T
    corner, edge, plane, _ = levels(torch.from_numpy(read(response, positions, 22.0))).tolist()
    assert corner > 0.5 and edge < 0.1 and plane < 0.1
    assert read(mass, positions, 22.0)[3] == pytest.approx(0, abs=0.01)


def test_a_crop_is_the_same_on_every_run_and_its_points_lie_at_its_surface():
    first, again = (next(c for c in iter(lambda: make_crop(np.random.default_rng(9)), None) if c)[0] for _ in range(2))
    assert all(np.array_equal(first[name], again[name]) for name in first)
    apart = np.linalg.norm(first["solid_0"][:200, None] - first["surface"], axis=2).min(axis=1)
    assert np.median(apart) < 0.6  # voxels


def test_rays_meet_a_room_from_inside():
    world, rng = Solids(), np.random.default_rng(2)
    half, center, turn = np.array([2.0, 3.0, 4.0]), np.array([5.0, -1.0, 2.0]), any_turn(rng)
    world.add(ROOM, center, half, turn)
    rays = rng.normal(size=(500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    reach, _, slope = world.cast(np.tile(center + 0.3, (500, 1)), rays)
    local = np.abs((center + 0.3 + rays * reach[:, None] - center) @ turn / half)
    assert np.allclose(local.max(axis=1), 1) and (0 < slope).all() and (slope <= 1).all()
    assert len(np.unique(local.argmax(axis=1))) == 3 and not world.inside(center[None]).any()
    # From outside, a ray passes the near side.
    ahead, _, _ = world.cast(center[None] - 9 * turn[:, 2], turn[:, 2][None])
    assert np.allclose(ahead, 13)
