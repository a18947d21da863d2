"""The golden networks in tests of the Python module. They do not depend on how good the built-in model is."""

from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import load_file, save

GOLDEN = Path(__file__).parent / "golden"
# Every query scores, so that any network has candidates.
EASY = {"query_resolution": 12, "refine_steps": 3, "surface_threshold": 0.0, "saliency_threshold": 0.0}


def same(a, b):
    """Whether two Keypoints have the same bits."""
    names = ("points", "saliency", "occupancy", "nearest_index")
    return a.counts == b.counts and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def with_metadata(name, **metadata):
    """Bytes of a golden weight file with metadata added."""
    path = GOLDEN / name / "weights.safetensors"
    with safe_open(path, "np") as file:
        old = file.metadata()
    return save(load_file(path), metadata=old | metadata)
