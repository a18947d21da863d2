"""Recordings of ROS in Python."""

import struct
from pathlib import Path

import numpy as np
import pytest

import snake_rs

DATA = Path(__file__).parent / "data" / "io"


def drive(frame):
    """The points of a frame, as tests/data/io/generate_scenes.py makes them."""
    u, v = np.arange(1000) * 0.1, np.arange(1000) * 0.7
    ring = 1 + 0.3 * np.cos(v)
    return np.stack([ring * np.cos(u) + frame, ring * np.sin(u), 0.3 * np.sin(v)], axis=1).astype("<f4")


def test_the_clouds_of_a_recording_are_read_one_by_one():
    recording = snake_rs.read_recording(str(DATA / "drive.mcap"))
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


def mcap(messages):
    """A recording of the topic /points: https://mcap.dev/spec."""

    def text(value):
        return struct.pack("<I", len(value)) + value.encode()

    def record(kind, *parts):
        return struct.pack("<BQ", kind, len(b"".join(parts))) + b"".join(parts)

    schema = (text("sensor_msgs/msg/PointCloud2"), text("ros2msg"), text(""))
    records = [record(1, text("ros2"), text("")), record(3, struct.pack("<H", 1), *schema)]
    records.append(record(4, struct.pack("<HH", 0, 1), text("/points"), text("cdr"), bytes(4)))
    for number, data in enumerate(messages):
        records.append(record(5, struct.pack("<HIQQ", 0, number, number, number), data))
    return b"\x89MCAP0\r\n" + b"".join([*records, record(15, bytes(4)), record(2, bytes(20))]) + b"\x89MCAP0\r\n"


def test_georeferenced_clouds_of_float64_keep_their_digits(tmp_path):
    points = drive(0).astype(float) + [500123.25, 5412345.75, 431.5]
    (tmp_path / "far.mcap").write_bytes(mcap(message(cloud) for cloud in (points, np.r_[points, [[0, 0, 0]]])))
    expected = snake_rs.detect(points).points
    for cloud in snake_rs.read_recording(tmp_path / "far.mcap"):
        assert cloud.points.dtype == np.float64
        assert np.abs(cloud.points[:1000] - points).max() < 1e-6
        assert np.array_equal(snake_rs.detect(cloud).points, expected)


def test_recordings_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        snake_rs.read_recording(tmp_path / "none.mcap")
    with pytest.raises(ValueError, match=r"a folder; .*ros2 bag convert"):
        snake_rs.read_recording(tmp_path)
    (tmp_path / "drive.db3").write_bytes(b"SQLite format 3")
    with pytest.raises(ValueError, match=r"drive.db3: bags in SQLite are not read; .*ros2 bag convert"):
        snake_rs.read_recording(tmp_path / "drive.db3")
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
