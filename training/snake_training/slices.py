"""Training in slices of minutes on a machine that keeps nothing in between: `python -m snake_training.slices --help`.

`pack` puts all that a run needs into one small tar, `train` there trains from it and leaves the checkpoint as files of at
most 16 MB, `join` makes them the run's last checkpoint again; then the next slice can be packed.
"""

import argparse
import hashlib
import io
import json
import os
import sys
import tarfile
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file

from .command_line import parse_arguments
from .config import from_json, to_json
from .data import Mixture, open_shapes, write_corpus
from .export import load_network, read_checkpoint, replacing, write_weights
from .targets import FORMAT, Targets
from .train import train

MEGABYTE = 1_000_000
PART = 16 * MEGABYTE
EXAMPLES = """
On your machine, on the other one, and on yours again:
  python -m snake_training.slices pack slice.tar -- --run-dir runs/mine --data my_clouds/ --validation-data others/
  tar xf slice.tar && cd slice && python -m snake_training.slices train --minutes 25 -o ../out
  python -m snake_training.slices join out/ --run-dir runs/mine
The other machine needs Python with torch, numpy, safetensors and tqdm."""


def shrink(state):
    """A checkpoint at about three fifths of its size: the averaged weights as the float16 difference from the network's,
    Adam's moments as bfloat16. The network's own weights keep every bit."""
    average = {name: (value - state["network"][name]).half() for name, value in state["ema"].items()}
    return state | {"ema": average, "optimizer": cast_moments(state["optimizer"], torch.bfloat16)}


def expand(state):
    """The checkpoint of a shrunk one."""
    average = {name: state["network"][name] + value.float() for name, value in state["ema"].items()}
    return state | {"ema": average, "optimizer": cast_moments(state["optimizer"], torch.float32)}


def cast_moments(optimizer, dtype):
    """The state of an optimiser with its moments, not its step counts, as `dtype`."""
    cast = {
        index: {name: value if name == "step" else value.to(dtype) for name, value in entry.items()}
        for index, entry in optimizer["state"].items()
    }
    return optimizer | {"state": cast}


