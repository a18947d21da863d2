"""Alignment of all fragments of a scene beside Open3D's multiway registration.

    python tests/bench/alignment.py FOLDER [--scene PREFIX]

Prints the share of the fragments within 15 degrees and 0.3 m of the published poses after one common motion.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import scene_pairs


def ours(clouds: list[np.ndarray]) -> tuple[list[np.ndarray], list[list[int]]]:
    import snake_rs

    found = snake_rs.align(clouds)
    return found.poses, found.parts


def open3d_multiway(clouds: list[np.ndarray]) -> tuple[list[np.ndarray], list[list[int]]]:
    """Open3D's pipeline for fragments: neighbours by the order, other pairs by FPFH with RANSAC, then its pose graph."""
    import open3d as o3d
    import registration_peers as peers

    registration, size = o3d.pipelines.registration, 0.05
    downs = [peers.with_normals(points, size, to_origin=True) for points in clouds]
    features = [peers.fpfh(down, size) for down in downs]
    distance = 1.5 * size
    checkers = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        registration.CorrespondenceCheckerBasedOnDistance(distance),
    ]
    graph = registration.PoseGraph()
    pose = np.eye(4)
    graph.nodes.append(registration.PoseGraphNode(pose))
    for source in range(len(clouds)):
        for target in range(source + 1, len(clouds)):
            is_next = target == source + 1
            o3d.utility.random.seed(0)
            rough = registration.registration_ransac_based_on_feature_matching(
                downs[source],
                downs[target],
                features[source],
                features[target],
                True,
                distance,
                registration.TransformationEstimationPointToPoint(False),
                3,
                checkers,
                registration.RANSACConvergenceCriteria(100000, 0.999),
            )
            found = registration.registration_icp(
                downs[source],
                downs[target],
                distance,
                rough.transformation,
                registration.TransformationEstimationPointToPlane(),
            )
            information = registration.get_information_matrix_from_point_clouds(
                downs[source], downs[target], distance, found.transformation
            )
            # As in Open3D's reconstruction system, a loop closure has 30 % of the smaller cloud as inliers.
            least = 0.3 * min(len(downs[source].points), len(downs[target].points))
            if is_next:
                pose = found.transformation @ pose
                graph.nodes.append(registration.PoseGraphNode(np.linalg.inv(pose)))
            elif information[5, 5] < least:
                continue
            graph.edges.append(
                registration.PoseGraphEdge(source, target, found.transformation, information, uncertain=not is_next)
            )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(distance, 0.25, 0.1, 0),
    )
    return [np.asarray(node.pose) for node in graph.nodes], [list(range(len(clouds)))]


def common_motion(poses: list[np.ndarray], truth: list[np.ndarray], clouds: list[np.ndarray]) -> np.ndarray:
    """The least-squares motion of the found frame onto the published one, by the points of all clouds."""
    move = lambda pose, points: points[::50] @ pose[:3, :3].T + pose[:3, 3]
    found = np.concatenate([move(pose, points) for pose, points in zip(poses, clouds)])
    wanted = np.concatenate([move(pose, points) for pose, points in zip(truth, clouds)])
    u, _, v = np.linalg.svd((found - found.mean(0)).T @ (wanted - wanted.mean(0)))
    rotation = (u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v).T
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, wanted.mean(0) - rotation @ found.mean(0)
    return motion


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--split", default="val")
    parser.add_argument("--scene", default="sun3d", help="prefix of the fragments [default: sun3d]")
    parser.add_argument("--ours-only", action="store_true")
    arguments = parser.parse_args()
    known = scene_pairs.poses(scene_pairs.overlapping(arguments.scenes, arguments.split))
    names = sorted(name for name in known if name.startswith(arguments.scene))
    clouds = [np.load(arguments.scenes / arguments.split / f"{name}.npy") for name in names]
    truth = [known[name][1] for name in names]
    for name, method in [("snake-rs", ours)] + [("Open3D multiway", open3d_multiway)] * (not arguments.ours_only):
        start, cpu = time.perf_counter(), time.process_time()
        poses, parts = method(clouds)
        seconds, processor = time.perf_counter() - start, time.process_time() - cpu
        largest = parts[0]
        motion = common_motion(*([values[i] for i in largest] for values in (poses, truth, clouds)))
        errors = np.array([scene_pairs.errors(motion @ poses[i], truth[i]) for i in largest])
        right = np.sum((errors[:, 0] <= scene_pairs.MAX_DEGREES) & (errors[:, 1] <= scene_pairs.MAX_METRES))
        degrees, metres = np.median(errors, axis=0)
        print(
            f"{name}: {right} of {len(clouds)} fragments right, parts of {[len(part) for part in parts]}, median error "
            f"{degrees:.1f} degrees and {metres:.2f} m; {seconds:.0f} s, {processor:.0f} s of processor time"
        )


if __name__ == "__main__":
    main()
