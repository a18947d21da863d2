"""Detection and registration on a cluster, with Ray Data: pip install "snake-rs[ray]".

Each class is for `ray.data.Dataset.map_batches`. It loads its model once an actor and uses as many threads as the actor has
CPUs.

import ray
from snake_rs.ray import DetectClouds, keypoints_of_tiles

clouds = ray.data.from_items([{"path": path} for path in paths])
found = clouds.map_batches(
    DetectClouds, fn_constructor_args=("compact",), batch_format="pyarrow", concurrency=4, num_cpus=2
)

tiles = snake_rs.tiles("city.laz", tile=50, folder="/shared/city.tiles", model="rooms")
keypoints = keypoints_of_tiles(tiles, concurrency=4, num_cpus=2)  # a pyarrow.Table
"""

from __future__ import annotations

import contextlib
import errno
import posixpath
import tempfile
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

try:
    import fsspec  # type: ignore[import-not-found, import-untyped, unused-ignore]
    import pyarrow as pa  # type: ignore[import-not-found, import-untyped, unused-ignore]
    import ray  # type: ignore[import-not-found, unused-ignore]
    import ray.data  # type: ignore[import-not-found, unused-ignore]
except ImportError as _error:
    raise ImportError('snake_rs.ray needs Ray Data: pip install "snake-rs[ray]"') from _error

from ._core import Model, Tiles, detect, register, set_num_threads

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
    ]
)
# What `RegisterPairs` adds.
_TRANSFORM = [
    pa.field("t_target_source", pa.list_(pa.float64(), 16)),
    pa.field("confidence", pa.float64()),
    pa.field("is_reliable", pa.bool_()),
    pa.field("error", pa.string()),
]
_RANK = ["cell_x", "cell_y", "cell_z", "rank"]


def _use_own_cpus() -> None:
    """Uses as many threads as this actor has CPUs."""
    context: Any = ray.get_runtime_context()
    set_num_threads(max(1, int(context.get_assigned_resources().get("CPU", 1))))


def _reason(error: Exception) -> str:
    """The text of an error. A full disk ends the run: it can be continued once there is room."""
    if isinstance(error, OSError) and error.errno in _FULL:
        raise error
    return f"{type(error).__name__}: {error}"


class DetectClouds:
    """Detects the keypoints of each row of a batch, a `pyarrow.Table`: of the file in the column `path`, or of the cloud in
    the column `points`, flat `x, y, z, x, ..` or lists of three. A path may be a URL that fsspec opens, such as
    `s3://bucket/cloud.ply` once s3fs is installed; `storage_options` are those of its file system.

    Adds the column `keypoints`, a list of structs with `x`, `y`, `z`, `saliency`, `occupancy` and `nearest_index`, by
    falling saliency, and the column `error`: the reason why a cloud could not be detected, or null. The other columns stay,
    and `points` is dropped. `model` and `options` are those of `snake_rs.detect`.
    """

    def __init__(
        self, model: Model | str = "compact", storage_options: dict[str, Any] | None = None, **options: Any
    ) -> None:
        _use_own_cpus()
        self.model = _loaded(model)
        self.storage_options = storage_options or {}
        self.options = options

    def __call__(self, batch: pa.Table) -> pa.Table:
        is_path = "path" in batch.column_names
        if not is_path and "points" not in batch.column_names:
            raise ValueError(f"a batch needs the column path or points; it has {', '.join(batch.column_names)}")
        found: list[list[dict[str, Any]] | None] = []
        errors: list[str | None] = []
        for value in batch["path" if is_path else "points"]:
            try:
                cloud: contextlib.AbstractContextManager[Any] = (
                    _local_file(value.as_py(), self.storage_options)
                    if is_path
                    else contextlib.nullcontext(_points(value))
                )
                with cloud as points:
                    found.append(_structs(detect(points, self.model, **self.options).to_dict()))
                errors.append(None)
            except (OSError, ValueError) as error:
                found.append(None)
                errors.append(_reason(error))
        if not is_path:
            batch = batch.drop_columns(["points"])
        batch = batch.append_column("keypoints", pa.array(found, pa.list_(_KEYPOINT)))
        return batch.append_column("error", pa.array(errors, pa.string()))


