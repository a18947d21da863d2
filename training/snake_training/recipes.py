"""Runs recipes: `python -m snake_training.recipes recipes/compact.toml`. Stages that are done are not done again, and a training
stage goes on from its checkpoint, on this machine or, by its weights alone, on another (`--pack`, `--unpack`).

A recipe is a TOML file of stages in order. Each has a name, a kind, and the settings of its kind:

objects   a network of objects: init (a stage), targets (of stages), share (of the time, see `--later`; 1: all that is left), and the settings of
          `snake_training.train`
choice    of (stages of objects), objects: the best at equal coverage; what begins with it has its sparsity_ridge too
teacher   of (stages) and the settings of `snake_training.teacher`: the targets of a student
crops     files: ranges [first seed, number] of files of 25 made crops (`snake_training.make crops`)
scenes    a network of scenes: init and teacher (stages), crops, and the settings of `config.SceneTraining`
export    of (a stage), output, digest, metadata: the weight file; the digest is that of the released file
frames    pairs, seed: pairs of depth frames of made rooms (`snake_training.make frames`)
drives    drives, sweeps, step, seed: pairs of sweeps of made drives (`snake_training.make drives`)
confidence  of (an export), scenes (stages), number, rotations: the map in the file, of pairs of scenes, or else of the
          validation data (`snake_training.confidence`)
figures   of (an export), objects, epsilon, rotations: its repeatability on the validation data (`snake_training.evaluate`)

A stage with `like` has the settings of a stage before it, where it does not give its own. Shapes are procedural; `--data` adds some. `--smoke` runs every stage with next to no work.
"""

import dataclasses
import json
import re
import shutil
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors import safe_open

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib

from . import choice, confidence, evaluate, moving
from .arguments import RUN, check_run, option, parser_of
from .command_line import with_start
from .config import NETWORK_SHAPE, SceneTraining, TrainConfig, check, from_table
from .data import Procedural, open_shapes, write_corpus
from .data.crops import Crops, write_part
from .data.sensors import write_drives, write_frames
from .device import choose_device, processor
from .export import Moved, load_network, replacing, weights_of, write_weights
from .tasks.objects import Objects
from .tasks.scenes import Scenes
from .teacher import TeacherSettings, make_targets, scales_of
from .train import run

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")  # of a stage or of an output: within the run folder, on every system
SMOKE_OBJECTS = dict(
    steps=2, batch=1, resolution=8, num_points=256, num_occupancy=20, num_grids=4, grid_size=3, num_targets=50, warmup=1,
    validation_objects=1, validation_resolution=8,
)  # fmt: skip
SMOKE_TEACHER = dict(procedural=2, rotations=3, queries=200, points=256, engine="torch")
RESERVE = 0.4  # minutes that training by the time leaves to validation and export
SMOKE_SCENES = dict(steps=2, batch=1, queries=50, num_occupancy=20, warmup=1)


class TimeSpent(Exception):
    """The minutes of the command are over; its message says how far it came."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A step of a recipe. Fields that name other stages are in `USES`; `SETTINGS` is the class of further keys, if any."""

    USES = ()
    SETTINGS = None
    name: str
    settings: object = None

    @classmethod
    def read(cls, table):
        """A stage from its table of TOML; an unknown key is a ValueError."""
        own = {field.name for field in dataclasses.fields(cls)} - {"settings"}
        mine = {key: value for key, value in table.items() if key in own or not cls.SETTINGS}
        if cls.SETTINGS:
            others = {key: value for key, value in table.items() if key not in own}
            mine["settings"] = cls.settings_of(others)
        return from_table(cls, mine)

    @classmethod
    def settings_of(cls, table):
        """The further settings."""
        return from_table(cls.SETTINGS, table)

    def uses(self):
        """The names of the earlier stages that it needs."""
        named = (getattr(self, key) for key in self.USES)
        return [name for some in named for name in ([some] if isinstance(some, str) else some) if name]


