"""Compares the golden files with our PyTorch network: python tests/golden/generate.py [FOLDER ...] --check

The files were written by the authors' released network and are not rewritten here. With no option, the seeded weights
alone are made again and compared; --check also runs the network on the stored points and compares every tensor of
io.safetensors. One line a tensor; exit status 1 if any differs by more than its tolerance. README.md beside this file
says what the tensors are.
"""

import argparse
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from snake_training.detection import query_grid
from snake_training.model import NetworkConfig, SnakeNetwork, voxel_index

HERE = Path(__file__).resolve().parent
FOLDERS = [HERE / name for name in ("tiny", "odd", "anisotropic")]


@dataclass
class Tolerance:
    """Largest difference allowed: absolute, plus a share of the expected value, over this quantile of the entries."""

    absolute: float
    relative: float = 0.0
    quantile: float = 1.0


# The two networks do the same float32 arithmetic in another order, on another machine. One rounding is 6e-8 of a
# value; some tens of layers and sums of hundreds of terms leave about 1e-5 of values of order one.
EXACT = Tolerance(0.0)
FEATURES = Tolerance(1e-4, 1e-4)  # unbounded values, up to about 10
# With AVX2 alone the paper's network differs by up to 1.5e-5. The Rust test allows the same 2e-5.
PROBABILITIES = Tolerance(2e-5)
# Slopes of up to some tens, and a query whose ReLU or voxel boundary falls the other way has another slope entirely.
GRADIENTS = Tolerance(1e-3, 1e-3, quantile=0.99)
# Adam divides by the gradient's own size: where that is near zero, rounding decides a step of 1e-3 (the learning
# rate) or its sign. Nearly all queries agree, so a high quantile is compared, not the maximum.
REFINED = Tolerance(1e-4, quantile=0.99)
DESCENDED = Tolerance(1e-3, quantile=0.99)
# The same for a saliency along that path, and for a masked score whose occupancy stands at the threshold.
REFINED_SCORES = Tolerance(1e-3, quantile=0.99)


def seeded_weights(shapes, seed):
    """{name: array} for {name: shape}: each tensor from a stream of its own, chosen by its name and the seed.

    Normalisation is near the identity; everything else is uniform within gain / sqrt(fan-in), where the gains make the
    fields vary enough to be worth testing.
    """
    weights = {}
    for name, shape in shapes.items():
        stream = np.random.RandomState((zlib.crc32(name.encode()) ^ seed * 2654435761) % 2**32)
        if "groupnorm" in name:
            value = 0.2 * stream.randn(*shape) + name.endswith("weight")
        else:
            fan_in = np.prod(shape[1:]) if len(shape) > 1 else 32
            gains = {"fc_p.weight": 6, "fc_out.weight": 4, "conv.weight": 1.8}
            gain = next((gain for end, gain in gains.items() if name.endswith(end)), 1)
            value = stream.uniform(-1, 1, shape) * gain / np.sqrt(fan_in)
        weights[name] = torch.from_numpy(value.astype(np.float32))
    return weights


def gradients(field, network, volume, queries):
    """Values (Q,) of a field of the network at queries (Q, 3), and their derivatives (Q, 3) in the queries."""
    queries = queries.clone().requires_grad_()
    values = field(network, volume, queries[None])[0]
    return values.detach(), torch.autograd.grad(values.sum(), queries)[0]


def refined(network, volume, start, method, steps=10, step_size=1e-3):
    """Positions (K, 3) after the steps, and before each step saliency and saliency x [occupancy > 0.8], (steps, K)."""
    position = start.clone().requires_grad_()
    optimizer = (torch.optim.Adam if method == "adam" else torch.optim.SGD)([position], lr=step_size)
    saliencies, scores = [], []
    for _ in range(steps):
        occupancy, saliency = network.occupancy_and_saliency(volume, position[None])
        saliencies.append(saliency[0].detach())
        scores.append((saliency * (occupancy > 0.8))[0].detach())
        energy = 1 - saliency
        (position.grad,) = torch.autograd.grad(energy.mean() if method == "adam" else energy.sum(), position)
        optimizer.step()
    return position.detach(), torch.stack(saliencies), torch.stack(scores)


