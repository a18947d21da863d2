"""Every setting of a training run, on a line with its meaning and unit; lengths are in network units (the cube +-0.5)."""

import argparse
import dataclasses
import json
from dataclasses import dataclass

from .model import NetworkConfig


def setting(default, meaning, **kwargs):
    """A dataclass field that carries its help text."""
    if isinstance(default, tuple):
        kwargs["nargs"] = "*"
    return dataclasses.field(default=default, metadata={"help": meaning} | kwargs)


@dataclass(frozen=True)
class TrainConfig:
    """The defaults are the recipe of the compact model; `PRESETS` holds the paper's rows."""

    run_dir: str = setting("runs/compact", "run folder: resolved config, checkpoints, TensorBoard logs; an existing run is resumed")
    data: tuple = setting((), "corpus folders (points.npy + index.json) or folders of .npy / .ply files", type=str)
    validation_data: tuple = setting((), "the same for validation; without it, procedural shapes are used", type=str)
    procedural_share: float = setting(0.25, "share of samples that are procedural shapes; 1 if no data is given")
    init: str = setting("", "weights to start from: a safetensors export or a checkpoint")
    seed: int = setting(1, "seed of initial weights and samples; sample i is the same whatever the number of processes")
    device: str = setting("auto", "auto, cpu or cuda", choices=("auto", "cpu", "cuda"))
    bf16: bool = setting(True, "run the U-Net in bfloat16 autocast; everything else stays float32")

    resolution: int = setting(32, "voxels along each axis of the volume")
    unet_levels: int = setting(3, "levels of the U-Net")
    unet_base_channels: int = setting(16, "channels of its first level")
    c_dim: int = setting(32, "channels of the volume")

    num_points: int = setting(4096, "input points of each view")
    rotation: str = setting("so3", "second view: uniform rotation, or three uniform Euler angles (released code)", choices=("so3", "euler"))
    translation: float = setting(0.0, "second view: uniform shift of up to this much along each axis")
    jitter_sigma: float = setting(0.005, "second view: standard deviation of the noise on each coordinate")
    jitter_clip: float = setting(0.015, "the noise is clipped to this")
    max_downsampling: float = setting(4.0, "second view: points are thinned by a uniform rate between 1 and this, then repeated")

    num_occupancy: int = setting(600, "occupancy queries on the surface, and as many uniform ones, a view")
    num_grids: int = setting(60, "local grids a sample (n in the paper)")
    grid_size: int = setting(5, "points along each side of a local grid (H_l)")
    grid_fraction: float = setting(6.0, "a local grid's side is 1 / this (U)")

    weight_occupancy: float = setting(1.0, "weight of the occupancy loss; 0 switches a loss off")
    weight_repeatability: float = setting(1.0, "weight of the repeatability loss")
    weight_surface: float = setting(1.0, "weight of the surface loss")
    weight_sparsity: float = setting(1.0, "weight of the sparsity loss")

    steps: int = setting(8000, "optimiser steps of the whole schedule")
    batch: int = setting(4, "samples a step, over all processes")
    learning_rate: float = setting(1e-3, "Adam's learning rate after warm-up")
    weight_decay: float = setting(5e-4, "Adam's L2 penalty")
    schedule: str = setting("cosine", "cosine: to zero at the last step; step: x 0.1 after two thirds of the steps", choices=("cosine", "step"))
    warmup: int = setting(200, "steps of linear warm-up")
    clip_norm: float = setting(1.0, "gradient norm limit")
    ema_decay: float = setting(0.998, "decay a step of the averaged weights that are validated and exported; 0: no averaging")

    validate_every: int = setting(500, "steps between validations")
    validation_objects: int = setting(32, "objects of a validation")
    checkpoint_minutes: float = setting(5.0, "minutes between checkpoints")
    minutes: float = setting(0.0, "stop with a checkpoint after this many minutes, to be resumed; 0: never")

    @property
    def network(self):
        """The network's part of the configuration."""
        return NetworkConfig(
            resolution=(self.resolution,) * 3, unet_levels=self.unet_levels,
            unet_base_channels=self.unet_base_channels, c_dim=self.c_dim,
        )


PAPER = dict(
    resolution=64, unet_levels=4, unet_base_channels=32, num_grids=500, grid_size=8, batch=16, learning_rate=1e-4,
    rotation="euler", schedule="step", warmup=0, ema_decay=0.0, procedural_share=0.0,
)
PRESETS = {
    "compact": {},
    "modelnet40": PAPER | dict(num_points=5000, num_occupancy=2000, jitter_sigma=0.01, jitter_clip=0.03),
    "keypointnet": PAPER | dict(num_points=2048, num_occupancy=1000, grid_fraction=8.0, jitter_clip=0.01, max_downsampling=1.0),
    "smpl": PAPER | dict(num_points=2048, num_occupancy=1000, grid_fraction=8.0, jitter_clip=0.01, max_downsampling=1.0),
    "3dmatch": PAPER | dict(
        resolution=100, num_points=10000, num_occupancy=3000, num_grids=150, grid_size=10, grid_fraction=8.0,
        jitter_clip=0.01, batch=6, translation=0.3,
    ),
}  # fmt: skip


def parse_arguments(argv, description):
    """Command line -> TrainConfig: preset first, then whatever is given explicitly."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.train", description=description,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--preset", choices=PRESETS, default="compact", help="settings to start from")
    for field in dataclasses.fields(TrainConfig):
        options = dict(field.metadata)
        if field.type is bool:
            options["action"] = argparse.BooleanOptionalAction
        else:
            options.setdefault("type", field.type)
        parser.add_argument("--" + field.name.replace("_", "-"), default=field.default, **options)
    preset = parser.parse_known_args(argv)[0].preset
    parser.set_defaults(**PRESETS[preset])
    values = vars(parser.parse_args(argv))
    del values["preset"]
    return check(TrainConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}))


def check(config):
    """Refuse settings that cannot train, before any work is done."""
    positive = (
        "resolution", "unet_levels", "unet_base_channels", "c_dim", "num_points", "num_occupancy", "num_grids",
        "grid_size", "grid_fraction", "steps", "batch", "learning_rate", "validate_every", "validation_objects",
    )  # fmt: skip
    for name in positive:
        if getattr(config, name) <= 0:
            raise SystemExit(f"--{name.replace('_', '-')} must be positive, got {getattr(config, name)}")
    if not 0 <= config.procedural_share <= 1 or not 0 <= config.ema_decay < 1 or config.max_downsampling < 1:
        raise SystemExit("--procedural-share is within [0, 1], --ema-decay within [0, 1), --max-downsampling at least 1")
    if config.resolution >> (config.unet_levels - 1) < 1:
        raise SystemExit(f"{config.unet_levels} levels do not fit a volume of {config.resolution} voxels a side")
    return config


def to_json(config):
    """The resolved configuration as text."""
    return json.dumps(dataclasses.asdict(config), indent=1)


def from_json(text):
    """Inverse of `to_json`."""
    return TrainConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in json.loads(text).items()})
