"""Distillation: the averaged targets, their file, the views drawn from them, and a run that learns them."""

import dataclasses

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from conftest import TINY
from snake_training import targets as module
from snake_training.augment import (
    BOUND,
    WINDOW_CORE,
    degraded,
    distillation_views,
    near,
    normalize,
    random_rotation,
    window,
)
from snake_training.config import TrainConfig
from snake_training.data import Procedural, Stretched
from snake_training.data.procedural import box, sample_surface
from snake_training.data.scenes import Places
from snake_training.export import load_network, write_weights
from snake_training.losses import distillation_losses
from snake_training.targets import (
    Targets,
    averaged_fields,
    local_contrast,
    rank_targets,
    sample_queries,
    sharpen,
    snake_rs_teacher,
    surface_variation,
    torch_teacher,
    weighted_sum,
    write_targets,
)
from snake_training.train import make_batch, train


@pytest.fixture
def file(tmp_path, network):
    """A file of targets of three procedural shapes."""
    path = tmp_path / "targets.safetensors"
    write_targets(path, torch_teacher(network), Procedural(3, points=200), rotations=2, queries=64, points=128)
    return path


def test_queries_are_near_the_points_or_uniform_and_within_the_volume():
    points = np.zeros((10, 3), np.float32)
    queries = sample_queries(points, 4000, np.random.default_rng(0))
    distance = np.linalg.norm(queries, axis=1)
    assert queries.shape == (4000, 3) and queries.dtype == np.float32 and abs(queries).max() <= BOUND
    assert 0.85 < (distance < 0.13).mean() < 0.9 and distance.max() > 0.5


def test_fields_are_the_means_over_turned_copies(network):
    rng = np.random.default_rng(2)
    points, queries = (rng.uniform(-0.4, 0.4, (number, 3)).astype(np.float32) for number in (128, 50))
    turns = np.stack([random_rotation(rng) for _ in range(3)])
    found = averaged_fields(torch_teacher(network), points, queries, turns)
    volumes = [network.encode(torch.from_numpy(points @ turn.T)[None], autocast=True) for turn in turns]
    fields = [
        network.occupancy_and_saliency(volume, torch.from_numpy(queries @ turn.T)[None])
        for volume, turn in zip(volumes, turns)
    ]
    log_odds = torch.stack([torch.logit(saliency[0]) for _, saliency in fields]).detach().numpy()
    occupancy = torch.stack([occupancy[0] for occupancy, _ in fields]).detach()
    assert np.allclose(found[0], log_odds.mean(axis=0), atol=0.01)  # bfloat16
    assert np.allclose(found[1], occupancy.mean(dim=0), atol=0.01)
    assert np.ptp(log_odds, axis=0).max() > 0.05


def test_several_teachers_say_the_sum_of_their_shares(network):
    rng = np.random.default_rng(4)
    points, queries = (rng.uniform(-0.4, 0.4, (2, number, 3)).astype(np.float32) for number in (128, 50))
    teachers = [torch_teacher(network), lambda points, queries: (np.ones((2, 50)), np.zeros((2, 50)))]
    alone = teachers[0](points, queries)
    log_odds, occupancy = weighted_sum(teachers, [0.5, 3])(points, queries)
    assert np.allclose(log_odds, 0.5 * alone[0] + 3) and np.allclose(occupancy, alone[1] / 2)


def test_both_teachers_agree(network, tmp_path):
    path = tmp_path / "weights.safetensors"
    write_weights(path, network.config, network.state_dict())
    rng = np.random.default_rng(3)
    points, queries = (rng.uniform(-0.4, 0.4, (2, number, 3)).astype(np.float32) for number in (128, 50))
    ours, theirs = (teacher(points, queries) for teacher in (snake_rs_teacher(path), torch_teacher(network)))
    for one, other in zip(ours, theirs):
        assert one.shape == other.shape == (2, 50) and np.allclose(one, other, atol=0.02)  # bfloat16


def test_a_surface_bends_most_at_corners():
    cube = sample_surface(box((0.6, 0.6, 0.6)), 4000, np.random.default_rng(0))
    corner, edge, face, inside = (0.3, 0.3, 0.3), (0.3, 0.3, 0), (0.3, 0, 0), (0, 0, 0)
    response, nearness = surface_variation(cube, np.float32([corner, edge, face, inside]))
    assert response[0] > response[1] > response[2] + 5 and response[3] < -20
    assert (nearness[:3] > 0.8).all() and nearness[3] < 1e-9


