"""Writes the files of good/ that no one writes by hand: python tests/data/io/generate.py.

Needs open3d, laspy[lazrs] and plyfile.
"""

from pathlib import Path

import laspy
import numpy as np
import open3d as o3d
import plyfile

CLOUD = np.array([[0, 0, 0], [1, -2, 0.5], [-0.25, 3, 100], [0.125, 0.001, -7]])
GOOD = Path(__file__).parent / "good"


def las(name: str, point_format: int, version: str) -> None:
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = [0.001] * 3, [0, 0, 0]
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = CLOUD.T
    scan.write(GOOD / name)


cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(CLOUD))
cloud.paint_uniform_color([0.5, 0, 1])
o3d.io.write_point_cloud(str(GOOD / "compressed.pcd"), cloud, compressed=True)
cloud.normals = o3d.utility.Vector3dVector(np.tile([0, 0, 1], (4, 1)))
for name in ("colours.xyzrgb", "normals.xyzn"):
    o3d.io.write_point_cloud(str(GOOD / name), cloud)
mesh = o3d.geometry.TriangleMesh(cloud.points, o3d.utility.Vector3iVector([[0, 1, 2], [0, 2, 3]]))
mesh.compute_vertex_normals()
for name in ("mesh.obj", "mesh.off", "binary.stl"):
    o3d.io.write_triangle_mesh(str(GOOD / name), mesh)
np.savez(GOOD / "stored.npz", points=CLOUD, labels=np.arange(4))
np.savez_compressed(GOOD / "only_cloud.npz", weights=np.ones((4, 2)), scan=CLOUD.astype("f4"))
las("format_2.las", 2, "1.2")
las("format_7.las", 7, "1.4")
las("format_3.laz", 3, "1.2")
las("format_6.laz", 6, "1.4")
# The data set's own tools write a sweep in this way: x, y, z and reflectance of each point.
np.hstack([CLOUD, np.full((4, 1), 0.5)]).astype("<f4").tofile(GOOD.parent / "velodyne" / "000000.bin")
vertices = np.rec.fromarrays(CLOUD.T, names="X,Y,Z")
plyfile.PlyData([plyfile.PlyElement.describe(vertices, "vertex")]).write(GOOD / "upper_case.ply")
