"""Numbers far too large (`pytest tests/test_python_robust.py`)."""

import subprocess
import sys


def test_large_numbers_are_refused_or_work(tmp_path):
    """The call runs in a process of its own with 6 GB, which an abort would end."""
    code = """
import resource
import numpy as np
resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
import snake_rs
from snake_rs import baselines
snake_rs.set_num_threads(1)
few = np.random.default_rng(0).random((300, 3))
field = snake_rs.Model.builtin().encode(few)
def calls(n):
    yield lambda: snake_rs.set_num_threads(n)
    yield lambda: baselines.iss(few, min_neighbors=n)
    yield lambda: baselines.iss(few, count=n)
    yield lambda: baselines.sift3d(few, octaves=n)
    yield lambda: baselines.sift3d(few, scales_per_octave=n)
    yield lambda: baselines.farthest_points(few, n)
    yield lambda: baselines.random_points(few, n)
    for name in ("max_points", "rotations", "query_resolution", "query_band", "refine_steps", "max_keypoints"):
        yield lambda name=name: snake_rs.detect(few, **{name: n})
    yield lambda: field.mesh(resolution=n)
    for name in ("max_keypoints", "num_keypoints", "max_matches", "hypotheses"):
        yield lambda name=name: snake_rs.register(few, few, **{name: n})
    yield lambda: snake_rs.align([few, few], max_partners=n)
for n in (10**7, 2**64 - 1):
    for i, call in enumerate(calls(n)):
        print(n, i, flush=True)
        try:
            call()
        except (ValueError, OverflowError) as error:
            assert str(error)
        assert len(snake_rs.detect(few)) > 0
print("all")
"""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, timeout=900)
    assert done.stdout.endswith("all\n"), (done.stdout[-200:], done.stderr[-2000:])
