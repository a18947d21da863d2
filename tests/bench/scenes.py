"""Where the keypoints of `scenes` lie, with the options that the model recommends: `python tests/bench/scenes.py CLOUD.npy ..`.

Of whole clouds (N, 3), the median distance from a keypoint to the cloud, in voxels. Of their halves, cut at the median of x, y and z, the
share of keypoints within two voxels of the cut, divided by the share of points there: 1 where keypoints do not mind the border. A folder
stands for its .npy files.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import snake_rs


def clouds(paths):
    """The clouds (N, 3) of files and folders, by name."""
    for path in map(Path, paths):
        for file in sorted(path.glob("*.npy")) if path.is_dir() else [path]:
            yield file.name, np.load(file)[:, :3].astype(np.float32)


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clouds", nargs="+")
    model = snake_rs.Model.builtin("scenes")
    near, expected = 0, 0.0
    for name, points in clouds(parser.parse_args().clouds):
        field = model.encode(points)
        found, voxel = field.detect(), field.normalization[1]
        print(
            f"{name}: {len(found)} keypoints, {np.median(cKDTree(points).query(found.points)[0]) / voxel:.2f} voxels away"
        )
        for axis in range(3):
            cut = np.median(points[:, axis])
            for half in (points[points[:, axis] < cut], points[points[:, axis] >= cut]):
                field = model.encode(half)
                found, reach = field.detect().points, 2 * field.normalization[1]
                near += (np.abs(found[:, axis] - cut) <= reach).sum()
                expected += (np.abs(half[:, axis] - cut) <= reach).mean() * len(found)
    print(f"keypoints at the cuts: {near}, {near / expected:.2f} times as many as points would give")


if __name__ == "__main__":
    main()
