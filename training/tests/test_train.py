"""The training loop on the smallest network: what a run writes, resuming, and sharing a batch between processes."""

import dataclasses
import itertools
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from conftest import arguments, judged
from snake_training import train as training
from snake_training.augment import normalize, two_views
from snake_training.command_line import parse_arguments
from snake_training.config import TrainConfig, from_table
from snake_training.data import Procedural
from snake_training.data.landmarks import landmarks
from snake_training.detection import DetectOptions, why_none
from snake_training.export import load_network, read_checkpoint, write_weights
from snake_training.losses import LOSSES, losses_of
from snake_training.model import SnakeNetwork
from snake_training.tasks import objects
from snake_training.tasks.objects import Objects, make_batch, start_saliency
from snake_training.train import dead_share, learning_rate, train, update_average


def state(config, name="last.pt"):
    """A checkpoint of a run."""
    return torch.load(Path(config.run_dir) / name, weights_only=True)


def scalars(config):
    """{name: {step: value}} of a run's TensorBoard files."""
    events = EventAccumulator(config.run_dir)
    events.Reload()
    return {name: {event.step: event.value for event in events.Scalars(name)} for name in events.Tags()["scalars"]}


def flat(tree, prefix=""):
    """{path: leaf} of nested dictionaries and lists."""
    if not isinstance(tree, dict | list | tuple):
        return {prefix: tree}
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    return {path: leaf for key, value in items for path, leaf in flat(value, f"{prefix}/{key}").items()}


# Runs


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1])
def test_a_signal_ends_a_run_with_a_checkpoint(tiny, monkeypatch, number):
    config = tiny()
    draw = Objects.batch

    def interrupted(self, *given):
        os.kill(os.getpid(), number)
        return draw(self, *given)

    handler = signal.getsignal(number)
    monkeypatch.setattr(Objects, "batch", interrupted)
    with pytest.raises(SystemExit, match="step 1: stopped; .* resumes"):
        train(config, "cpu")
    assert state(config)["step"] == 1 and signal.getsignal(number) is handler


def test_batches_of_worker_processes_are_those_of_one_process(tiny, tmp_path):
    one, ahead = tiny(run_dir=str(tmp_path / "one")), tiny(run_dir=str(tmp_path / "ahead"))
    train(one, "cpu")
    train(ahead, "cpu", workers=2)
    here, there = state(one)["network"], state(ahead)["network"]
    assert all(torch.equal(tensor, there[name]) for name, tensor in here.items())


def test_a_run_writes_its_config_checkpoints_and_logs(tiny):
    config = tiny()
    train(config)
    run = Path(config.run_dir)
    assert from_table(TrainConfig, json.loads((run / "config.json").read_text())) == config
    assert set(state(config)) == {
        "settings",
        "network_config",
        "step",
        "best",
        "network",
        "ema",
        "optimizer",
    }
    assert state(config)["step"] == 2 and from_table(TrainConfig, json.loads(state(config)["settings"])) == config
    assert state(config, "best.pt")["best"] >= 0
    logged = scalars(config)
    losses = {"occupancy", "repeatability", "surface", "sparsity", "saturated"}
    assert {name.removeprefix("train/") for name in logged if "train/" in name} == losses | {"gradient_norm"}
    measured = {f"{what}_nms_{radius}" for what in ("repeatability", "keypoints") for radius in (0.01, 0.05)}
    health = {"dead_share"}
    assert {name.removeprefix("validation/") for name in logged if "validation/" in name} == losses | measured | health
    assert all(math.isfinite(value) for steps in logged.values() for value in steps.values())
    assert not list(run.glob("*.partial"))
    # The export has the average, in a network that detection can use.
    average = load_network(run)
    assert average.config == config.network
    saved = state(config, "best.pt")["ema"]
    assert all(tensor.equal(saved[name]) for name, tensor in average.state_dict().items())


def test_training_lowers_the_occupancy_loss(tiny):
    config = tiny(steps=12, learning_rate=1e-2)
    batch = make_batch(Procedural(), config, 0, 4, stream=1)
    train(config)
    torch.manual_seed(config.seed)
    networks = SnakeNetwork(config.network), load_network(config.run_dir)
    before, after = (judged(network, batch)[0]["occupancy"].item() for network in networks)
    assert after < before - 0.05


def test_the_options_of_the_losses_reach_training_and_validation(tiny, monkeypatch):
    given = []
    for module in (training, objects):
        monkeypatch.setattr(
            module, "losses_of", lambda *a, **options: given.append(options) or losses_of(*a, **options)
        )
    train(tiny(sparsity_ridge=0.7, occupancy_decoder=False, weight_occupancy=0, weight_surface=0, steps=1), "cpu")
    assert len(given) > 1 and all(options == {"ridge": 0.7, "has_occupancy": False} for options in given)


