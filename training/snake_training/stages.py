"""The stages of recipes. Each has a name, a kind, and the settings of its kind:

objects   a network of objects: init (a stage), targets (of stages), and the settings of `snake_training.train`
teacher   of (stages) and the settings of `snake_training.teacher`: the targets of a student
crops     files: ranges [first seed, number] of files of 25 made crops (`snake_training.make crops`)
scenes    a network of scenes: init and teacher (stages), crops, and the settings of `config.SceneTraining`
export    of (a stage), output, digest, metadata: the weight file; the digest is that of the released file
frames    pairs, seed, bare: pairs of depth frames of made rooms, or samples of bare ones (`snake_training.make frames`, `bare`)
drives    drives, sweeps, step, seed: pairs of sweeps of made drives (`snake_training.make drives`)
confidence  of (an export), scenes (stages), number, rotations: the map in the file, of pairs of scenes, or else of the
          validation data (`snake_training.confidence`)
figures   of (an export), objects, epsilon, rotations: its repeatability on the validation data beside ISS (`snake_training.evaluation`)
"""

import dataclasses
from dataclasses import dataclass, replace

import torch
from safetensors import safe_open

from . import confidence
from .command_line import with_start
from .config import NETWORK_SHAPE, SceneTraining, TrainConfig, check, from_table
from .data.crops import Crops, write_part
from .data.sensors import write_drives, write_frames
from .data.views import write_bare
from .export import load_network, weights_of, write_weights
from .tasks.objects import Objects
from .tasks.scenes import Scenes
from .teacher import TeacherSettings, make_targets, scales_of

SMOKE_OBJECTS = dict(
    steps=2, batch=1, resolution=8, num_points=256, num_occupancy=20, num_grids=4, grid_size=3, num_targets=50, warmup=1,
    validation_objects=1, validation_resolution=8,
)  # fmt: skip
SMOKE_TEACHER = dict(procedural=2, rotations=3, queries=200, points=256, engine="torch")
SMOKE_SCENES = dict(steps=2, batch=1, queries=50, num_occupancy=20, warmup=1)


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
    given: tuple = ()  # which settings of the network's shape stand in the recipe

    @classmethod
    def read(cls, table):
        own = {"name", "init", "targets"}
        settings = {key: value for key, value in table.items() if key not in own}
        of_the_run = {"run_dir", "data", "split", "validation_data", "validation_split"} & set(settings)
        if of_the_run:
            raise ValueError(f"unknown setting {min(of_the_run)!r}: the command line says where data and runs are")
        config = from_table(TrainConfig, settings)
        stage = from_table(cls, {key: table[key] for key in own & set(table)})
        # The start file is written by an earlier stage, so only check that one is named.
        check(replace(config, init=stage.init))
        return replace(stage, settings=config, given=tuple(name for name in NETWORK_SHAPE if name in settings))

    def run(self, recipe, folder):
        """Trains, from the checkpoint if there is one."""
        init = recipe.weights(self.init) if self.init else ""
        config = replace(
            self.settings, run_dir=str(folder), data=recipe.data, validation_data=recipe.validation_data, init=str(init),
            targets=tuple(str(recipe.run_dir / name / "targets.safetensors") for name in self.targets),
        )  # fmt: skip
        given = {*self.given, "resolution"} if recipe.smoke else set(self.given)
        config = replace(config, **SMOKE_OBJECTS) if recipe.smoke else config
        recipe.train(Objects(check(with_start(config, given))), folder)


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
    """Depth frames, or bare rooms, sampled everywhere."""

    pairs: int = 30
    seed: int = 1
    bare: bool = False

    def run(self, recipe, folder):
        """Clouds and pairs.json."""
        (write_bare if self.bare else write_frames)(folder, 2 if recipe.smoke else self.pairs, self.seed)


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
        pairs = [recipe.run_dir / name for name in (self.scenes[-1:] if recipe.smoke else self.scenes)]
        report = confidence.fit_map(
            recipe.output_of(self.of), "" if pairs else recipe.shapes(folder), pairs, (), 2 if recipe.smoke else self.number,
            rotations=self.rotations,
        )  # fmt: skip
        recipe.keep(folder / "confidence.json", report)


@dataclass(frozen=True, kw_only=True)
class FigureStage(Stage):
    """The repeatability of an exported file, by the options that it recommends."""

    USES = ("of",)
    of: str
    objects: int = 30
    num_points: int = 5000
    epsilon: tuple = (0.02, 0.04, 0.1)
    rotations: int = 1

    def run(self, recipe, folder):
        """Kept as figures.json."""
        from .evaluation.run import repeatability  # with pandas: training does without it
        from .evaluation.tables import pivot

        smoke = dict(limit=1, num_points=256) if recipe.smoke else {}
        given = dict(limit=self.objects, num_points=self.num_points, downsample=(1,), noise=(0,)) | smoke
        weights = f"{recipe.output_of(self.of)}" + (f":rotations={self.rotations}" if self.rotations > 1 else "")
        table = repeatability(recipe.shapes(folder), (weights, "iss"), epsilon=self.epsilon, **given)
        columns = {f"ε {distance:g}": ("repeatability", f"ε {distance:g}") for distance in self.epsilon}
        columns |= {name: (name, "clean") for name in ("coverage", "keypoints")}
        recipe.keep(folder / "figures.json", pivot(table, columns).round(4).to_dict("index"))


KINDS = {
    "objects": ObjectStage, "teacher": TeacherStage, "crops": CropStage, "scenes": SceneStage, "export": ExportStage,
    "frames": FrameStage, "drives": DriveStage, "confidence": ConfidenceStage, "figures": FigureStage,
}  # fmt: skip
