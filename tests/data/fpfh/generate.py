"""Writes open3d.csv: a cloud with the normals and the FPFH that Open3D (0.20) computes for it.

Columns: x y z, normal (radius 0.5, towards the cloud's mean), the 33 numbers of FPFH (radius 0.8).
"""

from pathlib import Path

import numpy as np
import open3d as o3d

NORMAL_RADIUS, FEATURE_RADIUS = 0.5, 0.8

rng = np.random.default_rng(0)
u, v = rng.uniform(-1, 1, (2, 150))
# A wavy sheet off the origin, with a point apart that has no neighbours and one that is there twice.
points = np.stack([u, v, 0.3 * np.sin(4 * u) + 0.2 * np.cos(5 * v)], axis=1) + [1, -2, 5]
points[-1] = [9, 9, 9]
points[-2] = points[-3]
points = points.astype(np.float32)

cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))
cloud.estimate_normals(o3d.geometry.KDTreeSearchParamRadius(NORMAL_RADIUS))
cloud.orient_normals_towards_camera_location(points.astype(float).mean(0))
normals = np.asarray(cloud.normals).astype(np.float32)
normals[-1] = 0  # Open3D gives lone points (0, 0, 1)
cloud.normals = o3d.utility.Vector3dVector(normals.astype(float))
fpfh = o3d.pipelines.registration.compute_fpfh_feature(cloud, o3d.geometry.KDTreeSearchParamRadius(FEATURE_RADIUS))
table = np.concatenate([points.astype(float), normals.astype(float), fpfh.data.T], axis=1)
np.savetxt(Path(__file__).with_name("open3d.csv"), table, delimiter=",", fmt=["%.9g"] * 6 + ["%.7g"] * 33)
