"""Recordings of ROS in Python."""

import shutil
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest

import snake_rs

DATA = Path(__file__).parent / "data" / "io"
METADATA = "rosbag2_bagfile_information:\n  relative_file_paths: [drive_1.db3, drive_0.mcap]\n"


def drive(frame):
    """The points of a frame, as tests/data/io/generate_scenes.py makes them."""
    u, v = np.arange(1000) * 0.1, np.arange(1000) * 0.7
    ring = 1 + 0.3 * np.cos(v)
    return np.stack([ring * np.cos(u) + frame, ring * np.sin(u), 0.3 * np.sin(v)], axis=1).astype("<f4")


@pytest.mark.parametrize("name", ["drive.mcap", "drive.db3"])
def test_the_clouds_of_a_recording_are_read_one_by_one(name):
    recording = snake_rs.read_recording(str(DATA / name))
    assert recording.topic == "/points" and repr(recording) == "Recording(topic /points)"
    assert iter(recording) is recording
    for frame, cloud in enumerate(recording):
        assert (cloud.log_time, cloud.frame_id, cloud.points.dtype) == (frame * 10**9, "lidar", np.float32)
        assert np.array_equal(cloud.points, drive(frame))
        assert repr(cloud) == f"RecordedCloud(1000 points, log_time {frame}000000000, frame_id lidar)".replace(
            " 0000000000,", " 0,"
        )
        assert np.array_equal(snake_rs.detect(cloud).points, snake_rs.detect(drive(frame)).points)
    assert frame == 1 and next(recording, None) is None


def message(points):
    """A PointCloud2 of ROS 2 with float64 coordinates, in CDR."""
    data = bytearray()

    def put(kind, *values):
        for value in values:
            data.extend(b"\0" * (-len(data) % struct.calcsize(kind)) + struct.pack("<" + kind, value))

    def text(value):
        put("I", len(value) + 1)
        data.extend(value.encode() + b"\0")

    put("I", 0, 0)
    text("map")
    put("I", 1, len(points), 3)
    for i, name in enumerate("xyz"):
        text(name)
        put("I", 8 * i)
        put("B", 8)
        put("I", 1)
    put("B", 0)
    put("I", 24, 24 * len(points), 24 * len(points))
    data.extend(points.astype("<f8").tobytes() + b"\1")
    return b"\0\1\0\0" + bytes(data)


def test_georeferenced_clouds_of_float64_keep_their_digits(tmp_path):
    points = drive(0).astype(float) + [500123.25, 5412345.75, 431.5]
    bag = sqlite3.connect(tmp_path / "far.db3")
    bag.execute("create table topics (id integer, name text, type text, serialization_format text)")
    bag.execute("create table messages (id integer, topic_id integer, timestamp integer, data blob)")
    bag.execute("insert into topics values (1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr')")
    for number, cloud in enumerate((points, np.r_[points, [[0, 0, 0]]])):
        bag.execute("insert into messages values (?, 1, ?, ?)", (number, number, message(cloud)))
    bag.commit()
    bag.close()
    expected = snake_rs.detect(points).points
    for cloud in snake_rs.read_recording(tmp_path / "far.db3"):
        assert cloud.points.dtype == np.float64
        assert np.abs(cloud.points[:1000] - points).max() < 1e-6
        assert np.array_equal(snake_rs.detect(cloud).points, expected)


def test_the_folder_of_a_bag_has_the_clouds_of_its_files(tmp_path):
    shutil.copy(DATA / "drive.mcap", tmp_path / "drive_0.mcap")
    shutil.copy(DATA / "drive.db3", tmp_path / "drive_1.db3")
    (tmp_path / "metadata.yaml").write_text(METADATA)
    clouds = list(snake_rs.read_recording(tmp_path, topic="/points"))
    assert [cloud.log_time // 10**9 for cloud in clouds] == [0, 1, 0, 1]
    (tmp_path / "metadata.yaml").write_text("damaged: [")
    with pytest.raises(ValueError, match=r"metadata.yaml: no metadata of a bag of ROS 2"):
        snake_rs.read_recording(tmp_path)


def test_recordings_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        snake_rs.read_recording(tmp_path / "none.mcap")
    with pytest.raises(ValueError, match=r"metadata.yaml"):
        snake_rs.read_recording(tmp_path)
    with pytest.raises(ValueError, match="no messages of the topic /other; topics with point clouds: /points"):
        snake_rs.read_recording(DATA / "drive.mcap", topic="/other")
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    with pytest.raises(ValueError, match=r"bad.mcap: "):
        snake_rs.read_recording(tmp_path / "bad.mcap")
    # The clouds are whole, the end of the file is missing.
    (tmp_path / "cut.mcap").write_bytes((DATA / "drive.mcap").read_bytes()[:-20])
    recording = snake_rs.read_recording(tmp_path / "cut.mcap")
    assert [len(next(recording).points) for _ in range(2)] == [1000, 1000]
    with pytest.raises(ValueError, match=r"cut.mcap: cut short"):
        next(recording)
    assert next(recording, None) is None
    with pytest.raises(ValueError, match="read_recording"):
        snake_rs.detect(DATA / "drive.mcap")
