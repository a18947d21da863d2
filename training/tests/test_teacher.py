"""A teacher's targets, their file, the views that a student is shown, and a run that learns them."""

import dataclasses

import numpy as np
import pytest
import torch

from conftest import TINY, judged
from snake_training import teacher as module
from snake_training.augment import BOUND, degraded, normalize, random_rotation, student_views
from snake_training.config import TrainConfig
from snake_training.data import Procedural
from snake_training.export import load_network, write_weights
from snake_training.tasks.objects import make_batch
from snake_training.teacher import (
    Targets,
    TeacherSettings,
    averaged_fields,
    copies,
    sample_queries,
    snake_rs_teacher,
    target_of,
    torch_teacher,
    write_targets,
)
from snake_training.train import train

SMALL = TeacherSettings(rotations=2, queries=64, points=128)


@pytest.fixture
def file(tmp_path, network):
    """A file of targets of three procedural shapes."""
    path = tmp_path / "targets.safetensors"
    write_targets(path, [torch_teacher(network)], Procedural(3, points=200), SMALL)
    return path


def test_queries_are_near_the_points_or_uniform_and_within_the_volume():
    points = np.zeros((10, 3), np.float32)
    queries = sample_queries(points, 4000, np.random.default_rng(0))
    distance = np.linalg.norm(queries, axis=1)
    assert queries.shape == (4000, 3) and queries.dtype == np.float32 and abs(queries).max() <= BOUND
    assert 0.85 < (distance < 0.13).mean() < 0.9 and distance.max() > 0.5


def test_fields_are_the_means_over_turned_copies(network):
    rng = np.random.default_rng(2)
    clouds = rng.uniform(-0.4, 0.4, (3, 128, 3)).astype(np.float32)
    queries = rng.uniform(-0.4, 0.4, (50, 3)).astype(np.float32)
    rotations = np.stack([random_rotation(rng) for _ in range(3)])
    found = averaged_fields(torch_teacher(network), clouds, queries, rotations)
    fields = [
        network(torch.from_numpy(cloud @ turn.T)[None], torch.from_numpy(queries @ turn.T)[None])
        for cloud, turn in zip(clouds, rotations)
    ]
    log_odds = torch.stack([torch.logit(saliency[0]) for _, saliency in fields]).detach().numpy()
    assert np.allclose(found[0], log_odds.mean(axis=0), atol=0.01)  # bfloat16
    assert np.allclose(found[1], fields[0][0][0].detach(), atol=0.01)  # of three copies the first is clean
    assert np.ptp(log_odds, axis=0).max() > 0.05


def test_both_engines_agree(network, tmp_path):
    path = tmp_path / "weights.safetensors"
    write_weights(path, network.config, network.state_dict())
    rng = np.random.default_rng(3)
    points, queries = (rng.uniform(-0.4, 0.4, (2, number, 3)).astype(np.float32) for number in (128, 50))
    ours, theirs = (teacher(points, queries) for teacher in (snake_rs_teacher(path), torch_teacher(network)))
    for one, other in zip(ours, theirs):
        assert one.shape == other.shape == (2, 50) and np.allclose(one, other, atol=0.02)  # bfloat16


def test_of_three_copies_one_is_clean_one_noisy_and_one_thinned():
    rng = np.random.default_rng(4)
    shape = np.append(rng.uniform(-0.5, 0.5, (900, 2)), np.zeros((900, 1)), axis=1).astype(np.float32)
    clouds = copies(shape, 6, 600, rng)
    assert clouds.shape == (6, 600, 3) and clouds.dtype == np.float32
    height = clouds[:, :, 2].std(axis=1)
    assert (height[[0, 2, 3, 5]] == 0).all() and (0.008 < height[[1, 4]]).all() and (height[[1, 4]] < 0.04).all()
    distinct = [len(np.unique(cloud, axis=0)) for cloud in clouds]
    assert distinct[0] == distinct[3] == 600 and all(60 <= distinct[copy] <= 150 for copy in (2, 5))


@pytest.mark.parametrize(("log_odds", "expected"), [(1.5, 1.5 + np.log(0.52 / 1.02) - 0.7), (-9, -3)])
def test_targets_are_the_mean_lowered_off_the_surface(log_odds, expected):
    assert target_of([(np.full(3, log_odds), np.full(3, 0.5))], [1]) == pytest.approx(expected, abs=1e-6)


def test_of_several_networks_the_highest_is_the_target():
    everywhere = np.ones(3)
    one, other = np.float64([5.7, -9, 0.7]), np.float64([-9, 1.7, 0.2])  # 0.7 are taken off
    found = target_of([(one, everywhere), (other, everywhere)], [0.5, 1])
    assert found == pytest.approx([-3 + 0.5 * 8, 1, -0.5], abs=1e-6)


def test_a_file_holds_the_shapes_and_comes_back(file, tmp_path):
    targets = Targets(file)
    assert len(targets) == 3 and [p.name for p in tmp_path.iterdir()] == [file.name]
    clouds = [normalize(Procedural(3, points=200)[row])[0] for row in range(3)]
    points, queries, target = targets.sample(np.random.default_rng(0))
    assert points.shape == (128, 3) and queries.shape == (64, 3) and target.shape == (64,)
    assert points.dtype == queries.dtype == target.dtype == np.float32
    gaps = [np.linalg.norm(points[:, None] - cloud[None], axis=2).min(axis=1).max() for cloud in clouds]
    first, second, _ = sorted(gaps)
    assert first < 1e-4 < second
    assert np.isfinite(target).all() and -3 <= target.min() and target.max() < 5
    assert len(Targets(file, file)) == 6


