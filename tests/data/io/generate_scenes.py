"""Writes scan.e57, scene.glb, scene.gltf and drive.mcap: python tests/data/io/generate_scenes.py.

Needs numpy, trimesh, pye57 and mcap-ros2-support.
"""

import base64
import json
import struct
from pathlib import Path

import numpy as np

CLOUD = np.array([[0, 0, 0], [1, -2, 0.5], [-0.25, 3, 100], [0.125, 0.001, -7]])
FOLDER = Path(__file__).parent
GOOD = FOLDER / "good"


def e57() -> None:
    import pye57

    path = GOOD / "scan.e57"
    path.unlink(missing_ok=True)
    file = pye57.E57(str(path), mode="w")
    columns = dict(zip(["cartesianX", "cartesianY", "cartesianZ"], CLOUD.T, strict=True))
    file.write_scan_raw(columns | {"intensity": np.full(4, 0.5)})
    file.close()


def gltf() -> None:
    import trimesh

    mesh = trimesh.Trimesh(CLOUD, [[0, 1, 2], [0, 2, 3]], process=False)
    scene = mesh.export(file_type="glb")
    (GOOD / "scene.glb").write_bytes(scene)
    # The same scene as one JSON file.
    (length,) = struct.unpack("<I", scene[12:16])
    tree = json.loads(scene[20 : 20 + length])
    data = base64.b64encode(scene[28 + length :]).decode()
    tree["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
    (GOOD / "scene.gltf").write_text(json.dumps(tree))


def drive(frame: int) -> np.ndarray:
    """The points of a frame of the recordings, (1000, 3)."""
    u, v = np.arange(1000) * 0.1, np.arange(1000) * 0.7
    ring = 1 + 0.3 * np.cos(v)
    return np.stack([ring * np.cos(u) + frame, ring * np.sin(u), 0.3 * np.sin(v)], axis=1).astype("<f4")


def mcap() -> None:
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    definition = """std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
===
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
===
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count
"""
    for name, compression in (("drive", CompressionType.ZSTD), ("drive_lz4", CompressionType.LZ4)):
        with (FOLDER / f"{name}.mcap").open("wb") as file:
            writer = Writer(file, compression=compression)
            schema = writer.register_msgdef("sensor_msgs/msg/PointCloud2", definition)
            for frame in range(2):
                points = drive(frame)
                fields = [{"name": n, "offset": 4 * i, "datatype": 7, "count": 1} for i, n in enumerate("xyz")]
                message = {
                    "header": {"stamp": {"sec": frame, "nanosec": 0}, "frame_id": "lidar"},
                    "height": 1,
                    "width": 1000,
                    "fields": fields,
                    "is_bigendian": False,
                    "point_step": 12,
                    "row_step": 12000,
                    "data": points.tobytes(),
                    "is_dense": True,
                }
                writer.write_message("/points", schema, message, log_time=frame * 10**9, publish_time=frame * 10**9)
            writer.finish()


if __name__ == "__main__":
    e57()
    gltf()
    mcap()
