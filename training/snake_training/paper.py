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

import torch

from . import body_model, export
from .arguments import RUN, check_run, option, parser_of
from .command_line import parse_arguments
from .paper_files import missing
from .paper_tables import ITEMS, TRAINING
from .train import train

TERAFLOPS = 27.0  # a second of an H100 in float32: an estimate, by which the hours are told
SMOKE = (
    "--resolution 8 --unet-levels 2 --unet-base-channels 8 --num-points 64 --num-occupancy 16 --num-grids 4 --grid-size 3 --batch 1 "
    "--steps 2 --validate-every 100 --validation-samples 2 --validation-objects 1 --validation-resolution 6"
)
SMOKE_OF = {
    "repeatability": "--methods snake --downsample 1,8 --noise 0,0.02 --limit 1 --set query_resolution=12",
    "semantic": "--methods snake --limit 1 --set query_resolution=12",
    "registration": "--detectors snake --limit 1 --set query_resolution=12",
    "detect": "--set query_resolution=12", "view": "--set query_resolution=12", "field": "--resolution 12",
    "reconstruct": "--resolution 12",
}  # fmt: skip
LIST_630 = "keypointnet_test_630.txt"


class Programme:
    """The tables that are asked for, from folders of data and lists into a folder of runs; a mean is over `seeds` networks. `smoke` does
    everything with next to no work."""

    def __init__(self, names, data, lists, run_dir, seeds=6, smoke=False):
        self.items = {name: ITEMS[name] for name in names}
        self.folders = {"data": str(data), "lists": str(lists), "run": str(run_dir)}
        self.run_dir, self.seeds, self.smoke = Path(run_dir), seeds, smoke
        self.commands = list(dict.fromkeys(command for item in self.items.values() for command in commands_of(item)))

    def models(self, commands):
        """The networks of commands with their seeds, each once."""
        wanted = ((c.network, seed) for c in commands for seed in range(1, self.seeds_of(c) + 1))
        return list({(network.name, seed): (network, seed) for network, seed in wanted}.values())

    def seeds_of(self, command):
        """The number of models whose mean the paper's figure is: all seeds, or one."""
        return self.seeds if command.seeds else 1

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

    def command_words(self, command):
        """The arguments of snake-cli."""
        words = [word.format(**self.folders) for word in command.words.split()]
        files = [
            f"{self.folder(command.network, seed)}/weights.safetensors" for seed in range(1, self.seeds_of(command) + 1)
        ]
        words += ["--model", files[0]] if len(files) == 1 else ["--models", ",".join(files)]
        kind = words[1] if words[0] == "eval" else words[0]
        if words[0] == "eval":
            words += ["-o", str(self.tables_of(command))]
        given = SMOKE_OF[kind].split() if self.smoke else []
        for name, value in zip(given[::2], given[1::2]):
            words += [name, value] if name == "--set" or name not in words else []
        return words

    def tables_of(self, command):
        """The folder of an evaluation's tables, which depend on the number of models."""
        return self.run_dir / "tables" / command.name / (f"seeds{self.seeds}" if command.seeds else "")

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
            lines += [shlex.join(["snake-cli", *self.command_words(command)]) for command in commands]
        return [*lines, f"# {number} networks, about {total:.0f} hours of an H100"]

    def preparations(self):
        """Files that the downloads have in another form: the file, the line of a shell that makes it, and a function that does."""
        lists, bodies = Path(self.folders["lists"]), Path(self.folders["data"]) / "smpl_model"
        names, made = self.run_dir / LIST_630, self.run_dir / "smpl_bodies"
        model = made / "model.npz"

        copy_bodies = f"mkdir -p {made} && cp {bodies}/*_test_100.npy {made} && "
        copy_bodies += f"python -m snake_training.body_model {bodies}/model.pkl {model}"

        def write_names():
            lines = (lists / "keypointnet_test_full.txt").read_text(encoding="utf-8-sig").splitlines()
            names.write_text("\n".join(lines[:630]) + "\n")

        def write_bodies():
            made.mkdir(exist_ok=True)
            for file in ("pose_test_100.npy", "beta_test_100.npy"):
                shutil.copy(bodies / file, made / file)
            body_model.main([str(bodies / "model.pkl"), str(model)])

        steps = (
            ("{run}/keypointnet_test_630.txt", names, f"head -n 630 {lists}/keypointnet_test_full.txt > {names}", write_names),
            (
                "{run}/smpl_bodies", model, copy_bodies, write_bodies,
            ),
        )  # fmt: skip
        return [step for named, *step in steps if any(named in command.words for command in self.commands)]

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
        """The rows of a table of Markdown: the paper's figure beside ours, with its deviation if it is of several models."""
        rows = []
        for cell in item.cells:
            ours, paper = snake_rows(self.tables_of(cell.command), cell.table)
            label = cell.command.name.rpartition("/")[2]
            for column in [cell.column] if cell.column else ours:
                figure = ours[column] if self.seeds_of(cell.command) > 1 else ours[column].partition(" ±")[0]
                theirs = paper.get(column, "-") if cell.paper is None else f"{cell.paper:g}"
                rows.append(f"| {label}: {column} | {theirs} | {figure} |")
        return ["| | paper | ours |", "|---|---|---|", *rows]


def commands_of(item):
    """The commands of an item, each once."""
    return list(dict.fromkeys([*(cell.command for cell in item.cells), *item.pictures]))


def snake_rows(folder, table):
    """The figures of our network and of the paper's by column, of a table that snake-cli wrote, without counts."""
    (path,) = folder.glob("*.md")
    groups = [group for group in path.read_text().split("\n\n") if group.startswith("|")]
    head, _, *rows = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in groups[table].splitlines() if line[0] == "|"
    )
    columns = [column for column, name in enumerate(head) if column and name not in ("keypoints", "coverage")]
    ours, paper = (
        [row for row in rows if row[0].startswith("snake") and row[0].endswith("(paper)") == is_paper]
        for is_paper in (0, 1)
    )
    return tuple({head[column]: some[0][column] for column in columns} if some else {} for some in (ours, paper))


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
        "--snake-cli": option("snake-cli", "the program that evaluates"),
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
    if not shutil.which(given.snake_cli):
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
