"""The paper's tables from its data, each by one command: `python -m snake_training.paper tab8 tab9 --data data/`.

A command trains, exports and evaluates what its tables need, and prints the paper's figures beside ours. Networks are shared by
the tables. The same command goes on where it stopped. `--dry-run` prints the commands, their samples and hours.
"""

import json
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import torch

from . import export
from .arguments import RUN, check_run, option, parser_of
from .command_line import parse_arguments
from .evaluation.__main__ import evaluate
from .evaluation.tables import kind_of, pivot
from .paper_files import missing
from .paper_tables import ITEMS, SHAPE, TRAINING, Evaluation
from .train import train

TERAFLOPS = 27.0  # a second of an H100 in float32: an estimate, by which the hours are told
SMOKE = (
    "--resolution 8 --unet-levels 2 --unet-base-channels 8 --num-points 64 --num-occupancy 16 --num-grids 4 --grid-size 3 --batch 1 "
    "--steps 2 --validate-every 100 --validation-samples 2 --validation-objects 1 --validation-resolution 6"
)
SMOKE_OF = {
    "repeatability": {"downsample": (1, 8), "noise": (0, 0.02), "limit": 1}, "semantic": {"limit": 1}, "registration": {"limit": 1},
    "detect": "--set query_resolution=12", "view": "--set query_resolution=12", "field": "--resolution 12",
    "reconstruct": "--resolution 12",
}  # fmt: skip
LIST_630 = "keypointnet_test_630.txt"
# The views of figure 6.
DISTURBED = """import numpy as np, snake_rs
from snake_training.evaluation.views import Condition, disturbed
points = snake_rs.read_points({shape!r})
for name, condition in (("thinned", Condition(8)), ("noisy", Condition(noise=0.06))):
    np.save(f"{run}/{{name}}.npy", disturbed(points, condition, np.random.default_rng(0)))"""


