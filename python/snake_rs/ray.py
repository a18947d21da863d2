"""Detection and registration on a cluster, with Ray Data: pip install 'ray[data]'.

Each class is for `ray.data.Dataset.map_batches`. It loads its model once an actor and uses as many threads as the actor has
CPUs.

import ray
from snake_rs.ray import DetectClouds, keypoints_of_tiles

clouds = ray.data.from_items([{"path": path} for path in paths])
found = clouds.map_batches(
    DetectClouds, fn_constructor_args=("compact",), batch_format="pyarrow", concurrency=4, num_cpus=2
)

tiles = snake_rs.tiles("city.laz", tile=50, folder="/shared/city.tiles", voxel_size=0.1)
keypoints = keypoints_of_tiles(tiles, concurrency=4, num_cpus=2)  # a pyarrow.Table
"""

from __future__ import annotations

import contextlib
import errno
import posixpath
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

try:
    import pyarrow as pa  # type: ignore[import-not-found, import-untyped, unused-ignore]
    import ray  # type: ignore[import-not-found, unused-ignore]
    import ray.data  # type: ignore[import-not-found, unused-ignore]
except ImportError as _error:
    raise ImportError("snake_rs.ray needs Ray Data: pip install 'ray[data]'") from _error

from ._core import Model, Tiles, detect, register, set_num_threads
from ._remote import open_url, retried

__all__ = ["DetectClouds", "DetectTiles", "RegisterPairs", "TileKeypoints", "keypoints_of_tiles"]

# Errors that every further file would have too.
_FULL = (errno.ENOSPC, errno.EDQUOT)

_KEYPOINT = pa.struct(
    [
        ("x", pa.float64()),
        ("y", pa.float64()),
        ("z", pa.float64()),
        ("saliency", pa.float32()),
        ("occupancy", pa.float32()),
        ("nearest_index", pa.int64()),
        ("confidence", pa.float32()),
    ]
)
# Columns that `DetectClouds` and `RegisterPairs` add beside the error.
_DETECTED = [pa.field("keypoints", pa.list_(_KEYPOINT))]
_TRANSFORM = [
    pa.field("t_target_source", pa.list_(pa.float64(), 16)),
    pa.field("confidence", pa.float64()),
    pa.field("is_reliable", pa.bool_()),
]
_ERROR = pa.field("error", pa.string())
_RANK = [("rank", "descending"), ("start", "descending"), *((f"cell_{axis}", "ascending") for axis in "zyx")]


def _use_own_cpus() -> None:
    """Uses as many threads as this actor has CPUs."""
    context: Any = ray.get_runtime_context()
    set_num_threads(max(1, int(context.get_assigned_resources().get("CPU", 1))))


def _reason(error: Exception) -> str:
    """The text of an error. A full disk ends the run: it can be continued once there is room."""
    if isinstance(error, OSError) and error.errno in _FULL:
        raise error
    return f"{type(error).__name__}: {error}"


def _with_results(
    batch: pa.Table, given: list[str], fields: list[pa.Field], of_row: Callable[..., dict[str, Any]]
) -> pa.Table:
    """A batch with the results of its rows from their columns `given`, and the column `error`: an error is that of its row alone.
    A result's column that is there already stays, and is the error of all rows."""
    taken = [field.name for field in [*fields, _ERROR] if field.name in batch.column_names]
    results: list[dict[str, Any]] = []
    for row in batch.select([*given, *(name for name in taken if name == "error")]).to_pylist():
        try:
            if taken:
                known = f", here {row['error']!r}" if "error" in taken else ""
                raise ValueError(
                    f"the rows have the column {' and '.join(taken)} already{known}; rename or drop it before"
                )
            results.append(of_row(*(row[name] for name in given)))
        except Exception as error:  # noqa: BLE001 (those of libraries for HTTP and S3 have no common class)
            results.append({"error": _reason(error)})
    for field in [*fields, _ERROR]:
        column = pa.array([result.get(field.name) for result in results], field.type)
        if field.name not in batch.column_names:
            batch = batch.append_column(field, column)
        elif field is _ERROR:
            batch = batch.set_column(batch.column_names.index(field.name), field, column)
    return batch


