"""Threads in Python: the GIL, and identical results for any number of threads."""

import sys
import threading
import time

import numpy as np
import pytest

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
