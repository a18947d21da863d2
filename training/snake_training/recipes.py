"""Runs recipes: `python -m snake_training.recipes recipes/scenes.toml`. Stages that are done are not done again, and a training
stage goes on from its checkpoint, on this machine or on another to which the run folder was moved (`--pack`, `--unpack`).

A recipe is a TOML file of stages in order. Each has a name, a kind, and the settings of its kind:

weights   file (a weight file): a network to go on from
targets   of (stages, the teachers), the options of `snake_training.targets`
train     init and targets (stages), the options of `snake_training.train`, for a network of objects
crops     files: ranges [first seed, number] of files of 25 made crops (`snake_training.data.crops`)
start     init (a weight file, or "" for new weights), crops, seed: layers with the crops' statistics for constants
scenes    init (a stage), teacher (a stage, or ""), crops, the settings of `snake_training.scenes.SceneTraining`, and at times
          stop, a step before the last
average   of (stages), weights: the weighted mean of their networks
export    of (a stage), output, metadata: the weight file
frames    the options of `snake_training.data.frames`: pairs of depth frames of made rooms
drives    the options of `snake_training.data.drives`: pairs of sweeps of made drives
confidence  of (an export), scenes (stages), the options of `snake_training.confidence`: the map in the file, of pairs of
          scenes, or else of the validation data
figures   of (an export), the options of `snake_training.evaluate`: its repeatability on the validation data

A path is relative to the recipe's folder, the output to the run folder. Shapes are procedural; `--data` adds some. `--smoke` runs
every stage with next to no work.
"""

import argparse
import contextlib
import io
import json
import platform
import sys
import time
from dataclasses import fields
from pathlib import Path

import torch

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib

from . import confidence, evaluate, pieces, targets
from .command_line import parse_arguments
from .data import Procedural, drives, frames, write_corpus
from .data.crops import Crops, write_part
from .export import config_of, load_network, network_of, replacing, write_weights
from .scenes import SceneTraining, Target, started
from .scenes import train as train_scenes
from .train import run_steps

SMOKE = dict(steps=2, batch=1, queries=50, occupancy_queries=20, warmup=1)
SMOKE_OF_OBJECTS = dict(
    steps=2, batch=1, resolution=8, num_points=256, num_occupancy=20, num_grids=4, grid_size=3, num_targets=50,
    validation_objects=1, validation_resolution=8,
)  # fmt: skip
SMOKE_OF_TARGETS = dict(procedural=2, rotations=3, queries=200, points=256)
SMOKE_OF_FIGURES = dict(objects=1, num_points=256, query_resolution=8)
SMOKE_OF_FRAMES = dict(pairs=2)
SMOKE_OF_DRIVES = dict(drives=1, sweeps=3)
SMOKE_OF_CONFIDENCE = dict(number=2)


def save(folder, network):
    """The stage's result: the network; of a network of scenes with its scales, as they are trained."""
    with replacing(folder / "network.pt") as temporary:
        torch.save({"config": network.config.to_metadata(), "network": network.state_dict()}, temporary)


def result(folder):
    """The network of a stage that is done."""
    state = torch.load(folder / "network.pt", map_location="cpu", weights_only=True)
    network = network_of(config_of(state["config"]))
    network.load_state_dict(state["network"])
    return network


def command(options):
    """The command line of a stage's options."""
    words = []
    for name, value in options.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
        else:
            words += [f"--{option}", *map(str, value if isinstance(value, (list, tuple)) else [value])]
    return words


def named(stage, key):
    """The stages that a stage names there: none, one or a list."""
    names = stage.get(key, [])
    return [names] if isinstance(names, str) else names


