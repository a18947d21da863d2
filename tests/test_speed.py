"""The benchmark runs and reports what it measured, at a size where that takes seconds; no time is asserted."""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="pip install ./training")

from snake_training.data import Procedural
from snake_training.detection import DetectOptions
from snake_training.model import NetworkConfig

sys.path.insert(0, str(Path(__file__).parent / "bench"))

import scaling
import speed

CONFIG = NetworkConfig(resolution=(16, 16, 16), c_dim=8, unet_levels=2, unet_base_channels=8)
OPTIONS = DetectOptions(query_resolution=16, refine_steps=2)


@pytest.fixture(scope="module")
def report():
    report = speed.measure(CONFIG, num_points=512, occupied=300, options=OPTIONS, threads=1, runs=1)
    return {"machine": speed.machine(), **report}


def test_every_part_is_measured(report):
    assert report["counts"]["queries"] == 16**3
    assert abs(report["counts"]["occupied"] - 300) <= 3  # the two engines differ in the last bits
    assert report["counts"]["above_threshold"] > 30 and report["counts"]["keypoints"] > 0
    for rows in (report["detect_seconds"], report["thread_seconds"]):
        for name, row in rows.items():
            assert set(row) == {*speed.STAGES, "refined"} and all(value > 0 for value in row.values()), name
    assert len(report["detect_seconds"]) == 4 and report["thread_ratio"] == {}
    ratio, rows = report["detect_ratio"]["PyTorch / snake-rs"], report["detect_seconds"]
    assert ratio["total"] == rows["PyTorch"]["total"] / rows["snake-rs"]["total"]
    assert report["compact_seconds"]["snake-rs, built-in model"]["total"] > 0


def test_threads_are_compared_in_processes_of_their_own(tmp_path):
    points = Procedural(points=512)[0]
    network = speed.seeded_network(CONFIG, points, 300, query_resolution=16)
    weights = str(tmp_path / "network.safetensors")
    speed.write_weights(weights, CONFIG, network.state_dict())
    rows, ratio = speed.compare_threads(weights, points, OPTIONS, threads=2, runs=1)
    assert list(rows) == ["1 thread", "2 threads"]
    assert ratio["1 / 2 threads"]["encode"] == rows["1 thread"]["encode"] / rows["2 threads"]["encode"]


def test_engines_agree_where_a_ratio_is_given(report):
    rows = report["unet_seconds"]
    assert rows["snake-rs (whole encode)"]["difference"] < 1e-4
    assert rows["PyTorch channels_last_3d"]["ratio"] > 0
    for name, row in rows.items():
        assert ("ratio" in row) != ("note" in row), name
        assert "ratio" not in row or row["difference"] <= speed.MAX_DIFFERENCE, name


def test_the_report_can_be_read_as_text_and_json(report):
    assert json.loads(json.dumps(report))["settings"]["threads"] == 1
    text = speed.text(report)
    for word in (*speed.PACKAGES, *report["unet_seconds"], *report["detect_ratio"], "threads of each: 1", "J = 2"):
        assert word in text


def test_a_busy_machine_is_said(report):
    for load, said in ((0.0, False), (99.0, True)):
        host = report["machine"] | {"load_before": load, "cores": 2}
        assert ("BUSY MACHINE" in speed.text(report | {"machine": host})) == said


@pytest.mark.parametrize("package", ["onnxruntime", "openvino", "open3d"])
def test_installed_peers_are_measured(report, package):
    pytest.importorskip(package, reason=f"{package} is not installed: it was not compared with")
    row = {"onnxruntime": "ONNX Runtime float32", "openvino": "OpenVINO float32", "open3d": "Open3D ISS"}[package]
    measured = (report["unet_seconds"] | report["compact_seconds"])[row]
    assert measured.get("seconds", measured.get("total")) > 0


def test_missing_peers_are_named_not_counted(monkeypatch):
    for package in ("onnxruntime", "openvino", "open3d"):
        monkeypatch.setitem(sys.modules, package, None)  # importing it raises ImportError
    import snake_rs

    points = Procedural(points=512)[0]
    rows = speed.compare_compact(snake_rs.Model.builtin(), points, runs=1)
    assert rows["Open3D ISS"] == {"note": speed.NOT_INSTALLED}
    assert speed.NOT_INSTALLED in speed.table("title", rows)


