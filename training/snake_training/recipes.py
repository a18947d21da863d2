"""Runs recipes: `python -m snake_training.recipes recipes/compact.toml`. Stages that are done are not done again, and a training
stage goes on from its checkpoint, on this machine or, by its weights alone, on another (`--pack`, `--unpack`).

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

from . import moving
from .arguments import RUN, check_run, option, parser_of
from .data import Procedural, write_corpus
from .device import processor
from .export import Moved, load_network, replacing, weights_of, write_weights
from .stages import KINDS, ChoiceStage, ObjectStage, SceneStage
from .train import run

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")  # of a stage or of an output: within the run folder, on every system
RESERVE = 0.4  # minutes that training by the time leaves to the validation and the stages after it


class TimeSpent(Exception):
    """The minutes of the command are over; its message says how far it came."""


class Recipe:
    """A recipe's stages and the folder of their results. A recipe that cannot run is a ValueError before anything does.

    device, minutes, workers, later are those of `train.run`; the minutes are of all stages together.
    """

    def __init__(
        self, path, run_dir, smoke=False, data=(), validation_data=(), device="auto", minutes=0.0, workers=0, later=None, log=print
    ):  # fmt: skip
        self.path, self.run_dir, self.smoke, self.log = Path(path), Path(run_dir), smoke, log
        self.data, self.validation_data = (tuple(map(str, some)) for some in (data, validation_data))
        self.device, self.workers, self.minutes, self.later = device, workers, minutes, later
        if later is not None and not (later >= 0 and minutes > 0):
            raise ValueError(f"later must be 0 minutes or more, beside minutes of this call, got {later} and {minutes}")
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
            report = stage.run(self, folder) or {}
            seconds = round(time.time() - began)
            with replacing(done) as temporary:
                temporary.write_text(json.dumps(made | {"seconds": seconds, "processor": processor()} | report))
            self.log(f"{stage.name}: {seconds} s")

    def unneeded(self):
        """The names of the stages whose results no stage reads any more, also not on another machine, where only training moves."""
        names = set()
        for name in reversed(self.stages):
            readers = [stage for stage in self.stages.values() if name in stage.uses()]
            if readers and all(stage.name in names or self.has_read(stage, name) for stage in readers):
                names.add(name)
        return names

    def has_read(self, stage, name):
        """Whether a training stage or a choice no longer needs another one: it is done, or has weights of its own and began with that one's."""
        has = [(self.run_dir / stage.name / file).exists() for file in ("done.json", "last.pt", Moved.NAME)]
        trains = isinstance(stage, ObjectStage | SceneStage) and (has[0] or (stage.init == name and any(has)))
        return trains or (isinstance(stage, ChoiceStage) and has[0])

    def in_time(self, name):
        """The minutes that are left, 0 without a limit. Raises TimeSpent if none are left."""
        left = 0.0 if self.deadline is None else (self.deadline - time.monotonic()) / 60
        if self.deadline is not None and left <= 0:
            raise TimeSpent(f"the minutes are over before {name} is done; the same command goes on")
        return left

    def train(self, task, folder, share=0.0):
        """A run of a task to its last step, or through its share of the time, then its averaged weights as the stage's result."""
        minutes, later = self.in_time(folder.name), None
        if share and self.later is not None:
            minutes = max(minutes - RESERVE, 1e-9)
            whole = minutes + self.later if share == 1 else share * (self.minutes + self.later)
            minutes = min(minutes, whole)
            later = whole - minutes
        is_done = run(task, folder, self.device, minutes, self.workers, later)
        network = load_network(folder / "last.pt")
        if not is_done:
            raise TimeSpent(f"the minutes are over within {folder.name}; the same command goes on")
        write_weights(folder / "weights.safetensors", network.config, weights_of(network))

    def chosen(self, name):
        """The stage that a choice took."""
        return self.stages[json.loads((self.run_dir / name / "done.json").read_text())["best"]]

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
        "--later": dict(
            type=float,
            metavar="MINUTES",
            help="the time is this call's and so much of a later one: stages with a share end by it, the "
            "learning rate falling to 0",
        ),
        "--unpack": dict(metavar="FOLDER", help="first take up what another machine packed there"),
        "--pack": dict(metavar="FOLDER", help="at the end write there what moves to another machine, in pieces"),
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
            recipe = Recipe(path, run_dir, given.smoke, *data, given.device, given.minutes, given.workers, given.later)
            if given.unpack:
                moving.unpack(Path(given.unpack) / path.stem, run_dir)
            try:
                recipe.run()
            except TimeSpent as error:
                print(error)
            except ModuleNotFoundError as error:  # of snake_rs, on a machine that is there for its GPU
                print(f"{error}: the stages that are left need it; the same command goes on where it is installed")
            if given.pack and run_dir.is_dir():
                moving.pack(run_dir, Path(given.pack) / path.stem, recipe.unneeded())
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
