"""A folder as files below 5 MB, which can be committed or sent one by one, and back."""

import hashlib
import io
import json
import shutil
import tarfile
from pathlib import Path

PIECE = 4_900_000  # bytes
LIST = "pieces.json"


class Splitter(io.RawIOBase):
    """A file to write to that begins a new piece where the last is full."""

    def __init__(self, folder):
        self.folder, self.digests, self.room = folder, [], bytearray()

    def writable(self):
        return True

    def write(self, content):
        self.room += content
        while len(self.room) >= PIECE:
            self.put(PIECE)
        return len(content)

    def put(self, number):
        piece, self.room = bytes(self.room[:number]), self.room[number:]
        (self.folder / f"{len(self.digests):04d}").write_bytes(piece)
        self.digests.append(hashlib.sha256(piece).hexdigest())

    def finish(self):
        """The last piece, then the list of all."""
        self.put(len(self.room))
        (self.folder / LIST).write_text(json.dumps(self.digests))


def pack(source, folder):
    """Writes the folder `source` as pieces to `folder`, which is made anew. Files that are being written are left out."""
    if not source.is_dir():
        raise ValueError(f"{source}: no such run folder")
    if folder.exists() and any(folder.iterdir()) and not (folder / LIST).exists():
        raise ValueError(f"{folder} holds something else than pieces")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    splitter = Splitter(folder)
    with tarfile.open(fileobj=splitter, mode="w|") as tar:
        for path in sorted(path for path in source.rglob("*") if path.is_file() and path.suffix != ".partial"):
            tar.add(path, str(path.relative_to(source)))
    splitter.finish()


def unpack(folder, target):
    """Restores a folder from its pieces, each checked first."""
    try:
        digests = json.loads((folder / LIST).read_text())
        content = [(folder / f"{row:04d}").read_bytes() for row in range(len(digests))]
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder}: not all pieces of a run are there ({error})") from error
    for row, (digest, piece) in enumerate(zip(digests, content)):
        if hashlib.sha256(piece).hexdigest() != digest:
            raise ValueError(f"{folder}/{row:04d}: not the piece that was written")
    Path(target).mkdir(parents=True, exist_ok=True)
    with tarfile.open(fileobj=io.BytesIO(b"".join(content))) as tar:
        tar.extractall(target, filter="data")