class Programme:
    """The tables that are asked for, from folders of data and lists into a folder of runs; a mean is over `seeds` networks. `smoke` does
    everything with next to no work."""

    def __init__(self, names, data, lists, run_dir, seeds=6, smoke=False):
        self.items = {name: ITEMS[name] for name in names}
        self.folders = {"data": str(data), "lists": str(lists), "run": str(run_dir)}
        self.run_dir, self.seeds, self.smoke, self.tables = Path(run_dir), seeds, smoke, {}
        self.commands = list(dict.fromkeys(command for item in self.items.values() for command in commands_of(item)))

    def models(self, commands):
        """The networks of commands with their seeds, each once."""
        wanted = ((c.network, seed) for c in commands for seed in range(1, self.seeds_of(c) + 1))
        return list({(network.name, seed): (network, seed) for network, seed in wanted}.values())

    def seeds_of(self, command):
        """The number of models whose mean the paper's figure is: all seeds, or one."""
        return self.seeds if isinstance(command, Evaluation) and command.seeds else 1

    def folder(self, network, seed):
        """The run of a network."""
        return self.run_dir / network.name / f"seed{seed}"

    def training_words(self, network, seed):
        """The settings of a run, for `snake_training.train`."""
        folder, *lists, _ = TRAINING[network.preset]
        data, (split, validation) = f"{self.folders['data']}/{folder}", lists
        words = ["--preset", network.preset, "--data", data, "--validation-data", data]
        if split:
            at = self.folders["lists"]
            words += ["--split", f"{at}/{split}", "--validation-split", f"{at}/{validation}"]
        words += ["--seed", str(seed), *network.words, *(SMOKE.split() if self.smoke else ())]
        return [*words, "--run-dir", str(self.folder(network, seed))]

    def export_words(self, network, seed):
        """The arguments of `snake_training.export`."""
        folder = self.folder(network, seed)
        return [str(folder), "-o", str(folder / "weights.safetensors")]

    def weights(self, command):
        """The files of a command's networks."""
        seeds = range(1, self.seeds_of(command) + 1)
        return [f"{self.folder(command.network, seed)}/weights.safetensors" for seed in seeds]

    def command_words(self, command):
        """The arguments of snake-cli."""
        words = [*command.words.format(**self.folders).split(), "--model", self.weights(command)[0]]
        given = SMOKE_OF[words[0]].split() if self.smoke else []
        for name, value in zip(given[::2], given[1::2]):
            words += [name, value] if name == "--set" or name not in words else []
        return words

    def evaluation_words(self, command):
        """The arguments of `snake_training.evaluation`."""
        words = [command.kind, command.data.format(**self.folders), "--methods", *self.methods(command)]
        words += () if self.smoke else command.others
        arguments = (SMOKE_OF[command.kind] if self.smoke else {}) | dict(command.arguments)
        for name, value in arguments.items():
            values = value if isinstance(value, tuple) else () if value is True else (value,)
            words += ["--" + name.replace("_", "-"), *(str(one).format(**self.folders) for one in values)]
        return [*words, "-o", str(self.run_dir / "tables" / command.name)]

    def methods(self, command):
        """The words of our networks in an evaluation."""
        options = ",".join(filter(None, (command.options, "query_resolution=12" if self.smoke else "")))
        return [f"{path}:{options}" if options else path for path in self.weights(command)]

    def words(self, command):
        """The whole command line."""
        if isinstance(command, Evaluation):
            return ["python", "-m", "snake_training.evaluation", *self.evaluation_words(command)]
        return ["snake-cli", *self.command_words(command)]

    def missing(self):
        """The files that are not there, each with where it comes from, as lines."""
        return missing(self.commands, [network for network, _ in self.models(self.commands)], self.folders)

    def samples(self, network, seed):
        """How many samples a run has, and how many hours of an H100 they take: an estimate from the operations of both views,
        forwards and backwards."""
        config = parse_arguments(self.training_words(network, seed), "")[0]
        queries = config.num_grids * config.grid_size**3 + 2 * config.num_occupancy
        view = 140.5e9 * (config.resolution / 64) ** 3 + 62e3 * queries
        samples = config.steps * config.batch
        return samples, samples * 6 * view / (TERAFLOPS * 1e12) / 3600

    def steps(self):
        """Each item's name, the networks that it needs and the ones before it do not, and the same of its commands."""
        commands, networks = [], []
        for name, item in self.items.items():
            ours = [command for command in commands_of(item) if command not in commands]
            models = [model for model in self.models(ours) if model not in networks]
            commands, networks = commands + ours, networks + models
            yield name, models, ours

    def describe(self):
        """The commands in order, with samples and hours, as lines."""
        total, number, lines = 0.0, 0, [line for _, line, _ in self.preparations()]
        for name, models, commands in self.steps():
            lines.append(f"# {name}: {self.items[name].title}")
            for network, seed in models:
                samples, hours = self.samples(network, seed)
                total, number = total + hours, number + 1
                lines += [
                    f"# {network.name}, seed {seed}: {samples} samples, about {hours:.1f} hours of an H100",
                    shlex.join(["python", "-m", "snake_training.train", *self.training_words(network, seed)]),
                    shlex.join(["python", "-m", "snake_training.export", *self.export_words(network, seed)]),
                ]
            lines += [shlex.join(self.words(command)) for command in commands]
        return [*lines, f"# {number} networks, about {total:.0f} hours of an H100"]

    def preparations(self):
        """Files that the downloads have in another form: the file, the line of a shell that makes it, and a function that does."""
        names, disturbed = self.run_dir / LIST_630, self.run_dir / "noisy.npy"
        listed = f"{self.folders['lists']}/keypointnet_test_full.txt"
        code = DISTURBED.format(shape=SHAPE.format(**self.folders), run=self.folders["run"])

        def run_code():
            subprocess.run([sys.executable, "-c", code], check=True)

        def write_names():
            lines = Path(listed).read_text(encoding="utf-8-sig").splitlines()
            names.write_text("\n".join(lines[:630]) + "\n")

        steps = (
            (f"{{run}}/{LIST_630}", names, f"head -n 630 {listed} > {names}", write_names),
            ("{run}/noisy.npy", disturbed, f"python -c {shlex.quote(code)}", run_code),
        )
        needed = [str(command) for command in self.commands]
        return [step for named, *step in steps if any(named in text for text in needed)]

    def run(self, snake_cli, device="auto", minutes=0.0, workers=0, log=print):
        """Does what is not done yet, then writes the tables; returns whether the minutes sufficed."""
        deadline = time.monotonic() + 60 * minutes if minutes else None
        self.run_dir.mkdir(parents=True, exist_ok=True)
        for path, _, write in self.preparations():
            if not path.exists():
                write()
        for name, models, commands in self.steps():
            for network, seed in models:
                left = (deadline - time.monotonic()) / 60 if deadline else 0.0
                if (deadline and left <= 0) or not self.train(network, seed, device, left, workers):
                    log(f"the minutes are over before {network.name}, seed {seed}, is done; the same command goes on")
                    return False
            for command in commands:
                if isinstance(command, Evaluation):
                    self.tables[command] = evaluate(self.evaluation_words(command))
                else:
                    subprocess.run([snake_cli, *self.command_words(command)], check=True, stdout=subprocess.DEVNULL)
            if self.items[name].cells:
                text = "\n".join([f"{name}: {self.items[name].title}", "", *self.rows(self.items[name])]) + "\n"
                (self.run_dir / f"{name}.md").write_text(text)
                log(text)
        return True

    def train(self, network, seed, device, minutes, workers):
        """Trains a network to its weight file; returns whether it is done. Another run's folder is a ValueError."""
        folder, words = self.folder(network, seed), self.training_words(network, seed)
        given = folder / "words.json"
        if given.exists() and json.loads(given.read_text()) != words[:-2]:  # without the folder itself
            raise ValueError(f"{folder} was trained with other settings; delete it, or give another --run-dir")
        if (folder / "weights.safetensors").exists():
            return True
        folder.mkdir(parents=True, exist_ok=True)
        given.write_text(json.dumps(words[:-2]))
        is_done = train(parse_arguments(words, "")[0], device, minutes, workers)
        if is_done:
            export.main(self.export_words(network, seed))
        return is_done

    def rows(self, item):
        """The rows of a table of Markdown: the paper's figure beside ours, the mean over several models with its deviation."""
        rows = []
        for cell in item.cells:
            table = self.tables[cell.command]
            means = pivot(table[table["metric"] == cell.metric])
            of = " d3feat" if cell.command.kind == "registration" else ""
            ours = means.loc[[f"{method}{of}" for method in self.methods(cell.command)]]
            theirs = means.loc[f"snake{of} (paper)"] if f"snake{of} (paper)" in means.index else {}
            label = cell.command.name.rpartition("/")[2]
            for condition in means.columns if cell.paper is None else [cell.condition]:
                if cell.paper is None and (kind_of(condition)[0] != cell.condition or ours[condition].isna().any()):
                    continue
                paper = cell.paper if cell.paper is not None else theirs.get(condition, float("nan"))
                spread = f" ±{ours[condition].std():.3f}" if len(ours) > 1 else ""
                figures = "-" if pd.isna(paper) else f"{paper:g}", f"{ours[condition].mean():.3f}{spread}"
                rows.append(f"| {label}: {condition} | {' | '.join(figures)} |")
        return ["| | paper | ours |", "|---|---|---|", *rows]