def test_resuming_continues_bit_for_bit(tiny, tmp_path):
    """Six steps at once, and one by one with a checkpoint after each (a minute's 1e-9th allows no second step)."""
    whole = tiny(steps=6, schedule="cosine", run_dir=str(tmp_path / "whole"))
    train(whole)
    parts = dataclasses.replace(whole, run_dir=str(tmp_path / "parts"))
    for step in (1, 2, 3):
        train(parts, minutes=1e-9)
        assert state(parts)["step"] == step
    train(parts)
    expected, found = flat(state(whole)), flat(state(parts))
    assert expected.keys() == found.keys()
    differing = [
        path
        for path, value in expected.items()
        if not (value.equal(found[path]) if isinstance(value, torch.Tensor) else value == found[path])
    ]
    assert differing == ["/settings", "/best"] or differing == ["/settings"]  # the run folder; validated more often
    assert sum("/exp_avg" in path for path in expected) > 100


def test_a_finished_run_is_left_as_it_is_and_another_network_is_refused(tiny):
    config = tiny()
    train(config)
    before = (Path(config.run_dir) / "last.pt").read_bytes()
    train(config)
    assert (Path(config.run_dir) / "last.pt").read_bytes() == before
    with pytest.raises(SystemExit, match="holds another network"):
        train(dataclasses.replace(config, c_dim=16))