class RegisterPairs:
    """Registers the files in the columns `source` and `target` of each row of a batch, a `pyarrow.Table`. Paths may be URLs, and
    `storage_options` are as in `DetectClouds`.

    Adds the columns `t_target_source`, the 16 numbers of the matrix row by row, `confidence`, `is_reliable`, and `error`: the
    reason why a pair could not be registered, or null. `model` and `options` are those of `snake_rs.register`.
    """

    def __init__(
        self, model: Model | str = "compact", storage_options: dict[str, Any] | None = None, **options: Any
    ) -> None:
        _use_own_cpus()
        self.model = _loaded(model)
        self.storage_options = storage_options or {}
        self.options = options

    def __call__(self, batch: pa.Table) -> pa.Table:
        rows = [self._row(row["source"], row["target"]) for row in batch.select(["source", "target"]).to_pylist()]
        for column in _TRANSFORM:
            batch = batch.append_column(column, pa.array([row.get(column.name) for row in rows], column.type))
        return batch

    def _row(self, source: str, target: str) -> dict[str, Any]:
        try:
            with contextlib.ExitStack() as copies:
                source, target = (
                    copies.enter_context(_local_file(path, self.storage_options)) for path in (source, target)
                )
                found = register(source, target, self.model, **self.options)
        except (OSError, ValueError) as error:
            return {"error": _reason(error)}
        matrix = found.t_target_source.ravel().tolist()
        return {"t_target_source": matrix, "confidence": found.confidence, "is_reliable": found.is_reliable}


def _loaded(model: Model | str) -> Model:
    if isinstance(model, Model):
        return model
    return Model.builtin(model) if model in ("compact", "standard", "rooms") else Model.load(model)


@contextlib.contextmanager
def _local_file(path: str, storage_options: dict[str, Any]) -> Iterator[str]:
    """The path of a file of this machine, or of a copy of the file at a URL."""
    if "://" not in path:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        files, remote = fsspec.url_to_fs(path, **storage_options)
        copy = f"{folder}/{posixpath.basename(remote)}"
        files.get_file(remote, copy)
        yield copy


def _points(value: pa.Scalar) -> np.ndarray:
    """The points (N, 3) of a row."""
    points = np.asarray(value.as_py())
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
        errors: list[str | None] = []
        for tile in batch["tile"].to_pylist():
            try:
                self.tiles.detect(tile)
                errors.append(None)
            except (OSError, ValueError) as error:
                errors.append(_reason(error))
        return batch.append_column("error", pa.array(errors, pa.string()))


class TileKeypoints:
    """The keypoints of tiles, once all tiles are detected: the seams between them are solved here. A batch is as of
    `DetectTiles`, and gives a row for each keypoint: the columns of `DetectedTiles.keypoints`, `tile`, and `rank`, the order in
    the tile.
    """

    def __init__(self, tiles: Tiles) -> None:
        _use_own_cpus()
        self.detected = tiles.detected()

    def __call__(self, batch: pa.Table) -> pa.Table:
        return pa.concat_tables(self._keypoints(tile) for tile in batch["tile"].to_pylist())

    def _keypoints(self, tile: int) -> pa.Table:
        columns = self.detected.keypoints(tile)
        number = len(columns["x"])
        return pa.table({**columns, "tile": np.full(number, tile), "rank": np.arange(number)})


def keypoints_of_tiles(tiles: Tiles, concurrency: int = 1, num_cpus: float = 1) -> pa.Table:
    """The keypoints of a large cloud by `concurrency` actors of `num_cpus` CPUs each: the bits of `Tiles.finish` on one
    machine. Columns: `x`, `y`, `z` (float64, in the units of the files), `saliency`, `occupancy`, `nearest_index` and `tile`,
    by falling saliency.

    A worker that dies is started again and goes on with the tiles that are not done. A tile that fails is named in a
    UserWarning with its bounds, and the others are detected. Raises OSError within `ray.exceptions.RayError` when the disk is
    full; the same call continues.
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

    for row in over_tiles(DetectTiles, 1).take_all():
        if row["error"] is not None:
            bounds = "x {west:.2f}, y {south:.2f} to x {east:.2f}, y {north:.2f}".format(**row)
            warnings.warn(f"the tile from {bounds} is left out: {row['error']}", stacklevel=2)
    references: Any = over_tiles(TileKeypoints, 4).to_arrow_refs()
    parts: list[pa.Table] = ray.get(references)
    order = [("saliency", "descending"), *((name, "ascending") for name in _RANK)]
    table = pa.concat_tables(part for part in parts if part.num_rows > 0 or len(parts) == 1).sort_by(order)
    return table.drop_columns(_RANK).slice(0, tiles.max_keypoints)