def test_surface_variation_is_that_of_the_weighted_covariance():
    rng = np.random.default_rng(1)
    surface = rng.uniform(-0.3, 0.3, (300, 3)).astype(np.float32)
    for query, response in zip(surface, surface_variation(surface, surface[:20], (0.2,))[0]):
        weight = np.maximum(1 - ((surface - query) ** 2).sum(axis=1) / 0.2**2, 0)
        values = np.linalg.eigvalsh(np.cov(surface.T, aweights=weight, ddof=0))
        assert np.isclose(response, np.log(values[0] ** 2 / values.sum()), atol=1e-3)

    each = [surface_variation(surface, surface[:20], (radius,))[0] for radius in (0.1, 0.2)]
    assert np.allclose(surface_variation(surface, surface[:20], (0.1, 0.2))[0], np.mean(each, axis=0), atol=1e-4)


def test_corners_and_tips_stand_out_from_their_own_surroundings():
    rng = np.random.default_rng(1)
    cube = rng.uniform(-0.25, 0.25, (6000, 3))
    axis = rng.integers(3, size=6000)
    cube[np.arange(6000), axis] = rng.choice([-0.25, 0.25], 6000)
    cube = cube.astype(np.float32)
    corner, edge, face, inside = [0.25] * 3, [0.25, 0.25, 0], [0.25, 0, 0], [0, 0, 0]
    score, nearness = local_contrast(cube, np.float32([corner, edge, face, inside]))
    assert score[0] > score[1] + 0.5 > score[2] + 1
    assert (nearness[:3] > 0.5).all() and nearness[3] < 0.01


