"""Fixtures of the tests of the Python module: a cloud, a golden network, its field and its keypoints; and what tests run."""

import importlib.util
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from golden_network import EASY, GOLDEN

import snake_rs


def pytest_configure(config):
    config.addinivalue_line("markers", "nightly: `make test-full` runs it, `make test` another one of its kind")


@pytest.fixture(scope="session")
def points():
    """A bumpy sphere off the origin, (700, 3) float32 in metres."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(700, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = 2 + 0.3 * np.sin(5 * direction[:, :1]) + 0.2 * np.sign(direction[:, 1:2])
    return (direction * radius + [3, -1, 0.5]).astype(np.float32)


@pytest.fixture(scope="session")
def model():
    return snake_rs.Model.load(GOLDEN / "odd" / "weights.safetensors")


@pytest.fixture(scope="session")
def field(model, points):
    return model.encode(points)


@pytest.fixture(scope="session")
def keypoints(field):
    return field.detect(**EASY, max_keypoints=10**6, nms_radius=0.3)


@pytest.fixture(scope="session")
def generate():
    """The script `tools/samples.py`, which casts rays at boxes."""
    spec = importlib.util.spec_from_file_location("samples", Path(__file__).parents[1] / "tools" / "samples.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


@pytest.fixture(scope="session")
def compiled():
    """The folder of the binaries and examples. `cargo test` has compiled them, so this takes no time after it."""
    root = Path(__file__).parents[1]
    build = ["cargo", "build", "--release", "--workspace", "--lib", "--bins", "--tests", "--examples"]
    subprocess.run(build, cwd=root, check=True, env=os.environ | {"PYO3_BUILD_EXTENSION_MODULE": "1"})
    return Path(os.environ.get("CARGO_TARGET_DIR", root / "target")) / "release"


@pytest.fixture(scope="session")
def object_storage():
    """A server of the S3 protocol with the bucket `clouds`: its file system and the `storage_options` of it."""
    moto = pytest.importorskip("moto.server", reason="S3 is not tested: pip install s3fs 'moto[server]'")
    s3fs = pytest.importorskip("s3fs", reason="S3 is not tested: pip install s3fs 'moto[server]'")
    running = moto.ThreadedMotoServer(port=0)
    running.start()
    try:
        host, port = running.get_host_and_port()
        options = {"key": "any", "secret": "any", "endpoint_url": f"http://{host}:{port}"}
        files = s3fs.S3FileSystem(**options)
        files.mkdir("clouds")
        yield files, options
    finally:
        running.stop()
