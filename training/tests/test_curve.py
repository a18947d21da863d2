"""Curves of repeatability, and times beside ISS, by the program itself on two made shapes."""

import re

import numpy as np
import pytest

from snake_training import curve, times
from snake_training.data import Procedural, write_corpus


@pytest.fixture
def shapes(tmp_path, snake_cli, monkeypatch):
    """A corpus of two shapes, and the program where the modules look for it."""
    monkeypatch.setenv("SNAKE_CLI", snake_cli.path)
    procedural, rng = Procedural(), np.random.default_rng(0)
    write_corpus(tmp_path / "shapes", [procedural.cloud(rng) for _ in range(2)], points=1024)
    return tmp_path / "shapes"


def test_a_curve_has_a_run_for_each_value(shapes, tmp_path, capsys):
    words = [
        str(shapes),
        "--option",
        "nms_radius",
        "--values",
        "0.5",
        "0.1",
        "-o",
        str(tmp_path / "out"),
        "--num-points",
        "500",
    ]
    curve.main([*words, "--epsilon", "0.02,0.04", "--model", "compact"])
    printed = capsys.readouterr().out
    rows = re.findall(r"^\| ([\d.]+) \| (0\.\d+) ±0\.\d+ \| [\d.]+ \|$", printed, re.MULTILINE)
    assert [value for value, _ in rows] == ["0.1", "0.5"] and "nms_radius | repeatability at 0.04" in printed
    assert (tmp_path / "out/curve.md").read_text() == printed
    drawn = re.search(r'<polyline points="([^"]*)"', (tmp_path / "out/curve.svg").read_text())[1].split()
    heights = [
        (curve.HEIGHT - curve.MARGIN - float(point.split(",")[1])) / (curve.HEIGHT - 2 * curve.MARGIN)
        for point in drawn
    ]
    np.testing.assert_allclose(heights, [float(share) for _, share in rows], atol=0.002)
    assert len({share for _, share in rows}) == 2, "the option has an effect"
    models = ["--models", "6=compact", "4=compact", "--label", "grid", "-o", str(tmp_path / "models")]
    curve.main([str(shapes), *models, "--num-points", "500", "--limit", "1"])
    printed = capsys.readouterr().out
    assert re.findall(r"^\| (\w+) ", printed, re.MULTILINE) == ["grid", "4", "6"] and "±" not in printed, "one shape"


def test_times_are_a_row_for_each_number_of_points_and_steps(shapes, capsys):
    times.main([str(shapes), "--points", "256", "512", "--steps", "0", "2"])
    rows = re.findall(r"^\| (\d+) \| ([^|]*) \| ([\d.]+) \| (\S+) \|$", capsys.readouterr().out, re.MULTILINE)
    names = ["ISS", "SNAKE, J = 0", "SNAKE, J = 2"]
    assert [row[:2] for row in rows] == [(number, name) for number in ("256", "512") for name in names]
    assert all(memory == "–" if name == "ISS" else 10 < int(memory) < 4000 for _, name, _, memory in rows)
    assert all(float(seconds) < 20 for _, _, seconds, _ in rows)


def test_what_cannot_be_is_an_error(shapes, tmp_path, capsys):
    for words, expected in (
        (["--option", "refine_steps"], "--values"),
        (["--option", "refine_steps", "--values", "1", "--models", "1=compact"], "or --models"),
        (["--models", "compact"], "expected VALUE=MODEL"),
        (["--option", "no_such", "--values", "1"], "non-zero exit status"),
    ):
        with pytest.raises(SystemExit):
            curve.main([str(shapes), *words, "-o", str(tmp_path / "out")])
        assert expected in capsys.readouterr().err
    with pytest.raises(SystemExit):
        times.main([str(tmp_path / "nowhere")])
    assert "no such folder" in capsys.readouterr().err