def test_a_peer_that_disagrees_or_cannot_run_gets_no_ratio(monkeypatch):
    def broken():
        raise RuntimeError("compile_model:\nno kernel\n")

    def peers(unet, volume, threads):
        right = np.zeros((1, 8, 16, 16, 16), np.float32)
        return {"PyTorch contiguous": lambda: lambda: right, "wrong": lambda: lambda: right + 0.01, "broken": broken}

    class Model:
        def encode(self, points):
            return self

        volume = np.zeros((8, 16, 16, 16), np.float32)

    monkeypatch.setattr(speed, "unet_peers", peers)
    points = Procedural(points=512)[0]
    network = speed.seeded_network(CONFIG, points, 300, query_resolution=16)
    rows = speed.compare_unet(network, Model(), points, threads=1, runs=1)
    assert "ratio" in rows["PyTorch contiguous"]
    assert "ratio" not in rows["wrong"] and "differs" in rows["wrong"]["note"]
    assert rows["broken"] == {"note": "cannot run here: no kernel"}


def test_engines_that_refine_other_numbers_of_queries_get_no_ratio():
    ours = dict.fromkeys(speed.STAGES, 1.0) | {"refined": 1000}
    assert speed.detect_ratio(ours | {"total": 2.0, "refined": 1009}, ours)["total"] == 2.0
    ratio = speed.detect_ratio(ours | {"refined": 1020}, ours)
    assert ratio == {"note": "no ratio: 1020 queries refined, by snake-rs 1000"}
    assert ratio["note"] in speed.table("ratios", {"PyTorch / snake-rs": ratio})


@pytest.mark.nightly
def test_each_level_of_instructions_has_a_process_of_its_own():
    capability = torch.backends.cpu.get_cpu_capability()
    with pytest.MonkeyPatch.context() as environment:
        for name in speed.AVX2:
            environment.setenv(name, "")
        reports = dict(speed.measure_levels(CONFIG, 512, 300, OPTIONS, 1, 1))
    assert len(reports) == (2 if capability == "AVX512" else 1)
    assert all(report["unet_seconds"]["snake-rs (whole encode)"]["difference"] < 1e-4 for report in reports.values())
    assert len({report["machine"]["load_before"] for report in reports.values()}) == 1, "the first level is no load"


def test_medians_leave_out_the_first_round():
    seconds = iter([9.0, 1.0, 5.0, 2.0])
    assert speed.alternate({"a": lambda: {"total": next(seconds)}}, runs=3) == {"a": {"total": 2.0}}


def test_bad_arguments_are_refused(capsys, tmp_path):
    for main, words, expected in (
        (speed.main, ["--runs", "0"], "--runs must be 1 to"),
        (speed.main, ["--occupied", "-3"], "--occupied must be 1 to"),
        (scaling.main, ["-o", "plot.png"], "must end in .svg"),
        (scaling.main, ["-o", "plot.svg", "--runs", "0"], "must be 1 or more"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert expected in capsys.readouterr().err


def test_exponents_of_a_known_law():
    rows = [("points", x, x, dict.fromkeys(scaling.STAGES, 1e-3 * x**0.5)) for x in (1, 4, 16)]
    for fitted, last in scaling.exponents(rows, "points").values():
        assert fitted == pytest.approx(0.5) and last == pytest.approx(0.5)


def test_scaling_measures_each_setting(tmp_path, capsys):
    base = {"points": 256, "resolution": 16, "query_resolution": 16, "refine_steps": 1}
    rows = scaling.sweep({"points": [128, 256], "refine_steps": [0, 2]}, base, occupied=300, runs=1, config=CONFIG)
    assert [row[:3] for row in rows] == [
        ("points", 128, 128), ("points", 256, 256), ("refine_steps", 0, 1), ("refine_steps", 2, 3),
    ]  # fmt: skip
    assert len(capsys.readouterr().out.splitlines()) == 5
    scaling.write_csv(tmp_path / "scaling.csv", rows)
    with open(tmp_path / "scaling.csv") as file:
        assert [line["value"] for line in csv.DictReader(file)] == ["128", "256", "0", "2"]
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: the plot was not drawn")
    scaling.plot(tmp_path / "scaling.svg", rows, "title")
    assert "J + 1" in (tmp_path / "scaling.svg").read_text()
