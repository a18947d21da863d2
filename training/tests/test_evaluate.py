"""Detection, suppression and repeatability against values worked out by hand."""

import json

import numpy as np
import pytest
import torch

from snake_training.augment import normalize
from snake_training.data import Procedural
from snake_training.evaluate import (
    DetectOptions,
    candidates,
    detect,
    main,
    query_grid,
    refine,
    relative_repeatability,
    repeatability,
    suppress,
    view_pairs,
)
from snake_training.export import write_weights
from snake_training.model import NetworkConfig

QUARTER_TURN = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # about z


# Repeatability


def test_repeatability_is_the_share_of_first_view_keypoints_strictly_within_epsilon():
    first = np.array([[0.0, 0, 0], [1, 0, 0], [5, 0, 0], [9, 9, 9]])
    second = np.array([[0.25, 0, 0], [1, 0.5, 0]])
    values = relative_repeatability(first, second, np.eye(3), [0.25, 0.26, 0.5, 0.51, 100])
    assert values.tolist() == [0, 0.25, 0.25, 0.5, 1]


def test_repeatability_is_one_directional_and_not_one_to_one():
    first, second = np.array([[0.0, 0, 0], [0.1, 0, 0]]), np.array([[0.05, 0, 0], [3, 0, 0], [4, 0, 0]])
    assert relative_repeatability(first, second, np.eye(3), [0.06]).tolist() == [1]
    assert relative_repeatability(second, first, np.eye(3), [0.06]) == pytest.approx([1 / 3])


def test_repeatability_brings_the_second_view_back():
    first = np.array([[0.0, 1, 0], [1, 0, 2]])
    second = first @ QUARTER_TURN.T  # rotated cloud
    assert relative_repeatability(first, second, QUARTER_TURN.T, [1e-6]).tolist() == [1]
    assert relative_repeatability(first, second, QUARTER_TURN, [1e-6]).tolist() == [0]
    scored = np.concatenate([first, [[0.9], [0.8]]], axis=1)  # the fourth column is a score
    assert relative_repeatability(scored, second, QUARTER_TURN.T, [1e-6]).tolist() == [1]


@pytest.mark.parametrize(("one", "other"), [(0, 2), (2, 0), (0, 0)])
def test_repeatability_without_keypoints_is_zero(one, other):
    assert relative_repeatability(np.zeros((one, 4)), np.zeros((other, 4)), np.eye(3), [1, 2]).tolist() == [0, 0]


def test_view_pairs_are_the_same_points_and_come_back_by_the_rotation():
    shapes = Procedural(length=4, points=300)
    pairs = list(view_pairs(shapes, 4, 300, seed=0))
    assert len(pairs) == 4
    for row, (first, second, rotation) in enumerate(pairs):
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0
        assert not np.allclose(rotation, np.eye(3), atol=0.05)
        back = second @ rotation.T
        distance = np.linalg.norm(first[:, None] - back[None], axis=2).min(axis=1)
        assert distance.max() < 1e-5
        # The unit of epsilon and of the suppression radius: the cloud has radius 1 about its mean.
        assert np.linalg.norm(first - first.mean(axis=0), axis=1).max() == pytest.approx(1, abs=1e-5)
        original = np.sort(shapes[row], axis=0)  # scaled, nothing else
        factor = np.ptp(first, axis=0) / np.ptp(original, axis=0)
        assert np.allclose(factor, factor[0], rtol=1e-5)
        assert np.allclose(np.sort(first, axis=0), factor[0] * original, atol=1e-5)


def test_view_pairs_are_seeded_by_row_and_evenly_spaced():
    shapes = Procedural(length=9, points=50)
    few = list(view_pairs(shapes, 3, 20, seed=0))
    every = list(view_pairs(shapes, 100, 20, seed=0))
    assert len(few) == 3 and len(every) == 9
    for index, row in enumerate((0, 4, 8)):
        assert all(np.array_equal(a, b) for a, b in zip(few[index], every[row]))
    other = next(view_pairs(shapes, 3, 20, seed=1))
    assert not np.array_equal(few[0][2], other[2])


