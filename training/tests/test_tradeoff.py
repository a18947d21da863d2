"""Repeatability against time: every setting is measured, and written as numbers and as a plot."""

import csv

import pytest

from snake_training import tradeoff
from snake_training.data import Procedural
from snake_training.data.datasets import write_corpus
from snake_training.export import write_weights


@pytest.fixture
def arguments(tmp_path, network):
    weights = tmp_path / "tiny.safetensors"
    recommended = (
        '{"detect": {"query_resolution": 16, "refine_steps": 0, "occupancy_threshold": 0, "saliency_threshold": 0}}'
    )
    write_weights(weights, network.config, network.state_dict(), extra={"recommended_options": recommended})
    write_corpus(tmp_path / "shapes", Procedural(2, points=300), 300)
    return [str(weights), "--data", str(tmp_path / "shapes"), "--objects", "2", "--rotations", "1", "3"]


def test_every_setting_has_a_row(arguments, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    plot = tmp_path / "plot.svg"
    tradeoff.main([*arguments, "-o", str(plot)])
    with open(plot.with_suffix(".csv"), newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["model"], row["rotations"]) for row in rows] == [("tiny", "1"), ("tiny", "3")]
    assert all(0 <= float(row["repeatability at NMS 0.05"]) <= 1 and float(row["milliseconds"]) > 0 for row in rows)
    assert "NMS 0.05" in plot.read_text() and capsys.readouterr().out.count("tiny") == 2


def test_what_cannot_be_done_is_said(arguments, tmp_path, capsys):
    for wrong, said in (("plot.png", "must end in .svg"), ("nowhere/plot.svg", "nowhere")):
        with pytest.raises(SystemExit):
            tradeoff.main([*arguments, "-o", str(tmp_path / wrong)])
        assert said in capsys.readouterr().err
    with pytest.raises(SystemExit):
        tradeoff.main(["missing.safetensors", *arguments[1:], "-o", str(tmp_path / "plot.svg")])
    assert "missing.safetensors" in capsys.readouterr().err
