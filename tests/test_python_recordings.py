"""Recordings of ROS in Python."""

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


def test_recordings_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        snake_rs.read_recording(tmp_path / "none.mcap")
    with pytest.raises(ValueError, match="no messages of the topic /other; topics with point clouds: /points"):
        snake_rs.read_recording(DATA / "drive.mcap", topic="/other")
    # The clouds are whole, the end of the file is missing.
    (tmp_path / "cut.mcap").write_bytes((DATA / "drive.mcap").read_bytes()[:-20])
    recording = snake_rs.read_recording(tmp_path / "cut.mcap")
    assert [len(next(recording).points) for _ in range(2)] == [1000, 1000]
    with pytest.raises(ValueError, match=r"cut.mcap: cut short"):
        next(recording)
    assert next(recording, None) is None
    with pytest.raises(ValueError, match="read_recording"):
        snake_rs.detect(DATA / "drive.mcap")