def test_repeatability_is_the_mean_over_pairs_and_counts_the_first_view():
    """A detector of fixed input points repeats exactly; one that finds nothing on every other call, never."""
    shapes, calls = Procedural(length=3, points=100), []

    def detector(points):
        calls.append(len(points))
        farthest = np.linalg.norm(points, axis=1).argsort(kind="stable")[-5:]
        return {"extreme": points[farthest], "once": points[farthest] if len(calls) % 2 else points[:0]}

    result = repeatability(detector, shapes, num_points=100, epsilon=(1e-4, 10))
    assert calls == [100] * 6
    assert result["extreme"][0].tolist() == [1, 1] and result["extreme"][1] == 5
    assert result["once"][0].tolist() == [0, 0] and result["once"][1] == 5
    with pytest.raises(ValueError, match="at least one object"):
        repeatability(detector, shapes, number=0)


# Suppression


def test_suppression_keeps_the_better_of_two_within_the_radius():
    points = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [1.25, 0, 0], [1.5, 0, 0], [5, 0, 0]])
    assert suppress(points, 1.0, 10) == [0, 2, 4]
    assert suppress(points, 1.0, 2) == [0, 2]
    assert suppress(points, 0.5, 10) == [0, 2, 4]  # exactly the radius apart is not farther
    assert suppress(points, 0.49, 10) == [0, 1, 2, 4]
    assert suppress(points.flip(0), 1.0, 10) == [0, 1, 4]  # order is rank
    assert suppress(points, 0.0, 3) == [0, 1, 2]  # no radius, only the limit
    assert suppress(torch.cat([points[:1]] * 3), 0.0, 10) == [0, 1, 2]
    assert suppress(torch.zeros(0, 3), 1.0, 10) == []


# Detection


def test_query_grid_spans_the_cube_with_x_slowest():
    grid = query_grid(NetworkConfig(z_min=-0.25, z_max=0.25), 3, "cpu")
    assert grid.shape == (27, 3)
    assert grid[0].tolist() == [-0.5, -0.5, -0.25] and grid[-1].tolist() == [0.5, 0.5, 0.25]
    assert grid[1].tolist() == [-0.5, -0.5, 0] and grid[3].tolist() == [-0.5, 0, -0.25]
    assert grid[9].tolist() == [0, -0.5, -0.25]


class Bump(torch.nn.Module):
    """A network of one saliency peak of height 1 at `peak`, and a surface everywhere above `floor`."""

    def __init__(self, peak, floor=-1.0):
        super().__init__()
        self.config = NetworkConfig()
        self.peak = torch.nn.Parameter(torch.tensor(peak))
        self.floor = floor

    def encode(self, points):
        return points

    def occupancy(self, volume, queries):
        return (queries[..., 2] > self.floor).float()

    def occupancy_and_saliency(self, volume, queries):
        return self.occupancy(volume, queries), torch.exp(-20 * (queries - self.peak).square().sum(dim=-1))


CLOUD = (np.random.default_rng(0).normal(size=(500, 3)) * 3 + (7, -2, 1)).astype(np.float32)
COARSE = dict(query_resolution=11, refine_steps=30, refine_step_size=5e-3, nms_radius=0.0, max_keypoints=10**6)


@pytest.mark.parametrize("selection", ["best-position", "reference-final-position"])
def test_detection_climbs_to_the_peak_in_the_clouds_frame(selection):
    network = Bump([0.13, -0.02, 0.24])
    _, center, scale = normalize(CLOUD)
    options = DetectOptions(**COARSE, selection=selection)
    found = detect(network, CLOUD, options)
    expected = np.array([0.13, -0.02, 0.24]) * scale + center
    # The nearest query starts 0.05 a side away, within reach of 30 steps of 0.005; ten percent of a step remains.
    assert np.abs(found[0, :3] - expected).max() < 0.02 * scale
    assert found[0, 3] > 0.98
    assert (np.diff(found[:, 3]) <= 0).all() and (found[:, 3] > 0.7).all()
    one = detect(network, CLOUD, DetectOptions(**COARSE | {"nms_radius": 10.0 * float(scale)}))
    assert len(one) == 1
    assert len(detect(network, CLOUD, DetectOptions(**COARSE | {"max_keypoints": 3}))) == 3


