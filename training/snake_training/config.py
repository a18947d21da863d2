"""Every setting of a training run with its meaning and unit; lengths are in network units (the cube +-0.5)."""

import dataclasses
import json
import math
from dataclasses import dataclass

import torch

from .model import NetworkConfig, SnakeNetwork


def setting(default, meaning, **kwargs):
    """A dataclass field that carries its help text."""
    if isinstance(default, tuple):
        kwargs["nargs"] = "*"
    return dataclasses.field(default=default, metadata={"help": meaning} | kwargs)


@dataclass(frozen=True)
class TrainConfig:
    """The defaults are the recipe of the compact model; `PRESETS` holds the paper's rows."""

    run_dir: str = setting(
        "runs/compact", "run folder: config, checkpoints, TensorBoard logs; an existing run is resumed"
    )
    data: tuple = setting(
        (), "corpus folders (points.npy + index.json), folders of clouds or meshes, of KeypointNet, ModelNet40, 3DMatch, "
        "Redwood, or SMPL's model.pkl or model.npz", type=str,
    )  # fmt: skip
    split: tuple = setting(
        (), "a list for each folder of data: the released code's, a shape a line; else all", type=str
    )
    validation_data: tuple = setting((), "as data, for validation; without it, procedural shapes are used", type=str)
    validation_split: tuple = setting((), "a list for each of them", type=str)
    procedural_share: float = setting(0.25, "share of samples that are procedural shapes; 1 if no data is given")
    targets: tuple = setting(
        (), "files of snake_training.targets: learn their saliency instead of eqs. 3 to 5; needs no data", type=str
    )
    init: str = setting(
        "",
        "weights to start from: a safetensors export, checkpoint or run; also the network's shape where it is not given",
    )
    fresh_saliency: bool = setting(False, "with init: start the saliency decoder anew")
    revive: bool = setting(
        False,
        "with init: draw dead layers anew: a point encoder whose features do not vary, and dead units of residual blocks",
    )
    seed: int = setting(1, "seed of initial weights and samples; sample i is the same whatever the number of processes")
    device: str = setting("auto", "auto, cpu or cuda", choices=("auto", "cpu", "cuda"))
    bf16: bool = setting(True, "run the U-Net in bfloat16, where the GPU or processor has it; the rest stays float32")

    resolution: int = setting(32, "voxels along each axis of the volume")
    unet_levels: int = setting(3, "levels of the U-Net")
    unet_base_channels: int = setting(16, "channels of its first level")
    c_dim: int = setting(32, "channels of the volume")
    scatter: str = setting(
        "soft",
        "features to voxels: hard, each to its own (released code), or soft, to its eight by trilinear weights",
        choices=("hard", "soft"),
    )
    point_encoder: str = setting(
        "pointnet",
        "features of points: pointnet, pooled within voxels (released code), or pointnet2, PointNet++",
        choices=("pointnet", "pointnet2"),
    )

    normalization: str = setting(
        "unit-sphere",
        "of the clouds: unit-sphere (objects), unit-cube (rooms), or mixed: an extent between the two",
        choices=("unit-sphere", "unit-cube", "mixed"),
    )
    num_points: int = setting(4096, "input points of each view")
    rotation: str = setting(
        "so3", "second view: uniform, or three uniform angles (released code)", choices=("so3", "euler")
    )
    translation: float = setting(0.0, "second view: uniform shift of up to this much along each axis")
    recenter: bool = setting(
        False, "second view: moved back so that its mean is the origin (the released code does with 3DMatch)"
    )
    with_replacement: bool = setting(
        True, "points of a view are drawn with replacement (released code), so some come twice; off: distinct ones"
    )
    jitter_sigma: float = setting(0.005, "second view: standard deviation of the noise on each coordinate")
    jitter_clip: float = setting(0.015, "the noise is clipped to this")
    max_downsampling: float = setting(
        4.0,
        "second view: num_points / a uniform rate between 1 and this are drawn, then repeated; with targets: degraded views",
    )

    num_occupancy: int = setting(600, "occupancy queries on the surface, and as many uniform ones, a view")
    num_grids: int = setting(60, "local grids a sample (n in the paper)")
    grid_size: int = setting(5, "points along each side of a local grid (H_l)")
    grid_fraction: float = setting(6.0, "a local grid's side is 1 / this (U)")

    num_targets: int = setting(1024, "with targets: queries of the saliency a sample")
    degraded_share: float = setting(0.4, "with targets: share of views that are thinned, noisy or both, a third each")
    partial_share: float = setting(0.0, "with targets: share of samples of which one view sees one side only")
    max_noise: float = setting(0.02, "with targets: their noise's standard deviation is uniform up to this")

    weight_occupancy: float = setting(1.0, "weight of the occupancy loss; 0 switches a loss off")
    weight_repeatability: float = setting(1.0, "weight of the repeatability loss")
    weight_surface: float = setting(1.0, "weight of the surface loss")
    weight_sparsity: float = setting(1.0, "weight of the sparsity loss")
    sparsity_ridge: float = setting(
        0.9,
        "sparsity loss: share of the highest occupancy of a local grid that its points need to count; 0: all of occupancy "
        "0.5 (paper). The paper's is cheapest where the saliency peaks in the rim of the surface, which detection drops",
    )
    weight_distillation: float = setting(1.0, "with targets: weight of the distance to them")
    weight_consistency: float = setting(1.0, "with targets: weight of the distance between the two views")

    steps: int = setting(8000, "optimiser steps of the whole schedule")
    batch: int = setting(4, "samples a step, over all processes")
    learning_rate: float = setting(1e-3, "Adam's learning rate after warm-up")
    optimizer: str = setting(
        "adamw",
        "adamw: weight decay apart from the gradient, on the U-Net alone; adam: as an L2 penalty on everything (released "
        "code), which at learning rates of 1e-3 and more sets the point encoder to zero",
        choices=("adamw", "adam"),
    )
    weight_decay: float = setting(5e-4, "of the optimiser")
    schedule: str = setting(
        "cosine", "cosine: towards 0; step: x 0.1 after a share of the steps", choices=("cosine", "step")
    )
    drop_after: float = setting(2 / 3, "with the schedule step: that share (40 of 60 epochs in the paper)")
    warmup: int = setting(200, "steps of linear warm-up")
    clip_norm: float = setting(1.0, "gradient norm limit; 0: none")
    ema_decay: float = setting(
        0.998, "decay of the averaged weights, which are validated and exported; 0: no averaging"
    )

    validate_every: int = setting(500, "steps between validations")
    best_by: str = setting(
        "repeatability",
        "which validation is the best: of highest repeatability, or of lowest total loss (released code)",
        choices=("repeatability", "loss"),
    )
    validation_objects: int = setting(32, "objects of a validation")
    validation_resolution: int = setting(64, "queries along each axis when a validation detects keypoints")
    checkpoint_minutes: float = setting(5.0, "minutes between checkpoints")
    recommended_options: str = setting(
        "", "options of detection, as JSON, that an export recommends; without them those of init"
    )
    minutes: float = setting(0.0, "stop with a checkpoint after this many minutes, to be resumed; 0: never")

    @property
    def network(self):
        """The network's part of the configuration."""
        return NetworkConfig(
            resolution=(self.resolution,) * 3, unet_levels=self.unet_levels,
            unet_base_channels=self.unet_base_channels, c_dim=self.c_dim, scatter=self.scatter,
            point_encoder=self.point_encoder,
        )  # fmt: skip