class Recipe:
    """A recipe's stages and the folder of their results."""

    KINDS = (
        "weights", "targets", "train", "crops", "start", "scenes", "average", "export", "frames", "drives", "confidence",
        "figures",
    )  # fmt: skip

    def __init__(self, path, run_dir, smoke=False, data=(), validation_data=()):
        self.base, self.run_dir, self.smoke = Path(path).parent, Path(run_dir), smoke
        self.data, self.validation_data = ([str(Path(folder)) for folder in some] for some in (data, validation_data))
        try:
            self.stages = tomllib.loads(Path(path).read_text())["stages"]
        except (tomllib.TOMLDecodeError, KeyError) as error:
            raise ValueError(f"{path}: not a recipe: {error}") from error
        seen = set()
        for stage in self.stages:
            name, kind = stage.get("name"), stage.get("kind")
            if not name or name in seen or kind not in self.KINDS:
                raise ValueError(
                    f"{path}: stage {name!r} of kind {kind!r}: names differ, kinds are {', '.join(self.KINDS)}"
                )
            for key in ("crops", "teacher", "of", "targets", "scenes") + (() if kind == "start" else ("init",)):
                for other in named(stage, key):
                    if other and other not in seen:
                        raise ValueError(f"{path}: stage {name!r}: no stage {other!r} before it")
            seen.add(name)

    def run(self, log=print):
        """All stages that are not done."""
        for stage in self.stages:
            folder = self.run_dir / stage["name"]
            done = folder / "done.json"
            made = {"stage": stage, "smoke": self.smoke}
            if done.exists():
                if not made.items() <= json.loads(done.read_text()).items():
                    raise ValueError(f"{folder} was made with other settings; delete it, or give another --run-dir")
                continue
            folder.mkdir(parents=True, exist_ok=True)
            began = time.time()
            getattr(self, stage["kind"])(stage, folder, log)
            seconds = round(time.time() - began)
            with replacing(done) as temporary:
                temporary.write_text(json.dumps(made | {"seconds": seconds, "processor": processor()}))
            log(f"{stage['name']}: {seconds} s")

    def options(self, stage, smoke):
        """A stage's own options, as a command line."""
        return command(
            {
                name: value
                for name, value in stage.items()
                if name not in ("name", "kind", "of", "init", "targets", "scenes")
            }
            | (smoke if self.smoke else {})
        )

    def weights(self, stage, folder, log):
        """A network that is there."""
        save(folder, load_network(self.base / stage["file"]))

    def targets(self, stage, folder, log):
        """The teachers' saliency, averaged."""
        teachers = [str(self.run_dir / name / "network.pt") for name in named(stage, "of")]
        with replacing(folder / "targets.safetensors") as temporary:
            paths = [*command({"data": self.data} if self.data else {}), "-o", str(temporary)]
            targets.main([*teachers, *paths, *self.options(stage, SMOKE_OF_TARGETS)])

    def train(self, stage, folder, log):
        """A run of training of a network of objects, from its checkpoint if it has one."""
        added = {"run_dir": folder, "data": self.data, "validation_data": self.validation_data, "device": "cpu"}
        if stage.get("init"):
            added["init"] = self.run_dir / stage["init"] / "network.pt"
        if stage.get("targets"):
            added["targets"] = [self.run_dir / name / "targets.safetensors" for name in stage["targets"]]
        config = parse_arguments(self.options(stage, SMOKE_OF_OBJECTS) + command(added), "")
        run_steps(config)
        save(folder, load_network(folder / "last.pt"))

    def settings(self, stage):
        """The stage's SceneTraining."""
        known = {field.name for field in fields(SceneTraining)}
        unknown = set(stage) - known - {"name", "kind", "init", "teacher", "crops", "stop"}
        if unknown:
            raise ValueError(f"stage {stage['name']!r}: unknown settings {', '.join(sorted(unknown))}")
        given = {name: value for name, value in stage.items() if name in known}
        return SceneTraining(**given | (SMOKE if self.smoke else {}))

    def crops(self, stage, folder, log):
        """Files of crops; those that are there stay."""
        seeds = [first + part for first, number in stage["files"] for part in range(number)]
        for seed in seeds[:1] if self.smoke else seeds:
            path = folder / f"{seed:05d}.npz"
            if not path.exists():
                write_part(path, seed, 4 if self.smoke else 25)
                log(f"{path}: written")

    def start(self, stage, folder, log):
        """Layers with constants."""
        init = stage["init"] and str(self.base / stage["init"])
        save(folder, started(init, Crops(self.run_dir / stage["crops"]), self.settings(stage)))

    def scenes(self, stage, folder, log):
        """A run of training of a network of scenes, from its checkpoint if it has one."""
        crops, settings = Crops(self.run_dir / stage["crops"]), self.settings(stage)
        teacher = result(self.run_dir / stage["teacher"]).eval() if stage.get("teacher") else None
        network = result(self.run_dir / stage["init"]).train()
        target = Target(teacher, crops, settings)
        save(folder, train_scenes(folder, crops, settings, network, target, log, stop=stage.get("stop")))

    def average(self, stage, folder, log):
        """The weighted mean of networks."""
        networks = [result(self.run_dir / name) for name in stage["of"]]
        weights = torch.tensor(stage.get("weights", [1.0] * len(networks)))
        mean = networks[0]
        states = [network.state_dict() for network in networks]
        mean.load_state_dict({
            name: sum(weight * state[name] for weight, state in zip(weights / weights.sum(), states, strict=True))
            for name in states[0]
        })  # fmt: skip
        save(folder, mean)

    def export(self, stage, folder, log):
        """The weight file in float16, read back once."""
        network, path = result(self.run_dir / stage["of"]), self.run_dir / stage["output"]
        tensors = network.folded() if hasattr(network, "folded") else network.state_dict()
        write_weights(path, network.config, tensors, torch.float16, stage.get("metadata"))
        load_network(path)
        log(f"{path}: {path.stat().st_size} bytes")

    def frames(self, stage, folder, log):
        """Depth frames."""
        frames.main(["-o", str(folder), *self.options(stage, SMOKE_OF_FRAMES)])

    def drives(self, stage, folder, log):
        """Sweeps."""
        drives.main(["-o", str(folder), *self.options(stage, SMOKE_OF_DRIVES)])

    def confidence(self, stage, folder, log):
        """The map of confidences in an exported file, and its calibration error, printed and kept."""
        pairs = [str(self.run_dir / name) for name in stage.get("scenes", [])]
        data = command({"pairs": pairs} if pairs else {"objects": self.shapes(folder)})
        self.printed(
            confidence, stage, folder / "confidence.txt", [*data, *self.options(stage, SMOKE_OF_CONFIDENCE)], log
        )

    def figures(self, stage, folder, log):
        """The repeatability of an exported file, printed and kept."""
        options = [self.shapes(folder), *self.options(stage, SMOKE_OF_FIGURES)]
        self.printed(evaluate, stage, folder / "figures.json", options, log)

    def shapes(self, folder):
        """The folder of the validation data, or of procedural shapes."""
        if self.validation_data:
            return self.validation_data[0]
        write_corpus(folder / "shapes", [Procedural()[row] for row in range(2 if self.smoke else 32)], 8192)
        return str(folder / "shapes")

    def printed(self, module, stage, path, options, log):
        """What a command prints about the exported file of a stage."""
        output = next(other["output"] for other in self.stages if other["name"] == stage["of"])
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            module.main([str(self.run_dir / output), *options])
        path.write_text(printed.getvalue())
        log(printed.getvalue().strip())


