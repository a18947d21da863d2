"""Every setting of a training run with its meaning and unit; lengths of objects are in network units (the cube +-0.5)."""

import dataclasses
import json
import math
import typing
from dataclasses import dataclass

import torch

from .model import NetworkConfig, SnakeNetwork
from .scene_model import SHAPES, SceneConfig

NETWORK_SHAPE = "resolution", "unet_levels", "unet_base_channels", "c_dim", "scatter"


def setting(default, meaning, **kwargs):
    """A dataclass field that carries its help text."""
    if isinstance(default, tuple):
        kwargs["nargs"] = "*"
    return dataclasses.field(default=default, metadata={"help": meaning} | kwargs)


@dataclass(frozen=True)
class LoopSettings:
    """Settings of the training loop, for every task."""

    seed: int = setting(1, "seed of initial weights and samples; sample i is the same whatever the number of processes")
    bf16: bool = setting(True, "run the U-Net in bfloat16, where the GPU or processor has it; the rest stays float32")
    weight_occupancy: float = setting(1.0, "weight of the occupancy loss; 0 switches a loss off")
    weight_repeatability: float = setting(1.0, "weight of the repeatability loss")
    weight_surface: float = setting(1.0, "weight of the surface loss")
    weight_sparsity: float = setting(1.0, "weight of the sparsity loss")
    sparsity_ridge: float = setting(
        0.0,
        "sparsity loss: only points count whose occupancy is this share of the highest of their local grid; 0: as in the paper, "
        "where it is cheapest if the saliency peaks in the rim of the surface",
    )
    occupancy_decoder: bool = setting(
        True,
        "off: as if the network had none, with weight_occupancy and weight_surface 0 (first row of the paper's table 4): all "
        "points of the local grids count as occupied",
    )
    weight_distillation: typing.ClassVar[float] = 1.0  # of the distance to targets, beside which others are weighed
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
    warmup: int = setting(200, "steps of linear warm-up, also where Adam starts again from weights alone")
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
    recommended_options: str = setting(
        "", "options of detection, as JSON, that an export recommends; without them those of init"
    )


@dataclass(frozen=True)
class TrainConfig(LoopSettings):
    """A run on objects. The defaults are a network of the size of `compact`; `PRESETS` holds the paper's rows."""

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
        (), "files of snake_training.teacher: learn their saliency instead of eqs. 3 to 5; needs no data", type=str
    )
    init: str = setting(
        "",
        "weights to start from: a safetensors export, checkpoint or run; also the network's shape where it is not given",
    )
    fresh_saliency: bool = setting(
        False, "with init: start the saliency decoder anew, at the corners and tips of made shapes"
    )

    resolution: int = setting(32, "voxels along each axis of the volume")
    unet_levels: int = setting(3, "levels of the U-Net")
    unet_base_channels: int = setting(16, "channels of its first level")
    c_dim: int = setting(32, "channels of the volume")
    scatter: str = setting(
        "soft",
        "features to voxels: hard, each to its own (released code), or soft, to its eight by trilinear weights",
        choices=("hard", "soft"),
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
        4.0, "second view: num_points / a uniform rate between 1 and this are drawn, then repeated"
    )
    degraded_share: float = setting(
        0.0, "share of second views, of all views with targets, that are thinned, noisy or both, a third each"
    )

    num_occupancy: int = setting(600, "occupancy queries on the surface, and as many uniform ones, a view")
    num_grids: int = setting(60, "local grids a sample (n in the paper)")
    grid_size: int = setting(5, "points along each side of a local grid (H_l)")
    grid_fraction: float = setting(6.0, "a local grid's side is 1 / this (U)")
    num_targets: int = setting(1024, "with targets: queries of the saliency a sample")

    validation_samples: int = setting(
        32, "samples whose losses a validation averages; 0: each shape of the validation data once (released code)"
    )
    validation_objects: int = setting(32, "objects of which a validation measures the repeatability")
    validation_resolution: int = setting(64, "queries along each axis when a validation detects keypoints")

    @property
    def network(self):
        """The network's part of the configuration."""
        shape = {name: getattr(self, name) for name in NETWORK_SHAPE}
        return NetworkConfig(**shape | {"resolution": (self.resolution,) * 3})