def test_another_file_is_refused(tmp_path, network):
    path = tmp_path / "weights.safetensors"
    write_weights(path, network.config, network.state_dict())
    with pytest.raises(ValueError, match="not a file of python -m snake_training.teacher"):
        Targets(path)
    path.write_bytes(b"short")
    with pytest.raises(ValueError, match="weights.safetensors"):
        Targets(path)


def test_the_command_writes_targets_and_refuses_what_it_cannot_do(tmp_path, network, capsys):
    weights, output = tmp_path / "weights.safetensors", tmp_path / "targets.safetensors"
    network.decoder_occup.fc_out.bias.data.fill_(9)
    write_weights(weights, network.config, network.state_dict())
    small = ["--rotations", "1", "--queries", "64", "--points", "64"]
    for engine in ("torch", "snake-rs"):
        module.main([str(weights), "--procedural", "2", "--engine", engine, "-o", str(output), *small])
        assert len(Targets(output)) == 2
        output.unlink()
    for wrong, said in (
        ([str(weights), "--procedural", "0"], "no shapes"),
        ([str(weights), "--rotations", "0"], "--rotations must be 1 or more"),
        ([str(tmp_path / "absent.safetensors"), "--procedural", "1"], "absent"),
    ):
        with pytest.raises(SystemExit):
            module.main([*wrong[:1], "-o", str(output), *small, *wrong[1:]])
        assert said in capsys.readouterr().err and not output.exists()


def queries_of_targets(sample, config):
    """The targets' queries (2, Q, 3) of a sample."""
    return sample["queries"][:, 2 * config.num_occupancy :]


def test_views_show_the_same_places(file):
    config = TrainConfig(**TINY | {"num_targets": 40})
    shape = Targets(file).sample(np.random.default_rng(3))
    sample = student_views(shape, config, np.random.default_rng(4))
    shapes = {name: value.shape for name, value in sample.items()}
    assert shapes == {"points": (2, 128, 3), "queries": (2, 64 + 40, 3), "target": (40,)}
    # Undegraded views are rigid copies of one cloud: distances between queries agree, and are those of the shape.
    queries = queries_of_targets(sample, config)
    apart = [np.linalg.norm(view[:, None] - view[None], axis=2) for view in queries]
    assert np.allclose(*apart, atol=1e-5)
    assert not np.allclose(*queries, atol=0.01)
    # Half of the queries are from the fifth of highest target.
    assert (sample["target"] >= np.sort(shape[2])[-len(shape[2]) // 5]).mean() >= 0.5


def test_degraded_views_are_thinned_or_noisy_or_both():
    cloud = np.random.default_rng(3).random((128, 3), np.float32)
    views = [degraded(cloud, np.random.default_rng(seed)) for seed in range(60)]
    sizes = {len(view) for view in views}
    assert min(sizes) < 16 and min(sizes) >= 128 // 16 and max(sizes) == 128
    is_noisy = [not np.isin(view, cloud).all() for view in views]
    kinds = {(len(view) < 128, noisy) for view, noisy in zip(views, is_noisy)}
    assert kinds == {(True, False), (False, True), (True, True)}
    offsets = [view - cloud for view in views if len(view) == 128]
    assert 0.02 < max(offset.std() for offset in offsets) < 0.06


def test_losses_vanish_for_a_network_that_is_its_own_target(file, network):
    batch = make_batch(Targets(file), TrainConfig(**TINY | {"num_targets": 40}), 0, 2)
    saliency = network(batch["points"].flatten(0, 1), batch["queries"].flatten(0, 1))[1].detach().unflatten(0, (2, 2))
    matched = batch | {"target": torch.logit(saliency[:, 0, len(batch["label"]) :])}
    losses, _ = judged(network, matched)
    # The first view meets its target; the second misses it by what it misses the first by.
    assert losses["distillation"].item() == pytest.approx(losses["consistency"].item() / 2, rel=1e-4)
    still = {name: value[:, :1].expand_as(value) if value.ndim == 4 else value for name, value in matched.items()}
    losses, _ = judged(network, still)
    assert losses["distillation"].item() < 1e-9 and losses["consistency"].item() == 0


def test_a_run_learns_the_targets(file, tiny, tmp_path, network):
    weights = tmp_path / "teacher.safetensors"
    write_weights(weights, network.config, network.state_dict())
    config = tiny(targets=(str(file),), init=str(weights), fresh_saliency=True, steps=60, learning_rate=1e-2, batch=4)
    train(config, "cpu")
    batch = make_batch(Targets(file), dataclasses.replace(config, seed=9), 0, 8)
    after = judged(load_network(config.run_dir), batch)[0]["distillation"].item()
    mean = batch["target"].mean()
    constant = torch.nn.functional.smooth_l1_loss(mean.expand_as(batch["target"]), batch["target"]).item()
    assert after < constant