def recommended(normalization, max_points, **detect):
    """Options of detection of a preset, as JSON; what is not given is the default of snake-rs."""
    return json.dumps({"encode": {"normalization": normalization, "max_points": max_points}, "detect": detect})


OBJECTS = recommended("unit-cube", 2048, nms_radius=0.1)
BODIES = recommended("unit-cube", 2048, nms_radius=0.1, snap=True)
FRAGMENTS = recommended("unit-cube", None, nms_radius=0.04, saliency_threshold=0.4, max_keypoints=2500, snap=True)
ROOMS = recommended(
    "unit-cube", 10240, nms_radius=0.04, query_resolution=100, refine_step_size=1e-4, max_keypoints=512
)  # fmt: skip

# The paper's table of hyper-parameters, and the released configuration where that says more. Where they differ: SMPL has 500
# local grids in the paper and 300 in the code, the batch is 16 (8 a GPU in the code), the views of 3DMatch have 10 000 points
# and 10 240. These are the paper's; the learning rate is the code's 1e-4 (the text agrees). Steps are epochs x shapes / batch.
PAPER = dict(
    resolution=64, unet_levels=4, unet_base_channels=32, num_grids=500, grid_size=8, batch=16, learning_rate=1e-4,
    scatter="hard", rotation="euler", optimizer="adam", schedule="step", warmup=0, ema_decay=0.0, procedural_share=0.0,
    bf16=False, clip_norm=0.0, best_by="loss",
    sparsity_ridge=0.0,
)  # fmt: skip
PRESETS = {
    "compact": {},
    "modelnet40": PAPER | dict(
        steps=36900, num_points=5000, num_occupancy=2000, jitter_sigma=0.01, jitter_clip=0.03,
        recommended_options=recommended("unit-sphere", 5000),
    ),
    "keypointnet": PAPER | dict(
        steps=21600, num_points=2048, num_occupancy=1000, grid_fraction=8.0, jitter_clip=0.01, max_downsampling=1.0,
        recommended_options=OBJECTS,
    ),
    "smpl": PAPER | dict(
        steps=1900, num_points=2048, num_occupancy=1000, grid_fraction=8.0, jitter_clip=0.01, max_downsampling=1.0,
        recommended_options=BODIES,
    ),
    # The repeatability network of the Redwood tables, trained on 3DMatch.
    "redwood": PAPER | dict(
        steps=133000, resolution=100, num_points=10000, num_occupancy=3000, num_grids=150, grid_size=10,
        grid_fraction=8.0, jitter_clip=0.01, batch=6, translation=0.3, recenter=True, normalization="unit-cube",
        drop_after=15 / 20, recommended_options=ROOMS,
    ),
    # The registration network of the 3DMatch tables, trained on KeypointNet.
    "3dmatch": PAPER | dict(
        steps=21600, num_points=2048, num_occupancy=1000, grid_size=6, grid_fraction=12.0, jitter_clip=0.01,
        max_downsampling=1.0, recommended_options=FRAGMENTS,
    ),
}  # fmt: skip


