"""Makes the parsers of all command lines of this package."""

import argparse

DATA = {"data": dict(help="corpus folder, or folder of clouds and meshes")}
MODEL = {"--model": dict(default="compact", help="built-in model, or weight file")}
RUN = {
    "--device": dict(default="auto", choices=("auto", "cpu", "cuda"), help="torch device"),
    "--minutes": dict(default=0.0, type=float, help="stop with a checkpoint after so many, to be resumed; 0: never"),
    "--workers": dict(default=0, type=int, help="processes that draw batches ahead; 0: none, best on a CPU"),
}


class Help(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    """The description as it stands, and the default of each option that has one."""

    def _get_help_string(self, action):
        has_none = action.default is False or action.default in (None, (), [])
        return action.help if has_none else super()._get_help_string(action)


def option(default, meaning, kind=None, **words):
    """The words of an option with a default; its type is that of the default, or `kind`."""
    return dict(default=default, type=kind or type(default), help=meaning) | words


def add(parser, arguments):
    """Adds arguments to a parser, from their names and words."""
    for name, words in arguments.items():
        parser.add_argument(name, **words)
    return parser


def parser_of(module, description, arguments, **words):
    """The parser of `python -m snake_training.MODULE`, with its arguments by name."""
    words = {"prog": f"python -m snake_training.{module}", "formatter_class": Help} | words
    return add(argparse.ArgumentParser(description=description, **words), arguments)


def check_run(parser, given):
    """Refuses a negative number of minutes or workers."""
    if not (given.minutes >= 0 and given.workers >= 0):
        parser.error("--minutes and --workers must be 0 or more")
