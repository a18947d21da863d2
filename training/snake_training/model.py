"""The whole network (SNAKE section 3.1 and appendix A), with the tensor names of the authors' checkpoints.

Coordinates are the network's: the cube +-0.5. A volume is (B, C, D, H, W) with D, H, W along z, y, x.
"""

import json
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import nn
from torch.utils.checkpoint import checkpoint


@dataclass(frozen=True)
class NetworkConfig:
    """The network's configuration beyond tensor shapes; the weight file's metadata hold it."""

    resolution: tuple = (64, 64, 64)  # voxels along x, y, z
    padding: float = 0.125  # the volume spans +-0.5 * (1 + padding)
    z_min: float = -0.5
    z_max: float = 0.5
    c_dim: int = 32  # channels of the volume
    hidden_dim: int = 32  # width of the point encoder
    decoder_hidden_dim: int = 32
    resnet_blocks: int = 5
    unet_levels: int = 4
    unet_base_channels: int = 32
    group_norm_groups: int = 8
    scatter: str = "hard"  # features to voxels: each to its own voxel (as released), or "soft", to its eight voxels

    def __post_init__(self):
        if self.scatter not in ("hard", "soft"):
            raise ValueError(f"scatter {self.scatter!r} is neither hard nor soft")

    def to_metadata(self):
        """Metadata strings of the weight file, `format_version` 1."""
        values = {name: str(value) for name, value in vars(self).items()}
        return (
            {"format": "snake-field", "format_version": "1"}
            | values
            | {"resolution": json.dumps(list(self.resolution))}
        )

    @classmethod
    def from_metadata(cls, metadata):
        """Inverse of `to_metadata`; unknown keys are ignored."""
        if metadata.get("format") != "snake-field" or int(metadata.get("format_version", 0)) != 1:
            raise ValueError("not a snake-field weight file of format version 1")
        metadata = {"scatter": "hard"} | metadata  # older files do not say
        if metadata.get("point_encoder", "pointnet") != "pointnet":
            raise ValueError(f"the weight file has a point encoder of another kind: {metadata['point_encoder']}")
        missing = [name for name in cls.__dataclass_fields__ if name not in metadata]
        if missing:
            raise ValueError(f"the weight file's metadata lacks {', '.join(missing)}")
        read = {int: int, float: float, str: str, tuple: lambda text: tuple(json.loads(text))}
        return cls(**{name: read[field.type](metadata[name]) for name, field in cls.__dataclass_fields__.items()})


class ResnetBlockFC(nn.Module):
    """Fully connected pre-activation residual block: shortcut(x) + fc_1(relu(fc_0(relu(x))))."""

    def __init__(self, size_in, size_out):
        super().__init__()
        size_hidden = min(size_in, size_out)
        self.fc_0 = nn.Linear(size_in, size_hidden)
        self.fc_1 = nn.Linear(size_hidden, size_out)
        self.shortcut = None if size_in == size_out else nn.Linear(size_in, size_out, bias=False)
        nn.init.zeros_(self.fc_1.weight)

    def forward(self, x):
        residual = self.fc_1(F.relu(self.fc_0(F.relu(x))))
        return residual + (x if self.shortcut is None else self.shortcut(x))


class SingleConv(nn.Module):
    """GroupNorm -> 3x3x3 convolution without bias -> ReLU ("gcr")."""

    def __init__(self, channels_in, channels_out, groups):
        super().__init__()
        self.groupnorm = nn.GroupNorm(groups if channels_in >= groups else 1, channels_in)
        self.conv = nn.Conv3d(channels_in, channels_out, 3, padding=1, bias=False)

    def forward(self, x):
        return F.relu(self.conv(self.groupnorm(x)))