def torchrun(config, processes):
    """Train with torch.distributed, as the command line of a user."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive", "CUDA_VISIBLE_DEVICES": ""}
    return subprocess.run(
        [*command, "-m", "snake_training.train", *arguments(config)],
        capture_output=True, text=True, env=environment, timeout=300, check=False,
    )  # fmt: skip


@pytest.mark.nightly
def test_two_processes_train_like_one(tiny, tmp_path):
    """The same samples, masked losses averaged over the whole batch: the same gradients but for the order of sums.

    Shifted second views put different numbers of local grids out of bounds in each process, so that a mean of the
    processes' means would differ. Adam hides the gradient's scale, so its first moments are compared, unclipped.
    """
    one = tiny(
        batch=4, steps=2, translation=0.5, clip_norm=0.0, learning_rate=1e-5, ema_decay=0.5, run_dir=str(tmp_path / "one")
    )  # fmt: skip
    train(one)
    two = dataclasses.replace(one, run_dir=str(tmp_path / "two"))
    result = torchrun(two, 2)
    assert result.returncode == 0, result.stderr
    first, second = flat(state(one)), flat(state(two))
    assert first.keys() == second.keys()
    for path, value in first.items():
        if isinstance(value, torch.Tensor):
            # Weights that start at zero show Adam's epsilon in the first steps, where gradients are tiny.
            share = 1e-4 if path.startswith("/optimizer") else 3e-3
            tolerance = share * value.abs().max().item() + 1e-9
            assert (value - second[path]).abs().max().item() <= tolerance, path
    logged_one, logged_two = scalars(one), scalars(two)
    for name in (name for name in logged_one if name.startswith("train/")):
        assert logged_two[name][2] == pytest.approx(logged_one[name][2], rel=1e-4, abs=1e-6), name


def test_average_of_weights_follows_and_without_decay_copies(network):
    average = SnakeNetwork(network.config).requires_grad_(False)
    start = [parameter.clone() for parameter in average.parameters()]
    update_average(average, network, decay=0.998, step=10**6)
    for ours, theirs, before in zip(average.parameters(), network.parameters(), start):
        assert torch.allclose(ours, 0.998 * before + 0.002 * theirs, atol=1e-6)
    update_average(average, network, decay=0.998, step=0)  # early: a tenth of the old weights
    expected = [0.1 * (0.998 * b + 0.002 * t) + 0.9 * t for b, t in zip(start, network.parameters())]
    assert all(torch.allclose(ours, value, atol=1e-6) for ours, value in zip(average.parameters(), expected))
    update_average(average, network, decay=0.0, step=5)
    assert all(ours.equal(theirs) for ours, theirs in zip(average.parameters(), network.parameters()))


def test_the_start_gives_the_networks_shape(tmp_path, network):
    path = tmp_path / "start.safetensors"
    write_weights(path, network.config, network.state_dict())
    shape = network.config
    start = ["--init", str(path), "--run-dir", str(tmp_path / "run")]
    assert parse_arguments(start, "")[0].network == shape != parse_arguments([], "")[0].network
    given = parse_arguments([*start, "--resolution", "32"], "")[0].network
    assert given == dataclasses.replace(shape, resolution=(32,) * 3)
    with pytest.raises(SystemExit, match="absent"):
        parse_arguments(["--init", str(tmp_path / "absent.pt")], "")


def test_init_from_an_export_or_a_run(tiny, tmp_path, network):
    path = tmp_path / "start.safetensors"
    write_weights(path, network.config, network.state_dict())
    config = tiny(steps=1, learning_rate=1e-30, weight_decay=0.0, init=str(path))
    train(config)
    started = read_checkpoint(config.run_dir)[1]
    assert all(torch.allclose(started[name], tensor) for name, tensor in network.state_dict().items())
    again = dataclasses.replace(config, init=config.run_dir, run_dir=str(tmp_path / "second"))
    train(again)
    second = read_checkpoint(again.run_dir)[1]
    assert all(torch.allclose(second[name], tensor) for name, tensor in started.items())
    finer = dataclasses.replace(config, resolution=16, run_dir=str(tmp_path / "finer"))
    train(finer)
    network_of_finer, tensors = read_checkpoint(finer.run_dir)
    assert network_of_finer.resolution == (16,) * 3
    assert all(torch.allclose(tensors[name], tensor) for name, tensor in network.state_dict().items())
    with pytest.raises(SystemExit, match="do not fit"):
        train(dataclasses.replace(config, c_dim=16, run_dir=str(tmp_path / "third")))
    with pytest.raises(SystemExit, match="absent"):
        train(dataclasses.replace(config, init=str(tmp_path / "absent.pt"), run_dir=str(tmp_path / "third")))
    path.unlink()
    train(dataclasses.replace(config, steps=2))  # a resumed run does not need its start any more


def test_validation_uses_every_folder(tiny, tmp_path, monkeypatch):
    for name in "ab":
        (tmp_path / name).mkdir()
        np.save(tmp_path / name / "cloud.npy", np.random.default_rng(ord(name)).normal(size=(300, 3)))
    rows = []
    monkeypatch.setattr(Objects, "validate", lambda self, *_: rows.append(len(self.held_out)) or dict(SCORES))
    train(tiny(validation_data=(str(tmp_path / "a"), str(tmp_path / "b")), steps=1))
    assert rows == [2]


SCORES = {"repeatability_nms_0.01": 0.1, "repeatability_nms_0.05": 0.2}


def test_best_is_kept_by_score(tiny, monkeypatch):
    scores = iter((0.1, 0.5, 0.3, 0.0))
    monkeypatch.setattr(
        Objects, "validate", lambda *_: {"repeatability_nms_0.01": next(scores), "repeatability_nms_0.05": 0.0}
    )
    config = tiny(steps=4, validate_every=1)
    train(config)
    assert state(config, "best.pt")["step"] == 2 and state(config)["best"] == 0.5


def test_a_gradient_that_is_not_finite_stops_the_run(tiny, tmp_path, network, monkeypatch):
    def poisoned(*given, **named):
        losses, saturated = judge(*given, **named)
        return losses | {"surface": losses["surface"] * math.nan}, saturated

    judge = training.losses_of
    monkeypatch.setattr(training, "losses_of", poisoned)
    with pytest.raises(SystemExit, match="step 0: the gradient is not finite"):
        train(tiny())


def test_a_new_saliency_begins_at_corners_of_shapes_it_has_not_seen(network):
    before = {name: value.clone() for name, value in network.state_dict().items() if "keypoint" not in name}
    start_saliency(network)
    preferred = []
    for name in ("chair", "table", "box"):
        cloud, at = landmarks(name, np.random.default_rng(100))
        points = torch.from_numpy(normalize(cloud)[0])[None]
        with torch.no_grad():
            values = network.saliency(network.encode(points), points)[0].logit()
        preferred.append(((values[at].mean() - values.mean()) / values.std()).item())
    assert np.mean(preferred) > 1
    assert all(torch.equal(value, network.state_dict()[name]) for name, value in before.items())


# Schedules


def test_cosine_schedule_warms_up_and_falls_to_zero(tiny):
    config = tiny(steps=110, warmup=10, learning_rate=0.2, schedule="cosine")
    rates = [learning_rate(config, step) for step in range(110)]
    assert rates[:10] == pytest.approx([0.02 * (step + 1) for step in range(10)])
    assert rates[10] == 0.2 and rates[60] == pytest.approx(0.1) and 0 < rates[-1] < 1e-4
    assert all(later < earlier for earlier, later in itertools.pairwise(rates[10:]))
    assert learning_rate(config, 110) == pytest.approx(0, abs=1e-12)


def test_step_schedule_falls_once_to_a_tenth(tiny):
    config = tiny(steps=60, warmup=0, learning_rate=0.2, schedule="step")
    rates = [learning_rate(config, step) for step in range(60)]
    assert rates[:40] == [0.2] * 40 and rates[40:] == pytest.approx([0.02] * 20)


def test_a_validation_judges_each_shape_once_or_so_many_samples(tiny, tmp_path, network, monkeypatch):
    """The released code's goes over its whole list; theirs and ours draw the views at random."""
    for row in range(6):
        np.save(tmp_path / f"{row}.npy", np.random.default_rng(row).normal(size=(200, 3)))
    seen = []
    monkeypatch.setattr(objects, "two_views", lambda cloud, *_: seen.append(cloud) or two_views(cloud, *_))
    for samples, number in ((0, 6), (9, 9)):
        task = Objects(tiny(validation_data=(str(tmp_path),), validation_samples=samples))
        seen.clear()
        found = task.validation_losses(network, torch.device("cpu"), False)
        assert len(seen) == number and set(found) == {*LOSSES, "saturated"}
        in_order = [any(np.array_equal(cloud, task.held_out[row]) for cloud in seen) for row in range(6)]
        assert all(in_order) or samples
    batches = [
        objects.make_batch(task.held_out, task.settings, first, size, 1) for first, size in ((0, 4), (4, 4), (8, 1))
    ]
    with torch.no_grad():
        each = [losses_of(*task.answer(network, batch, False), batch)[0]["surface"].item() for batch in batches]
    assert found["surface"] == pytest.approx((4 * each[0] + 4 * each[1] + each[2]) / 9)