def check(config):
    """Refuse settings that cannot train, before any work is done."""
    positive = (
        "resolution", "unet_levels", "unet_base_channels", "c_dim", "num_points", "max_downsampling", "num_occupancy",
        "num_grids", "grid_size", "grid_fraction", "num_targets", "steps", "batch", "learning_rate", "validate_every",
        "validation_objects", "validation_resolution",
    )  # fmt: skip
    not_negative = (
        "seed", "translation", "jitter_sigma", "jitter_clip", "weight_occupancy", "weight_repeatability",
        "weight_surface", "weight_sparsity", "weight_distillation", "weight_consistency", "max_noise", "weight_decay",
        "warmup", "clip_norm", "checkpoint_minutes", "minutes",
    )  # fmt: skip

    def refuse(name, allowed):
        raise SystemExit(f"--{name.replace('_', '-')} must be {allowed}, got {getattr(config, name)}")

    # Written so that NaN is refused too.
    for name in positive:
        if not 0 < getattr(config, name) < math.inf:
            refuse(name, "positive")
    for name in not_negative:
        if not 0 <= getattr(config, name) < math.inf:
            refuse(name, "0 or more")
    for name in ("procedural_share", "degraded_share", "partial_share", "drop_after", "sparsity_ridge"):
        if not 0 <= getattr(config, name) <= 1:
            refuse(name, "within [0, 1]")
    if not 0 <= config.ema_decay < 1:
        refuse("ema_decay", "within [0, 1)")
    try:
        json.loads(config.recommended_options or "{}")
    except ValueError:
        refuse("recommended_options", "JSON")
    for name in ("fresh_saliency", "revive"):
        if getattr(config, name) and not config.init:
            raise SystemExit(
                f"--{name.replace('_', '-')} needs --init: without it every part of the network starts anew"
            )
    if config.max_downsampling < 1:
        refuse("max_downsampling", "1 or more")
    if config.resolution >> (config.unet_levels - 1) < 1:
        raise SystemExit(f"{config.unet_levels} levels do not fit a volume of {config.resolution} voxels a side")
    try:
        with torch.device("meta"):
            SnakeNetwork(config.network)
    except ValueError as error:
        raise SystemExit(f"--c-dim or --unet-base-channels does not divide into groups: {error}") from None
    return config


def to_json(config):
    """The resolved configuration as text."""
    return json.dumps(dataclasses.asdict(config), indent=1)


def from_json(text):
    """Inverse of `to_json`; configurations from before soft scattering are hard."""
    values = {"scatter": "hard"} | json.loads(text)
    return TrainConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