def test_no_surface_and_no_salient_position_give_no_keypoints():
    assert detect(Bump([0.0, 0, 0], floor=1.0), CLOUD, DetectOptions(**COARSE)).shape == (0, 4)
    assert detect(Bump([3.0, 0, 0]), CLOUD, DetectOptions(**COARSE)).shape == (0, 4)


def test_positions_off_the_surface_score_zero():
    """The peak lies where there is no surface: no returned position does."""
    _, center, scale = normalize(CLOUD)
    found = detect(Bump([0.0, 0.0, -0.1], floor=0.0), CLOUD, DetectOptions(**COARSE))
    assert len(found) > 0
    assert ((found[:, 2] - center[2]) / scale > 0).all()


def test_gradient_descent_moves_each_query_by_its_own_gradient():
    network = Bump([0.0, 0.0, 0.0])
    queries = torch.tensor([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]])
    options = DetectOptions(refine_method="gradient-descent", refine_steps=1, refine_step_size=0.01)
    position, score = refine(network, torch.zeros(1), queries, options)
    slope = lambda x: 40 * x * np.exp(-20 * x**2)  # of the saliency
    expected = torch.tensor([[0.1 - 0.01 * slope(0.1), 0, 0], [0, 0.2 - 0.01 * slope(0.2), 0]], dtype=torch.float32)
    assert torch.allclose(position, expected, atol=1e-6)
    assert torch.allclose(score, torch.exp(-20 * expected.square().sum(dim=1)), atol=1e-6)
    both, _ = refine(network, torch.zeros(1), queries[:1], options)
    assert torch.equal(both[0], position[0])  # whatever the other queries are


def test_adam_moves_a_step_size_along_each_axis():
    position, _ = refine(
        Bump([0.0, 0.0, 0.0]), torch.zeros(1), torch.tensor([[0.1, -0.2, 0.0]]), DetectOptions(refine_steps=1)
    )
    assert torch.allclose(position, torch.tensor([[0.099, -0.199, 0.0]]), atol=1e-6)


def on_surface_queries(network):
    """A volume of the tiny network and queries in it."""
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        volume = network.encode(torch.rand(1, 80, 3, generator=generator) - 0.5)
    return volume, torch.rand(200, 3, generator=generator) - 0.5


@pytest.mark.parametrize("steps", [0, 1, 6])
def test_best_position_returns_the_saliency_at_the_returned_position(network, steps):
    volume, queries = on_surface_queries(network)
    options = DetectOptions(refine_steps=steps, refine_step_size=0.02, surface_threshold=0.0)
    position, score = refine(network, volume, queries, options)
    with torch.no_grad():
        _, saliency = network.occupancy_and_saliency(volume, position[None])
        _, start = network.occupancy_and_saliency(volume, queries[None])
    assert torch.allclose(score, saliency[0], atol=1e-6)
    assert (score >= start[0]).all()
    assert torch.equal(position, queries) == (steps == 0)


