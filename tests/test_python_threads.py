"""Threads in Python: the GIL, and identical results for any number of threads."""

import hashlib
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from golden_network import EASY, GOLDEN
from safetensors.numpy import load_file

import snake_rs


def test_the_gil_is_released_while_computing(model, field, points):
    many = np.tile(points, (30, 1))
    calls = [
        lambda: model.encode(many),
        lambda: field.saliency(many),
        lambda: field.occupancy_and_gradient(many),
        lambda: field.descriptors(many),
        lambda: field.detect(query_resolution=24),
        lambda: field.mesh(resolution=24, level=0.5),
        lambda: snake_rs.detect(many, model, query_resolution=12),
        lambda: snake_rs.baselines.iss(many, salient_radius=0.1, non_max_radius=0.1),
        lambda: snake_rs.register(points, points, max_keypoints=50),
        lambda: snake_rs.estimate_normals(many, 0.1),
        lambda: snake_rs.fpfh(points, points, 0.5),
    ]
    ticks, done = 0, threading.Event()

    def count():
        nonlocal ticks
        while not done.is_set():
            ticks += 1
            time.sleep(1e-4)

    interval = sys.getswitchinterval()
    thread = threading.Thread(target=count)
    thread.start()
    try:
        # With so long an interval the counter runs only while this thread gives the GIL up of its own accord.
        sys.setswitchinterval(60)
        for number, call in enumerate(calls):
            for _ in range(50):  # a busy machine may leave the counter asleep during one call
                before = ticks
                call()
                if ticks > before:
                    break
            else:
                pytest.fail(f"call {number} never released the GIL")
    finally:
        sys.setswitchinterval(interval)
        done.set()
        thread.join()


def digest():
    """One hash over all results on a golden network."""
    golden = load_file(GOLDEN / "odd" / "io.safetensors")
    model = snake_rs.Model.load(GOLDEN / "odd" / "weights.safetensors")
    field = model.encode(golden["points"], max_points=1000, seed=3)
    arrays = [field.volume, field.descriptors(golden["queries"])]
    arrays += [*field.occupancy_and_gradient(golden["points"]), *field.saliency_and_gradient(golden["points"])]
    for method in ("adam", "gradient-descent"):
        found = field.detect(**EASY | {"query_resolution": 16, "refine_method": method, "max_keypoints": 10**6})
        assert len(found) > 100
        arrays += [found.points, found.saliency, found.occupancy, found.nearest_index]
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def test_results_are_identical_for_any_number_of_threads():
    found = set()
    for threads in ("1", "2", "7"):
        command = [sys.executable, "-c", "import test_python_threads; print(test_python_threads.digest())"]
        environment = os.environ | {"RAYON_NUM_THREADS": threads}
        found.add(subprocess.check_output(command, cwd=Path(__file__).parent, env=environment, text=True))
    assert len(found) == 1 and len(found.pop().strip()) == 64
