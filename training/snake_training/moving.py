"""A recipe's run on another machine: the weights of its training stages in float16, in pieces below 5 MB, which can be committed.

Checkpoints with Adam's moments are eight times as large, and made files (crops, targets) are made again.
"""

import hashlib
import json
import shutil
from pathlib import Path

import torch

from .export import Moved, load_network, read_state, replacing, weights_of, write_weights

PIECE = 4_900_000  # bytes
LIST = "pieces.json"


def pack(run_dir, folder, unneeded=()):
    """Writes what moves of a run to `folder`, which is made anew: of each training stage its result, or how far it came.

    Of the stages named as unneeded, only that they are done.
    """
    if not run_dir.is_dir():
        raise ValueError(f"{run_dir}: no such run folder")
    if folder.exists() and any(folder.iterdir()) and not (folder / LIST).exists():
        raise ValueError(f"{folder} holds something else than pieces")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    digests = {}
    for stage in sorted(path for path in run_dir.iterdir() if path.is_dir()):
        last, weights, done = stage / "last.pt", stage / "weights.safetensors", stage / "done.json"
        if done.exists() and stage.name in unneeded:
            put(folder, digests, f"{stage.name}/done.json", done.read_bytes())
            continue
        if done.exists() and weights.exists():
            network = load_network(weights)
            name = f"{stage.name}/weights.safetensors"
            written = folder / "whole"
            write_weights(written, network.config, weights_of(network), torch.float16)
            put(folder, digests, f"{stage.name}/done.json", done.read_bytes())
        elif last.exists():
            name, written = f"{stage.name}/{Moved.NAME}", folder / "whole"
            Moved(load_network(last), read_state(last)["step"]).write(written)
        elif (stage / Moved.NAME).exists():  # unpacked here, not trained further
            put(folder, digests, f"{stage.name}/{Moved.NAME}", (stage / Moved.NAME).read_bytes())
            continue
        else:
            continue
        put(folder, digests, name, written.read_bytes())
        written.unlink()
    (folder / LIST).write_text(json.dumps(digests, indent=1))


def put(folder, digests, name, content):
    """A file's pieces, and their digests by the file's name."""
    pieces = [content[first : first + PIECE] for first in range(0, len(content), PIECE)]
    digests[name] = [hashlib.sha256(piece).hexdigest() for piece in pieces]
    for digest, piece in zip(digests[name], pieces):
        (folder / digest[:16]).write_bytes(piece)


def unpack(folder, run_dir):
    """Takes up what was packed, each piece checked first. Stages that are further here stay as they are."""
    try:
        files = {
            str(name): [(digest, (folder / str(digest)[:16]).read_bytes()) for digest in digests]
            for name, digests in json.loads((folder / LIST).read_text()).items()
        }
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise ValueError(f"{folder}: not all pieces of a run are there ({error})") from error
    for name, pieces in files.items():
        stage, _, kind = name.partition("/")
        if Path(stage).name != stage or kind not in ("done.json", "weights.safetensors", Moved.NAME):
            raise ValueError(f"{folder}: {name[:60]!r} is no file of a run")
        if any(hashlib.sha256(piece).hexdigest() != digest for digest, piece in pieces):
            raise ValueError(f"{folder}: a piece of {name} is not the one that was written")
    for name, pieces in sorted(
        files.items(), key=lambda file: file[0].endswith("done.json")
    ):  # what is done is said last
        target = run_dir / name
        if (target.parent / "done.json").exists() or (target.parent / "last.pt").exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as temporary:
            temporary.write_bytes(b"".join(piece for _, piece in pieces))
