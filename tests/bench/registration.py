"""Registration beside Open3D and KISS-Matcher: how often each is right, and seconds a pair, ICP included.

    make bench-registration SCENES=FOLDER OBJECTS=FOLDER

FOLDER of scenes has clouds (.npy) and `pairs.json`, that of objects `points.npy` (N, P, 3), a row for each; the sweeps of a simulated
LiDAR are made. Results are kept in the file of `--results` as they come: what is there does not run again.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from made_pairs import box, camera, camera_room, clear, errors, furnished, lidar, pose, twice
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from tqdm import tqdm

from snake_training.data.solids import Solids, about_axis, scan
from snake_training.data.worlds import any_turn

# The peers have voxels of 3, 5 and 8 cm: objects are 4 m across, and sweeps are in units of 10 m.
METHODS = ["snake-rs", *(f"{name}/{size}" for size in (0.03, 0.05, 0.08) for name in ("kiss", "ransac", "fgr"))]
METHODS += ["ransac/0.05/oriented", "fgr/0.05/oriented"]
DIAMETER, UNIT = 4.0, 10.0


class Pair(NamedTuple):
    """A name, a group of the table, two clouds (N, 3) when they are asked for, and whether a transform (4, 4) is right."""

    name: str
    group: str
    clouds: Callable[[], tuple[np.ndarray, np.ndarray]]
    is_right: Callable[[np.ndarray], bool]


def within(truth: np.ndarray, degrees: float, metres: float) -> Callable[[np.ndarray], bool]:
    return lambda transform: bool(np.all(np.array(errors(transform, truth)) <= (degrees, metres)))


def scenes(folder: Path) -> Iterator[Pair]:
    """The published pairs, right within 15 degrees and 0.3 m."""
    for row in json.loads((folder / "pairs.json").read_text()):
        files = [folder / f"{row[end]}.npy" for end in ("source", "target")]
        low = max(limit for limit in (0.1, 0.3, 0.5) if row["overlap"] >= limit or limit == 0.1)
        is_right = within(np.array(row["T"]), 15, 0.3)
        clouds = lambda files=files: tuple(map(np.load, files))
        yield Pair(f"{row['source']}>{row['target']}", f"overlap from {low}", clouds, is_right)


def objects(folder: Path, count: int) -> Iterator[Pair]:
    """Two parts of an object, each cut by a plane that leaves 30 to 70 % of its own half of the points, any rotation. At least 0.3 of the
    source is within 2 % of the diameter of the target. A right transform moves its points so near to any point of the object (ADD-S)."""
    stored, rng, limit = np.load(folder / "points.npy", mmap_mode="r"), np.random.default_rng(0), 0.02 * DIAMETER
    for index in rng.permutation(len(stored)):
        points = rng.permutation(np.asarray(stored[index], float))
        points -= points.mean(axis=0)
        points *= DIAMETER / (2 * np.linalg.norm(points, axis=1).max())
        parts = []
        for half in (points[::2], points[1::2]):
            height = half @ any_turn(rng)[0]
            parts.append(half[height < np.quantile(height, rng.uniform(0.3, 0.7))].astype("f4"))
        if np.mean(cKDTree(parts[1]).query(parts[0])[0] < limit) < 0.3:
            continue
        truth = np.eye(4)
        truth[:3, :3], truth[:3, 3] = any_turn(rng), rng.uniform(-2, 2, 3)
        source, target = parts[0], moved(truth, parts[1]).astype("f4")
        tree, whole = cKDTree(moved(truth, points[::4])), points[::4]
        is_right = lambda found, tree=tree, whole=whole: bool(tree.query(moved(found, whole))[0].mean() < limit)
        yield Pair(f"object {index}", "objects", lambda source=source, target=target: (source, target), is_right)
        count -= 1
        if count == 0:
            return


def moved(transform: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ transform[:3, :3].T + transform[:3, 3]


def seen(points: np.ndarray, noise: float, rng) -> np.ndarray:
    """Points of a depth camera that looks along x, with noise that grows with the square of the depth."""
    return points * (1 + noise * points[:, :1] * rng.normal(size=(len(points), 1)))


def on_depth_frames(seeds: range) -> None:
    """Prints the errors of reliable transforms of depth frames with noise of 0.0015 z^2, and of small_gicp from the truth. Then of
    frames 6 cm apart, without and with this noise, how many matches are right within 0.1 m: by FPFH and by the network."""
    import small_gicp

    import snake_rs

    rows, options = [], dict(registration_type="GICP", downsampling_resolution=0.03, max_correspondence_distance=0.15)
    model, shares = snake_rs.Model.builtin("scenes"), {}
    for rng in map(np.random.default_rng, tqdm(seeds, mininterval=1)):
        pair = camera_room(rng, (320, 240), 0.0)
        source, target = (seen(points, 0.0015, rng) for points in (pair.source, pair.target))
        ours = snake_rs.register(source, target)
        if ours.verdict.is_reliable:
            theirs = small_gicp.align(target, source, pair.right[0], **options).T_target_source
            rows.append([errors(transform, pair.right[0]) for transform in (ours.t_target_source, theirs)])
        world, turn = furnished(rng), rng.uniform(0, 360)
        at = clear(world, rng)
        pair = twice(world, [pose(at, turn), pose(at + [0.06, 0, 0], turn)], camera(320, 240), rng, 0.0, 10.0)
        for noise in (0.0, 0.0015):
            fields = [model.encode(seen(points, noise, rng)) for points in (pair.source, pair.target)]
            found = [field.detect() for field in fields]
            if not all(map(len, found)):
                continue
            apart = cdist(*(field.descriptors(keypoints.points) for field, keypoints in zip(fields, found)))
            mutual = [(i, j) for i, j in enumerate(apart.argmin(axis=1)) if apart[:, j].argmin() == i]
            for name, matches in ("FPFH", snake_rs.match(*found)), ("network", mutual):
                ends = [keypoints.points[index] for keypoints, index in zip(found, np.transpose(matches), strict=True)]
                right = np.linalg.norm(moved(pair.right[0], ends[0]) - ends[1], axis=1) < 0.1
                shares.setdefault((name, noise), []).extend(right)
    for name, (degrees, metres) in zip(("snake-rs", "small_gicp"), np.median(rows, axis=0), strict=True):
        print(f"{name}: {degrees:.3f} degrees, {1000 * metres:.1f} mm, median of {len(rows)}")
    for (name, noise), right in shares.items():
        print(f"matches by {name}, noise {noise} z^2: {np.mean(right):.2f} of {len(right)} are right")


def sweeps(count: int) -> Iterator[Pair]:
    """Sweeps from two positions 10 m apart along a street; the heading is random and the tilt up to 2 degrees."""
    for index in range(count):
        rng = np.random.default_rng([0, index])
        world, clouds, poses = street(rng), [], []
        for x in (-5.0, 5.0):
            heading, (roll, pitch) = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(-2, 2, 2))
            u, _, v = np.linalg.svd(about_axis(2, heading) @ [[1, 0, pitch], [0, 1, -roll], [-pitch, roll, 1]])
            poses.append(np.eye(4))
            poses[-1][:3, :3], poses[-1][:3, 3] = u @ v, [x, rng.uniform(-1.5, 1.5), 1.8]
            cloud = scan(world, poses[-1], lidar(64, 900, -24.8, 2), 0.02, 80.0, rng)
            clouds.append((cloud / UNIT).astype("f4"))
        truth = np.linalg.inv(poses[1]) @ poses[0]
        truth[:3, 3] /= UNIT
        yield Pair(f"sweep {index}", "sweeps", lambda clouds=clouds: clouds, within(truth, 5, 0.6 / UNIT))


def street(rng: np.random.Generator) -> Solids:
    """A street along the x axis in metres: buildings, cars and poles on z = 0."""
    world = Solids()
    for side in (-1, 1):
        x = -90.0
        while x < 100:
            length, setback, depth, height = rng.uniform([8, 6, 6, 4], [25, 12, 15, 18])
            box(world, [x + length / 2, side * (setback + depth / 2), height / 2], [length, depth, height])
            x += length + rng.uniform(0, 8)
        for at in rng.uniform(-80, 90, 12):
            box(world, [at + 2.1, side * rng.uniform(3, 5), 0.75], [4.2, 1.8, 1.5])
        for at in rng.uniform(-80, 90, 10):
            box(world, [at + 0.15, side * 5.5, 3], [0.3, 0.3, 6])
    box(world, [0, 0, -0.5], [400, 400, 1])
    return world


def snake_rs(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    import snake_rs

    try:
        return snake_rs.register(source, target).t_target_source
    except ValueError:  # nothing fits
        return np.eye(4)


def kiss(source: np.ndarray, target: np.ndarray, voxel_size: float) -> np.ndarray:
    """KISS-Matcher with its defaults."""
    import kiss_matcher

    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_size))
    solution, transform = matcher.estimate(list(source), list(target)), np.eye(4)
    transform[:3, :3], transform[:3, 3] = solution.rotation, solution.translation
    return transform


def reduced(points: np.ndarray, voxel_size: float, is_oriented: bool = False):
    """A cloud of Open3D of voxels with normals."""
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud = cloud.voxel_down_sample(voxel_size)
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel_size, max_nn=30))
    if is_oriented:
        cloud.orient_normals_towards_camera_location(np.zeros(3))
    return cloud


def open3d_fpfh(name: str, source: np.ndarray, target: np.ndarray, voxel_size: float, is_oriented: bool) -> np.ndarray:
    """FPFH with RANSAC or with fast global registration, by the options of Open3D's tutorial."""
    import open3d

    api = open3d.pipelines.registration
    clouds = [reduced(points, voxel_size, is_oriented) for points in (source, target)]
    search = open3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel_size, max_nn=100)
    features = [api.compute_fpfh_feature(cloud, search) for cloud in clouds]
    open3d.utility.random.seed(0)
    if name == "fgr":
        option = api.FastGlobalRegistrationOption(maximum_correspondence_distance=0.5 * voxel_size)
        return api.registration_fgr_based_on_feature_matching(*clouds, *features, option).transformation
    distance = 1.5 * voxel_size
    checkers = [api.CorrespondenceCheckerBasedOnEdgeLength(0.9), api.CorrespondenceCheckerBasedOnDistance(distance)]
    estimation, criteria = api.TransformationEstimationPointToPoint(False), api.RANSACConvergenceCriteria(100000, 0.999)
    return api.registration_ransac_based_on_feature_matching(
        *clouds, *features, True, distance, estimation, 3, checkers, criteria
    ).transformation


