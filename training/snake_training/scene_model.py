"""The network for scenes: that of `model.py` at the scale of the world, on an unbounded lattice, with constants for statistics.

All positions are in voxels, p / voxel size; the lattice's nodes lie at the integers. A box of nodes is (B, C, D, H, W) with D, H,
W along z, y, x.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import nn

from .model import Decoder, NetworkConfig, ResnetBlockFC, UNet3D, saliency_head

# Metadata of all networks of scenes.
FIXED = {
    "format": "snake-field", "format_version": "2", "coordinates": "voxel", "scatter": "soft",
}  # fmt: skip
SHAPES = "c_dim", "unet_levels", "unet_base_channels"


@dataclass(frozen=True)
class SceneConfig:
    """A network of scenes, whose coordinates are p / voxel size: it has no window, and sees a cloud of any extent."""

    c_dim: int = 32
    hidden_dim: int = 32
    decoder_hidden_dim: int = 32
    resnet_blocks: int = 5
    unet_levels: int = 3
    unet_base_channels: int = 16
    scatter_mass: float = 1.0  # a node of less mass holds less than the weighted mean of its features

    @property
    def period(self):
        """Moved by a multiple of this many voxels, a cloud has the same field, moved."""
        return 2 ** (self.unet_levels - 1)

    @property
    def reach(self):
        """A node's value depends on the scattered features of nodes up to this many voxels away along each axis."""
        layers = 2 * self.period + 4 * (self.period - 1)  # two convolutions down and two up, but for the deepest level
        return layers + self.period - 1  # and what pooling joins

    def to_metadata(self):
        """Metadata strings of the weight file, `format_version` 2."""
        return FIXED | {name: str(value) for name, value in vars(self).items()}

    @classmethod
    def from_metadata(cls, metadata):
        """Inverse of `to_metadata`; unknown keys are ignored."""
        wrong = [name for name, value in FIXED.items() if metadata.get(name) != value]
        if wrong:
            raise ValueError(f"not a snake-field weight file of scenes: {wrong[0]} is {metadata.get(wrong[0])!r}")
        missing = [name for name in cls.__dataclass_fields__ if name not in metadata]
        if missing:
            raise ValueError(f"the weight file's metadata lacks {', '.join(missing)}")
        return cls(**{name: field.type(metadata[name]) for name, field in cls.__dataclass_fields__.items()})