def recompute(network, stored, query_resolution):
    """Yield (name, our value, tolerance) for the tensors of io.safetensors that are computed."""
    config = network.config
    points = stored["points"][None]
    with torch.no_grad():
        voxels = voxel_index(points, config)
        features = network.encoder.point_features(points, voxels)
        scattered = network.encoder.scatter_mean(features, voxels)[0]
        volume = network.encode(points)
    yield "point_features", features[0], FEATURES
    z, y, x = stored["scatter_voxels_dhw"].long().unbind(dim=1)
    yield "scatter_values", scattered[:, z, y, x].T, FEATURES
    occupied = (scattered != 0).any(dim=0).nonzero().int()
    listed = stored["scatter_voxels_dhw"]
    yield "scatter_voxels_dhw", occupied, EXACT, listed[np.lexsort(listed.numpy().T[::-1])]
    flat = volume[0].reshape(config.c_dim, -1).T
    yield "volume_sample_values", flat[stored["volume_sample_index"].long()], FEATURES
    if "volume_full_cdhw" in stored:
        yield "volume_full_cdhw", volume[0], FEATURES
    for name, field in (("occupancy", SnakeNetwork.occupancy), ("saliency", SnakeNetwork.saliency)):
        value, gradient = gradients(field, network, volume, stored["queries"])
        yield name, value, PROBABILITIES
        yield f"{name}_grad", gradient, GRADIENTS
    grid = query_grid(config, query_resolution, "cpu")
    with torch.no_grad():
        parts = [network.occupancy_and_saliency(volume, part[None]) for part in grid.split(1 << 15)]
    occupancy, saliency = (torch.cat([part[field][0] for part in parts]) for field in (0, 1))
    yield "occupancy_grid", occupancy, PROBABILITIES
    yield "saliency_grid", saliency, PROBABILITIES
    yield "refine_start", grid[stored["occupancy_grid"] > 0.5], Tolerance(1e-7)  # linspace may round otherwise
    end, saliencies, scores = refined(network, volume, stored["refine_start"], "adam")
    yield "refine_adam_end", end, REFINED
    yield "refine_adam_saliency_per_step", saliencies, REFINED_SCORES
    yield "refine_adam_masked_score_per_step", scores, REFINED_SCORES
    # Plain descent takes steps in proportion to the gradient, which jumps at a kink: from there a query ends elsewhere.
    yield "refine_gd_sum_end", refined(network, volume, stored["refine_start"], "descent")[0], DESCENDED


def compare(name, found, expected, tolerance):
    """Print one line; whether the tensor agrees."""
    if found.shape != expected.shape:
        print(f"  {name:36s} {tuple(found.shape)}, expected {tuple(expected.shape)}  MISMATCH")
        return False
    difference = (found.double() - expected.double()).abs()
    excess = difference - tolerance.absolute - tolerance.relative * expected.double().abs()
    # NaN compares false, so it is counted as wrong.
    right = (excess <= 0).double().mean().item() >= tolerance.quantile
    share = f" in {tolerance.quantile:.0%}" if tolerance.quantile < 1 else ""
    allowed = f"{tolerance.absolute:g}" + (f" + {tolerance.relative:g} relative" if tolerance.relative else "") + share
    print(f"  {name:36s} largest difference {difference.max():.1e}  allowed {allowed}  {'ok' if right else 'MISMATCH'}")
    return right


def check(folder, network_too=True):
    """Compare one folder, printing a line a tensor; the names of the tensors that differ."""
    print(folder)
    stored, weights = load_file(folder / "io.safetensors"), load_file(folder / "weights.safetensors")
    with safe_open(folder / "io.safetensors", "pt") as file:
        metadata = file.metadata()
    config = NetworkConfig.from_metadata(metadata)
    with safe_open(folder / "weights.safetensors", "pt") as file:
        if NetworkConfig.from_metadata(file.metadata()) != config:
            print("  the two files' configurations differ  MISMATCH")
            return ["configuration"]
    network = SnakeNetwork(config).eval()
    made = seeded_weights({name: tensor.shape for name, tensor in network.state_dict().items()}, int(metadata["seed"]))
    # These two were set so that the thresholds of detection divide the queries.
    made["decoder_occup.fc_out.bias"] = stored["occupancy_output_bias"]
    made["decoder_keypoint.fc_out.bias"] = stored["saliency_output_bias"]
    equal = made.keys() == weights.keys() and all(made[name].equal(weights[name]) for name in made)
    print(f"  {len(made)} seeded weights{'':22s} {'equal to the last bit  ok' if equal else 'MISMATCH'}")
    wrong = [] if equal else ["weights"]
    if network_too:
        network.load_state_dict(weights, strict=True)
        for name, found, tolerance, *expected in recompute(network, stored, int(metadata["query_resolution"])):
            if not compare(name, found, *(expected or [stored[name]]), tolerance):
                wrong.append(name)
    return wrong


def main(argv=None):
    """Check the folders of the command line, by default the committed ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, default=FOLDERS, help="golden folders; default: those here")
    parser.add_argument("--check", action="store_true", help="run the network as well")
    arguments = parser.parse_args(argv)
    for folder in arguments.folders:
        if not (folder / "io.safetensors").exists():
            parser.error(f"{folder} holds no io.safetensors")
    wrong = {folder: check(folder, arguments.check) for folder in arguments.folders}
    for folder, names in wrong.items():
        if names:
            print(f"{folder}: {', '.join(names)} differ")
    return 1 if any(wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
