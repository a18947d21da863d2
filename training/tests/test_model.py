"""Soft scattering against its formula."""

from dataclasses import replace

import pytest
import torch

from snake_training.model import NetworkConfig, SnakeNetwork, interpolate

CONFIG = NetworkConfig((5, 4, 3), unet_levels=1, unet_base_channels=8, c_dim=8, scatter="soft")


def coordinates(axis, number):
    """Voxel coordinate of `number` positions along an axis, in network units."""
    return (torch.arange(number) / (number - 1) - 0.5) * (1 + CONFIG.padding)


def plain(points, features):
    """The formula, point by point and voxel by voxel: weights are products of tent functions about the voxels."""
    x, y, z = (coordinates(axis, number) for axis, number in enumerate(CONFIG.resolution))
    total, mass = torch.zeros(8, 3, 4, 5), torch.zeros(3, 4, 5)
    limit = 0.5 * (1 + CONFIG.padding)
    for point, feature in zip(points.clamp(-limit, limit), features):
        tents = [
            (1 - (point[axis] - positions).abs() / (positions[1] - positions[0])).clamp(min=0)
            for axis, positions in enumerate((x, y, z))
        ]
        weight = tents[2][:, None, None] * tents[1][None, :, None] * tents[0][None, None, :]
        mass += weight
        total += weight * feature[:, None, None, None]
    typical = mass[mass > 1e-6].mean()
    return total / mass.clamp(min=typical)


def test_soft_scattering_is_its_formula():
    generator = torch.Generator().manual_seed(1)
    points = torch.rand(40, 3, generator=generator) * 1.3 - 0.65
    features = torch.randn(40, 8, generator=generator)
    volume = SnakeNetwork(CONFIG).encoder.scatter_soft(features[None], points[None])
    assert torch.allclose(volume[0], plain(points, features), atol=1e-4)


def test_a_dense_constant_comes_back_where_it_is_read():
    points = torch.rand(1, 4000, 3) * 0.9 - 0.45
    features = torch.ones(1, 4000, 8)
    volume = SnakeNetwork(CONFIG).encoder.scatter_soft(features, points)
    assert volume.max() <= 1 + 1e-5
    assert interpolate(volume, points[:, :50] * 0.3, CONFIG).min() > 0.9


def test_the_volume_moves_smoothly_with_the_cloud():
    torch.manual_seed(0)
    points = torch.rand(1, 500, 3) * 0.8 - 0.4
    features = torch.randn(1, 500, 8)

    def change(config):
        encoder = SnakeNetwork(config).encoder
        scatter = encoder.scatter_soft if config.scatter == "soft" else hard(encoder, config)
        return (scatter(features, points) - scatter(features, points + 1e-4)).abs().max()

    def hard(encoder, config):
        from snake_training.model import voxel_index

        return lambda features, points: encoder.scatter_mean(features, voxel_index(points, config))

    assert change(CONFIG) < 0.01 < change(replace(CONFIG, resolution=(32, 32, 32), scatter="hard"))


def test_files_that_do_not_say_are_hard_and_other_words_are_refused():
    metadata = CONFIG.to_metadata()
    assert NetworkConfig.from_metadata(metadata) == CONFIG
    del metadata["scatter"]
    assert NetworkConfig.from_metadata(metadata).scatter == "hard"
    with pytest.raises(ValueError, match="scatter"):
        NetworkConfig.from_metadata(metadata | {"scatter": "gentle"})
    with pytest.raises(ValueError, match="point encoder of another kind"):
        NetworkConfig.from_metadata(metadata | {"point_encoder": "pointnet3"})
