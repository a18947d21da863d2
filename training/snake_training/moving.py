"""A recipe's run on another machine: the weights of its training stages in float16, as a tar in parts below 5 MB, which can be
committed.

Checkpoints with Adam's moments are eight times as large, and made files (crops, targets) are made again.
"""

import hashlib
import io
import json
import shutil
import tarfile
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
    files = {}
    for stage in sorted(path for path in run_dir.iterdir() if path.is_dir()):
        last, weights, done = stage / "last.pt", stage / "weights.safetensors", stage / "done.json"
        if done.exists() and stage.name in unneeded:
            files[f"{stage.name}/done.json"] = done.read_bytes()
            continue
        if done.exists() and weights.exists():
            network = load_network(weights)
            name = f"{stage.name}/weights.safetensors"
            written = folder / "whole"
            write_weights(written, network.config, weights_of(network), torch.float16)
            files[f"{stage.name}/done.json"] = done.read_bytes()
        elif last.exists():
            name, written = f"{stage.name}/{Moved.NAME}", folder / "whole"
            Moved(load_network(last), read_state(last)["step"]).write(written)
        elif (stage / Moved.NAME).exists():  # unpacked here, not trained further
            files[f"{stage.name}/{Moved.NAME}"] = (stage / Moved.NAME).read_bytes()
            continue
        else:
            continue
        files[name] = written.read_bytes()
        written.unlink()
    with tarfile.open(fileobj=(content := io.BytesIO()), mode="w") as tar:
        for name, held in files.items():
            (member := tarfile.TarInfo(name)).size = len(held)
            tar.addfile(member, io.BytesIO(held))
    content = content.getvalue()
    parts = [content[first : first + PIECE] for first in range(0, len(content), PIECE)]
    for row, part in enumerate(parts):
        (folder / f"{row:03d}").write_bytes(part)
    (folder / LIST).write_text(json.dumps([hashlib.sha256(part).hexdigest() for part in parts]))


def unpack(folder, run_dir):
    """Takes up what was packed, each piece checked first. Stages that are further here stay as they are."""
    try:
        digests = json.loads((folder / LIST).read_text())
        parts = [(folder / f"{row:03d}").read_bytes() for row in range(len(digests))]
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(f"{folder}: not all pieces of a run are there ({error})") from error
    if [hashlib.sha256(part).hexdigest() for part in parts] != digests:
        raise ValueError(f"{folder}: a piece is not the one that was written")
    try:
        with tarfile.open(fileobj=io.BytesIO(b"".join(parts))) as tar:
            files = {member.name: tar.extractfile(member).read() for member in tar if member.isfile()}
    except tarfile.TarError as error:
        raise ValueError(f"{folder}: not the pieces of a run ({error})") from error
    for name in files:
        stage, _, kind = name.partition("/")
        if Path(stage).name != stage or stage == ".." or kind not in ("done.json", "weights.safetensors", Moved.NAME):
            raise ValueError(f"{folder}: {name[:60]!r} is no file of a run")
    # What is done is said last.
    for name in sorted(files, key=lambda name: name.endswith("done.json")):
        target = run_dir / name
        if (target.parent / "done.json").exists() or (target.parent / "last.pt").exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as temporary:
            temporary.write_bytes(files[name])