def test_contrast_hardly_changes_with_other_points_of_the_same_surface():
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(2, 4096, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    first, second = (directions * (0.2, 0.3, 0.4)).astype(np.float32)  # two samples of an ellipsoid
    one, other = (local_contrast(cloud, first[:200])[0] for cloud in (first, second))
    assert np.corrcoef(one, other)[0, 1] > 0.8


def test_every_place_gets_a_sharp_peak_whatever_its_height():
    rng = np.random.default_rng(3)
    queries = rng.uniform(-0.5, 0.5, (4000, 3)).astype(np.float32)
    queries[:, 2] = 0
    centers = np.float32([[-0.3, 0, 0], [0.3, 0, 0]])
    bumps = [h * np.exp(-((queries - c) ** 2).sum(axis=1) / (2 * 0.1**2)) for h, c in zip((3, 1), centers)]
    target = (sum(bumps) - 1).astype(np.float32)
    sharp = sharpen(target, queries)
    high, low = (sharp[np.argmin(((queries - c) ** 2).sum(axis=1))] for c in centers)
    slope = sharp[np.argmin(((queries - (-0.3, 0.1, 0)) ** 2).sum(axis=1))]
    assert high > low > slope + 0.5  # before, the high bump's slope was above the low bump's top
    assert sharpen(np.full(10, -3, np.float32), queries[:10]).max() == -3


def test_keypoints_of_the_mean_get_a_bump_on_the_surface_alone():
    rng = np.random.default_rng(3)
    plane = rng.uniform(-0.5, 0.5, (4096, 3)).astype(np.float32) * (1, 1, 0)
    queries = plane.astype(np.float32)
    places = np.array([[0.2, 0.1, 0], [-0.3, -0.2, 0]])
    distance = np.linalg.norm(queries[:, None] - places, axis=2).min(axis=1)
    log_odds = (1 - distance / 0.2).astype(np.float32)
    occupancy = np.ones(4096, np.float32)
    found = module.seek_modes(log_odds, occupancy, queries).numpy()[:2]
    assert np.linalg.norm(found[:, None] - places, axis=2).min(axis=0).max() < 0.02  # queries are 0.016 apart
    target = module.keypoint_targets(log_odds, occupancy, queries)
    peaks = np.linalg.norm(queries[:, None] - found, axis=2).argmin(axis=0)
    assert target[peaks] == pytest.approx(log_odds[peaks] - 0.7 + 2, abs=0.1)
    occupancy[peaks] = 0.1
    assert (module.keypoint_targets(log_odds, occupancy, queries)[peaks] < target[peaks] - 1.5).all()
    with pytest.raises(ValueError, match="no surface"):
        module.keypoint_targets(log_odds, 0 * occupancy, queries)


def test_targets_may_be_the_keypoints_of_a_teacher(tmp_path, network):
    shape = sample_surface(box((1, 2, 3)), 500, np.random.default_rng(1)).astype(np.float32)

    def teacher(points, queries):
        return queries[..., 0], np.ones(queries.shape[:2], np.float32)

    module.write_targets(tmp_path / "t", teacher, [shape], 1, 600, 300, local="keypoints")
    (points, queries, target) = module.Targets(tmp_path / "t").sample(np.random.default_rng(1))
    assert points.shape == (1, 300, 3) and queries.shape == (600, 3) and target.max() > 0.5


@pytest.mark.parametrize(("log_odds", "expected"), [(1.5, 1.5 + np.log(0.52 / 1.02) - 0.7), (-9, -3)])
def test_targets_may_be_the_mean_itself(tmp_path, log_odds, expected):
    shape = sample_surface(box((1, 2, 3)), 500, np.random.default_rng(1)).astype(np.float32)

    def teacher(points, queries):
        return np.full(queries.shape[:2], log_odds), np.full(queries.shape[:2], 0.5)

    module.write_targets(tmp_path / "t", teacher, [shape], 1, 600, 300, local="mean")
    assert module.Targets(tmp_path / "t").target == pytest.approx(expected, abs=1e-3)


def test_of_three_copies_one_is_whole_one_noisy_and_one_thinned(tmp_path):
    rng = np.random.default_rng(4)
    shape = np.append(rng.uniform(-0.5, 0.5, (900, 2)), np.zeros((900, 1)), axis=1).astype(np.float32)
    copies = module.disturbed_copies(shape, 6, 600, rng)
    assert copies.shape == (6, 600, 3) and copies.dtype == np.float32
    height = copies[:, :, 2].std(axis=1)
    assert (height[[0, 2, 3, 5]] == 0).all() and (0.008 < height[[1, 4]]).all() and (height[[1, 4]] < 0.04).all()
    distinct = [len(np.unique(copy, axis=0)) for copy in copies]
    assert distinct[0] == distinct[3] == 600 and all(60 <= distinct[copy] <= 150 for copy in (2, 5))

    def teacher(points, queries):
        """As log-odds the number of distinct points; whole copies are occupied."""
        found = [
            [len(np.unique(cloud.round(4), axis=0)), np.ptp(cloud @ np.linalg.svd(cloud)[2][2])] for cloud in points
        ]
        number, thickness = np.array(found).T
        shape = queries.shape[:2]
        return np.broadcast_to(number[:, None], shape), np.broadcast_to(thickness[:, None] < 1e-5, shape).astype(float)

    fields = module.fields_of(0, shape, teacher, rotations=3, queries=8, points=600, disturbed=True)
    assert (fields.occupancy == 1).all() and 420 < fields.log_odds[0] < 450  # (600 + 600 + 60 to 150) / 3


def test_clouds_without_a_teacher_are_ranked_by_themselves(tmp_path):
    shapes = Procedural(3, points=400)
    write_targets(tmp_path / "all", None, shapes, queries=256, points=256)
    write_targets(tmp_path / "first", None, [shapes[0]], queries=256, points=256)
    assert np.array_equal(Targets(tmp_path / "all").target[0], Targets(tmp_path / "first").target[0])


def test_targets_keep_the_order_and_spread_the_best():
    """On the surface the share of better queries decides: e times fewer are 0.6 higher."""
    rng = np.random.default_rng(0)
    saturated = np.tanh(rng.normal(size=(4, 10000)) + 2).astype(np.float32)
    target = rank_targets(saturated, np.ones_like(saturated))
    order = saturated.ravel().argsort()[::-1]
    best_first = target.ravel()[order]
    assert (np.diff(best_first) <= 0).all()
    assert best_first[400] - best_first[1087] == pytest.approx(0.6, abs=0.02)
    above = (1 / (1 + np.exp(-target)) > 0.7).mean()
    assert above == pytest.approx(0.046, abs=0.002)


def test_targets_fall_off_the_surface():
    log_odds = np.linspace(-5, 5, 100, dtype=np.float32)
    occupancy = np.repeat([[1.0], [0.6], [0.1], [0.0]], 100, axis=1).astype(np.float32)
    target = rank_targets(np.stack([log_odds] * 4), occupancy)
    assert (target[0, 1:] > target[1, 1:]).all() and (target[1, 50:] > target[2, 50:]).all()
    assert target.min() == -3 and target[3, :50].max() == -3
    with pytest.raises(ValueError, match="no surface"):
        rank_targets(log_odds, np.zeros_like(log_odds))


def test_a_file_holds_the_shapes_and_comes_back(file, tmp_path):
    targets = Targets(file)
    assert len(targets) == 3 and [p.name for p in tmp_path.iterdir()] == [file.name]
    clouds = [normalize(Procedural(3, points=200)[row])[0] for row in range(3)]
    (points,), queries, target = targets.sample(np.random.default_rng(0))
    assert points.shape == (128, 3) and queries.shape == (64, 3) and target.shape == (64,)
    assert points.dtype == queries.dtype == target.dtype == np.float32
    gaps = [np.linalg.norm(points[:, None] - cloud[None], axis=2).min(axis=1).max() for cloud in clouds]
    first, second, _ = sorted(gaps)
    assert first < 1e-4 < second
    assert np.isfinite(target).all() and -3 <= target.min() and target.max() < 5


@pytest.fixture
def places(tmp_path):
    """A file of targets of three places, each in four views."""
    path = tmp_path / "places.safetensors"
    write_targets(path, None, Places(Procedural(), 3), queries=64, points=128)
    return path


def test_files_of_objects_and_of_places_come_together(file, places):
    targets = Targets(file, places)
    assert targets.views.tolist() == [1, 1, 1, 4, 4, 4]
    shapes = {targets.sample(np.random.default_rng(seed))[0].shape for seed in range(20)}
    assert shapes == {(1, 128, 3), (4, 32, 3)}


def test_windows_of_a_place_show_the_same_places(tmp_path):
    config = TrainConfig(**TINY | {"degraded_share": 0.0, "num_targets": 40})
    write_targets(tmp_path / "places", None, Places(Procedural(), 1), queries=1024, points=512)
    shape = Targets(tmp_path / "places").sample(np.random.default_rng(3))
    for seed in range(10):
        sample = distillation_views(shape, config, np.random.default_rng(seed))
        assert np.linalg.norm(sample["points"], axis=2).max() <= 0.5 + 1e-5
        # Each window has its own scale; distances between the queries agree up to it.
        one, other = (np.linalg.norm(view[:, None] - view[None], axis=2) for view in sample["queries"])
        assert one.sum() > 0
        assert np.allclose(one * (other.sum() / one.sum()), other, atol=1e-4)


def test_a_window_is_a_ball_within_the_volume():
    points = np.random.default_rng(0).uniform(-BOUND, BOUND, (2000, 3))
    for seed in range(20):
        inside, center, scale = window(points, np.random.default_rng(seed))
        assert np.linalg.norm((points[inside] - center) / scale, axis=1).max() < 0.5
        assert 0.8 <= scale <= 1 and np.linalg.norm(center) + scale / 2 <= BOUND + 1e-9
    assert near(np.float32([[0, 0, 0.01], [0.3, 0, 0]]), np.zeros((1, 3))).tolist() == [True, False]
    assert WINDOW_CORE < 0.5


def test_stretched_copies_are_affine_images_of_their_shapes():
    shapes = Procedural(2, points=50)
    copies = Stretched(shapes, 2)
    assert len(copies) == 4
    for row in range(4):
        source = np.c_[shapes[row % 2], np.ones(50)]
        matrix, residual, _, _ = np.linalg.lstsq(source, copies[row], rcond=None)
        stretch = np.linalg.svd(matrix[:3], compute_uv=False)
        assert residual.max() < 1e-6 and stretch.max() < np.exp(0.5) + 1e-4 and stretch.min() > np.exp(-0.5) - 1e-4
        assert np.ptp(stretch) > 0.01


def test_another_file_is_refused(tmp_path, network):
    path = tmp_path / "weights.safetensors"
    write_weights(path, network.config, network.state_dict())
    with pytest.raises(ValueError, match="not a file of python -m snake_training.targets"):
        Targets(path)
    path.write_bytes(b"short")
    with pytest.raises(ValueError, match="weights.safetensors"):
        Targets(path)


def test_the_command_writes_targets_and_refuses_what_it_cannot_do(tmp_path, network, capsys):
    weights, output = tmp_path / "weights.safetensors", tmp_path / "targets.safetensors"
    write_weights(weights, network.config, network.state_dict())
    small = ["--rotations", "1", "--queries", "64", "--points", "64"]
    for given, number in (
        ([str(weights), "--procedural", "2"], 2),
        ([str(weights), "--procedural", "2", "--engine", "snake-rs"], 2),
        (["--procedural", "2"], 2),
        (["--procedural", "2", "--local", "peaks"], 2),
        (["--places", "1"], 1),
        ([str(weights), "--procedural", "1", "--local", "mean", "--disturbed"], 1),
        ([str(weights), str(weights), "--shares", "1", "2", "--procedural", "1"], 1),
    ):
        module.main([*given, "-o", str(output), *small])
        assert len(Targets(output)) == number
        output.unlink()
    for wrong, said in (
        ([str(weights), "--procedural", "0"], "no shapes"),
        ([str(weights), "--rotations", "0"], "--rotations must be 1 or more"),
        ([str(weights), "--places", "1"], "leave out the WEIGHTS"),
        ([str(weights), "--local", "peaks"], "leave out WEIGHTS"),
        (["--procedural", "1", "--local", "mean"], "give WEIGHTS"),
        (["--procedural", "1", "--disturbed"], "give WEIGHTS"),
        ([str(weights), "--shares", "1", "2", "--procedural", "1"], "--shares needs as many numbers"),
    ):
        with pytest.raises(SystemExit):
            module.main(["-o", str(output), *small, *wrong])
        assert said in capsys.readouterr().err and not output.exists()


def test_views_show_the_same_places(file):
    config = TrainConfig(**TINY | {"degraded_share": 0.0, "num_targets": 40})
    shape = Targets(file).sample(np.random.default_rng(3))
    sample = distillation_views(shape, config, np.random.default_rng(4))
    assert {name: value.shape for name, value in sample.items()} == {
        "points": (2, 128, 3), "occupancy_queries": (2, 64, 3), "queries": (2, 40, 3), "target": (40,),
    }  # fmt: skip
    # Undegraded views are rigid copies of one cloud: distances between queries agree, and are those of the shape.
    apart = [np.linalg.norm(view[:, None] - view[None], axis=2) for view in sample["queries"]]
    assert np.allclose(*apart, atol=1e-5)
    assert not np.allclose(*sample["queries"], atol=0.01)
    # Half of the queries are from the fifth of highest target.
    assert (sample["target"] >= np.sort(shape[2])[-len(shape[2]) // 5]).mean() >= 0.5


def test_the_share_of_degraded_views_is_that_of_the_settings(file):
    shape = Targets(file).sample(np.random.default_rng(3))
    distinct = {}
    for share in (0.0, 1.0):
        config = TrainConfig(**TINY | {"degraded_share": share, "max_downsampling": 16.0})
        samples = [distillation_views(shape, config, np.random.default_rng(seed)) for seed in range(20)]
        distinct[share] = [len(np.unique(view, axis=0)) for sample in samples for view in sample["points"]]
    assert min(distinct[0.0]) > 90 and max(distinct[1.0]) > 90 and min(distinct[1.0]) < 16


def test_degraded_views_are_thinned_or_noisy_or_both():
    config, cloud = (
        TrainConfig(max_downsampling=16.0, max_noise=0.05),
        np.random.default_rng(3).random((128, 3), np.float32),
    )
    views = [degraded(cloud, config, np.random.default_rng(seed)) for seed in range(60)]
    sizes = {len(view) for view in views}
    assert min(sizes) < 16 and min(sizes) >= 128 // 16 and max(sizes) == 128
    is_noisy = [not np.isin(view, cloud).all() for view in views]
    kinds = {(len(view) < 128, noisy) for view, noisy in zip(views, is_noisy)}
    assert kinds == {(True, False), (False, True), (True, True)}
    offsets = [view - cloud for view in views if len(view) == 128]
    assert 0.02 < max(offset.std() for offset in offsets) < 0.06


def test_one_view_of_a_sample_may_show_one_side(tmp_path, network):
    path = tmp_path / "targets.safetensors"
    write_targets(path, torch_teacher(network), Procedural(3, points=3000), rotations=1, queries=2000, points=2000)
    config = TrainConfig(**TINY | {"degraded_share": 0.0, "partial_share": 1.0, "num_points": 2000, "num_targets": 400})
    for seed in range(6):
        sample = distillation_views(
            Targets(path).sample(np.random.default_rng(seed)), config, np.random.default_rng(seed)
        )
        full, partial = sorted(range(2), key=lambda view: -len(np.unique(sample["points"][view], axis=0)))
        assert len(np.unique(sample["points"][partial], axis=0)) < 0.8 * len(np.unique(sample["points"][full], axis=0))
        # What is asked is near what both show, and the one side is normalised as if there were nothing else.
        for view in range(2):
            gap = np.linalg.norm(sample["queries"][view][:, None] - sample["points"][view][None, ::2], axis=2).min(
                axis=1
            )
            assert gap.max() < 0.2
        assert np.abs(sample["points"].mean(axis=1)).max() < 0.02
        assert np.allclose(np.linalg.norm(sample["points"], axis=2).max(axis=1), 0.5, atol=1e-5)


def test_losses_vanish_for_a_network_that_is_its_own_target(file, network):
    batch = make_batch(Targets(file), TrainConfig(**TINY | {"num_targets": 40}), 0, 2, "cpu")
    queries = batch["queries"].flatten(0, 1)
    saliency = network(batch["points"].flatten(0, 1), queries)[1].detach().unflatten(0, (2, 2))
    matched = batch | {"target": torch.logit(saliency[:, 0])}
    losses, _ = distillation_losses(network, matched, False)
    # The first view meets its target; the second misses it by what it misses the first by.
    assert losses["distillation"].item() == pytest.approx(losses["consistency"].item() / 2, rel=1e-4)
    still = {name: value[:, :1].expand_as(value) if value.ndim == 4 else value for name, value in matched.items()}
    losses, _ = distillation_losses(network, still, False)
    assert losses["distillation"].item() < 1e-9 and losses["consistency"].item() == 0


def test_a_run_learns_the_targets(file, tiny, tmp_path, network):
    weights = tmp_path / "teacher.safetensors"
    write_weights(weights, network.config, network.state_dict())
    config = tiny(targets=(str(file),), init=str(weights), fresh_saliency=True, steps=30, learning_rate=1e-2, batch=4)
    train(config)
    batch = make_batch(Targets(file), dataclasses.replace(config, seed=9), 0, 8, "cpu")
    student = load_network(config.run_dir)
    after = distillation_losses(student, batch, False)[0]["distillation"].item()
    mean = batch["target"].mean()
    constant = torch.nn.functional.smooth_l1_loss(mean.expand_as(batch["target"]), batch["target"]).item()
    assert after < constant


def test_a_cluster_computes_the_same_targets(network, tmp_path, monkeypatch):
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'ray[data]'")
    pytest.importorskip("ray.data", reason="Ray Data is not installed: pip install 'ray[data]'")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=200 << 20)
    except (ray.exceptions.RayError, OSError, RuntimeError) as error:  # such as a sandbox without shared memory
        pytest.skip(f"Ray cannot start here: {error}")
    write_weights(tmp_path / "weights.safetensors", network.config, network.state_dict())
    given = [str(tmp_path / "weights.safetensors"), "--engine", "snake-rs", "--procedural", "20"]
    given += ["--rotations", "2", "--queries", "64", "--points", "128", "--disturbed"]
    try:
        for name, more in (("here", []), ("there", ["--ray", "2"])):
            module.main([*given, *more, "-o", str(tmp_path / name)])
    finally:
        ray.shutdown()
    here, there = (load_file(tmp_path / name) for name in ("here", "there"))
    assert here.keys() == there.keys() and all(np.array_equal(here[name], there[name]) for name in here)
