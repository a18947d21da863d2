"""Detection against values worked out by hand; its steps are compared with `snake_rs` in `test_parity`."""

import numpy as np
import pytest
import torch

from snake_training.augment import normalize
from snake_training.detection import (
    DetectOptions,
    candidates,
    detect,
)
from snake_training.model import NetworkConfig


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
