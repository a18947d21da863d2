"""The fit of the rule that chooses between the models of objects and of scenes."""

import numpy as np

from snake_training.cloud_kind import fit, score, signs, torus
from snake_training.data.sensors import SCENE_KINDS, scene_cloud


def test_the_fit_finds_the_log_odds():
    """Two normal distributions of one variance, 2 apart along the first axis: the log-odds are 2 x there, and 0 in between."""
    rng = np.random.default_rng(0)
    things, scenes = (rng.normal(size=(20000, 3)) + (shift, 0, 0) for shift in (-1, 1))
    weights = fit([(things, False), (scenes, True)], penalty=0)
    assert np.allclose(weights, (2, *np.zeros(6)), atol=0.1)  # of three signs, their squares and one
    # Each class is as important as the other, however many clouds it has.
    assert np.allclose(fit([(things[:2000], False), (scenes, True)], penalty=0), (2, *np.zeros(6)), atol=0.3)
    assert np.allclose(score(things[:5], weights), 2 * things[:5, 0], atol=0.5)


def test_made_scenes_are_of_all_kinds_and_have_signs():
    rng = np.random.default_rng(1)
    made = [scene_cloud(rng) for _ in range(12)]
    assert {kind for kind, _ in made} <= set(SCENE_KINDS) and len({kind for kind, _ in made}) > 3
    assert all(cloud.shape[1] == 3 and np.isfinite(cloud).all() and len(cloud) > 100 for _, cloud in made)
    rows = signs(cloud for _, cloud in made)
    assert rows.shape == (12, 8) and np.isfinite(rows).all()


def test_signs_do_not_depend_on_the_unit_and_small_clouds_have_none():
    ring = torus(np.random.default_rng(2))
    here, there = signs([ring, ring * 1000])
    assert np.allclose(here, there, rtol=0.05, atol=0.02)
    assert len(signs([ring[:20]])) == 0
