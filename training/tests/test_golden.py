"""The networks against the values in tests/golden (README.md there), recomputed tensor by tensor."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from snake_training.detection import DetectOptions, query_grid, refine
from snake_training.export import load_network
from snake_training.model import NetworkConfig, saliency_head, voxel_index

REPOSITORY = Path(__file__).resolve().parents[2]
GOLDEN = REPOSITORY / "tests" / "golden"
FULL = REPOSITORY.parent / "shared" / "golden" / "full"
NO_FULL = pytest.mark.skipif(not FULL.exists(), reason=f"{FULL} is not here: the paper's network (20 MB)")

# Largest differences, absolute and relative, and the quantile of the entries that must keep them. The two networks do the
# same float32 arithmetic in another order: some tens of layers and sums of hundreds of terms leave about 1e-5 of values of
# order one.
FEATURES = 1e-4, 1e-4, 1.0  # unbounded values, up to about 10
# With AVX2 alone the paper's network differs by up to 1.5e-5. The Rust test allows the same 2e-5.
PROBABILITIES = 2e-5, 0.0, 1.0
# Slopes of up to some tens, and a query whose ReLU or voxel boundary falls the other way has another slope entirely.
GRADIENTS = 1e-3, 1e-3, 0.99
# Adam divides by the gradient's own size: where that is near zero, rounding decides a step of 1e-3 (the learning rate) or
# its sign.
REFINED = 1e-4, 0.0, 0.99
# Plain descent takes steps in proportion to the gradient, which jumps at a kink: from there a query ends elsewhere.
DESCENDED = 1e-3, 0.0, 0.99


def gradients(field, volume, queries):
    """Values (Q,) of a field of the network at queries (Q, 3), and their derivatives (Q, 3) in the queries."""
    queries = queries.clone().requires_grad_()
    values = field(volume, queries[None])[0]
    return values.detach(), torch.autograd.grad(values.sum(), queries)[0]


def recomputed(network, stored, query_resolution):
    """{name: our value, *tolerance} for the tensors of a released network's io.safetensors that are computed."""
    config, points = network.config, stored["points"][None]
    with torch.no_grad():
        voxels = voxel_index(points, config)
        features = network.encoder.point_features(points, voxels)
        scattered = network.encoder.scatter_mean(features, voxels)[0]
        volume = network.encode(points)
        grid = query_grid(config, query_resolution, "cpu")
        parts = [network.occupancy_and_saliency(volume, part[None]) for part in grid.split(1 << 15)]
    listed = stored["scatter_voxels_dhw"]
    occupied = (scattered != 0).any(dim=0).nonzero()
    assert np.array_equal(occupied, listed[np.lexsort(listed.numpy().T[::-1])])
    z, y, x = listed.long().unbind(dim=1)
    found = {
        "point_features": (features[0], FEATURES),
        "scatter_values": (scattered[:, z, y, x].T, FEATURES),
        "volume_sample_values": (volume[0].reshape(config.c_dim, -1).T[stored["volume_sample_index"].long()], FEATURES),
        "volume_full_cdhw": (volume[0], FEATURES),
        "occupancy_grid": (torch.cat([part[0][0] for part in parts]), PROBABILITIES),
        "saliency_grid": (torch.cat([part[1][0] for part in parts]), PROBABILITIES),
        "refine_start": (grid[stored["occupancy_grid"] > 0.5], (1e-7, 0.0, 1.0)),  # linspace may round otherwise
    }
    for name in ("occupancy", "saliency"):
        value, gradient = gradients(getattr(network, name), volume, stored["queries"])
        found |= {name: (value, PROBABILITIES), f"{name}_grad": (gradient, GRADIENTS)}
    for method, end in (("adam", "refine_adam_end"), ("gradient-descent", "refine_gd_sum_end")):
        options = DetectOptions(refine_method=method, selection="reference-final-position")
        position, score = refine(network, volume, stored["refine_start"], options)
        found[end] = position, REFINED if method == "adam" else DESCENDED
        if method == "adam":
            assert (score - stored["refine_adam_masked_score_per_step"].amax(dim=0)).abs().quantile(0.99) < 1e-3
    return found


def recomputed_scene(network, stored, voxel_size, reach=3):
    """The same of the network of scenes, whose volume is listed at nodes up to `reach` voxels from a point."""
    voxels = stored["points"] / voxel_size
    owner = torch.zeros(len(voxels), dtype=torch.long)
    period, margin = network.config.period, network.config.reach + reach + 2
    origin = ((voxels.amin(dim=0) - margin) / period).floor() * period
    size = (((voxels.amax(dim=0) + margin - origin) / period).ceil() * period).long().tolist()
    at_nodes = lambda values, nodes: values[(slice(None), *(nodes - origin).long().flip(1).unbind(dim=1))].T
    # One of the queries lies far from everything.
    queries = (stored["queries"] / voxel_size).clamp(min=-500, max=500)
    with torch.no_grad():
        features = network.encoder.point_features(voxels, owner)
        scattered = network.encoder.scatter(features, voxels - origin, owner, 1, size)[0]
        volume, far = network.encode(voxels - origin, owner, 1, size)
        occupancy, saliency = network.logits(volume, far, queries[None] - origin)
    assert len(stored["scatter_nodes"]) == (scattered != 0).any(dim=0).sum()
    probabilities = 1e-5, 1e-4, 1.0
    return {
        "point_features": (features, FEATURES),
        "scatter_values": (at_nodes(scattered, stored["scatter_nodes"]), FEATURES),
        "volume_values": (at_nodes(volume[0], stored["volume_nodes"]) + far, FEATURES),
        "volume_far": (far, FEATURES),
        "occupancy_logit": (occupancy[0], FEATURES),
        "saliency_logit": (saliency[0], FEATURES),
        "occupancy": (occupancy[0].sigmoid(), probabilities),
        "saliency": (saliency_head(saliency[0]), probabilities),
    }


@pytest.mark.parametrize("name", ["tiny", "odd", "anisotropic", "scene", pytest.param("full", marks=NO_FULL)])
def test_every_stage_has_the_stored_values(name):
    folder = FULL if name == "full" else GOLDEN / name
    network, stored = load_network(folder / "weights.safetensors").eval(), load_file(folder / "io.safetensors")
    with safe_open(folder / "io.safetensors", "pt") as file:
        metadata = file.metadata()
    inputs = {"points", "queries", "volume_sample_index", "scatter_voxels_dhw"}
    if name == "scene":
        found = recomputed_scene(network, stored, float(metadata["voxel_size"]))
        inputs |= {"scatter_nodes", "volume_nodes"}
    else:
        assert NetworkConfig.from_metadata(metadata) == network.config
        found = recomputed(network, stored, int(metadata["query_resolution"]))
        inputs |= {"occupancy_output_bias", "saliency_output_bias"}  # they are in the weights
        inputs |= {"refine_adam_saliency_per_step", "refine_adam_masked_score_per_step"}  # compared by their best
    assert stored.keys() - inputs <= found.keys()
    for tensor in stored.keys() - inputs:
        (value, (absolute, relative, quantile)), expected = found[tensor], stored[tensor]
        assert value.shape == expected.shape
        # Of two numbers one may be NaN, which is no agreement.
        agrees = (value - expected).abs() <= absolute + relative * expected.abs()
        assert agrees.double().mean() >= quantile, (tensor, (value - expected).abs().max())