@dataclass(frozen=True, kw_only=True)
class ObjectStage(Stage):
    """Training of a network of objects."""

    USES = "init", "targets"
    SETTINGS = TrainConfig
    init: str = ""
    targets: tuple = ()
    share: float = (
        0.0  # with `later`: of the minutes of both calls, 1: of all that are left; else it ends with its steps
    )
    given: tuple = ()  # which settings of the network's shape stand in the recipe

    @classmethod
    def read(cls, table):
        own = {"name", "init", "targets", "share"}
        settings = {key: value for key, value in table.items() if key not in own}
        of_the_run = {"run_dir", "data", "split", "validation_data", "validation_split"} & set(settings)
        if of_the_run:
            raise ValueError(f"unknown setting {min(of_the_run)!r}: the command line says where data and runs are")
        config = from_table(TrainConfig, settings)
        stage = from_table(cls, {key: table[key] for key in own & set(table)})
        if not 0 <= stage.share <= 1:
            raise ValueError(f"share must be within [0, 1], got {stage.share}")
        # The start file is written by an earlier stage, so only check that one is named.
        check(replace(config, init=stage.init))
        return replace(stage, settings=config, given=tuple(name for name in NETWORK_SHAPE if name in settings))

    def run(self, recipe, folder):
        """Trains, from the checkpoint if there is one."""
        moved = folder / Moved.NAME
        init = moved if moved.exists() else recipe.weights(self.init) if self.init else ""
        config = replace(
            self.settings, run_dir=str(folder), data=recipe.data, validation_data=recipe.validation_data, init=str(init),
            targets=tuple(str(recipe.run_dir / name / "targets.safetensors") for name in self.targets),
        )  # fmt: skip
        if isinstance(recipe.stages.get(self.init), ChoiceStage):
            config = replace(config, sparsity_ridge=recipe.chosen(self.init).settings.sparsity_ridge)
        given = {*self.given, "resolution"} if recipe.smoke else set(self.given)
        config = replace(config, **SMOKE_OBJECTS) if recipe.smoke else config
        recipe.train(Objects(check(with_start(config, given))), folder, self.share)


@dataclass(frozen=True, kw_only=True)
class ChoiceStage(Stage):
    """The best of several networks of objects."""

    USES = ("of",)
    of: tuple
    objects: int = 24

    def run(self, recipe, folder):
        """The weights of the best; its name and the figures of all stand in done.json, which moves with them."""
        device, shapes = choose_device(recipe.device), open_shapes(recipe.shapes(folder))
        objects, weights = 1 if recipe.smoke else self.objects, {name: recipe.weights(name) for name in self.of}
        judged = {name: choice.judge(load_network(path, device), shapes, objects) for name, path in weights.items()}
        best = max(judged, key=lambda name: judged[name]["score"])
        shutil.copyfile(recipe.weights(best), folder / "weights.safetensors")
        recipe.log(json.dumps({"best": best, "judged": judged}))
        return {"best": best, "judged": judged}


@dataclass(frozen=True, kw_only=True)
class TeacherStage(Stage):
    """The targets of a student."""

    USES = ("of",)
    SETTINGS = TeacherSettings
    of: tuple

    def __post_init__(self):
        scales_of(self.settings, len(self.of))

    def run(self, recipe, folder):
        """The shapes of the data and procedural ones."""
        settings = replace(self.settings, **SMOKE_TEACHER) if recipe.smoke else self.settings
        device = recipe.device if recipe.device != "auto" else "cpu"
        settings = replace(settings, engine="torch") if device == "cuda" else settings
        weights = [recipe.weights(name) for name in self.of]
        make_targets(folder / "targets.safetensors", weights, recipe.data, settings, device, recipe.workers)


@dataclass(frozen=True, kw_only=True)
class CropStage(Stage):
    """Made crops for networks of scenes."""

    files: tuple

    def __post_init__(self):
        pairs = [
            pair for pair in self.files if isinstance(pair, list) and [type(value) for value in pair] == [int, int]
        ]
        if len(pairs) != len(self.files) or min((value for pair in pairs for value in pair), default=0) < 1:
            raise ValueError(
                f"files must be pairs of a first seed and a number, both 1 or more, got {list(self.files)}"
            )

    def run(self, recipe, folder):
        """Writes the files that are not there yet."""
        seeds = [first + part for first, number in self.files for part in range(number)]
        for seed in seeds[:1] if recipe.smoke else seeds:
            path = folder / f"{seed:05d}.npz"
            if not path.exists():
                recipe.in_time(self.name)
                write_part(path, seed, 4 if recipe.smoke else 25)
                recipe.log(f"{path}: written")


