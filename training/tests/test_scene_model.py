"""The network of scenes: what its constants, its lattice and its reach promise."""

import pytest
import torch
import torch.nn.functional as F

from snake_training.export import load_network, write_weights
from snake_training.model import NetworkConfig, SnakeNetwork
from snake_training.scene_model import SceneConfig, SceneNetwork, corner_nodes

CONFIG = SceneConfig(c_dim=8, unet_base_channels=8)
CORE = 16  # voxels along each side of the box that holds the points


@pytest.fixture
def scene():
    """A network whose layers all have constants of their own."""
    torch.manual_seed(3)
    network = SceneNetwork(CONFIG)
    for name, parameter in network.named_parameters():
        spread = {"scale": 0.2, "bias": 0.1}.get(name.split(".")[-1], 0.02)
        parameter.data += spread * torch.randn_like(parameter)
        if name.endswith("conv.weight"):
            parameter.data *= 2.5
    return network.eval()


def volume_of(network, points, margin, core=CORE):
    """The volume about points within [0, core), its far value and the box's origin."""
    box = core + 2 * margin
    owner = torch.zeros(len(points), dtype=torch.long)
    with torch.no_grad():
        volume, far = network.encode(points + margin, owner, 1, (box,) * 3)
    return volume[0], far


def lattice_points(number, seed=1):
    """Points within the core whose coordinates, multiples of 1/64, add without rounding."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(64, (CORE - 1) * 64 - 64, (number, 3), generator=generator) / 64 + 1 / 128


def explicit(network, x):
    """The U-Net layer by layer on a volume whose padding is zero, scales and constants applied as they are written."""

    def double(block, x):
        for layer in (block.SingleConv1, block.SingleConv2):
            x = F.relu(F.conv3d(layer.scale[:, None, None, None] * x, layer.conv.weight, layer.conv.bias, padding=1))
        return x

    skips = []
    for level, encoder in enumerate(network.encoders):
        x = double(encoder.basic_module, x if level == 0 else F.max_pool3d(x, 2))
        skips.append(x)
    for decoder, skip in zip(network.decoders, reversed(skips[:-1])):
        x = double(decoder.basic_module, torch.cat([skip, F.interpolate(x, scale_factor=2)], dim=1))
    return network.final_conv(x)


def test_the_border_of_a_box_is_the_unbounded_lattice(scene):
    points, margin, rim = lattice_points(300), 24, 2 * 24
    volume, far = volume_of(scene, points, margin)
    features = scene.encoder.point_features(points, torch.zeros(300, dtype=torch.long))
    size = (CORE + 2 * (margin + rim),) * 3
    scattered = scene.encoder.scatter(features, points + margin + rim, torch.zeros(300, dtype=torch.long), 1, size)
    with torch.no_grad():
        whole = explicit(scene.encoder.unet3d, scattered)[0, :, rim:-rim, rim:-rim, rim:-rim]
    assert torch.allclose(volume + far[:, None, None, None], whole, atol=1e-4)
    assert volume.abs().max() > 0.1  # it is not all alike


def test_fixed_statistics_are_those_of_the_group_normalisation():
    torch.manual_seed(2)
    usual = SnakeNetwork(NetworkConfig(unet_levels=3, unet_base_channels=16, c_dim=16)).encoder.unet3d
    layer = usual.encoders[0].basic_module.SingleConv1
    layer.groupnorm.weight.data += 0.3 * torch.randn(16)
    layer.groupnorm.bias.data += 0.3 * torch.randn(16)
    fixed = SceneNetwork(SceneConfig(c_dim=16)).encoder.unet3d.encoders[0].basic_module.SingleConv1
    fixed.conv.weight.data.copy_(layer.conv.weight.data)
    x, far = torch.randn(1, 16, 12, 12, 12) * torch.rand(16, 1, 1, 1), torch.rand(16)
    fixed.fix(x, far, layer.groupnorm.weight, layer.groupnorm.bias, 8)
    with torch.no_grad():
        expected = layer(x + far[:, None, None, None])
        y, y_far = fixed(x, far)
    inner = (slice(None), slice(None), *[slice(1, -1)] * 3)  # at the border the usual padding is zero
    assert torch.allclose((y + y_far[:, None, None, None])[inner], expected[inner], atol=1e-4)


def test_the_folded_export_equals_the_network(scene, tmp_path):
    write_weights(tmp_path / "scenes.safetensors", CONFIG, scene.folded())
    again = load_network(tmp_path / "scenes.safetensors")
    points = lattice_points(300)
    (a, far_a), (b, far_b) = volume_of(scene, points, 4), volume_of(again, points, 4)
    assert torch.allclose(a, b, atol=1e-5) and torch.allclose(far_a, far_b, atol=1e-5)
    assert again.config == CONFIG and not any("scale" in name or "fc_p.weight" in name for name in again.folded())


def test_moved_by_a_period_the_field_moves_exactly(scene):
    points, margin, shift = lattice_points(300), 32, torch.tensor([4.0, 8, -4])
    owner, box = torch.zeros(300, dtype=torch.long), (CORE + 2 * margin,) * 3
    queries = points[None, :50] + margin
    with torch.no_grad():
        volume, far = scene.encode(points + margin, owner, 1, box)
        moved, _ = scene.encode(points + margin + shift, owner, 1, box)
        fields = zip(scene.logits(volume, far, queries), scene.logits(moved, far, queries + shift))
    assert torch.equal(moved[..., 4:-8, 12:-4, 8:-4], volume[..., 8:-4, 4:-12, 4:-8])
    for there, here in fields:  # torch reads a volume by shares of its sides, which rounds
        assert torch.allclose(there, here, atol=1e-4)


def test_a_crop_changes_nothing_beyond_the_reach(scene):
    points = lattice_points(600)
    crop = points[points[:, 0] < 8]
    margin = 40
    whole, part = volume_of(scene, points, margin)[0], volume_of(scene, crop, margin)[0]
    differs = ((whole - part).abs().amax(dim=(0, 1, 2)) > 0).nonzero().flatten() - margin
    assert 8 - CONFIG.reach <= differs.min() < 8 - CONFIG.reach / 2  # of nodes along x; scattering reaches node 8
    assert CONFIG.reach == 23


def test_scattering_is_its_formula(scene):
    points = lattice_points(60)
    owner = torch.zeros(60, dtype=torch.long)
    features = torch.randn(60, 8)
    volume = scene.encoder.scatter(features, points, owner, 1, (CORE,) * 3)[0]
    at = torch.stack(torch.meshgrid(*[torch.arange(CORE)] * 3, indexing="ij"), dim=-1).float()  # z, y, x
    total, mass = torch.zeros(8, CORE, CORE, CORE), torch.zeros(CORE, CORE, CORE)
    for point, feature in zip(points, features):
        weight = (1 - (at - point.flip(0)).abs()).clamp(min=0).prod(dim=-1)
        mass += weight
        total += weight * feature[:, None, None, None]
    assert torch.allclose(volume, total / mass.clamp(min=CONFIG.scatter_mass), atol=1e-5)
    assert torch.allclose(corner_nodes(points, (CORE,) * 3)[1].sum(dim=0), torch.ones(60))


def test_the_clouds_of_a_batch_do_not_see_each_other(scene):
    first, second = lattice_points(200, 1), lattice_points(300, 2)
    owner = torch.tensor([0] * 200 + [1] * 300)
    with torch.no_grad():
        both, _ = scene.encode(torch.cat([first, second]), owner, 2, (CORE,) * 3)
        alone, _ = scene.encode(second, owner[200:] - 1, 1, (CORE,) * 3)
    assert torch.allclose(both[1], alone[0], atol=1e-5)
