"""The fit of the rule that chooses between the models of objects and of scenes."""

import numpy as np

from snake_training.cloud_kind import fit, signs, torus, varied
from snake_training.data.sensors import SCENE_KINDS, scene_cloud
from snake_training.data.views import FRAMES, one_sided, table_top


def test_the_fit_finds_the_log_odds():
    """Two normal distributions of one variance, 2 apart along the first axis: the log-odds are 2 x there, and 0 in between."""
    rng = np.random.default_rng(0)
    things, scenes = (rng.normal(size=(20000, 3)) + (shift, 0, 0) for shift in (-1, 1))
    rule = fit([(things, False), (scenes, True)], penalty=0)
    near = things[np.abs(things).max(axis=1) < 1.5]
    assert np.allclose(rule.score(near), 2 * near[:, 0], atol=0.4)
    # Each class is as important as the other, however many clouds it has.
    assert np.allclose(fit([(things[:2000], False), (scenes, True)], penalty=0).score(near), 2 * near[:, 0], atol=0.8)


def test_the_fit_finds_products():
    """Scenes are where the two signs have one sign."""
    rows = np.random.default_rng(0).normal(size=(4000, 2))
    is_scene = rows.prod(axis=1) > 0
    rule = fit([(rows[~is_scene], False), (rows[is_scene], True)])
    assert np.mean((rule.score(rows) > 0) == is_scene) > 0.97


def test_made_scenes_are_of_all_kinds_and_have_signs():
    rng = np.random.default_rng(1)
    made = [scene_cloud(rng) for _ in range(12)]
    assert {kind for kind, _ in made} <= set(SCENE_KINDS) and len({kind for kind, _ in made}) > 3
    assert all(cloud.shape[1] == 3 and np.isfinite(cloud).all() and len(cloud) > 100 for _, cloud in made)
    rows = signs([table_top(rng), *(varied(cloud, rng) for _, cloud in made)])
    assert rows.shape == (13, 12) and np.isfinite(rows).all()


def test_a_view_shows_the_near_side_in_its_frame():
    rng = np.random.default_rng(3)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for frame in FRAMES:
        for _ in range(4):
            view = one_sided(ball, rng, frame).astype(float)
            size = np.linalg.norm(view - view.mean(axis=0), axis=1).max()
            distance = np.linalg.norm(view.mean(axis=0)) / size
            assert 100 < len(view) <= 20000 and np.isfinite(view).all()
            if frame == "centred":
                assert distance < 1e-3
            elif frame != "moved":
                # The middle of what is seen is nearer than the center of the ball, which is at least 2 radii away.
                assert distance > 0.8
            if frame == "camera":
                assert view[:, 2].min() > 0


def test_signs_do_not_depend_on_the_unit_and_small_clouds_have_none():
    ring = torus(np.random.default_rng(2))
    here, there = signs([ring, ring * 1000])
    assert np.allclose(here, there, rtol=0.05, atol=0.02)
    assert len(signs([ring[:20]])) == 0