class DoubleConv(nn.Module):
    """Two SingleConvs; an encoder's first one widens to at most half of the output."""

    def __init__(self, channels_in, channels_out, groups, encoder):
        super().__init__()
        channels_mid = max(channels_in, channels_out // 2) if encoder else channels_out
        self.SingleConv1 = SingleConv(channels_in, channels_mid, groups)
        self.SingleConv2 = SingleConv(channels_mid, channels_out, groups)

    def forward(self, x):
        return self.SingleConv2(self.SingleConv1(x))


class Level(nn.Module):
    """One level of the U-Net; it only holds the name `basic_module` of the authors' checkpoints."""

    def __init__(self, channels_in, channels_out, groups, encoder):
        super().__init__()
        self.basic_module = DoubleConv(channels_in, channels_out, groups, encoder)

    def forward(self, x):
        return self.basic_module(x)


class UNet3D(nn.Module):
    """3-D U-Net: max-pool down, nearest upsampling to the skip's size up, concatenation, final 1x1x1 convolution."""

    def __init__(self, config):
        super().__init__()
        channels = [config.unet_base_channels * 2**level for level in range(config.unet_levels)]
        groups = config.group_norm_groups
        self.encoders = nn.ModuleList(
            Level(config.c_dim if level == 0 else channels[level - 1], channels[level], groups, encoder=True)
            for level in range(config.unet_levels)
        )
        self.decoders = nn.ModuleList(
            Level(channels[level + 1] + channels[level], channels[level], groups, encoder=False)
            for level in reversed(range(config.unet_levels - 1))
        )
        self.final_conv = nn.Conv3d(channels[0], config.c_dim, 1)

    def doubles(self):
        """The DoubleConvs in the order they compute."""
        return [level.basic_module for level in [*self.encoders, *self.decoders]]

    def forward(self, x):
        skips = []
        for level, encoder in enumerate(self.encoders):
            x = encoder(x if level == 0 else F.max_pool3d(x, 2))
            skips.append(x)
        for decoder, skip in zip(self.decoders, reversed(skips[:-1])):
            x = decoder(torch.cat([skip, F.interpolate(x, size=skip.shape[2:], mode="nearest")], dim=1))
        return self.final_conv(x)


class PointEncoder(nn.Module):
    """Points to volume: PointNet with local max-pooling per voxel (ConvONet), scattering, U-Net."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        hidden = config.hidden_dim
        self.fc_pos = nn.Linear(3, 2 * hidden)
        self.blocks = nn.ModuleList(ResnetBlockFC(2 * hidden, hidden) for _ in range(config.resnet_blocks))
        self.fc_c = nn.Linear(hidden, config.c_dim)
        self.unet3d = UNet3D(config)

    def point_features(self, points, voxels):
        """points (B, N, 3), voxels (B, N) flat indices -> features (B, N, c_dim)."""
        batch, number, _ = points.shape
        offsets = torch.arange(batch, device=points.device).unsqueeze(1) * voxels_per_volume(self.config)
        occupied, inverse = torch.unique(voxels + offsets, return_inverse=True)
        index = inverse.reshape(-1, 1)
        x = self.blocks[0](self.fc_pos(points))
        for block in self.blocks[1:]:
            flat = x.reshape(batch * number, -1)
            pooled = flat.new_zeros(len(occupied), flat.shape[1])
            pooled = pooled.scatter_reduce(0, index.expand_as(flat), flat, "amax", include_self=False)
            x = block(torch.cat([x, pooled[inverse]], dim=2))
        return self.fc_c(x)

    def scatter_mean(self, features, voxels):
        """features (B, N, C), voxels (B, N) -> volume (B, C, D, H, W), zero where no point falls."""
        batch, number, channels = features.shape
        size = voxels_per_volume(self.config)
        index = (voxels + torch.arange(batch, device=voxels.device).unsqueeze(1) * size).reshape(-1)
        total = features.new_zeros(batch * size, channels).index_add(0, index, features.reshape(-1, channels))
        count = features.new_zeros(batch * size).index_add(0, index, features.new_ones(batch * number))
        volume = (total / count.clamp(min=1).unsqueeze(1)).reshape(batch, size, channels)
        return volume.transpose(1, 2).reshape(batch, channels, *reversed(self.config.resolution))

    def scatter_soft(self, features, points):
        """features (B, N, C) of points (B, N, 3) -> volume (B, C, D, H, W), anti-aliased; zero far from the points.

        Each feature is added to its 8 voxels with the trilinear weights w that `interpolate` reads them with. A voxel
        of mass m = sum w holds sum w f / max(m, mean mass of the cloud's voxels with mass): a weighted mean where points
        are many, and less where few points touch the voxel's border.
        """
        batch, _, channels = features.shape
        size = voxels_per_volume(self.config)
        voxels, weights = corner_voxels(points, self.config)
        index = (voxels + torch.arange(batch, device=voxels.device)[:, None, None] * size).reshape(-1)
        mass = features.new_zeros(batch * size).index_add(0, index, weights.reshape(-1))
        spread = (weights.unsqueeze(-1) * features.unsqueeze(1)).reshape(-1, channels)
        total = features.new_zeros(batch * size, channels).index_add(0, index, spread).reshape(batch, size, channels)
        mass = mass.reshape(batch, size)
        typical = mass.sum(dim=1, keepdim=True) / (mass > 0).sum(dim=1, keepdim=True)
        volume = total / torch.maximum(mass, typical).unsqueeze(-1)
        return volume.transpose(1, 2).reshape(batch, channels, *reversed(self.config.resolution))

    def forward(self, points, autocast=False):
        voxels = voxel_index(points, self.config)
        features = self.point_features(points, voxels)
        soft = self.config.scatter == "soft"
        volume = self.scatter_soft(features, points) if soft else self.scatter_mean(features, voxels)
        if volume.device.type == "cpu":
            volume = volume.contiguous(memory_format=torch.channels_last_3d)
        with torch.autocast(volume.device.type, torch.bfloat16, enabled=autocast):
            return self.unet3d(volume).float()


class Constant(nn.Module):
    """The layer of a position that is not read: its bias alone."""

    def __init__(self, channels):
        super().__init__()
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, _):
        return self.bias


class Decoder(nn.Module):
    """Implicit decoder: query and interpolated feature to one logit, the feature added before every block."""

    def __init__(self, config):
        super().__init__()
        hidden = config.decoder_hidden_dim
        self.fc_p = nn.Linear(3, hidden) if isinstance(config, NetworkConfig) else Constant(hidden)
        self.fc_c = nn.ModuleList(nn.Linear(config.c_dim, hidden) for _ in range(config.resnet_blocks))
        self.blocks = nn.ModuleList(ResnetBlockFC(hidden, hidden) for _ in range(config.resnet_blocks))
        self.fc_out = nn.Linear(hidden, 1)

    def forward(self, queries, features):
        """queries (B, Q, 3), features (B, Q, c_dim) -> logits (B, Q)."""
        x = self.fc_p(queries)
        for fc_c, block in zip(self.fc_c, self.blocks):
            x = block(x + fc_c(features))
        return self.fc_out(F.relu(x)).squeeze(-1)


QUERIES_AT_ONCE = 16384  # of a view, in training: the decoders' activations of more are computed again, not kept


class SnakeNetwork(nn.Module):
    """Point cloud -> volume -> occupancy and saliency of any query."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        # The released network gives its z bounds to the occupancy decoder only: its saliency decoder reads every
        # volume as if it spanned +-0.5 in z. All published networks do span that.
        self.saliency_config = replace(config, z_min=-0.5, z_max=0.5)
        self.encoder = PointEncoder(config)
        self.decoder_occup = Decoder(config)
        self.decoder_keypoint = Decoder(config)

    def encode(self, points, autocast=False):
        """points (B, N, 3) -> volume (B, c_dim, D, H, W); `autocast` runs the U-Net in bfloat16."""
        return self.encoder(points, autocast)

    def occupancy_and_saliency(self, volume, queries):
        """Both fields at queries (B, Q, 3): two (B, Q) tensors of probabilities."""
        features = interpolate(volume, queries, self.config)
        occupancy = torch.sigmoid(self.decoder_occup(queries, features))
        if self.saliency_config != self.config:
            features = interpolate(volume, queries, self.saliency_config)
        return occupancy, saliency_head(self.decoder_keypoint(queries, features))

    def occupancy(self, volume, queries):
        """Occupancy probability (B, Q)."""
        return torch.sigmoid(self.decoder_occup(queries, interpolate(volume, queries, self.config)))

    def saliency(self, volume, queries):
        """Saliency (B, Q) in [0, 1)."""
        return saliency_head(self.decoder_keypoint(queries, interpolate(volume, queries, self.saliency_config)))

    def forward(self, points, queries, autocast=False):
        volume = self.encode(points, autocast)
        if not torch.is_grad_enabled() or queries.shape[1] <= QUERIES_AT_ONCE:
            return self.occupancy_and_saliency(volume, queries)
        parts = [
            checkpoint(self.occupancy_and_saliency, volume, part, use_reentrant=False, preserve_rng_state=False)
            for part in queries.split(QUERIES_AT_ONCE, dim=1)
        ]
        return tuple(torch.cat(field, dim=1) for field in zip(*parts))


def saliency_head(logits):
    """softplus(l) / (1 + softplus(l))."""
    positive = F.softplus(logits)
    return positive / (1 + positive)


def voxels_per_volume(config):
    """Number of voxels of one volume."""
    x, y, z = config.resolution
    return x * y * z


def to_volume_frame(points, config):
    """Points in +-0.5 -> [0, 1) of the padded volume, clamped (the clamp stops the gradient)."""
    unpadded = points / (1 + config.padding + 1e-7)
    xy = unpadded[..., :2] + 0.5
    z = (unpadded[..., 2:] - config.z_min) / (config.z_max - config.z_min + 1e-7)
    unit = torch.cat([xy, z], dim=-1)
    unit = torch.where(unit >= 1, torch.full_like(unit, 1 - 1e-7), unit)
    return torch.where(unit < 0, torch.zeros_like(unit), unit)


def voxel_index(points, config):
    """Flat index floor(Rx x) + Rx floor(Ry y) + Rx Ry floor(Rz z) of each point's voxel."""
    resolution = points.new_tensor(config.resolution)
    cell = (to_volume_frame(points, config) * resolution).long()
    x, y, _ = config.resolution
    return cell[..., 0] + x * (cell[..., 1] + y * cell[..., 2])


def corner_voxels(points, config):
    """Flat indices and trilinear weights (B, 8, N) of the voxels about each point, corners aligned as in `interpolate`."""
    resolution = torch.tensor(config.resolution, device=points.device)
    at = to_volume_frame(points, config) * (resolution - 1)
    lower = torch.minimum(at.long(), (resolution - 2).clamp(min=0))
    above = at - lower
    x, y, _ = config.resolution
    voxels, weights = [], []
    for corner in range(8):
        step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2], device=points.device)
        cell = torch.minimum(lower + step, resolution - 1)
        voxels.append(cell[..., 0] + x * (cell[..., 1] + y * cell[..., 2]))
        weights.append(torch.where(step == 1, above, 1 - above).prod(dim=-1))
    return torch.stack(voxels, dim=1), torch.stack(weights, dim=1)


def interpolate(volume, queries, config):
    """Trilinear features (B, Q, C): border padding, corners aligned to the first and last voxel."""
    grid = (2 * to_volume_frame(queries, config) - 1)[:, :, None, None]
    features = F.grid_sample(volume, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return features[..., 0, 0].transpose(1, 2)
