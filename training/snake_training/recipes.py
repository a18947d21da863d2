"""Runs recipes: `python -m snake_training.recipes recipes/compact.toml`. Stages that are done are not done again, and a training
stage goes on from its checkpoint.

A recipe is a TOML file of stages (`snake_training.stages`) in order. A stage with `like` has the settings of
a stage before it, where it does not give its own. Shapes are procedural; `--data` adds some. `--smoke` runs every stage with next to no
work.
"""

import json
import re
import sys
import time
from pathlib import Path

import torch

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib

from .arguments import RUN, check_run, option, parser_of
from .data import Procedural, write_corpus
from .device import processor
from .export import load_network, replacing, weights_of, write_weights
from .stages import KINDS
from .train import run

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")  # of a stage or of an output: within the run folder, on every system


class TimeSpent(Exception):
    """The minutes of the command are over; its message says how far it came."""


class Recipe:
    """A recipe's stages and the folder of their results. A recipe that cannot run is a ValueError before anything does.

    device, minutes, workers are those of `train.run`; the minutes are of all stages together.
    """

    def __init__(
        self, path, run_dir, smoke=False, data=(), validation_data=(), device="auto", minutes=0.0, workers=0, log=print
    ):  # fmt: skip
        self.path, self.run_dir, self.smoke, self.log = Path(path), Path(run_dir), smoke, log
        self.data, self.validation_data = (tuple(map(str, some)) for some in (data, validation_data))
        self.device, self.workers = device, workers
        self.deadline = time.monotonic() + 60 * minutes if minutes else None
        try:
            self.tables = tomllib.loads(self.path.read_text())["stages"]
            if not isinstance(self.tables, list) or not all(isinstance(table, dict) for table in self.tables):
                raise TypeError("stages is no list of tables")
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: not a recipe: {error}") from error
        self.stages = {}
        for row, table in enumerate(self.tables):
            if "like" in table:
                like = [other for other in self.tables[:row] if other["name"] == table["like"]]
                if not like:
                    raise ValueError(
                        f"{path}: stage {str(table.get('name'))[:40]!r}: no stage {str(table['like'])[:40]!r} before it"
                    )
                table = self.tables[row] = like[0] | {key: value for key, value in table.items() if key != "like"}
            stage = self.stage_of(table)
            self.stages[stage.name] = stage

    def stage_of(self, table):
        """A stage from its table, checked against those before it."""
        name, kind = table.get("name"), table.get("kind")
        is_new = isinstance(name, str) and NAME.fullmatch(name) and name not in self.stages
        if not is_new or not isinstance(kind, str) or kind not in KINDS:
            raise ValueError(
                f"{self.path}: stage {str(name)[:40]!r} of kind {str(kind)[:40]!r}: names differ and are words of letters, digits, "
                f"'_', '.' and '-', kinds are {', '.join(KINDS)}"
            )
        try:
            stage = KINDS[kind].read({key: value for key, value in table.items() if key != "kind"})
        except (ValueError, TypeError) as error:
            raise ValueError(f"{self.path}: stage {name!r}: {error}") from error
        for other in stage.uses():
            if other not in self.stages:
                raise ValueError(f"{self.path}: stage {name!r}: no stage {other!r} before it")
        output = getattr(stage, "output", None)
        if output is not None and (not NAME.fullmatch(output) or output in self.stages):
            raise ValueError(
                f"{self.path}: stage {name!r}: output {output!r} is not the name of a file in the run folder"
            )
        return stage

    def run(self):
        """All stages that are not done. A TimeSpent says that the minutes are over."""
        for stage, table in zip(self.stages.values(), self.tables, strict=True):
            folder = self.run_dir / stage.name
            done = folder / "done.json"
            made = {"stage": table, "smoke": self.smoke}
            if done.exists():
                if not made.items() <= json.loads(done.read_text()).items():
                    raise ValueError(f"{folder} was made with other settings; delete it, or give another --run-dir")
                continue
            self.in_time(stage.name)
            folder.mkdir(parents=True, exist_ok=True)
            began = time.time()
            stage.run(self, folder)
            seconds = round(time.time() - began)
            with replacing(done) as temporary:
                temporary.write_text(json.dumps(made | {"seconds": seconds, "processor": processor()}))
            self.log(f"{stage.name}: {seconds} s")

    def in_time(self, name):
        """The minutes that are left, 0 without a limit. Raises TimeSpent if none are left."""
        left = 0.0 if self.deadline is None else (self.deadline - time.monotonic()) / 60
        if self.deadline is not None and left <= 0:
            raise TimeSpent(f"the minutes are over before {name} is done; the same command goes on")
        return left

    def train(self, task, folder):
        """A run of a task to its last step, then its averaged weights as the stage's result."""
        if not run(task, folder, self.device, self.in_time(folder.name), self.workers):
            raise TimeSpent(f"the minutes are over within {folder.name}; the same command goes on")
        network = load_network(folder / "last.pt")
        write_weights(folder / "weights.safetensors", network.config, weights_of(network))

    def weights(self, name):
        """The weight file of a training stage that is done."""
        return self.run_dir / name / "weights.safetensors"

    def output_of(self, name):
        """The file of an export."""
        return self.run_dir / self.stages[name].output

    def shapes(self, folder):
        """The folder of the validation data, or of procedural shapes."""
        if self.validation_data:
            return self.validation_data[0]
        write_corpus(folder / "shapes", [Procedural()[row] for row in range(2 if self.smoke else 32)], 8192)
        return str(folder / "shapes")

    def keep(self, path, report):
        """A stage's figures, kept and printed."""
        text = json.dumps(report)
        path.write_text(text)
        self.log(text)


def main(argv=None):
    """Command line."""
    arguments = {
        "recipes": dict(nargs="+", help="TOML files"),
        "--run-dir": option("runs", "its folder NAME holds the stages of NAME.toml"),
        "--data": option([], "corpus folders or folders of clouds, beside the procedural ones", str, nargs="*"),
        "--validation-data": option([], "the same for validation and figures", str, nargs="*"),
        "--smoke": dict(action="store_true", help="every stage with next to no work, to see that it runs"),
    }
    parser = parser_of("recipes", __doc__, arguments | RUN)
    given = parser.parse_args(argv)
    check_run(parser, given)
    if given.device != "cuda":
        torch.set_num_threads(1)
    try:
        for path in map(Path, given.recipes):
            run_dir = Path(given.run_dir) / path.stem
            data = given.data, given.validation_data
            recipe = Recipe(path, run_dir, given.smoke, *data, given.device, given.minutes, given.workers)
            try:
                recipe.run()
            except TimeSpent as error:
                print(error)
            except ModuleNotFoundError as error:  # of snake_rs, on a machine that is there for its GPU
                print(f"{error}: the stages that are left need it; the same command goes on where it is installed")
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
