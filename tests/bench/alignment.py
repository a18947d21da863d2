"""Alignment of all fragments of a scene beside Open3D's multiway registration.

    python tests/bench/alignment.py FOLDER [--scene PREFIX] [--methods snake-rs] [--published-pairs]

Prints how many fragments are within 15 degrees and 0.3 m of the published poses after one common motion, and how well the
fragments of the published pairs fit by either poses. With --check-published, prints instead where the published transforms of
pairs do not fit the surfaces: ICP that starts at them moves far.
"""

import argparse
import itertools
import time
from pathlib import Path

import numpy as np
import scene_pairs
from scipy.spatial import cKDTree
from tqdm import tqdm

METHODS = OURS, OPEN3D = ["snake-rs", "open3d-multiway"]


def ours(clouds: list[np.ndarray]) -> tuple[list[np.ndarray], list[list[int]]]:
    import snake_rs

    found = snake_rs.align(clouds)
    return found.poses, found.parts


def open3d_multiway(
    clouds: list[np.ndarray], size: float, pairs: set[tuple[int, int]]
) -> tuple[list[np.ndarray], list[list[int]]]:
    """Open3D's pipeline for fragments: neighbours by the order and the given pairs by FPFH with RANSAC on voxels of a size in
    metres, then its pose graph."""
    import open3d as o3d
    import registration_peers as peers

    registration = o3d.pipelines.registration
    downs = [peers.with_normals(points, size, to_origin=True) for points in clouds]
    features = [peers.fpfh(down, size) for down in downs]
    distance = 1.5 * size
    graph = registration.PoseGraph()
    pose = np.eye(4)
    graph.nodes.append(registration.PoseGraphNode(pose))
    following = {(source, source + 1) for source in range(len(clouds) - 1)}
    for source, target in tqdm(sorted(following | pairs), "Open3D"):
        is_next = target == source + 1
        both = downs[source], downs[target]
        rough = peers.ransac(both, [features[source], features[target]], distance)
        to_plane = registration.TransformationEstimationPointToPlane()
        found = registration.registration_icp(*both, distance, rough.transformation, to_plane)
        information = registration.get_information_matrix_from_point_clouds(*both, distance, found.transformation)
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


