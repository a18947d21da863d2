"""The fit of the networks that chooses between the models of objects and of scenes."""

import json

import numpy as np

import snake_rs
from snake_training.cloud_kind import Rule, fit, signs
from snake_training.data.kinds import empty_room, lattice, terrain, thing, varied
from snake_training.data.landmarks import landmarks
from snake_training.data.sensors import SCENE_KINDS, scene_cloud
from snake_training.data.views import FRAMES, bare_room, one_sided, table_top


def test_the_fit_finds_shapes_and_its_file_holds_the_networks(tmp_path):
    """Scenes are where two signs have one sign; a class of fewer clouds is as important."""
    rows = np.random.default_rng(0).normal(size=(4000, 2))
    is_scene = rows.prod(axis=1) > 0
    rule = fit([(rows[~is_scene][::10], False), (rows[is_scene], True)], networks=2, steps=300)
    for share in rule.score(rows[is_scene]) > 0, rule.score(rows[~is_scene]) < 0:
        assert share.mean() > 0.95
    rule.write(tmp_path / "kind.json")
    read = Rule(**json.loads((tmp_path / "kind.json").read_text()))
    assert np.allclose(read.score(rows), rule.score(rows), atol=0.1)


def test_made_scenes_are_of_all_kinds_and_the_built_in_rule_knows_them_from_objects():
    rng = np.random.default_rng(1)
    made = [scene_cloud(rng) for _ in range(5)]
    assert {kind for kind, _ in made} <= set(SCENE_KINDS) and len({kind for kind, _ in made}) > 2
    scenes = [cloud for _, cloud in made]
    scenes += [make(rng) for make in (table_top, bare_room, lattice, empty_room, terrain) for _ in range(3)]
    scenes += [bare_room(rng, closed=True) for _ in range(3)]
    assert np.isfinite(signs(varied(cloud, rng) for cloud in scenes)).all()
    things = [landmarks(name, rng)[0] for name in ("box", "nut") for _ in range(4)]
    things += [thing(rng) for _ in range(4)]
    things += [one_sided(cloud, rng, frame) for cloud in things for frame in ("camera", "turned")]
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
