"""Detection and suppression against values worked out by hand."""

import numpy as np
import pytest
import torch

from snake_training.augment import normalize
from snake_training.detection import (
    DetectOptions,
    candidates,
    detect,
    query_grid,
    refine,
    suppress,
)
from snake_training.model import NetworkConfig

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


def on_surface_queries(network):
    """A volume of the tiny network and queries in it."""
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        volume = network.encode(torch.rand(1, 80, 3, generator=generator) - 0.5)
    return volume, torch.rand(200, 3, generator=generator) - 0.5


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