class FixedConv(nn.Module):
    """3x3x3 convolution of scale * x, bias, ReLU: a SingleConv whose normalisation has constants for statistics.

    Far from all points x is a constant vector on the unbounded lattice. A volume holds what x exceeds it by, so that the
    padding of a volume's border, zero, is the unbounded lattice's value.
    """

    def __init__(self, channels_in, channels_out):
        super().__init__()
        self.conv = nn.Conv3d(channels_in, channels_out, 3, padding=1)
        self.scale = nn.Parameter(torch.ones(channels_in))

    def forward(self, x, far):
        """x - far (B, C, D, H, W) and far (C,) -> the same of the output."""
        weight = self.conv.weight * self.scale[:, None, None, None]
        bias = (weight.sum(dim=(2, 3, 4)) * far).sum(dim=1) + self.conv.bias
        y, far = F.relu(F.conv3d(x, weight, bias, padding=1)), F.relu(bias)
        return y - far.to(y.dtype)[:, None, None, None], far

    @torch.no_grad()
    def fix(self, x, far, weight, bias, groups):
        """Takes the constants from inputs (B, C, D, H, W): then the layer is a SingleConv whose group normalisation has
        this `weight` and `bias` (C,) and the inputs' statistics for all inputs."""
        channels = x.shape[1]
        groups = groups if channels >= groups else 1
        mean, square = x.mean(dim=(0, 2, 3, 4)) + far, (x + far[:, None, None, None]).square().mean(dim=(0, 2, 3, 4))
        mean, square = (v.reshape(groups, -1).mean(dim=1).repeat_interleave(channels // groups) for v in (mean, square))
        self.scale.copy_(weight / (square - mean.square() + 1e-5).sqrt())
        self.conv.bias.copy_(self.conv.weight.sum(dim=(2, 3, 4)) @ (bias - self.scale * mean))


class SceneUNet(UNet3D):
    """The U-Net with `FixedConv` for its layers, on a part of the unbounded lattice."""

    def __init__(self, config):
        super().__init__(replace(NetworkConfig(), **{k: getattr(config, k) for k in SHAPES}))
        for double in self.doubles():
            for name, layer in list(double.named_children()):
                setattr(double, name, FixedConv(layer.conv.in_channels, layer.conv.out_channels))

    def forward(self, x, visit=lambda layer, x, far: None):
        """Scattered features (B, C, D, H, W), each side a multiple of the period -> the volume less its value far from
        all points, and that (C,). `visit` sees every layer with its input before it computes."""

        def both(level, x, far):
            for layer in (level.basic_module.SingleConv1, level.basic_module.SingleConv2):
                visit(layer, x, far)
                x, far = layer(x, far)
            return x, far

        far, skips = x.new_zeros(x.shape[1]), []
        for level, encoder in enumerate(self.encoders):
            x, far = both(encoder, x if level == 0 else F.max_pool3d(x, 2), far)
            skips.append((x, far))
        for decoder, (skip, skip_far) in zip(self.decoders, reversed(skips[:-1])):
            above = F.interpolate(x, scale_factor=2, mode="nearest")
            x, far = both(decoder, torch.cat([skip, above], dim=1), torch.cat([skip_far, far]))
        weight = self.final_conv.weight
        return F.conv3d(x, weight).float(), (weight.flatten(1) * far).sum(dim=1) + self.final_conv.bias


class SceneEncoder(nn.Module):
    """Points to a box of nodes of the lattice. Points are in voxels; the box is [0, size) with nodes at the integers.

    The clouds of a batch are one array of points (N, 3) and the number of each point's cloud, `owner` (N,).
    """

    def __init__(self, config):
        super().__init__()
        self.config, hidden = config, config.hidden_dim
        self.fc_pos = nn.Linear(3, 2 * hidden)
        self.blocks = nn.ModuleList(ResnetBlockFC(2 * hidden, hidden) for _ in range(config.resnet_blocks))
        self.fc_c = nn.Linear(hidden, config.c_dim)
        self.unet3d = SceneUNet(config)

    def point_features(self, points, owner):
        """Features (N, c_dim) from the points' offsets in their cells, pooled within the cells."""
        cell = points.floor()
        _, inverse = torch.unique(torch.cat([owner[:, None], cell.long()], dim=1), dim=0, return_inverse=True)
        index, cells = inverse[:, None], int(inverse.max()) + 1
        x = self.blocks[0](self.fc_pos(points - cell - 0.5))
        for block in self.blocks[1:]:
            pooled = x.new_zeros(cells, x.shape[1])
            pooled = pooled.scatter_reduce(0, index.expand_as(x), x, "amax", include_self=False)
            x = block(torch.cat([x, pooled[inverse]], dim=1))
        return self.fc_c(x)

    def scatter(self, features, points, owner, clouds, size):
        """Volume (clouds, C, D, H, W): at each node the sum of w f over max(sum of w, scatter_mass), w trilinear."""
        nodes, weights = corner_nodes(points, size)
        index = (nodes + owner * size[0] * size[1] * size[2]).reshape(-1)
        number, channels = clouds * size[0] * size[1] * size[2], features.shape[1]
        mass = features.new_zeros(number).index_add(0, index, weights.reshape(-1))
        spread = (weights.unsqueeze(-1) * features).reshape(-1, channels)
        total = features.new_zeros(number, channels).index_add(0, index, spread)
        volume = total / mass.clamp(min=self.config.scatter_mass).unsqueeze(1)
        return volume.reshape(clouds, *reversed(size), channels).movedim(-1, 1)

    def forward(self, points, owner, clouds, size, autocast=False):
        volume = self.scatter(self.point_features(points, owner), points, owner, clouds, size)
        with torch.autocast(volume.device.type, torch.bfloat16, enabled=autocast):
            return self.unet3d(volume)  # the memory is already laid out channels last


class SceneNetwork(nn.Module):
    """Point clouds -> volumes -> occupancy and saliency of any query; all positions are in voxels."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        self.encoder = SceneEncoder(config)
        self.decoder_occup = Decoder(config)
        self.decoder_keypoint = Decoder(config)

    def encode(self, points, owner, clouds, size, autocast=False):
        """points (N, 3) within [0, size - 1), owner (N,) -> volume (clouds, c_dim, D, H, W) of size (x, y, z) nodes, less
        its value far from all points, and that (c_dim,).

        A box is exact if all points that lie within `reach` voxels of it are in it, and a margin of `reach` about them.
        """
        return self.encoder(points, owner, clouds, size, autocast)

    def logits(self, volume, far, queries):
        """Log-odds of the occupancy (B, Q) and the saliency head's input (B, Q), at queries (B, Q, 3)."""
        sides = queries.new_tensor([side - 1 for side in reversed(volume.shape[2:])])
        grid = (2 * queries / sides - 1)[:, :, None, None]
        features = F.grid_sample(volume, grid, mode="bilinear", padding_mode="zeros", align_corners=True)
        features = features[..., 0, 0].transpose(1, 2) + far
        return self.decoder_occup(None, features), self.decoder_keypoint(None, features)

    def forward(self, points, owner, queries, side, autocast=False):
        """Occupancy and saliency (B, Q) of B clouds in boxes of `side` nodes along each axis, at queries (B, Q, 3)."""
        volume, far = self.encode(points, owner, len(queries), (side,) * 3, autocast)
        occupancy, saliency = self.logits(volume, far, queries)
        return torch.sigmoid(occupancy), saliency_head(saliency)

    def folded(self):
        """The tensors of the weight file: scales multiplied into the convolutions."""
        tensors = self.state_dict()
        for name in [name for name in tensors if name.endswith(".scale")]:
            weight = name.removesuffix("scale") + "conv.weight"
            tensors[weight] = tensors[weight] * tensors.pop(name)[:, None, None, None]
        return tensors

    def load_folded(self, tensors):
        """Inverse of `folded`; a RuntimeError says which tensor does not fit."""
        scales = {name: torch.ones_like(value) for name, value in self.state_dict().items() if name.endswith(".scale")}
        self.load_state_dict(tensors | scales, strict=True)


def corner_nodes(points, size):
    """Flat indices and trilinear weights (8, N) of the nodes about each point."""
    lower = points.floor()
    above, lower = points - lower, lower.long()
    nodes, weights = [], []
    for corner in range(8):
        step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2], device=points.device)
        x, y, z = (lower + step).unbind(dim=1)
        nodes.append(x + size[0] * (y + size[1] * z))
        weights.append(torch.where(step == 1, above, 1 - above).prod(dim=1))
    return torch.stack(nodes), torch.stack(weights)