# Refusals and devices


def test_a_batch_that_does_not_divide_is_refused(tiny, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "4")
    with pytest.raises(SystemExit, match="batch 6 does not divide over 4 processes"):
        train(tiny(batch=6))


def test_an_empty_folder_of_data_is_refused_as_such(tiny, tmp_path):
    """There is no file to remove."""
    (tmp_path / "clouds").mkdir()
    said = f"{tmp_path}/clouds: neither points.npy + index.json nor any .npy, .ply or .pcd file"
    for option in ("data", "validation_data"):
        with pytest.raises(SystemExit) as stop:
            train(tiny(**{option: (str(tmp_path / "clouds"),)}))
        assert stop.value.code == said


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_cuda_without_a_gpu_is_refused(tiny):
    with pytest.raises(SystemExit, match="torch finds no GPU"):
        train(tiny(), "cuda")


def test_dead_layers_are_counted(network):
    assert dead_share(network) == 0
    for block in network.encoder.blocks:
        for parameter in block.parameters():
            parameter.data.zero_()
    zeroed = sum(p.dim() >= 2 for p in network.encoder.blocks.parameters())
    assert dead_share(network) == zeroed / sum(p.dim() >= 2 for p in network.parameters())


def test_weights_without_gradient_are_not_decayed(network, tiny):
    optimizer = training.make_optimizer(network, tiny(weight_decay=0.1))
    before = {name: p.detach().clone() for name, p in network.named_parameters()}
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    for _ in range(50):
        optimizer.step()
    for name, parameter in network.named_parameters():
        if not name.startswith("encoder.unet3d."):
            assert torch.equal(parameter, before[name]), name


# A validation without keypoints


class Fields:
    """A network whose fields are functions of the distance from the origin, where a ball of radius 0.3 is occupied."""

    def __init__(self, network, occupancy, saliency):
        self.config, self.parameters, self.encode = network.config, network.parameters, network.encode
        self.fields = occupancy, saliency

    def occupancy_and_saliency(self, _volume, queries):
        return tuple(field(queries.norm(dim=-1)) for field in self.fields)

    def occupancy(self, _volume, queries):
        return self.fields[0](queries.norm(dim=-1))


@pytest.mark.parametrize(
    ("occupancy", "saliency", "reason"),
    [
        (lambda r: 0 * r + 0.4, lambda r: 0 * r + 0.9, "occupancy is at most 0.40"),
        (lambda r: (1.2 - 2 * r).clamp(0, 1), lambda r: (r > 0.25) * 0.9, "peaks beside the surface: it reaches 0.90"),
        (lambda r: (r < 0.3).float(), lambda r: 0 * r + 0.2, "at most 0.20 on the surface, the threshold is 0.7"),
        (lambda r: (r < 0.3).float(), lambda r: 0 * r + 0.9, None),
    ],
)
def test_the_reason_why_there_are_no_keypoints(network, occupancy, saliency, reason):
    points = np.random.default_rng(0).normal(size=(200, 3)).astype(np.float32)
    options = DetectOptions(query_resolution=12, refine_steps=0)
    said = why_none(Fields(network, occupancy, saliency), points, options)
    assert said is None if reason is None else reason in said


def test_a_validation_without_keypoints_warns_at_once(tiny, capsys):
    train(tiny(steps=1, validate_every=1))
    printed = capsys.readouterr()
    assert "warning: no keypoint in the validation: the " in printed.out + printed.err