class DetectClouds:
    """Detects the keypoints of each row of a batch, a `pyarrow.Table`: of the file in the column `path`, or of the cloud in
    the column `points`, flat `x, y, z, x, ..` or lists of three. A path may be a URL that fsspec opens, such as
    `s3://bucket/cloud.ply` once s3fs is installed; `storage_options` are those of its file system.

    Adds the column `keypoints`, a list of structs with `x`, `y`, `z`, `saliency`, `occupancy` and `nearest_index`, by
    falling saliency, and the column `error`: the reason why a cloud could not be detected, or null. The other columns stay,
    and `points` is dropped. A server's reply that may pass, such as 503, is tried again. `model` and `options` are those of
    `snake_rs.detect`; an unknown option raises TypeError.
    """

    def __init__(
        self, model: Model | str = "compact", storage_options: dict[str, Any] | None = None, **options: Any
    ) -> None:
        _use_own_cpus()
        self.model = _loaded(model)
        self.storage_options = storage_options or {}
        self.options = options
        with contextlib.suppress(ValueError):  # no points: only the names of the options are looked at
            detect(np.empty((0, 3), np.float32), self.model, **options)

    def __call__(self, batch: pa.Table) -> pa.Table:
        is_path = "path" in batch.column_names
        if not is_path and "points" not in batch.column_names:
            raise ValueError(f"a batch needs the column path or points; it has {', '.join(batch.column_names)}")
        if is_path:
            return _with_results(batch, ["path"], _DETECTED, self._of_path)
        return _with_results(batch, ["points"], _DETECTED, self._of_points).drop_columns(["points"])

    def _of_path(self, path: Any) -> dict[str, Any]:
        with _local_file(path, self.storage_options) as local:
            return self._found(local)

    def _of_points(self, points: Any) -> dict[str, Any]:
        return self._found(_points(points))

    def _found(self, cloud: str | np.ndarray) -> dict[str, Any]:
        return {"keypoints": _structs(detect(cloud, self.model, **self.options).to_dict())}


class RegisterPairs:
    """Registers the files in the columns `source` and `target` of each row of a batch, a `pyarrow.Table`. Paths may be URLs, and
    `storage_options` are as in `DetectClouds`.

    Adds the columns `t_target_source`, the 16 numbers of the matrix row by row, `confidence`, `is_reliable`, and `error`: the
    reason why a pair could not be registered, or null. `model` and `options` are those of `snake_rs.register`; an unknown option
    raises TypeError.
    """

    def __init__(
        self, model: Model | str | None = None, storage_options: dict[str, Any] | None = None, **options: Any
    ) -> None:
        _use_own_cpus()
        self.model = None if model is None else _loaded(model)
        self.storage_options = storage_options or {}
        self.options = options
        nothing = np.empty((0, 3), np.float32)
        with contextlib.suppress(ValueError):  # no points: only the names of the options are looked at
            register(nothing, nothing, self.model, **options)

    def __call__(self, batch: pa.Table) -> pa.Table:
        if missing := [name for name in ("source", "target") if name not in batch.column_names]:
            raise ValueError(f"a batch needs the column {missing[0]}; it has {', '.join(batch.column_names)}")
        return _with_results(batch, ["source", "target"], _TRANSFORM, self._of_pair)

    def _of_pair(self, source: Any, target: Any) -> dict[str, Any]:
        with contextlib.ExitStack() as copies:
            source, target = (
                copies.enter_context(_local_file(path, self.storage_options)) for path in (source, target)
            )
            found = register(source, target, self.model, **self.options)
        matrix, verdict = found.t_target_source.ravel().tolist(), found.verdict
        return {"t_target_source": matrix, "confidence": verdict.confidence, "is_reliable": verdict.is_reliable}


def _loaded(model: Model | str) -> Model:
    if isinstance(model, Model):
        return model
    return Model.load(model) if Path(model).suffix or Path(model).exists() else Model.builtin(model)


@contextlib.contextmanager
def _local_file(path: Any, storage_options: dict[str, Any]) -> Iterator[str]:
    """The path of a file of this machine, or of a copy of the file at a URL."""
    if not isinstance(path, str):
        raise ValueError("the path is null" if path is None else f"the path is {path!r}, not a text")
    if "://" not in path:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        files, remote = open_url(path, storage_options)
        copy = f"{folder}/{posixpath.basename(remote)}"
        retried(lambda: files.get_file(remote, copy), path)
        yield copy


