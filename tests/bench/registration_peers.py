"""Open3D and KISS-Matcher on a pair of clouds, each followed by the same ICP."""

import time

import kiss_matcher
import numpy as np
import open3d as o3d

registration = o3d.pipelines.registration
ICP_VOXEL_SIZE = 0.05
ICP_STEPS = 30


def cloud(points: np.ndarray, voxel_size: float) -> o3d.geometry.PointCloud:
    found = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    return found.voxel_down_sample(voxel_size)


def with_normals(points: np.ndarray, voxel_size: float, to_origin: bool) -> o3d.geometry.PointCloud:
    found = cloud(points, voxel_size)
    found.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel_size, max_nn=30))
    if to_origin:
        found.orient_normals_towards_camera_location(np.zeros(3))
    return found


def fpfh(down: o3d.geometry.PointCloud, voxel_size: float) -> registration.Feature:
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel_size, max_nn=100)
    return registration.compute_fpfh_feature(down, search)


def icp(source: np.ndarray, target: np.ndarray, rough: np.ndarray) -> tuple[np.ndarray, float]:
    """Point-to-plane ICP on 5 cm voxels; the transform and Open3D's fitness."""
    target_cloud = with_normals(target, ICP_VOXEL_SIZE, to_origin=False)
    found = registration.registration_icp(
        cloud(source, ICP_VOXEL_SIZE),
        target_cloud,
        1.5 * ICP_VOXEL_SIZE,
        rough,
        registration.TransformationEstimationPointToPlane(),
        registration.ICPConvergenceCriteria(max_iteration=ICP_STEPS),
    )
    return found.transformation, found.fitness


def ransac(clouds: list, features: list, distance: float) -> registration.RegistrationResult:
    """RANSAC over matches of two clouds' features that lie within a distance of each other."""
    checkers = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        registration.CorrespondenceCheckerBasedOnDistance(distance),
    ]
    estimation = registration.TransformationEstimationPointToPoint(False)
    criteria = registration.RANSACConvergenceCriteria(100000, 0.999)
    o3d.utility.random.seed(0)
    return registration.registration_ransac_based_on_feature_matching(
        *clouds, *features, True, distance, estimation, 3, checkers, criteria
    )


def open3d_rough(source, target, voxel_size: float, method: str, to_origin: bool) -> np.ndarray:
    """FPFH with RANSAC or with fast global registration, by the options of Open3D's tutorial."""
    clouds = [with_normals(points, voxel_size, to_origin) for points in (source, target)]
    features = [fpfh(down, voxel_size) for down in clouds]
    if method == "ransac":
        return ransac(clouds, features, 1.5 * voxel_size).transformation
    o3d.utility.random.seed(0)
    option = registration.FastGlobalRegistrationOption(maximum_correspondence_distance=0.5 * voxel_size)
    return registration.registration_fgr_based_on_feature_matching(*clouds, *features, option).transformation


def kiss_rough(source, target, voxel_size: float) -> tuple[np.ndarray, int]:
    """KISS-Matcher with its defaults; the transform and its count of inliers."""
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_size))
    solution = matcher.estimate(list(source), list(target))
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = solution.rotation, solution.translation
    return transform, matcher.get_num_final_inliers()


def run(method: str, source: np.ndarray, target: np.ndarray) -> dict:
    """A peer's transforms before and after ICP, its score and seconds; `method` is name, voxel size, options."""
    name, voxel_size, *options = method.split("/")
    start = time.perf_counter()
    score = None
    if name == "kiss":
        rough, score = kiss_rough(source, target, float(voxel_size))
    else:
        rough = open3d_rough(source, target, float(voxel_size), name, "oriented" in options)
    refined, fitness = icp(source, target, rough)
    seconds = time.perf_counter() - start
    score = fitness if score is None else score
    return {"rough": rough.tolist(), "refined": refined.tolist(), "score": score, "seconds": seconds}