def test_reference_selection_returns_final_positions_with_the_best_earlier_score(network):
    """Against a loop written out: the best score before any step, the position after the last one."""
    volume, queries = on_surface_queries(network)
    with torch.no_grad():
        threshold = network.occupancy_and_saliency(volume, queries[None])[0].median().item()  # half are on the surface
    options = DetectOptions(
        refine_steps=5, refine_step_size=0.03, surface_threshold=threshold, selection="reference-final-position"
    )
    position, score = refine(network, volume, queries, options)
    moving = queries.clone().requires_grad_()
    adam = torch.optim.Adam([moving], lr=0.03)
    scores = []
    for _ in range(5):
        adam.zero_grad()
        occupancy, saliency = network.occupancy_and_saliency(volume, moving[None])
        scores.append((saliency * (occupancy > threshold))[0].detach())
        (1 - saliency.mean()).backward()
        adam.step()
    assert torch.allclose(position, moving.detach(), atol=1e-6)
    assert torch.allclose(score, torch.stack(scores).amax(dim=0), atol=1e-6)
    best, best_score = refine(network, volume, queries, DetectOptions(**vars(options) | {"selection": "best-position"}))
    assert not torch.equal(best, position) and (best_score >= score).all()


def test_refinement_leaves_no_gradient_on_the_weights(network):
    volume, queries = on_surface_queries(network)
    refine(network, volume, queries, DetectOptions(refine_steps=2))
    assert all(parameter.grad is None for parameter in network.parameters())


@pytest.mark.parametrize("name", ["normalization", "refine_method", "selection"])
def test_options_of_another_name_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} 'other' is none of"):
        DetectOptions(**{name: "other"})


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_candidates_on_the_gpu_are_those_on_the_processor(network):
    options = DetectOptions(**COARSE | {"saliency_threshold": 0.0, "occupancy_threshold": 0.0, "refine_steps": 0})
    expected = candidates(network, CLOUD, options)
    found = candidates(network.cuda(), CLOUD, options)
    assert found.device.type == "cpu" and torch.allclose(found[:, 3], expected[:, 3], atol=1e-4)


def test_command_line(tmp_path, network, capsys):
    weights = tmp_path / "weights.safetensors"
    write_weights(weights, network.config, network.state_dict())
    (tmp_path / "shapes").mkdir()
    for row in range(2):
        np.save(tmp_path / "shapes" / f"{row}.npy", Procedural(points=200)[row])
    few = ["--query-resolution", "6", "--refine-steps", "1", "--num-points", "100", "--saliency-threshold", "0"]
    few += ["--surface-threshold", "0", "--occupancy-threshold", "0", "--max-keypoints", "9", "--nms-radius", "0.1"]
    main([str(weights), str(tmp_path / "shapes"), *few, "--epsilon", "0.04", "100"])
    report = json.loads(capsys.readouterr().out)
    assert report["repeatability"]["100"] == 1 and 0 <= report["repeatability"]["0.04"] < 1
    assert report["keypoints"] == 9 and report["options"]["query_resolution"] == 6
    for words in ([str(weights), str(tmp_path / "absent")], [str(tmp_path / "absent.pt"), str(tmp_path / "shapes")]):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 2 and "absent" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([str(weights), str(tmp_path / "shapes"), "--selection", "worst"])


def test_the_options_of_the_weights_are_those_of_snake_rs(tmp_path, network, capsys):
    """With --recommended, a file's own suppression decides how many keypoints there are."""
    np.save(tmp_path / "cloud.npy", np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32))
    counts = {}
    for radius in ("0.2", "2.0"):
        thresholds = '"occupancy_threshold":0,"surface_threshold":0,"saliency_threshold":0,"refine_steps":0'
        options = f'{{"detect":{{{thresholds},"query_resolution":8,"nms_radius":{radius}}}}}'
        write_weights(
            tmp_path / "w.safetensors", network.config, network.state_dict(), extra={"recommended_options": options}
        )
        main([str(tmp_path / "w.safetensors"), str(tmp_path), "--engine", "snake-rs", "--recommended"])
        counts[radius] = json.loads(capsys.readouterr().out)["keypoints"]
    assert counts["0.2"] > counts["2.0"] >= 1
    with pytest.raises(SystemExit):
        main([str(tmp_path / "w.safetensors"), str(tmp_path), "--recommended"])
    assert "need --engine snake-rs" in capsys.readouterr().err