def processor():
    """The name of this machine's processor, and what PyTorch says of its bfloat16."""
    capabilities = getattr(torch.cpu, "get_capabilities", dict)()
    bfloat16 = [name for name in ("amx_bf16", "avx512_bf16") if capabilities.get(name)]
    return " ".join([str(capabilities.get("cpu_name") or platform.machine()), *bfloat16])


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.recipes",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("recipes", nargs="+", help="TOML files")
    parser.add_argument(
        "--run-dir", default="runs", help="its folder NAME holds the stages of NAME.toml; default: runs"
    )
    parser.add_argument(
        "--data", nargs="*", default=[], help="corpus folders or folders of clouds, beside the procedural ones"
    )
    parser.add_argument("--validation-data", nargs="*", default=[], help="the same for validation and figures")
    parser.add_argument("--smoke", action="store_true", help="every stage with next to no work, to see that it runs")
    moving = parser.add_mutually_exclusive_group()
    moving.add_argument("--pack", metavar="FOLDER", help="only write the run folders there, in pieces below 5 MB")
    moving.add_argument("--unpack", metavar="FOLDER", help="first restore the run folders from such pieces")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    try:
        for path in map(Path, arguments.recipes):
            run_dir = Path(arguments.run_dir) / path.stem
            recipe = Recipe(path, run_dir, arguments.smoke, arguments.data, arguments.validation_data)
            if arguments.pack:
                pieces.pack(run_dir, Path(arguments.pack) / path.stem)
                continue
            if arguments.unpack:
                pieces.unpack(Path(arguments.unpack) / path.stem, run_dir)
            recipe.run()
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