@dataclass(frozen=True)
class SceneTraining(LoopSettings):
    """A run on crops of made rooms and streets; lengths are in voxels."""

    steps: int = 4000
    batch: int = 2
    learning_rate: float = 1.5e-3
    warmup: int = 50
    weight_occupancy: float = 0.5
    weight_consistency: float = 0.1
    unet_base_channels: int = setting(16, "channels of the first level of the U-Net, of a new network")
    c_dim: int = setting(32, "channels of the volume, of a new network")
    side: int = setting(32, "voxels of the box that a view is cut to; a multiple of the network's period")
    teacher_share: float = setting(0.6, "of the target, where there is a teacher; the rest is the crop's level")
    queries: int = setting(1500, "of the saliency, a crop")
    num_occupancy: int = setting(300, "occupancy queries on the surface, and as many off it, a view")
    num_grids: int = setting(0, "local grids a crop: learn by eqs. 3 to 5 instead of from targets; 0: from targets")
    grid_size: int = setting(5, "points along each side of a local grid")
    turned_share: float = setting(0.4, "share of the views that are turned in any way, not only about z")

    @property
    def network(self):
        """The configuration of a new network."""
        return SceneConfig(c_dim=self.c_dim, unet_base_channels=self.unet_base_channels)


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
    bf16=False, clip_norm=0.0, best_by="loss", validation_samples=0,
    validate_every=1000,
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
        drop_after=15 / 20, validate_every=3000, recommended_options=ROOMS,
    ),
    # The registration network of the 3DMatch tables, trained on KeypointNet.
    "3dmatch": PAPER | dict(
        steps=21600, num_points=2048, num_occupancy=1000, grid_size=6, grid_fraction=12.0, jitter_clip=0.01,
        max_downsampling=1.0, recommended_options=FRAGMENTS,
    ),
}  # fmt: skip


# Ranges of the settings; others may have any value of their type.
POSITIVE = (
    "resolution", "unet_levels", "unet_base_channels", "c_dim", "num_points", "num_occupancy", "grid_size", "grid_fraction",
    "num_targets", "steps", "batch", "learning_rate", "validate_every", "validation_objects", "validation_resolution",
    "side", "queries",
)  # fmt: skip
NOT_NEGATIVE = (
    "seed", "translation", "jitter_sigma", "jitter_clip", "num_grids", "weight_occupancy", "weight_repeatability",
    "weight_surface", "weight_sparsity", "weight_consistency", "weight_decay", "warmup", "clip_norm", "validation_samples",
)  # fmt: skip
AT_LEAST_ONE = ("max_downsampling",)
SHARES = (
    "procedural_share", "degraded_share", "drop_after", "teacher_share", "turned_share", "sparsity_ridge",
)  # fmt: skip
RANGES = (
    dict.fromkeys(POSITIVE, ("positive", lambda value: 0 < value < math.inf))
    | dict.fromkeys(NOT_NEGATIVE, ("0 or more", lambda value: 0 <= value < math.inf))
    | dict.fromkeys(AT_LEAST_ONE, ("1 or more", lambda value: 1 <= value < math.inf))
    | dict.fromkeys(SHARES, ("within [0, 1]", lambda value: 0 <= value <= 1))
    | {"ema_decay": ("within [0, 1)", lambda value: 0 <= value < 1)}
)  # NaN is refused by all


def check(config):
    """Refuse settings that cannot train, a ValueError, before any work is done."""
    for field in dataclasses.fields(config):
        allowed, fits = RANGES.get(field.name, ("", lambda _: True))
        if not fits(getattr(config, field.name)):
            raise ValueError(f"{field.name} must be {allowed}, got {getattr(config, field.name)}")
        choices = field.metadata.get("choices")
        if choices and getattr(config, field.name) not in choices:
            raise ValueError(f"{field.name} must be one of {', '.join(choices)}, got {getattr(config, field.name)!r}")
    try:
        json.loads(config.recommended_options or "{}")
    except ValueError:
        raise ValueError(f"recommended_options must be JSON, got {config.recommended_options}") from None
    if not config.occupancy_decoder and (config.weight_occupancy or config.weight_surface):
        raise ValueError("without occupancy_decoder weight_occupancy and weight_surface must be 0")
    if isinstance(config, TrainConfig):
        check_objects(config)
    shape = {name: getattr(config.network, name) for name in SHAPES}
    try:
        with torch.device("meta"):
            SnakeNetwork(NetworkConfig(**shape))
    except ValueError as error:
        raise ValueError(f"c_dim or unet_base_channels does not divide into groups: {error}") from None
    return config


def check_objects(config):
    """The same for the settings of runs on objects alone."""
    if config.num_grids < 1:
        raise ValueError(f"num_grids must be positive, got {config.num_grids}")
    if config.fresh_saliency and not config.init:
        raise ValueError("fresh_saliency needs init: without it every part of the network starts anew")
    if config.resolution >> (config.unet_levels - 1) < 1:
        raise ValueError(f"{config.unet_levels} levels do not fit a volume of {config.resolution} voxels a side")


def from_table(kind, table):
    """A dataclass of settings from a table of TOML: an unknown name or a wrong type is a ValueError."""
    types = typing.get_type_hints(kind)
    known = {field.name for field in dataclasses.fields(kind)}
    for name, value in table.items():
        if name not in known:
            raise ValueError(f"unknown setting {name!r}; known are {', '.join(sorted(known))}")
        wanted = typing.get_origin(types[name]) or types[name]
        fits = isinstance(value, (int, float) if wanted is float else list if wanted is tuple else wanted)
        if not fits or (isinstance(value, bool) and wanted is not bool):
            raise ValueError(f"{name} must be of type {wanted.__name__}, got {value!r}")
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in table.items()})


def to_json(config):
    """The resolved configuration as text."""
    return json.dumps(dataclasses.asdict(config), indent=1)