def write_parts(folder, state):
    """A checkpoint as checkpoint.000, .001 … of at most 16 MB each, and checkpoint.json with step and digest."""
    buffer = io.BytesIO()
    torch.save(shrink(state), buffer)
    data = buffer.getvalue()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    parts = [f"checkpoint.{index:03}" for index in range(-(-len(data) // PART))]
    for index, name in enumerate(parts):
        (folder / name).write_bytes(data[index * PART : (index + 1) * PART])
    manifest = {"step": state["step"], "parts": parts, "sha256": hashlib.sha256(data).hexdigest()}
    with replacing(folder / "checkpoint.json") as temporary:
        temporary.write_text(json.dumps(manifest, indent=1))


def read_parts(folder):
    """Inverse of `write_parts`; a missing or damaged part is a ValueError."""
    folder = Path(folder)
    try:
        manifest = json.loads((folder / "checkpoint.json").read_text())
        data = b"".join((folder / Path(name).name).read_bytes() for name in manifest["parts"])
        whole = hashlib.sha256(data).hexdigest() == manifest["sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder}: not the output of `slices train`: {error}") from error
    if not whole:
        raise ValueError(f"{folder}: its checkpoint parts are not those that checkpoint.json names; copy them again")
    return expand(torch.load(io.BytesIO(data), map_location="cpu", weights_only=True))


def pack(output, config, megabytes):
    """Write a tar with code, configuration, checkpoint and as many of the run's shapes as fit into `megabytes`.

    Each slice draws its shapes anew, seeded by the run's step, so that over several slices all are seen. Returns
    {"step", "shapes", "of"}.
    """
    last = Path(config.run_dir) / "last.pt"
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary) / "slice"
        code = root / "snake_training"
        (code / "data").mkdir(parents=True)
        for source in Path(__file__).parent.rglob("*.py"):
            (code / source.relative_to(Path(__file__).parent)).write_bytes(source.read_bytes())
        step, packed = 0, replace(config, run_dir="run", init="", data=(), validation_data=(), targets=())
        if last.exists():
            state = torch.load(last, map_location="cpu", weights_only=True)
            step = state["step"]
            write_parts(root / "checkpoint", state)
        elif config.init:
            network = load_network(config.init)
            write_weights(root / "init.safetensors", network.config, network.state_dict())
            packed = replace(packed, init="init.safetensors")
        if config.validation_data:
            held_out = Mixture([open_shapes(folder) for folder in config.validation_data], 0.0)
            rows = np.linspace(0, len(held_out) - 1, min(config.validation_objects, len(held_out))).round().astype(int)
            write_corpus(root / "validation", [held_out[row] for row in rows])
            packed = replace(packed, validation_data=("validation",))
        free = megabytes * MEGABYTE - sum(file.stat().st_size for file in root.rglob("*") if file.is_file())
        rng = np.random.default_rng([config.seed, step])
        shapes = of = 0
        if config.targets:
            shapes, of = pack_targets(root / "targets.safetensors", Targets(*config.targets), free, rng)
            packed = replace(packed, targets=("targets.safetensors",))
        elif config.data:
            shapes, of = pack_shapes(root / "data", [open_shapes(folder) for folder in config.data], free, rng)
            packed = replace(packed, data=("data",))
        (root / "config.json").write_text(to_json(packed))
        with replacing(output) as unfinished, tarfile.open(unfinished, "w") as tar:
            tar.add(root, "slice")
    return {"step": step, "shapes": shapes, "of": of}


def rows_that_fit(number, size, free, rng):
    """Row numbers drawn at random, as many of `number` rows of `size` bytes as fit; at least one must."""
    fit = int((free - 0.1 * MEGABYTE) // (size + 64))  # a line of index.json, the tar's own headers
    if fit < 1:
        raise ValueError("code, checkpoint and validation leave no room for shapes; give a larger --megabytes")
    return np.sort(rng.permutation(number)[:fit])


def pack_shapes(folder, collections, free, rng, points=4096):
    """A corpus folder of the shapes that fit; (how many, of how many)."""
    shapes = Mixture(collections, 0.0)
    rows = rows_that_fit(len(shapes), points * 6, free, rng)
    write_corpus(folder, [shapes[row] for row in rows], points)
    return len(rows), len(shapes)


def pack_targets(path, targets, free, rng):
    """A file of the targets that fit; (how many, of how many)."""
    arrays = {"points": targets.points, "queries": targets.queries, "target": targets.target, "views": targets.views}
    rows = rows_that_fit(len(targets), sum(array[:1].nbytes for array in arrays.values()), free, rng)
    save_file({name: array[rows] for name, array in arrays.items()}, path, metadata=FORMAT)
    return len(rows), len(targets)


def train_slice(minutes, output, folder="."):
    """Train from an unpacked slice; its checkpoint, and the best weights if these minutes found any, go to `output`."""
    output = Path(output).absolute()
    os.chdir(folder)
    config = replace(from_json(Path("config.json").read_text()), minutes=minutes)
    run = Path(config.run_dir)
    if Path("checkpoint").exists() and not (run / "last.pt").exists():
        run.mkdir(exist_ok=True)
        with replacing(run / "last.pt") as temporary:
            torch.save(read_parts("checkpoint"), temporary)
    train(config)
    write_parts(output, torch.load(run / "last.pt", map_location="cpu", weights_only=True))
    if (run / "best.pt").exists():
        write_weights(output / "best.safetensors", *read_checkpoint(run / "best.pt"), torch.float16)


def join(folder, run_dir):
    """Make the output of `train_slice` the last checkpoint of a run, and its best weights those of the run."""
    state, run = read_parts(folder), Path(run_dir)
    if (run / "last.pt").exists():
        earlier = torch.load(run / "last.pt", map_location="cpu", weights_only=True)["step"]
        if earlier > state["step"]:
            raise ValueError(f"{run}/last.pt is at step {earlier}, {folder} at {state['step']}; give another --run-dir")
    run.mkdir(parents=True, exist_ok=True)
    best = Path(folder) / "best.safetensors"
    if best.exists():
        with replacing(run / "best.pt") as temporary:
            torch.save({"config": state["config"], "ema": load_network(best).state_dict()}, temporary)
    with replacing(run / "last.pt") as temporary:
        torch.save(state, temporary)
    return state["step"]


def main(argv=None):
    """Command line."""
    argv = sys.argv[1:] if argv is None else argv
    # What follows `--` are the settings of snake_training.train.
    cut = argv.index("--") if "--" in argv else len(argv)
    settings = argv[cut + 1 :]
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.slices", description=__doc__, epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True)
    sub = commands.add_parser("pack", help="write the tar; after -- come the settings of snake_training.train")
    sub.add_argument("output", help="tar to write")
    sub.add_argument("--megabytes", type=float, default=60, help="its largest size (default: 60)")
    sub = commands.add_parser("train", help="train in an unpacked slice")
    sub.add_argument(
        "--minutes", type=float, required=True, help="of training; starting and the last validation come on top"
    )
    sub.add_argument("-o", "--output", required=True, help="folder for the checkpoint, in files of at most 16 MB")
    sub = commands.add_parser("join", help="make what came back the run's last checkpoint")
    sub.add_argument("folder", help="output of train")
    sub.add_argument("--run-dir", required=True, help="run folder")
    arguments = parser.parse_args(argv[:cut])
    if settings and arguments.command != "pack":
        parser.error("only pack takes settings of the training")
    try:
        if arguments.command == "pack":
            found = pack(arguments.output, parse_arguments(settings, "Settings of the run."), arguments.megabytes)
            size = Path(arguments.output).stat().st_size / MEGABYTE
            print(
                f"{arguments.output}: {size:.1f} MB, from step {found['step']}, {found['shapes']} of {found['of']} shapes"
            )
        elif arguments.command == "train":
            if not 0 < arguments.minutes < np.inf:
                parser.error("--minutes must be positive")
            train_slice(arguments.minutes, arguments.output)
        else:
            print(f"{arguments.run_dir}: at step {join(arguments.folder, arguments.run_dir)}")
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
