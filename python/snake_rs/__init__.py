"""Repeatable 3-D keypoints from point clouds: SNAKE, the shape-aware neural 3D keypoint field, on the CPU.

    import snake_rs

    keypoints = snake_rs.detect("scan.ply")    # one call, built-in model
    keypoints.points, keypoints.saliency       # (K, 3), (K,)
    points = snake_rs.read_points("scan.ply")  # (N, 3), or any array, tensor or cloud that numpy can convert
    keypoints = snake_rs.detect(points, model="standard")
    many = snake_rs.detect([points, "scan.ply"])  # a list of clouds: a list of keypoints, on all cores
    keypoints.save("keypoints.ply")
    snake_rs.view(points)                      # the cloud with its keypoints, in the browser or in the notebook

    model = snake_rs.Model.load("weights.safetensors")
    field = model.encode(points)               # encode once, query many times
    saliency, gradient = field.saliency_and_gradient(points)
    keypoints = field.detect(nms_radius=0.05, max_keypoints=128)
    mesh = field.mesh(outer=True)              # vertices, normals (V, 3), triangles (T, 3)

    result = snake_rs.register(source, target)  # rigid registration of two clouds
    result.t_target_source, result.verdict.is_reliable  # (4, 4): p_target = R p_source + t
    floor = snake_rs.PreparedMap(points, voxel_size=0.05)  # a map: described once, for floor.register(scan)
    pairs = snake_rs.match(snake_rs.detect(source), snake_rs.detect(target))  # (M, 2), by keypoints.descriptors

    for cloud in snake_rs.read_recording("drive.mcap", topic="/points"):
        keypoints = snake_rs.detect(cloud)     # each cloud of a recording of ROS, with cloud.log_time and cloud.frame_id

    tiles = snake_rs.tiles("city.laz", tile=50, folder="city.tiles", voxel_size=0.1)  # clouds that do not fit into memory

Classical detectors are in snake_rs.baselines, the steps of a detection in snake_rs.steps,
classes for clusters in snake_rs.ray.
"""

# NumPy imports this lazily: a child forked while another thread imports it would wait for the import lock forever.
import numpy.ma  # noqa: F401

from . import baselines, steps
from ._core import (
    Alignment,
    CloudReport,
    Contradiction,
    DetectedTiles,
    Edge,
    Field,
    Fit,
    FrameDetector,
    Hypothesis,
    Keypoint,
    Keypoints,
    Matches,
    Mesh,
    Model,
    Pose,
    PreparedMap,
    RecordedCloud,
    Recording,
    Registration,
    Tiles,
    Verdict,
    __version__,
    align,
    detect,
    estimate_normals,
    fpfh,
    get_num_threads,
    match,
    read_points,
    read_recording,
    register,
    set_num_threads,
    tiles,
)
from ._view import View, view

__all__ = [
    "Alignment",
    "CloudReport",
    "Contradiction",
    "DetectedTiles",
    "Edge",
    "Field",
    "Fit",
    "FrameDetector",
    "Hypothesis",
    "Keypoint",
    "Keypoints",
    "Matches",
    "Mesh",
    "Model",
    "Pose",
    "PreparedMap",
    "RecordedCloud",
    "Recording",
    "Registration",
    "Tiles",
    "Verdict",
    "View",
    "__version__",
    "align",
    "baselines",
    "detect",
    "estimate_normals",
    "fpfh",
    "get_num_threads",
    "match",
    "read_points",
    "read_recording",
    "register",
    "set_num_threads",
    "steps",
    "tiles",
    "view",
]