def icp(source: np.ndarray, target: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """30 steps of point-to-plane ICP on 5 cm voxels, after each peer."""
    import open3d

    api, clouds = open3d.pipelines.registration, [reduced(points, 0.05) for points in (source, target)]
    estimation, criteria = api.TransformationEstimationPointToPlane(), api.ICPConvergenceCriteria(max_iteration=30)
    return api.registration_icp(*clouds, 0.075, rough, estimation, criteria).transformation


def run(method: str, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The transform of a method: its name, or that of a peer, its voxel size and options."""
    name, *options = method.split("/")
    if name == "snake-rs":
        return snake_rs(source, target)
    size, is_oriented = float(options[0]), "oriented" in options
    rough = kiss(source, target, size) if name == "kiss" else open3d_fpfh(name, source, target, size, is_oriented)
    return icp(source, target, rough)


def results(pairs: list[Pair], methods: list[str], file: Path, cores: int) -> dict[tuple[str, str], dict]:
    """What each method makes of each pair; methods take turns."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    known = {(row["pair"], row["method"]): row for row in rows if row["cores"] == cores}
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as out:
        for pair in tqdm(pairs, mininterval=1):
            for method in methods:
                if (pair.name, method) in known:
                    continue
                clouds, start = pair.clouds(), time.perf_counter()
                transform = run(method, *clouds).tolist()
                row = {"seconds": time.perf_counter() - start, "transform": transform}
                known[pair.name, method] = row
                out.write(json.dumps({"pair": pair.name, "method": method, "cores": cores} | row) + "\n")
                out.flush()
    return known


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, help="folder of scenes")
    parser.add_argument("--objects", type=Path, help="folder of objects")
    parser.add_argument("--made", type=int, default=20, help="pairs of objects, and of sweeps [default: 20]")
    parser.add_argument("--methods", nargs="+", default=METHODS, help="some of " + " ".join(METHODS))
    parser.add_argument(
        "--depth-frames", type=int, nargs=2, help="instead: made frames of a range of seeds, for accuracy"
    )
    parser.add_argument("--cores", type=int, default=os.cpu_count(), help="cores of each [default: all]")
    parser.add_argument("--results", type=Path, default=Path("target/bench-registration.jsonl"))
    arguments = parser.parse_args()
    # Before the libraries start their threads: each counts the cores that it may use.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: arguments.cores])
    os.environ["OMP_NUM_THREADS"] = str(arguments.cores)
    if arguments.depth_frames:
        return on_depth_frames(range(*arguments.depth_frames))
    pairs = list(scenes(arguments.scenes)) if arguments.scenes else []
    pairs += objects(arguments.objects, arguments.made) if arguments.objects else ()
    pairs += sweeps(arguments.made)
    found = results(pairs, arguments.methods, arguments.results, arguments.cores)
    groups = sorted({pair.group: [other for other in pairs if other.group == pair.group] for pair in pairs}.items())
    print("| right, median seconds | " + " | ".join(f"{name} ({len(some)})" for name, some in groups) + " |")
    print("|---" * (len(groups) + 1) + "|")
    for method in arguments.methods:
        cells = []
        for _, some in groups:
            rows = [(pair, found[pair.name, method]) for pair in some]
            share = np.mean([pair.is_right(np.array(row["transform"])) for pair, row in rows])
            cells.append(f"{share:.3f}, {np.median([row['seconds'] for _, row in rows]):.2f}")
        print(f"| {method} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