def least_squares(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The motion (4, 4) of points (N, 3) onto others."""
    u, _, v = np.linalg.svd((found - found.mean(0)).T @ (wanted - wanted.mean(0)))
    rotation = (u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v).T
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, wanted.mean(0) - rotation @ found.mean(0)
    return motion


def common_motions(poses: np.ndarray, truth: np.ndarray, clouds: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The motions of the found frame onto the published one: by least squares over some points of all fragments, and by
    least squares over the largest set of fragments that are right by it (a consensus from every pair of fragments)."""
    points = np.stack([cloud[np.linspace(0, len(cloud) - 1, 100).astype(int)] for cloud in clouds])
    move = lambda motions: np.einsum("nij,nkj->nki", motions[:, :3, :3], points) + motions[:, None, :3, 3]
    found, wanted = move(poses), move(truth)
    fit = lambda chosen: least_squares(found[chosen].reshape(-1, 3), wanted[chosen].reshape(-1, 3))
    of_all = fit(np.arange(len(poses)))
    best, most = of_all, 0
    for first in range(len(poses)):
        for second in range(first):
            chosen = np.array([first, second])
            for _ in range(3):
                motion = fit(chosen)
                chosen = np.flatnonzero(is_right(motion, poses, truth))
                if len(chosen) > most:
                    best, most = motion, len(chosen)
                if len(chosen) == 0:
                    break
    return of_all, best


def is_right(motion: np.ndarray, poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    errors = np.array([scene_pairs.errors(motion @ pose, wanted) for pose, wanted in zip(poses, truth)])
    return (errors[:, 0] <= scene_pairs.MAX_DEGREES) & (errors[:, 1] <= scene_pairs.MAX_METRES)


def shares(pairs: list[tuple[int, int]], poses: np.ndarray, clouds: list[np.ndarray]) -> np.ndarray:
    """For pairs (source, target): the share of the source's points within 2.5 cm of the target by the poses."""
    trees, found = [cKDTree(cloud) for cloud in clouds], []
    for source, target in pairs:
        motion = np.linalg.inv(poses[target]) @ poses[source]
        points = clouds[source][::20] @ motion[:3, :3].T + motion[:3, 3]
        found.append(np.mean(trees[target].query(points, distance_upper_bound=0.025)[0] < 0.025))
    return np.array(found)


def check_published(pairs: list[scene_pairs.Pair]) -> None:
    """Prints how many published transforms ICP moves by more than 3 degrees or 0.1 m, and for these pairs by how much and how far
    it ends from `snake_rs.register`."""
    import registration_peers as peers

    import snake_rs

    moved = []
    for pair in tqdm(pairs, "ICP"):
        source, target = pair.clouds()
        transform = pair.t_target_source
        for _ in range(5):
            transform, _ = peers.icp(source, target, transform)
        by = scene_pairs.errors(transform, pair.t_target_source)
        if by[0] > 3 or by[1] > 0.1:
            found = snake_rs.register(source, target).t_target_source
            moved.append((pair, by, scene_pairs.errors(found, transform)))
    print(f"ICP moves {len(moved)} of {len(pairs)} published transforms by more than 3 degrees or 0.1 m")
    for pair, (degrees, metres), (ours_degrees, ours_metres) in moved:
        print(
            f"{pair.source.stem[-2:]}>{pair.target.stem[-2:]}, overlap {pair.overlap:.2f}: by {degrees:.1f} degrees and "
            f"{metres:.2f} m; ours is {ours_degrees:.1f} degrees and {ours_metres:.2f} m from where it ends"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--split", default="val")
    parser.add_argument("--scene", default="sun3d", help="prefix of the fragments [default: sun3d]")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--voxel-size", type=float, default=0.05, help="Open3D's, in metres [default: 0.05]")
    parser.add_argument(
        "--published-pairs", action="store_true", help="Open3D tries neighbours and pairs that overlap, not all"
    )
    parser.add_argument("--check-published", action="store_true", help="ICP from the published transforms of pairs")
    arguments = parser.parse_args()
    published = scene_pairs.overlapping(arguments.scenes, arguments.split)
    if arguments.check_published:
        distinct = {pair.name: pair for pair in published if pair.name.startswith(arguments.scene)}
        return check_published(list(distinct.values()))
    known = scene_pairs.poses(published)
    names = sorted(name for name in known if name.startswith(arguments.scene))
    clouds = [np.load(arguments.scenes / arguments.split / f"{name}.npy") for name in names]
    truth = [known[name][1] for name in names]
    ends = {(pair.source.stem, pair.target.stem) for pair in published}
    overlapping = sorted((names.index(a), names.index(b)) for a, b in ends if a in names and b in names)
    pairs = {(min(pair), max(pair)) for pair in overlapping}
    if not arguments.published_pairs:
        pairs = set(itertools.combinations(range(len(clouds)), 2))
    for name in arguments.methods:
        start, cpu = time.perf_counter(), time.process_time()
        poses, parts = ours(clouds) if name == OURS else open3d_multiway(clouds, arguments.voxel_size, pairs)
        seconds, processor = time.perf_counter() - start, time.process_time() - cpu
        largest = parts[0]
        of_part = lambda values: [values[i] for i in largest]
        placed, wanted, part = np.array(of_part(poses)), np.array(of_part(truth)), of_part(clouds)
        counts = [is_right(motion, placed, wanted).sum() for motion in common_motions(placed, wanted, part)]
        both = [(largest.index(a), largest.index(b)) for a, b in overlapping if a in largest and b in largest]
        of_found, of_published = shares(both, placed, part), shares(both, wanted, part)
        print(
            f"{name}: of {len(clouds)} fragments {counts[0]} right by least squares, {counts[1]} by the largest consensus; "
            f"parts of {[len(part) for part in parts]}; {seconds:.0f} s, {processor:.0f} s of processor time"
        )
        print(
            f"share of the points on the other fragment of {len(both)} pairs: {of_found.mean():.3f}, by the published "
            f"poses {of_published.mean():.3f}; larger by 0.02 in {np.sum(of_found > of_published + 0.02)} pairs, smaller "
            f"in {np.sum(of_found < of_published - 0.02)}"
        )


if __name__ == "__main__":
    main()