def _points(value: Any) -> np.ndarray:
    """The points (N, 3) of a row."""
    if value is None:
        raise ValueError("the points are null")
    points = np.asarray(value)
    if points.dtype.kind not in "fiu":
        raise ValueError("the points hold nulls or other values than numbers")
    return points.reshape(-1, 3) if points.ndim == 1 and points.size % 3 == 0 else points


def _structs(columns: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    rows = zip(*(columns[name].tolist() for name in columns), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


class DetectTiles:
    """Detects tiles of `snake_rs.tiles`. A batch is a `pyarrow.Table` with the column `tile`, as of `Tiles.rows()`.

    The candidates go to the tiles' folder, which all machines must see. A tile that is there is not detected again. Adds the
    column `error`: the reason why a tile could not be detected, or null.
    """

    def __init__(self, tiles: Tiles) -> None:
        _use_own_cpus()
        self.tiles = tiles

    def __call__(self, batch: pa.Table) -> pa.Table:
        return _with_results(batch, ["tile"], [], self._detect)

    def _detect(self, tile: Any) -> dict[str, Any]:
        self.tiles.detect(tile)
        return {}


class TileKeypoints:
    """The keypoints of tiles, once all tiles are detected: the seams between them are solved here. A batch is as of
    `DetectTiles`, and gives a row for each keypoint: the columns of `DetectedTiles.keypoints`, and `tile`. Raises ValueError when tiles are missing.
    """

    def __init__(self, tiles: Tiles) -> None:
        _use_own_cpus()
        self.detected = tiles.detected()
        if missing := self.detected.missing:
            raise ValueError(f"{len(missing)} of {len(tiles)} tiles are missing; detect them first: {missing[:9]}")

    def __call__(self, batch: pa.Table) -> pa.Table:
        return pa.concat_tables(self._keypoints(tile) for tile in batch["tile"].to_pylist())

    def _keypoints(self, tile: int) -> pa.Table:
        columns = self.detected.keypoints(tile)
        number = len(columns["x"])
        return pa.table({**columns, "tile": np.full(number, tile)})


def keypoints_of_tiles(tiles: Tiles, concurrency: int = 1, num_cpus: float = 1) -> pa.Table:
    """The keypoints of a large cloud by `concurrency` actors of `num_cpus` CPUs each: the bits of `Tiles.finish` on one
    machine. Columns: `x`, `y`, `z` (float64, in the units of the files), `saliency`, `occupancy`, `nearest_index` and `tile`,
    best first.

    A worker that dies is started again and goes on with the tiles that are not done. A tile that fails is named with its bounds
    in a ValueError, once the others are detected: the same call tries only the failed ones again. Raises OSError within
    `ray.exceptions.RayError` when the disk is full; once there is room, the same call continues.
    """

    def over_tiles(step: type, batch_size: int) -> ray.data.Dataset:
        rows = ray.data.from_items(tiles.rows(), override_num_blocks=max(1, len(tiles) // batch_size))
        return rows.map_batches(
            step,
            fn_constructor_args=(tiles,),
            batch_size=batch_size,
            batch_format="pyarrow",
            concurrency=concurrency,
            num_cpus=num_cpus,
        )

    failed = [row for row in over_tiles(DetectTiles, 1).take_all() if row["error"] is not None]
    if failed:
        bounds = "the tile from x {west:.2f}, y {south:.2f} to x {east:.2f}, y {north:.2f}: {error}"
        reasons = "; ".join(bounds.format(**row) for row in failed[:9])
        raise ValueError(f"{len(failed)} of {len(tiles)} tiles failed: {reasons}")
    references: Any = over_tiles(TileKeypoints, 4).to_arrow_refs()
    parts: list[pa.Table] = ray.get(references)
    table = pa.concat_tables(part for part in parts if part.num_rows > 0 or len(parts) == 1).sort_by(_RANK)
    return table.drop_columns([name for name, _ in _RANK]).slice(0, tiles.max_keypoints)