@dataclass(frozen=True, kw_only=True)
class SceneStage(Stage):
    """Training of a network of scenes."""

    USES = "init", "teacher", "crops"
    SETTINGS = SceneTraining
    init: str = ""
    teacher: str = ""
    crops: str

    @classmethod
    def settings_of(cls, table):
        return check(from_table(SceneTraining, table))

    def run(self, recipe, folder):
        """Trains, from the checkpoint if there is one."""
        settings = replace(self.settings, **SMOKE_SCENES) if recipe.smoke else self.settings
        init, teacher = (name and load_network(recipe.weights(name)) for name in (self.init, self.teacher))
        recipe.train(Scenes(settings, Crops(recipe.run_dir / self.crops), init or None, teacher or None), folder)


@dataclass(frozen=True, kw_only=True)
class ExportStage(Stage):
    """The weight file in float16, read back once. Its digest is compared with the one that the recipe states."""

    USES = ("of",)
    of: str
    output: str
    digest: str = ""
    metadata: dict = dataclasses.field(default_factory=dict)

    def run(self, recipe, folder):
        """Writes the file, and says whether it is the released one, if the recipe states that one's digest."""
        path = recipe.run_dir / self.output
        network = load_network(recipe.weights(self.of))
        write_weights(path, network.config, weights_of(network), torch.float16, self.metadata)
        load_network(path)
        with safe_open(path, "pt") as file:
            digest = file.metadata()["digest"]
        note = ", that of the released file" if digest == self.digest else ", other than that of the released file"
        recipe.log(f"{path}: {path.stat().st_size} bytes, digest {digest}{note if self.digest else ''}")


@dataclass(frozen=True, kw_only=True)
class FrameStage(Stage):
    """Depth frames."""

    pairs: int = 30
    seed: int = 1

    def run(self, recipe, folder):
        """Clouds and pairs.json."""
        write_frames(folder, 2 if recipe.smoke else self.pairs, self.seed)


@dataclass(frozen=True, kw_only=True)
class DriveStage(Stage):
    """Sweeps of drives."""

    drives: int = 10
    sweeps: int = 3
    step: float = 6.0
    seed: int = 1

    def run(self, recipe, folder):
        """Clouds and pairs.json."""
        write_drives(folder, 1 if recipe.smoke else self.drives, self.sweeps, self.step, self.seed)


@dataclass(frozen=True, kw_only=True)
class ConfidenceStage(Stage):
    """The map of confidences in an exported file, and its calibration error."""

    USES = "of", "scenes"
    of: str
    scenes: tuple = ()
    number: int = 200
    rotations: tuple = (1,)

    def run(self, recipe, folder):
        """Kept as confidence.json."""
        pairs = [recipe.run_dir / name for name in self.scenes]
        report = confidence.fit_map(
            recipe.output_of(self.of), "" if pairs else recipe.shapes(folder), pairs, (), 2 if recipe.smoke else self.number,
            rotations=self.rotations,
        )  # fmt: skip
        recipe.keep(folder / "confidence.json", report)


@dataclass(frozen=True, kw_only=True)
class FigureStage(Stage):
    """The repeatability of an exported file."""

    USES = ("of",)
    of: str
    objects: int = 30
    num_points: int = 5000
    epsilon: tuple = (0.02, 0.04, 0.1)
    rotations: int = 1

    def run(self, recipe, folder):
        """Kept as figures.json."""
        smoke = dict(objects=1, num_points=256) if recipe.smoke else {}
        given = dict(objects=self.objects, num_points=self.num_points, epsilon=self.epsilon) | smoke
        weights, shapes = str(recipe.output_of(self.of)), recipe.shapes(folder)
        report = evaluate.figures(weights, shapes, engine="snake-rs", rotations=self.rotations, **given)
        recipe.keep(folder / "figures.json", report)


KINDS = {
    "objects": ObjectStage, "choice": ChoiceStage, "teacher": TeacherStage, "crops": CropStage, "scenes": SceneStage, "export": ExportStage,
    "frames": FrameStage, "drives": DriveStage, "confidence": ConfidenceStage, "figures": FigureStage,
}  # fmt: skip


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
