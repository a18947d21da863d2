"""The fit of the rule that chooses between the models of objects and of scenes."""

import numpy as np

import snake_rs
from snake_training.cloud_kind import fit, signs, varied
from snake_training.data.landmarks import landmarks
from snake_training.data.sensors import SCENE_KINDS, scene_cloud
from snake_training.data.views import FRAMES, bare_room, one_sided, table_top


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


def test_made_scenes_are_of_all_kinds_and_the_built_in_rule_knows_them_from_objects():
    rng = np.random.default_rng(1)
    made = [scene_cloud(rng) for _ in range(5)]
    assert {kind for kind, _ in made} <= set(SCENE_KINDS) and len({kind for kind, _ in made}) > 2
    scenes = [cloud for _, cloud in made] + [make(rng) for make in (table_top, bare_room) for _ in range(3)]
    scenes += [bare_room(rng, closed=True) for _ in range(3)]
    assert np.isfinite(signs(varied(cloud, rng) for cloud in scenes)).all()
    things = [landmarks(name, rng)[0] for name in ("box", "nut") for _ in range(4)]
    things += [one_sided(thing, rng, frame) for thing in things for frame in ("camera", "turned")]
    for clouds, is_scene in ((scenes, True), (things, False)):
        found = [snake_rs.detect(cloud * 10.0 ** rng.integers(-2, 4)).model for cloud in clouds]
        assert np.mean([("scenes" in model) == is_scene for model in found]) > 0.8, found


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
