"""Runs a recipe: `python -m snake_training.recipes recipes/scenes.toml --run-dir runs/scenes`. Stages that are done are not done
again, and a training stage goes on from its checkpoint, on this machine or on another to which the run folder was moved.

A recipe is a TOML file of stages in order. Each has a name, a kind, and the settings of its kind:

crops     files: ranges [first seed, number] of files of 25 made crops (`snake_training.data.crops`)
start     init (a weight file, or "" for new weights), crops, seed: layers with the crops' statistics for constants
train     init (a stage), teacher (a stage, or ""), crops, the settings of `snake_training.scenes.SceneTraining`, and at times
          stop, a step before the last
average   of (stages), weights: the weighted mean of their networks
export    of (a stage), output, metadata: the weight file

A path is relative to the recipe's folder, the output to the run folder. `--smoke` runs every stage with next to no work.
"""

import argparse
import json
import sys
import time
from dataclasses import fields
from pathlib import Path

import torch

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib

from .data.crops import Crops, write_part
from .export import load_network, replacing, write_weights
from .scene_model import SceneConfig, SceneNetwork
from .scenes import SceneTraining, Target, started, train

SMOKE = dict(steps=2, batch=1, queries=50, occupancy_queries=20, warmup=1)


def save(folder, network):
    """The stage's result: the network with its scales, as they are trained."""
    with replacing(folder / "network.pt") as temporary:
        torch.save({"config": network.config.to_metadata(), "network": network.state_dict()}, temporary)


def result(folder):
    """The network of a stage that is done."""
    state = torch.load(folder / "network.pt", map_location="cpu", weights_only=True)
    network = SceneNetwork(SceneConfig.from_metadata(state["config"]))
    network.load_state_dict(state["network"])
    return network


class Recipe:
    """A recipe's stages and the folder of their results."""

    KINDS = ("crops", "start", "train", "average", "export")

    def __init__(self, path, run_dir, smoke=False):
        self.base, self.run_dir, self.smoke = Path(path).parent, Path(run_dir), smoke
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
            for key in ("crops", "teacher", "of") + (("init",) if kind == "train" else ()):
                for other in [stage[key]] if isinstance(stage.get(key), str) else stage.get(key, []):
                    if other and other not in seen:
                        raise ValueError(f"{path}: stage {name!r}: no stage {other!r} before it")
            seen.add(name)

    def run(self, log=print):
        """All stages that are not done."""
        for stage in self.stages:
            folder = self.run_dir / stage["name"]
            done = folder / "done.json"
            if done.exists():
                if json.loads(done.read_text())["stage"] != stage:
                    raise ValueError(f"{folder} was made with other settings; delete it, or give another --run-dir")
                continue
            folder.mkdir(parents=True, exist_ok=True)
            began = time.time()
            getattr(self, stage["kind"])(stage, folder, log)
            done.write_text(json.dumps({"stage": stage, "seconds": round(time.time() - began)}))
            log(f"{stage['name']}: {time.time() - began:.0f} s")

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

    def train(self, stage, folder, log):
        """A run of training, from its checkpoint if it has one."""
        crops, settings = Crops(self.run_dir / stage["crops"]), self.settings(stage)
        teacher = result(self.run_dir / stage["teacher"]).eval() if stage.get("teacher") else None
        network = result(self.run_dir / stage["init"]).train()
        target = Target(teacher, crops, settings)
        save(folder, train(folder, crops, settings, network, target, log, stop=stage.get("stop")))

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
        write_weights(path, network.config, network.folded(), torch.float16, stage.get("metadata"))
        load_network(path)
        log(f"{path}: {path.stat().st_size} bytes")


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.recipes",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("recipe", help="the TOML file")
    parser.add_argument("--run-dir", help="folder of the stages' results; default: runs/ and the recipe's name")
    parser.add_argument("--smoke", action="store_true", help="every stage with next to no work, to see that it runs")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    try:
        Recipe(arguments.recipe, arguments.run_dir or f"runs/{Path(arguments.recipe).stem}", arguments.smoke).run()
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
