"""The golden files of a network of scenes: python tests/golden/generate_scene.py [--check]

Written by our PyTorch network (`snake_training.model.SceneNetwork`), since nobody else has one. --check computes them
anew and compares; exit status 1 if a tensor differs by more than 1e-5, or a feature by more than 1e-4. README.md beside
this file says what the tensors are.
"""

import argparse
import sys
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from snake_training.export import load_network, write_weights
from snake_training.scene_model import SceneConfig, SceneNetwork

FOLDER = Path(__file__).resolve().parent / "scene"
VOXEL_SIZE, NEAR = 0.1, 3  # metres; nodes listed up to this many voxels from a point


def make_network():
    """Tiny, seeded, every layer with constants of its own; the last biases let thresholds cut through the queries."""
    torch.manual_seed(7)
    network = SceneNetwork(SceneConfig(c_dim=8, unet_base_channels=8))
    for name, parameter in network.named_parameters():
        spread = {"scale": 0.3, "bias": 0.15}.get(name.split(".")[-1], 0.05)
        parameter.data += spread * torch.randn_like(parameter)
        if name.endswith("conv.weight"):
            parameter.data *= 2.2
        if name.endswith("fc_out.weight"):
            parameter.data *= 6
    return network.eval()


def make_points():
    """(N, 3) metres: two walls and a floor's corner on both sides of zero, and a box some way off. Off the borders of cells."""
    generator = torch.Generator().manual_seed(5)
    walls = torch.rand(3, 200, 3, generator=generator) * 1.6 - 0.9
    for axis in range(3):
        walls[axis, :, axis] = -0.83
    box = torch.rand(100, 3, generator=generator) * torch.tensor([0.3, 0.3, 0.02]) + torch.tensor([2.4, 1.3, -0.4])
    points = torch.cat([walls.flatten(0, 1), box])
    offset = points / VOXEL_SIZE - (points / VOXEL_SIZE).floor()
    return points[((offset > 1e-3) & (offset < 1 - 1e-3)).all(dim=1)].contiguous()


@torch.no_grad()
def compute(network):
    """{name: tensor} of io.safetensors."""
    config, points = network.config, make_points()
    voxels = points / VOXEL_SIZE
    owner = torch.zeros(len(points), dtype=torch.long)
    period, margin = config.period, config.reach + NEAR + 2
    origin = ((voxels.amin(dim=0) - margin) / period).floor() * period
    sides = ((voxels.amax(dim=0) + margin - origin) / period).ceil() * period
    size = tuple(int(side) for side in sides)
    features = network.encoder.point_features(voxels, owner)
    scattered = network.encoder.scatter(features, voxels - origin, owner, 1, size)[0]
    volume, far = network.encode(voxels - origin, owner, 1, size)
    z, y, x = (scattered != 0).any(dim=0).nonzero().unbind(dim=1)
    scatter_nodes = torch.stack([x, y, z], dim=1)
    at = torch.stack(torch.meshgrid(*[torch.arange(side) for side in size], indexing="ij"), dim=-1).flatten(0, 2)
    near = torch.cat([torch.cdist(part + origin, voxels).amin(dim=1) <= NEAR for part in at.split(8192)])
    at = at[near]
    generator = torch.Generator().manual_seed(9)
    queries = voxels.repeat(2, 1) + torch.randn(2 * len(voxels), 3, generator=generator)
    queries = torch.cat([queries, torch.tensor([[1000.0, -1000, 3], [0, 0, 0], [-8, -8, -8]])])
    inside = queries.clamp(max=500, min=-500)  # the first of the last three lies far from everything
    occupancy, saliency = network.logits(volume, far, inside[None] - origin)
    return {
        "points": points, "point_features": features,
        "scatter_nodes": (scatter_nodes + origin.long()).int(), "scatter_values": scattered[:, z, y, x].T,
        "volume_nodes": (at + origin.long()).int(), "volume_values": (volume[0, :, at[:, 2], at[:, 1], at[:, 0]].T + far),
        "volume_far": far, "queries": queries * VOXEL_SIZE, "occupancy_logit": occupancy[0], "saliency_logit": saliency[0],
        "occupancy": occupancy[0].sigmoid(), "saliency": torch.nn.functional.softplus(saliency[0]).apply_(lambda s: s / (1 + s)),
    }  # fmt: skip


def check():
    """Compare the stored tensors with new ones, a line each; the names that differ."""
    network = load_network(FOLDER / "weights.safetensors")
    stored, wrong = load_file(FOLDER / "io.safetensors"), []
    for name, found in compute(network).items():
        expected = stored[name]
        tolerance = 1e-5 if name in ("occupancy", "saliency", "points") else 1e-4
        right = found.shape == expected.shape and torch.allclose(
            found.float(), expected.float(), atol=tolerance, rtol=1e-4
        )
        print(f"  {name:18s} {tuple(expected.shape)!s:12s} {'ok' if right else 'MISMATCH'}")
        wrong += [] if right else [name]
    return wrong


def main(argv=None):
    """Write or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    if parser.parse_args(argv).check:
        return 1 if check() else 0
    FOLDER.mkdir(exist_ok=True)
    network = make_network()
    write_weights(FOLDER / "weights.safetensors", network.config, network.folded(), extra={"name": "golden scene"})
    with safe_open(FOLDER / "weights.safetensors", "pt") as file:
        metadata = file.metadata()
    tensors = {name: value.contiguous() for name, value in compute(network).items()}
    save_file(tensors, FOLDER / "io.safetensors", metadata=metadata | {"voxel_size": str(VOXEL_SIZE)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
