"""Command line of a training run: the settings of `config` as options."""

import argparse
import dataclasses
from pathlib import Path

from .config import PRESETS, TrainConfig, check
from .export import load_network, recommended_options

NETWORK_SHAPE = "resolution", "unet_levels", "unet_base_channels", "c_dim", "scatter", "point_encoder"


def parse_arguments(argv, description):
    """Command line -> TrainConfig: preset first, then whatever is given explicitly."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.train", description=description, add_help=False,
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
    parser.add_argument("-h", "--help", action="help", help="show these settings, with the preset's values, and exit")
    # What a namespace holds already, argparse leaves alone: None tells what was not given.
    shape = vars(parser.parse_args(argv, argparse.Namespace(**dict.fromkeys(NETWORK_SHAPE))))
    values = vars(parser.parse_args(argv))
    resumed = Path(values["run_dir"]) / "last.pt"
    if values["init"]:
        started = resumed if resumed.exists() else values["init"]
        values |= {name: value for name, value in shape_of(started).items() if shape[name] is None}
        values["recommended_options"] = values["recommended_options"] or recommended_options(started)
    del values["preset"]
    return check(TrainConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}))


def shape_of(weights):
    """The settings of the network in a weight file, checkpoint or run folder."""
    try:
        network = load_network(weights).config
    except (OSError, ValueError) as error:
        raise SystemExit(f"--init: {error}") from error
    return {name: getattr(network, name) for name in NETWORK_SHAPE} | {"resolution": network.resolution[0]}
