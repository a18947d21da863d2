"""Files of object storage and of web servers, by fsspec."""

from __future__ import annotations

import hashlib
import os
import posixpath
from pathlib import Path
from typing import Any


def open_url(url: str, storage_options: dict[str, Any]) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    try:
        import fsspec  # type: ignore[import-not-found, import-untyped, unused-ignore]
    except ImportError as error:
        raise ImportError("URLs need fsspec: pip install fsspec, and s3fs for s3:// or aiohttp for https://") from error
    files, path = fsspec.url_to_fs(url, **storage_options)
    return files, path


def clouds_in(folder: str, extensions: list[str], storage_options: dict[str, Any]) -> list[str]:
    """The files with these extensions in a folder on disk or behind a URL, sorted by name."""
    if "://" in folder:
        files, path = open_url(folder, storage_options)
        found = [files.unstrip_protocol(name) for name in files.ls(path, detail=False)]
    else:
        found = [str(path) for path in Path(folder).iterdir() if path.is_file()]
    clouds = sorted(name for name in found if name.lower().endswith(tuple(f".{extension}" for extension in extensions)))
    if not clouds:
        raise FileNotFoundError(f"{folder}: the folder has no clouds ({', '.join(extensions)})")
    return clouds


class RemoteFile:
    """The file at a URL, which is read by ranges of bytes. It can be pickled."""

    def __init__(self, url: str, storage_options: dict[str, Any]) -> None:
        self.url = url
        self.files, self.path = open_url(url, storage_options)
        self.length = self.files.size(self.path)
        if self.length is None:
            raise OSError(f"{url}: the server does not tell the size of the file")
        # A text that changes when the file changes, as far as the file system knows.
        self.version = str(self.files.ukey(self.path))

    def read(self, start: int, end: int) -> bytes:
        """The bytes of a range."""
        return bytes(self.files.cat_file(self.path, start=start, end=end))

    def copy_to(self, folder: str | os.PathLike[str]) -> Path:
        """Copies the file to a folder, unless this version is there. Returns the path of the copy."""
        key = hashlib.sha256(f"{self.url} {self.version} {self.length}".encode()).hexdigest()[:16]
        copy = Path(folder) / key / posixpath.basename(self.path)
        if not copy.exists():
            copy.parent.mkdir(parents=True, exist_ok=True)
            part = copy.with_name(f"{copy.name}.part")
            self.files.get_file(self.path, str(part))
            part.replace(copy)
        return copy
