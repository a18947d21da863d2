"""Writes compact_fields.json: fields of the built-in weights, which scatter softly, by the PyTorch network.

`python tests/data/compact_fields.py` from the root of the repository, after every change of these weights. The test that
compares snake-core with it is crates/snake-core/tests/compact_fields.rs.
"""

import json
from pathlib import Path

import numpy as np
import torch

from snake_training.data.shapes import box, sample_surface
from snake_training.export import load_network

ROOT = Path(__file__).parents[2]


def main():
    """Points (300, 3) and queries (64, 3) in network units, occupancy and saliency (64,)."""
    rng = np.random.default_rng(7)
    points = sample_surface(box((0.9, 0.5, 0.3)), 300, rng).round(4).astype(np.float32)
    near = points[:48] + rng.normal(scale=0.02, size=(48, 3))
    queries = np.concatenate([near, rng.uniform(-0.5, 0.5, (16, 3))]).round(4).astype(np.float32)
    network = load_network(ROOT / "crates/snake-core/models/compact.safetensors")
    with torch.no_grad():
        fields = network(torch.from_numpy(points)[None], torch.from_numpy(queries)[None], False)
    occupancy, saliency = ([round(float(value), 6) for value in field[0]] for field in fields)
    rows = {
        "points": points.round(4).astype(float).round(4).tolist(),
        "queries": queries.astype(float).round(4).tolist(),
    }
    fields = rows | {"occupancy": occupancy, "saliency": saliency}
    (ROOT / "tests/data/compact_fields.json").write_text(json.dumps(fields).replace("], ", "],\n") + "\n")


if __name__ == "__main__":
    main()
