"""Command line of a training run on objects: the settings of `config` as options."""

import argparse
import dataclasses
from pathlib import Path

from .arguments import RUN, check_run, parser_of
from .config import NETWORK_SHAPE, PRESETS, TrainConfig, check
from .export import load_network, recommended_options


def parse_arguments(argv, description):
    """Command line -> TrainConfig, device, minutes, workers: preset first, then whatever is given explicitly."""
    parser = parser_of("train", description, RUN, add_help=False)
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
    # argparse leaves the values of a namespace alone: None marks an option that was not given.
    given = vars(parser.parse_args(argv, argparse.Namespace(**dict.fromkeys(NETWORK_SHAPE))))
    values = parser.parse_args(argv)
    check_run(parser, values)
    values = vars(values)
    del values["preset"]
    about_run = [values.pop(name.removeprefix("--")) for name in RUN]
    try:
        config = TrainConfig(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
        config = with_start(config, {name for name in NETWORK_SHAPE if given[name] is not None})
        return check(config), *about_run
    except (OSError, ValueError) as error:
        raise SystemExit(str(error)) from error


def with_start(config, given):
    """The settings with the network's shape, where it is not `given`, and options of the run that goes on, or of `init`."""
    if not config.init:
        return config
    resumed = Path(config.run_dir) / "last.pt"
    start = resumed if resumed.exists() else config.init
    shape = {name: value for name, value in shape_of(start).items() if name not in given}
    options = config.recommended_options or recommended_options(start)
    return dataclasses.replace(config, **shape, recommended_options=options)


def shape_of(weights):
    """The settings of the network in a weight file, checkpoint or run folder."""
    try:
        network = load_network(weights).config
    except (OSError, ValueError) as error:
        raise ValueError(f"init: {error}") from error
    return {name: getattr(network, name) for name in NETWORK_SHAPE} | {"resolution": network.resolution[0]}
