"""The benchmarks print their tables, at a size where that takes seconds; no time is asserted."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="pip install ./training")
sys.path.insert(0, str(Path(__file__).parent / "bench"))

import confusion
import made_pairs
import registration
import speed

import snake_rs
from snake_training.detection import DetectOptions
from snake_training.model import NetworkConfig


def test_speed_has_a_row_for_each_engine():
    config = NetworkConfig(resolution=(16, 16, 16), c_dim=8, unet_levels=2, unet_base_channels=8)
    rows = speed.calls(config, 512, 300, DetectOptions(query_resolution=16, refine_steps=2), threads=1)
    assert {"U-Net: PyTorch, channels_last_3d", "detection: PyTorch", "detection: snake-rs"} <= set(rows)
    assert all(seconds > 0 for seconds in speed.medians(rows, 1).values())


def test_registration_keeps_its_results(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(0)
    np.save(tmp_path / "points.npy", (rng.normal(size=(3, 4000, 3)) * [3000, 2000, 1000]).astype(np.int16))
    words = ["--objects", str(tmp_path), "--made", "1", "--methods", "snake-rs", "--results", str(tmp_path / "found")]
    monkeypatch.setattr(sys, "argv", ["registration.py", *words])
    registration.main()
    first = capsys.readouterr().out
    assert "| objects (1) | sweeps (1) |" in first and "\n| snake-rs | " in first
    monkeypatch.setattr(registration, "run", None)  # nothing runs again
    registration.main()
    assert capsys.readouterr().out == first


def test_confusion_counts_each_pair_once(compiled, monkeypatch, capsys):
    words = [str(compiled / "snake-cli"), "--kinds", "camera_room", "stairs", "--seeds", "0", "1"]
    monkeypatch.setattr(sys, "argv", ["confusion.py", *words])
    confusion.main()
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    counts = {name: list(map(int, row)) for name, *row in rows[1:]}
    assert [sum(row) for row in counts.values()] == [1, 1, 2] and counts["all made"][2] == 0


@pytest.mark.parametrize("kind", ["corners", "house"])
def test_bare_corners_never_tell_a_transform(kind):
    pair = made_pairs.make(kind, 1)
    found = snake_rs.register(pair.source, pair.target)
    assert not pair.is_right(found.t_target_source) and found.verdict.is_ambiguous and not found.verdict.is_reliable
    assert any("only a few planes" in note for note in found.verdict.notes)


@pytest.mark.parametrize("kind", ["slope", "lobby", "two rooms"])
def test_a_made_pair_knows_its_transforms(kind):
    pair = made_pairs.make(kind, 0)
    assert np.isfinite(pair.source).all() and all(pair.is_right(wanted) for wanted in pair.right)
    assert len(pair.right) == {"slope": 2, "lobby": 1, "two rooms": 0}[kind]
    assert not any(pair.is_right(made_pairs.pose([0, 0, 2 * pair.metres]) @ wanted) for wanted in pair.right)
