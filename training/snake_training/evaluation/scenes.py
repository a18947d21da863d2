"""The 3DMatch benchmark of detectors and descriptors on the fragments of scenes, as the long table of `tables`."""

import warnings
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from .datasets import apart_note, open_scenes, read_cloud, without_ending
from .methods import CLASSICAL, OWN, methods_of, read_keypoints
from .published import BEST
from .registration import (
    feature_matching_recall,
    information_matrix,
    inlier_ratio,
    mutual_nearest,
    overlap,
    ransac,
    registration_recall,
    squared_registration_error,
)
from .run import METHODS, by_method, progress, warn
from .views import spaced

VOXEL_SIZE = 0.03  # metres: fragments are reduced to voxels, with normals and FPFH of 2 and 7 of them
# Every salient point of our networks, on the surface, at least a voxel from the others.
SALIENT = {
    "saliency_threshold": 0.0, "mode_radius": None, "min_confidence": None, "snap": True, "nms_radius": VOXEL_SIZE, "rotations": 1,
    "normalization": "unit-cube",
}  # fmt: skip


@lru_cache(maxsize=64)
def reduced(path):
    """A fragment: its points (N, 3), the means of its voxels (V, 3), and their FPFH (V, 33)."""
    import snake_rs

    points = read_cloud(path)
    cells, index = np.unique(np.floor(points / VOXEL_SIZE), axis=0, return_inverse=True)
    sums = np.zeros_like(cells)
    np.add.at(sums, index.reshape(-1), points)
    voxels = sums / np.bincount(index.reshape(-1))[:, None]
    normals = snake_rs.estimate_normals(voxels, 2 * VOXEL_SIZE)
    return points, voxels, snake_rs.fpfh(voxels, normals, 7 * VOXEL_SIZE)


def registration(
    data, methods=METHODS, external=(), descriptors=("fpfh",), max_keypoints=BEST, nms_radius=None, limit=None, seed=0, output=None,
    paper=False,
):  # fmt: skip
    """Feature matching recall, inlier ratio and registration recall of methods; the units are scenes.

    `descriptors` are fpfh, of the nearest voxel, and names of `external`, of the nearest point in the file. Keypoints of files are also
    matched by the descriptors of their own files. `register` among the methods is `snake_rs.register`: it has a registration recall alone.
    """
    pairs, methods = open_scenes(data), methods_of(methods, external, others=("register",))
    pairs = [pairs[row] for row in spaced(len(pairs), limit)]
    folders = {method.name: method.folder for method in methods if method.folder}
    for name in descriptors:
        if name != "fpfh" and name not in folders:
            raise ValueError(f"descriptors name {name}: allowed are {', '.join(('fpfh', *folders))}")
    seeds = {
        path: seed + i for i, path in enumerate(dict.fromkeys(p for pair in pairs for p in (pair.source, pair.target)))
    }
    warn(
        apart_note(
            list(map(str, pairs)),
            lambda row: (read_cloud(pairs[row].target), read_cloud(pairs[row].source), pairs[row].t_target_source),
            range(len(pairs)),
        )
    )

    def file_of(path):
        """The name of a cloud in folders of keypoints."""
        return without_ending(path.relative_to(data))

    def features(method, path):
        """Its best keypoints of a fragment, and their descriptors by name."""
        points, voxels, fpfh = reduced(path)
        if not (method.name in CLASSICAL or method.folder or "preset" in method.options):
            method = type(method)(method.name, SALIENT | method.options)
        cloud = voxels if method.name in CLASSICAL else points
        spacing = OWN if nms_radius is None else nms_radius
        keypoints = method.find(cloud, file_of(path), seeds[path], max(max_keypoints), spacing)
        found = {}
        for name in dict.fromkeys([*descriptors, method.name] if method.folder else descriptors):
            places, rows = (voxels, fpfh) if name == "fpfh" else read_keypoints(folders[name], file_of(path))
            if rows is not None:
                found[name] = rows[cKDTree(places).query(keypoints)[1]] if len(keypoints) else rows[:0]
            elif name in descriptors:
                raise ValueError(f"--external {name}: no descriptors in its files")
        return keypoints, found

    def outcomes(method):
        """Rows (scene, method and descriptor, condition, pair, keypoints, correspondences, inlier ratio, squared error)."""
        known = {}
        for pair in progress(pairs, method.name):
            if known and known["scene"] != pair.scene:
                known.clear()
            known["scene"] = pair.scene
            for path in (pair.source, pair.target):
                if path not in known and method.name.partition(":")[0] != "register":
                    known[path] = features(method, path)
            source, target = reduced(pair.source)[0], reduced(pair.target)[0]
            information = pair.information
            if information is None:
                information = information_matrix(overlap(source, target, pair.t_target_source))

            def error(transform, pair=pair, information=information):
                return (
                    np.inf
                    if transform is None
                    else squared_registration_error(pair.t_target_source, transform, information)
                )

            if method.name.partition(":")[0] == "register":
                yield (
                    pair,
                    method.name,
                    "all voxels",
                    (np.nan, np.nan, np.nan, error(registered(source, target, method.options))),
                )
                continue
            (points_1, rows_1), (points_2, rows_2) = known[pair.source], known[pair.target]
            for name in rows_1:
                for count in max_keypoints:
                    matches = mutual_nearest(rows_1[name][:count], rows_2[name][:count])
                    first, second = points_1[matches[:, 0]], points_2[matches[:, 1]]
                    number = (len(points_1[:count]) + len(points_2[:count])) / 2
                    ratio = inlier_ratio(first, second, pair.t_target_source)
                    figures = number, len(matches), ratio, error(ransac(first, second, seed))
                    yield pair, f"{method.name} {name}", f"best {count}", figures

    def figures(method):
        grouped = {}
        for pair, name, condition, values in outcomes(method):
            grouped.setdefault((name, condition, pair.scene), []).append((pair.fragments, values))
        for (name, condition, scene), rows in grouped.items():
            fragments, values = zip(*rows)
            numbers, correspondences, ratios, errors = np.array(values).T
            all_figures = {
                "feature matching recall": np.nan if np.isnan(ratios).any() else feature_matching_recall(ratios),
                "inlier ratio": ratios.mean(), "registration recall": registration_recall(fragments, errors),
                "keypoints": numbers.mean(), "correspondences": correspondences.mean(),
            }  # fmt: skip
            for metric, value in all_figures.items():
                yield metric, name, condition, scene, float(value)

    settings = {
        "data": str(data), "descriptors": list(descriptors), "max_keypoints": list(max_keypoints), "nms_radius": nms_radius, "limit": limit,
        "seed": seed,
    }  # fmt: skip
    return by_method("registration", methods, output, settings, figures, "3dmatch" if paper else None)


def registered(source, target, options):
    """The transform of `snake_rs.register`, without a warning for each that is not reliable; None where it finds none."""
    import snake_rs

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            return snake_rs.register(source, target, **options).t_target_source
        except ValueError:
            return None
