"""Ten sets of options have the same model, keypoints and notes by the command line, Python, C and Rust."""

import ctypes
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import snake_rs

ROOT = Path(__file__).resolve().parents[1]
OPTIONS = [
    {},
    {"max_keypoints": 20, "nms_radius": "3r"},
    {"rotations": 3},
    {"rotations": 1},
    {"voxel_size": 0.1, "min_confidence": 0.0},
    {"voxel_size": "3r", "max_keypoints": 5, "min_confidence": 0.0},
    {"normalization": "principal-axes"},
    {"preset": "keypointnet"},
    {"preset": "standard", "max_keypoints": 7},
    {"voxel_size": 0},
]


def by_python(cloud, options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = snake_rs.detect(cloud, **options)
    assert [str(warning.message) for warning in caught] == found.notes
    return found.model, found.voxel_size, found.notes, np.c_[found.points, found.saliency, found.nearest_index]


def rows(found, keypoints):
    columns = [[keypoint[name] for name in ("x", "y", "z", "saliency", "nearest_index")] for keypoint in keypoints]
    return found["model"], found["voxel_size"], found["notes"], np.array(columns)


def by_command_line(program, file, options):
    named = [f"--set={name}={value}" for name, value in options.items() if name != "preset"]
    preset = ["--preset", options["preset"]] if "preset" in options else []
    run = [program, "detect", file, "--json", *named, *preset]
    found = json.loads(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
    return rows(found, found["keypoints"])


def by_rust(program, file, options):
    run = [program, file, json.dumps(options)]
    found = json.loads(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
    return rows(found, found["keypoints"])


class Cloud(ctypes.Structure):
    _fields_ = [("points", ctypes.c_void_p), ("num_points", ctypes.c_size_t), ("stride", ctypes.c_size_t)]


class Keypoint(ctypes.Structure):
    _fields_ = [
        ("position", ctypes.c_float * 3),
        ("saliency", ctypes.c_float),
        ("occupancy", ctypes.c_float),
        ("nearest_index", ctypes.c_size_t),
        ("confidence", ctypes.c_float),
        ("covariance", ctypes.c_float * 9),
    ]


def by_c(library, cloud, options):
    for name, result in {
        "snake_detection_keypoints": ctypes.POINTER(Keypoint),
        "snake_detection_num_keypoints": ctypes.c_size_t,
        "snake_detection_model": ctypes.c_char_p,
        "snake_detection_voxel_size": ctypes.c_float,
        "snake_detection_note": ctypes.c_char_p,
    }.items():
        getattr(library, name).restype = result
    model, found = ctypes.c_void_p(), ctypes.c_void_p()
    assert library.snake_model_auto(ctypes.byref(model)) == 0
    given = Cloud(cloud.ctypes.data, len(cloud), 3)
    assert library.snake_detect(model, given, json.dumps(options).encode(), ctypes.byref(found)) == 0
    keypoints = library.snake_detection_keypoints(found)[: library.snake_detection_num_keypoints(found)]
    table = np.array([[*k.position, k.saliency, k.nearest_index] for k in keypoints])
    name = library.snake_detection_model(found).decode()
    size = float(str(np.float32(library.snake_detection_voxel_size(found))))
    notes = [note.decode() for n in range(9) if (note := library.snake_detection_note(found, n))]
    library.snake_detection_free(found)
    library.snake_model_free(model)
    return name, size, notes, table


@pytest.mark.skipif(sys.platform != "linux", reason="the library has another name")
def test_ten_sets_of_options_have_one_result_by_all_interfaces(points, compiled, tmp_path):
    library = ctypes.CDLL(str(compiled / "libsnake_rs.so"))
    models = set()
    room = np.ascontiguousarray(snake_rs.read_points(ROOT / "samples/room/1.ply"), np.float32)
    for name, cloud in {"object": points, "room": room}.items():
        np.save(tmp_path / f"{name}.npy", cloud)
        cloud.tofile(tmp_path / f"{name}.f32")
        for options in OPTIONS:
            model, size, notes, keypoints = by_python(cloud, options)
            models.add((name, model))
            for other in (
                by_command_line(compiled / "snake-cli", tmp_path / f"{name}.npy", options),
                by_rust(compiled / "examples" / "choose", tmp_path / f"{name}.f32", options),
                by_c(library, cloud, options),
            ):
                assert (other[0], other[2]) == (model, notes) and np.isclose(other[1], size, rtol=1e-6), options
                assert len(other[3]) == len(keypoints) > 0 or "preset" in options, options
                assert len(other[3]) == len(keypoints), options
                assert np.allclose(other[3].reshape(-1, 5), keypoints, rtol=1e-6, atol=1e-7), options
    assert len(models) == 4