def commands_of(item):
    """The commands of an item, each once."""
    return list(dict.fromkeys([*(cell.command for cell in item.cells), *item.pictures]))


def main(argv=None):
    """Command line."""
    tables = "\n".join(f"  {name:9} {item.title}" for name, item in ITEMS.items())
    arguments = {
        "tables": dict(nargs="*", metavar="TABLE", help="tables and figures, see below"),
        "--all": dict(action="store_true", help="all of them"),
        "--data": dict(required=True, help="the folder of data, as in the authors' repository"),
        "--lists": dict(help="the folder of the authors' lists; default: split in that of --data"),
        "--run-dir": option("runs/paper", "folder of networks, tables and pictures"),
        "--seeds": option(6, "networks of tables 6 to 13, whose figures are means"),
        "--snake-cli": option("snake-cli", "the program that draws"),
        "--dry-run": dict(action="store_true", help="print the commands, their samples and hours, and end"),
        "--smoke": dict(action="store_true", help="everything with next to no work, to see that it runs"),
    }
    parser = parser_of("paper", __doc__, arguments | RUN, epilog=f"tables and figures:\n{tables}")
    given = parser.parse_args(argv)
    check_run(parser, given)
    names = list(ITEMS) if given.all else given.tables
    unknown = [name for name in names if name not in ITEMS]
    if unknown or not names:
        parser.error(f"{' '.join(unknown) or 'no table'}: give some of {', '.join(ITEMS)}, or --all")
    if given.seeds < 1:
        parser.error("--seeds must be 1 or more")
    lists = given.lists or f"{given.data}/split"
    programme = Programme(names, given.data, lists, given.run_dir, given.seeds, given.smoke)
    if given.dry_run:
        print("\n".join(programme.describe()))
        return
    absent = programme.missing()
    if any(item.pictures for item in programme.items.values()) and not shutil.which(given.snake_cli):
        absent.append(f"{given.snake_cli}: the program of the command line is not in PATH; give --snake-cli")
    if absent:
        sys.exit("missing:\n" + "\n".join(absent))
    if given.device != "cuda":
        torch.set_num_threads(1)
    try:
        programme.run(given.snake_cli, given.device, given.minutes, given.workers)
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    except subprocess.CalledProcessError as error:
        sys.exit(f"{shlex.join(map(str, error.cmd))}: ended with status {error.returncode}")


if __name__ == "__main__":
    main()
