"""Functions that Ray maps over rows, without a cluster: a row's error stays its own, and a temporary fault is tried again."""

import sys

import numpy as np
import pytest
from web_server import serving

import snake_rs

pytest.importorskip("fsspec", reason="rows are not tested: pip install 'ray[data]'")
pa = pytest.importorskip("pyarrow", reason="rows are not tested: pip install 'ray[data]'")
module = pytest.importorskip("snake_rs.ray", reason="rows are not tested: pip install 'ray[data]'")
OPTIONS = {"query_resolution": 16, "saliency_threshold": 0.1}


@pytest.fixture(autouse=True)
def without_a_cluster(monkeypatch):
    from snake_rs import _remote

    monkeypatch.setattr(module, "_use_own_cpus", lambda: None)
    monkeypatch.setattr(_remote, "_PAUSES", (0.01, 0.01, 0.01))


@pytest.fixture(scope="module")
def cloud():
    """The surface of a box."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (600, 3))
    points[np.arange(600), rng.integers(0, 3, 600)] = rng.choice([-1, 1], 600)
    return (points * [1, 2, 0.7]).astype(np.float32)


@pytest.fixture(scope="module")
def server(cloud, tmp_path_factory):
    """A web server: later.npy fails twice before it is there, and never.npy, 403.npy and 500.npy always."""
    folder = tmp_path_factory.mktemp("web")
    for name in ("good", "later", "never"):
        np.save(folder / f"{name}.npy", cloud)
    always = {f"{status}.npy": [status] * 99 for status in (403, 500)}
    with serving(folder, {"later.npy": [503] * 2, "never.npy": [503] * 99, **always}) as running:
        yield running.url


def test_each_bad_row_has_its_own_error(server, cloud, tmp_path, monkeypatch):
    # As if s3fs were not installed.
    monkeypatch.setitem(sys.modules, "s3fs", None)
    monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, "s3", raising=False)
    np.save(tmp_path / "good.npy", cloud)
    (tmp_path / "bad.npy").write_bytes(b"no array")
    rows = {
        str(tmp_path / "good.npy"): None,
        f"{server}/good.npy": None,
        f"{server}/later.npy": None,
        None: "the path is null",
        "": "",
        str(tmp_path / "missing.npy"): "FileNotFoundError",
        str(tmp_path / "bad.npy"): "bad.npy",
        str(tmp_path): "",
        f"{server}/404.npy": "FileNotFoundError",
        f"{server}/403.npy": "403",
        f"{server}/500.npy": "500",
        f"{server}/never.npy": "503",
        "http://127.0.0.1:9/refused.npy": "127.0.0.1",
        "s3://bucket/cloud.npy": "s3fs",
        "nothing://bucket/cloud.npy": "nothing",
    }
    found = module.DetectClouds(**OPTIONS)(pa.table({"path": list(rows)})).to_pylist()
    number = len(snake_rs.detect(cloud, **OPTIONS))
    assert number > 0 and len(found) == len(rows)
    for row, expected in zip(found, rows.values(), strict=True):
        if expected is None:
            assert row["error"] is None and len(row["keypoints"]) == number, row["error"]
        else:
            assert row["keypoints"] is None and expected in row["error"], (row["path"], row["error"])


def test_points_of_a_row_may_be_wrong(cloud):
    good = cloud.ravel().tolist()
    rows = [good, None, [], [1.0, None, 2.0], [1.0, 2.0], [float("nan")] * 9, good]
    found = module.DetectClouds(**OPTIONS)(pa.table({"points": rows, "name": range(7)})).to_pylist()
    assert [row["error"] is None for row in found] == [True, False, False, False, False, False, True]
    assert "null" in found[1]["error"] and "null" in found[3]["error"]
    assert found[0]["keypoints"] == found[6]["keypoints"] and found[6]["name"] == 6 and "points" not in found[0]


def test_columns_that_are_there_stay_and_are_the_error_of_their_rows(cloud, tmp_path):
    np.save(tmp_path / "good.npy", cloud)
    path = [str(tmp_path / "good.npy")] * 2
    for taken in ({"keypoints": ["mine", "yours"]}, {"error": ["mine", None]}, {"error": [0.5, 0.25]}):
        found = module.DetectClouds(**OPTIONS)(pa.table({"path": path, **taken}))
        assert found.column_names.count("error") == found.column_names.count("keypoints") == 1
        (name, values) = next(iter(taken.items()))
        for error, value in zip(found["error"].to_pylist(), values, strict=True):
            assert f"the column {name} already" in error and (name != "error" or repr(value) in error)
        if name == "keypoints":
            assert found["keypoints"].to_pylist() == values
    found = module.RegisterPairs()(pa.table({"source": path, "target": path, "confidence": [1, 2]}))
    assert found["confidence"].to_pylist() == [1, 2]
    assert all("the column confidence already" in error for error in found["error"].to_pylist())


def test_each_bad_pair_has_its_own_error(server, tmp_path):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (4000, 3)) * [1, 0.7, 0.4]
    points[np.arange(4000), rng.integers(0, 3, 4000)] *= 0.05
    good = str(tmp_path / "good.npy")
    np.save(good, points)
    table = pa.table({"source": [good, None, good, f"{server}/403.npy"], "target": [good, good, None, good]})
    errors = module.RegisterPairs(seed=3)(table)["error"].to_pylist()
    assert errors[0] is None and "null" in errors[1] and "null" in errors[2] and "403" in errors[3]


def test_a_mistake_of_the_job_ends_it_at_its_beginning():
    for step in (module.DetectClouds, module.RegisterPairs):
        with pytest.raises(TypeError, match="colour"):
            step(colour=1)
    with pytest.raises(ValueError, match="the column path or points"):
        module.DetectClouds()(pa.table({"file": ["a.npy"]}))
    with pytest.raises(ValueError, match="the column target"):
        module.RegisterPairs()(pa.table({"source": ["a.npy"]}))


def test_a_full_disk_ends_the_job(monkeypatch, tmp_path):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "detect", full)
    step = module.DetectClouds.__new__(module.DetectClouds)
    step.model, step.storage_options, step.options = None, {}, {}
    with pytest.raises(OSError, match="No space left"):
        step(pa.table({"path": [str(tmp_path / "a.npy")]}))
