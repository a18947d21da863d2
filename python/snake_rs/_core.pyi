"""Types of the private module `_core`. Check them with `python -m mypy.stubtest snake_rs._core`."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Protocol, TypeAlias, TypedDict, final, overload, type_check_only

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self, Unpack

__version__: str

@type_check_only
class _HasPoints(Protocol):
    @property
    def points(self) -> Any: ...

@type_check_only
class _HasVertices(Protocol):
    @property
    def vertices(self) -> Any: ...

@type_check_only
class _HasXyz(Protocol):
    @property
    def xyz(self) -> Any: ...

@type_check_only
class _HasPoint(Protocol):
    @property
    def point(self) -> Any: ...

_Path: TypeAlias = str | os.PathLike[str]
_Array: TypeAlias = ArrayLike | _HasPoints | _HasVertices | _HasXyz | _HasPoint
# An array, a cloud of another library, or the path of a file.
_Points: TypeAlias = _Array | _Path
# A model, the name of a built-in model, or the path of a weight file.
_Model: TypeAlias = Model | _Path
# Called with the name of a stage, the completed and all units of its work.
_Progress: TypeAlias = Callable[[str, int, int], object]

# float32 for clouds of float32 or float16, else float64.
_Positions: TypeAlias = NDArray[np.float32] | NDArray[np.float64]

# Options, written by SNAKE_WRITE_OPTIONS=1 cargo test --release -p snake-rs-python --test options

@type_check_only
class _Preset(TypedDict, total=False):
    preset: Literal["modelnet40", "keypointnet", "smpl", "redwood", "3dmatch"] | None

@type_check_only
class _EncodeOptions(_Preset, total=False):
    normalization: Literal["unit-sphere", "principal-axes", "unit-cube", "half", "none"]
    max_points: int | None
    seed: int
    rotations: int
    voxel_size: float | str | None

@type_check_only
class _DetectOptions(_Preset, total=False):
    query_resolution: int
    query_band: int
    occupancy_threshold: float
    refine_steps: int
    refine_step_size: float
    refine_method: Literal["adam", "gradient-descent"]
    selection: Literal["best-position", "reference-final-position"]
    surface_threshold: float
    saliency_threshold: float
    min_confidence: float | None
    mode_radius: float | str | None
    nms_radius: float | str | None
    prefer: Literal["salient", "corners"]
    max_keypoints: int | None
    snap: bool

@type_check_only
class _Options(_EncodeOptions, _DetectOptions, total=False): ...

@type_check_only
class _RegistrationOptions(TypedDict, total=False):
    detector: Literal["voxels", "snake", "iss", "harris3d", "sift3d", "surface-variation", "fps", "random"]
    descriptor: Literal["fpfh", "field"]
    max_keypoints: int
    num_keypoints: int | None
    max_matches: int
    voxel_size: float | str | None
    normal_radius: float | str | None
    feature_radius: float | str | None
    inlier_distance: float | str | None
    use_viewpoints: bool
    gravity: Literal["x", "y", "z"] | None
    seed: int
    icp_steps: int

@type_check_only
class _PairOptions(TypedDict, total=False):
    source_viewpoint: ArrayLike | None
    target_viewpoint: ArrayLike | None
    initial: ArrayLike | None
    hypotheses: int
    estimate_scale: bool

@type_check_only
class _RegisterOptions(_RegistrationOptions, _PairOptions, total=False): ...

@type_check_only
class _AlignOptions(_RegistrationOptions, total=False):
    max_partners: int
    pose_tolerance: float | str | None

@type_check_only
class _IssOptions(TypedDict, total=False):
    salient_radius: float | str
    non_max_radius: float | str
    gamma_21: float
    gamma_32: float
    min_neighbors: int
    covariance: Literal["about-mean", "about-point"]

@type_check_only
class _Harris3dOptions(TypedDict, total=False):
    radius: float | str
    threshold: float
    non_max: bool

@type_check_only
class _Sift3dOptions(TypedDict, total=False):
    min_scale: float | str
    octaves: int
    scales_per_octave: int
    min_contrast: float
    field: Literal["curvature", "y"]
    curvature_radius: float | str

@type_check_only
class _SurfaceVariationOptions(TypedDict, total=False):
    radius: float | str
    non_max_radius: float | str

@type_check_only
class _MeshOptions(TypedDict, total=False):
    resolution: int
    surface: Literal["middle", "level"]
    level: float
    outer: bool

# The end of the options.

@type_check_only
class _Config(TypedDict):
    resolution: tuple[int, int, int]
    padding: float
    z_min: float
    z_max: float
    c_dim: int
    hidden_dim: int
    decoder_hidden_dim: int
    resnet_blocks: int
    unet_levels: int
    unet_base_channels: int
    group_norm_groups: int
    scatter: str

@overload
def detect(
    points: list[NDArray[Any]] | tuple[NDArray[Any], ...] | list[str] | list[Path] | list[RecordedCloud],
    model: _Model | None = None,
    *,
    deadline: float | None = None,
    progress: _Progress | None = None,
    **options: Unpack[_Options],
) -> list[Keypoints]: ...
@overload
def detect(
    points: _Points,
    model: _Model | None = None,
    *,
    deadline: float | None = None,
    progress: _Progress | None = None,
    **options: Unpack[_Options],
) -> Keypoints: ...
def scene_signs(points: _Points) -> list[float] | None: ...
def match(a: Keypoints, b: Keypoints) -> NDArray[np.int64]: ...
def register(
    source: _Points,
    target: _Points,
    model: _Model | None = None,
    *,
    deadline: float | None = None,
    progress: _Progress | None = None,
    **options: Unpack[_RegisterOptions],
) -> Registration: ...
def align(
    clouds: Sequence[_Points],
    model: _Model | None = None,
    *,
    viewpoints: Sequence[Sequence[float] | None] | None = None,
    initial_poses: Sequence[ArrayLike | None] | None = None,
    deadline: float | None = None,
    progress: _Progress | None = None,
    **options: Unpack[_AlignOptions],
) -> Alignment: ...
def page(
    points: _Points,
    second: _Points | None = None,
    model: _Model | None = None,
    name: str | None = None,
    epsilon: float | str | None = None,
    t_first_second: ArrayLike | None = None,
    **options: Unpack[_Options],
) -> str: ...
def read_points(
    path: str | os.PathLike[str],
    sample: int | None = None,
    seed: int = 0,
    columns: Sequence[int | str] | None = None,
    keep_withheld: bool = False,
) -> NDArray[np.float64]: ...
def read_recording(path: str | os.PathLike[str], topic: str | None = None) -> Recording: ...
def estimate_normals(points: _Points, radius: float) -> NDArray[np.float32]: ...
def set_num_threads(num_threads: int) -> None: ...
def get_num_threads() -> int: ...
def fpfh(points: _Points, normals: _Points, radius: float) -> NDArray[np.float32]: ...
def tiles(
    paths: _Path | Sequence[_Path],
    tile: float,
    folder: _Path,
    model: _Model | None = None,
    storage_options: dict[str, Any] | None = None,
    **options: Unpack[_Options],
) -> Tiles: ...

@type_check_only
class _TileRow(TypedDict):
    tile: int
    folder: str
    west: float
    south: float
    east: float
    north: float
    num_points: int

@final
class Tiles:
    def rows(self) -> list[_TileRow]: ...
    folder: Final[Path]
    failures: Final[dict[Path, str]]
    max_keypoints: Final[int | None]
    def detect(self, tile: int) -> None: ...
    def is_detected(self, tile: int) -> bool: ...
    def detected(self) -> DetectedTiles: ...
    def finish(self) -> Keypoints: ...
    def __len__(self) -> int: ...

@final
class DetectedTiles:
    missing: Final[list[int]]
    counts: Final[dict[str, int]]
    def keypoints(self, tile: int) -> dict[str, NDArray[Any]]: ...

@final
class Recording:
    topic: Final[str]
    def __iter__(self) -> Self: ...
    def __next__(self) -> RecordedCloud: ...

@final
class RecordedCloud:
    log_time: Final[int]
    frame_id: Final[str]
    points: Final[_Positions]

@final
class Model:
    @staticmethod
    def builtin(name: str = "compact") -> Model: ...
    @staticmethod
    def load(path: str | os.PathLike[str]) -> Model: ...
    @staticmethod
    def from_bytes(data: bytes, name: str | None = None) -> Model: ...
    config: Final[_Config]
    metadata: Final[dict[str, str]]
    num_parameters: Final[int]
    recommended: Final[_Options]
    def encode(self, points: _Points, **options: Unpack[_EncodeOptions]) -> Field: ...

@final
class Field:
    def occupancy(self, queries: _Points) -> NDArray[np.float32]: ...
    def saliency(self, queries: _Points) -> NDArray[np.float32]: ...
    def occupancy_and_gradient(self, queries: _Points) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def saliency_and_gradient(self, queries: _Points) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def descriptors(self, queries: _Points) -> NDArray[np.float32]: ...
    volume: Final[NDArray[np.float32]]
    normalization: Final[tuple[_Positions, float]]
    orientation: Final[NDArray[np.float32]]
    def detect(self, **options: Unpack[_DetectOptions]) -> Keypoints: ...
    def mesh(self, **options: Unpack[_MeshOptions]) -> Mesh: ...
    notes: Final[list[str]]

@final
class FrameDetector:
    def __new__(cls, model: _Model, **options: Unpack[_Options]) -> Self: ...
    def detect(
        self, points: _Points, *, deadline: float | None = None, progress: _Progress | None = None
    ) -> Keypoints: ...

@final
class Keypoint:
    def __new__(
        cls,
        position: NDArray[Any],
        saliency: float,
        occupancy: float,
        nearest_index: int,
        confidence: float | None,
        covariance: NDArray[np.float32],
    ) -> Self: ...
    position: Final[NDArray[Any]]
    saliency: Final[float]
    occupancy: Final[float]
    nearest_index: Final[int]
    confidence: Final[float | None]
    covariance: Final[NDArray[np.float32]]

@final
class Keypoints:
    def __new__(
        cls,
        points: _Positions,
        saliency: NDArray[np.float32],
        occupancy: NDArray[np.float32],
        nearest_index: NDArray[np.int64],
        confidence: NDArray[np.float32],
        covariance: NDArray[np.float32],
        num_skipped: int,
        counts: dict[str, int],
        timing_seconds: dict[str, float],
        descriptors: NDArray[np.float32] | None = None,
        model: str | None = None,
        voxel_size: float | None = None,
        notes: list[str] = ...,
        weights: str | None = None,
    ) -> Self: ...
    descriptors: Final[NDArray[np.float32]]
    points: Final[_Positions]
    saliency: Final[NDArray[np.float32]]
    occupancy: Final[NDArray[np.float32]]
    nearest_index: Final[NDArray[np.int64]]
    confidence: Final[NDArray[np.float32]]
    covariance: Final[NDArray[np.float32]]
    num_skipped: Final[int]
    counts: Final[dict[str, int]]
    timing_seconds: Final[dict[str, float]]
    model: Final[str | None]
    voxel_size: Final[float | None]
    notes: Final[list[str]]
    def to_open3d(self) -> Any: ...
    def to_dict(self) -> dict[str, NDArray[Any]]: ...
    def save(self, path: _Path) -> None: ...
    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]: ...
    def __dlpack__(self, **options: Any) -> Any: ...
    def __dlpack_device__(self) -> tuple[int, int]: ...
    @overload
    def __getitem__(self, index: int, /) -> Keypoint: ...
    @overload
    def __getitem__(self, index: slice | NDArray[Any] | Sequence[int], /) -> Keypoints: ...
    def __iter__(self) -> Iterator[Keypoint]: ...
    def __len__(self) -> int: ...
    def _repr_html_(self) -> str: ...

@final
class Mesh:
    def __new__(
        cls,
        vertices: _Positions,
        normals: NDArray[np.float32],
        triangles: NDArray[np.uint32],
        notes: list[str] = ...,
    ) -> Self: ...
    notes: Final[list[str]]
    vertices: Final[_Positions]
    normals: Final[NDArray[np.float32]]
    triangles: Final[NDArray[np.uint32]]

def iss(
    points: _Points,
    *,
    count: int | None = None,
    protocol: Literal["ranked", "paper"] = "ranked",
    seed: int = 0,
    **options: Unpack[_IssOptions],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...
def harris3d(
    points: _Points,
    *,
    count: int | None = None,
    protocol: Literal["ranked", "paper"] = "ranked",
    seed: int = 0,
    **options: Unpack[_Harris3dOptions],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...
def sift3d(
    points: _Points,
    *,
    count: int | None = None,
    protocol: Literal["ranked", "paper"] = "ranked",
    seed: int = 0,
    **options: Unpack[_Sift3dOptions],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...
def surface_variation(
    points: _Points,
    *,
    count: int | None = None,
    protocol: Literal["ranked", "paper"] = "ranked",
    seed: int = 0,
    **options: Unpack[_SurfaceVariationOptions],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...
def farthest_points(points: _Points, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...
def random_points(points: _Points, count: int, seed: int = 0) -> tuple[NDArray[np.int64], NDArray[np.float64]]: ...
def run_command(words: list[str]) -> int: ...

@final
class PreparedMap:
    def __new__(
        cls,
        points: _Points,
        model: _Model | None = None,
        *,
        viewpoint: Sequence[float] | None = None,
        **options: Unpack[_RegistrationOptions],
    ) -> Self: ...
    def register(
        self,
        source: _Points,
        *,
        deadline: float | None = None,
        progress: _Progress | None = None,
        **options: Unpack[_PairOptions],
    ) -> Registration: ...
    voxel_size: Final[float]

# Results, written as the options.

@final
@dataclass(frozen=True, eq=False)
class Registration:
    t_target_source: NDArray[np.float64]
    scale: float
    verdict: Verdict
    fit: Fit
    matches: Matches
    clouds: list[CloudReport]
    hypotheses: list[Hypothesis]
    seconds: float

@final
@dataclass(frozen=True, eq=False)
class Verdict:
    confidence: float
    is_reliable: bool
    is_ambiguous: bool
    notes: list[str]
    weakest_constraint: float
    slide_margin: float
    repeat_fit: float
    free_space_violation: float

@final
@dataclass(frozen=True, eq=False)
class Fit:
    fitness: float
    rmse: float
    inlier_distance: float
    voxel_size: float
    information: NDArray[np.float64]

@final
@dataclass(frozen=True, eq=False)
class Matches:
    num_matches: int
    num_inliers: int
    rmse: float
    num_agreeing: int
    num_rival_agreeing: int
    spread: float

@final
@dataclass(frozen=True, eq=False)
class CloudReport:
    viewpoint: str
    position: list[float] | None
    visible: float | None
    num_skipped: int

@final
@dataclass(frozen=True, eq=False)
class Hypothesis:
    t_target_source: NDArray[np.float64]
    score: float
    num_inliers: int
    free_space_violation: float

@final
@dataclass(frozen=True, eq=False)
class Alignment:
    poses: list[Pose]
    parts: list[list[int]]
    edges: list[Edge]
    contradictions: list[Contradiction]
    notes: list[str]
    num_pairs: int
    num_skipped: list[int]
    seconds: float

@final
@dataclass(frozen=True, eq=False)
class Pose:
    part: int
    t_part_cloud: NDArray[np.float64]
    covariance: NDArray[np.float64]

@final
@dataclass(frozen=True, eq=False)
class Edge:
    source: int
    target: int
    t_target_source: NDArray[np.float64]
    confidence: float
    belief: float
    residual: float
    information: NDArray[np.float64]

@final
@dataclass(frozen=True, eq=False)
class Contradiction:
    source: int
    target: int
    distance: float
    tolerance: float

# The end of the results.

def aggregate(model: Model, points: _Points, features: ArrayLike) -> NDArray[np.float32]: ...
def interpolate(model: Model, volume: ArrayLike, queries: _Points) -> NDArray[np.float32]: ...
def interpolate_gradient(
    model: Model, volume: ArrayLike, queries: _Points, in_features: ArrayLike
) -> NDArray[np.float32]: ...
def decode(
    model: Model, quantity: Literal["occupancy", "saliency"], queries: _Points, features: ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
def refine(
    queries: _Points,
    gradients: ArrayLike,
    method: Literal["adam", "gradient-descent"] = "adam",
    step_size: float = 0.001,
) -> NDArray[np.float32]: ...
def suppress(
    points: _Points, scores: ArrayLike, radius: float, max_keypoints: int | None = None
) -> NDArray[np.int64]: ...
