"""Files of object storage and of web servers, by fsspec."""

from __future__ import annotations

import errno
import hashlib
import os
import posixpath
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

# Seconds before a call is tried again.
_PAUSES = (0.5, 1.0, 2.0)

# Replies that may be better next time, beside those from 500 on.
_TRANSIENT_STATUS = (408, 425, 429)
_TRANSIENT_ERRNO = (errno.EAGAIN, errno.EBUSY, errno.ECONNRESET, errno.EPIPE, errno.ETIMEDOUT)

# Headers of a server that tell versions of a file apart, the most precise first.
_VERSIONS = ("ETag", "Content-MD5", "Digest", "Last-Modified", "LastModified")


def open_url(url: str, storage_options: dict[str, Any]) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    try:
        import fsspec  # type: ignore[import-not-found, import-untyped, unused-ignore]

        files, path = fsspec.url_to_fs(url, **storage_options)
    except ImportError as error:
        needed = "pip install fsspec, and s3fs for s3:// or aiohttp for https://"
        raise ImportError(f"{url}: {error}; URLs need {needed}") from error
    return files, path


def _status(error: BaseException) -> int | None:
    """The status of the server's reply in an error of HTTP or of S3."""
    status = getattr(error, "status", None)
    if status is None:
        reply = getattr(error, "response", None)
        status = reply.get("ResponseMetadata", {}).get("HTTPStatusCode") if isinstance(reply, dict) else None
    return status if isinstance(status, int) else None


def _is_transient(error: BaseException) -> bool:
    status = _status(error)
    if status is not None:
        return status >= 500 or status in _TRANSIENT_STATUS
    if isinstance(error, OSError):
        return isinstance(error, TimeoutError) or error.errno in _TRANSIENT_ERRNO
    # Connections that break while a body is read: aiohttp is not a dependency.
    return type(error).__name__ in ("ServerDisconnectedError", "ClientPayloadError", "IncompleteRead")


def retried(call: Callable[[], T], url: str) -> T:
    """The result of a call to a server, which is tried again after errors that may pass, such as 503. Errors of the server are
    OSErrors."""
    for pause in (*_PAUSES, None):
        try:
            return call()
        except Exception as error:
            # To ask for the size, fsspec calls each failure a missing file.
            cause = error.__cause__ if isinstance(error, FileNotFoundError) else None
            reason = cause if cause is not None and _status(cause) not in (None, 404, 410) else error
            if pause is None or not _is_transient(reason):
                if reason is error and isinstance(error, (OSError, ValueError, ImportError)):
                    raise
                raise OSError(f"{url}: {type(reason).__name__}: {reason}") from error
            time.sleep(pause)
    raise AssertionError("unreachable")


def clouds_in(folder: str, extensions: list[str], storage_options: dict[str, Any]) -> list[str]:
    """The files with these extensions in a folder on disk or behind a URL, sorted by name."""
    if "://" in folder:
        files, path = open_url(folder, storage_options)
        listed = retried(lambda: files.ls(path, detail=False), folder)
        found = [files.unstrip_protocol(name) for name in listed]
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
        info = retried(lambda: self.files.info(self.path), url)
        self.length = info.get("size")
        if self.length is None:
            raise OSError(f"{url}: the server does not tell the size of the file")
        # A text that changes when the file changes, as far as the file system knows.
        told = (str(info[name]) for name in _VERSIONS if info.get(name))
        self.version = next(told, None) or str(self.files.ukey(self.path))

    def read(self, start: int, end: int) -> bytes:
        """The bytes of a range."""
        return retried(lambda: bytes(self.files.cat_file(self.path, start=start, end=end)), self.url)

    def copy_to(self, folder: Path) -> Path:
        """The copy of this version in the folder of a run, which is made unless it is there. It bears the name of a temporary file."""
        key = hashlib.sha256(f"{self.url} {self.version} {self.length}".encode()).hexdigest()[:16]
        copy = folder / ".snake-rs.inputs.part" / key / posixpath.basename(self.path)
        if not copy.exists():
            copy.parent.mkdir(parents=True, exist_ok=True)
            part = copy.with_name(f"{os.getpid()}.part")
            retried(lambda: self.files.get_file(self.path, str(part)), self.url)
            if (size := part.stat().st_size) != self.length:
                raise OSError(f"{self.url}: {size} bytes came instead of {self.length}")
            part.replace(copy)
        return copy
