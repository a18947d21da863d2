"""Recipes run from end to end, go on where they stopped, and refuse what does not fit."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from snake_training import pieces
from snake_training.data.crops import Crops
from snake_training.export import load_network
from snake_training.recipes import Recipe, main, result
from snake_training.scenes import SceneTraining, Target, make_batch, train

RECIPES = Path(__file__).resolve().parents[1] / "recipes"


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """The recipe from nothing, run with next to no work."""
    folder = tmp_path_factory.mktemp("run")
    Recipe(RECIPES / "scenes-from-nothing.toml", folder, smoke=True).run()
    return folder


def test_a_recipe_ends_with_a_weight_file(run_dir):
    network = load_network(run_dir / "scenes.safetensors")
    assert network.config.to_metadata()["coordinates"] == "voxel"
    assert (run_dir / "scenes.safetensors").stat().st_size < 1_000_000


def test_a_mean_of_networks_is_their_mean(run_dir):
    a, b, mean = (result(run_dir / name).state_dict() for name in ("corners", "learn", "mean"))
    name = "encoder.unet3d.final_conv.weight"
    assert torch.allclose(mean[name], 0.2 * a[name] + 0.8 * b[name], atol=1e-6)


def test_what_is_done_is_not_done_again(run_dir):
    before = {path: path.stat().st_mtime_ns for path in run_dir.rglob("*.*")}
    Recipe(RECIPES / "scenes-from-nothing.toml", run_dir, smoke=True).run()
    assert before == {path: path.stat().st_mtime_ns for path in run_dir.rglob("*.*")}


def test_the_recipe_of_the_released_weights_runs(tmp_path):
    main([str(RECIPES / "scenes.toml"), "--run-dir", str(tmp_path), "--smoke"])
    weights = tmp_path / "scenes/scenes.safetensors"
    assert load_network(weights)
    with safe_open(weights, "numpy") as file:
        knots = json.loads(file.metadata()["confidence"])
    assert all(0 <= probability <= 1 for _, probability in knots) and knots == sorted(knots)
    pairs = json.loads((tmp_path / "scenes/drives/pairs.json").read_text())
    assert [pair["source"] for pair in pairs] == ["drive100_1", "drive100_2"]


@pytest.mark.parametrize("name", ["compact", "standard", "paper"])
def test_a_recipe_of_objects_ends_with_a_weight_file_and_its_figures(tmp_path, name, capsys):
    """Without data, and the second time with some: then what is done stays."""
    main([str(RECIPES / f"{name}.toml"), "--run-dir", str(tmp_path), "--smoke"])
    weights = tmp_path / f"{name}/{name}.safetensors"
    assert weights.stat().st_size < (10_000_000 if name == "paper" else 1_000_000)
    assert load_network(weights).config.unet_base_channels == (32 if name == "paper" else 16)
    figures = json.loads((tmp_path / name / "figures/figures.json").read_text())
    assert set(figures) == {"repeatability", "keypoints", "options"}
    done = json.loads((tmp_path / name / "figures/done.json").read_text())
    assert done["processor"] and done["seconds"] >= 0
    made = weights.stat().st_mtime_ns
    main([str(RECIPES / f"{name}.toml"), "--run-dir", str(tmp_path), "--smoke"])
    assert weights.stat().st_mtime_ns == made


def test_a_run_moves_in_pieces(run_dir, tmp_path, monkeypatch):
    """The run of another machine goes on here; no piece is above 5 MB, and a changed or missing one is told."""
    assert pieces.PIECE < 5_000_000
    monkeypatch.setattr(pieces, "PIECE", 100_000)
    pieces.pack(run_dir, tmp_path / "pieces")
    files = sorted((tmp_path / "pieces").iterdir())
    assert len(files) > 3 and all(path.stat().st_size <= 100_000 for path in files)
    pieces.unpack(tmp_path / "pieces", tmp_path / "run")
    stored = {str(path.relative_to(run_dir)): path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}
    assert {
        str(p.relative_to(tmp_path / "run")): p.read_bytes() for p in (tmp_path / "run").rglob("*") if p.is_file()
    } == stored
    files[1].write_bytes(b"x" + files[1].read_bytes()[1:])
    with pytest.raises(ValueError, match="0001: not the piece that was written"):
        pieces.unpack(tmp_path / "pieces", tmp_path / "other")
    files[1].unlink()
    with pytest.raises(ValueError, match="not all pieces"):
        pieces.unpack(tmp_path / "pieces", tmp_path / "other")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("keep")
    with pytest.raises(ValueError, match="something else"):
        pieces.pack(run_dir, tmp_path / "mine")


def test_training_goes_on_from_its_checkpoint_bit_for_bit(run_dir, tmp_path):
    crops = Crops(run_dir / "crops")
    settings = SceneTraining(steps=3, batch=1, side=16, queries=50, occupancy_queries=20, warmup=1)

    def trained(folder, *stops):
        for steps in stops:  # a shorter run is the same run, stopped: its rates are those of the whole
            network = result(run_dir / "start").train()
            train(folder, crops, settings, network, Target(None, crops, settings), log=lambda _: None, stop=steps)
        return torch.load(folder / "last.pt", weights_only=True)["network"]

    once, twice = trained(tmp_path / "once", 3), trained(tmp_path / "twice", 2, 3)
    assert all(torch.equal(once[name], twice[name]) for name in once)


def test_other_settings_than_those_of_the_results_are_refused(run_dir, tmp_path):
    text = (RECIPES / "scenes-from-nothing.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace("steps = 8000", "steps = 8001"))
    with pytest.raises(ValueError, match="corners was made with other settings"):
        Recipe(tmp_path / "other.toml", run_dir, smoke=True).run()


def test_a_smoke_is_not_taken_for_the_real_run(run_dir):
    with pytest.raises(ValueError, match="crops was made with other settings"):
        Recipe(RECIPES / "scenes-from-nothing.toml", run_dir).run()


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ('name = "a"\nkind = "bake"', "kind 'bake'"),
        ('name = "a"\nkind = "scenes"\ninit = "b"\ncrops = "c"', "no stage 'c' before it"),
        ('name = "a"\nkind = "average"\nof = ["b"]', "no stage 'b' before it"),
    ],
)
def test_a_recipe_that_cannot_run_is_refused(tmp_path, line, word):
    (tmp_path / "wrong.toml").write_text(f"[[stages]]\n{line}\n")
    with pytest.raises(ValueError, match=word):
        Recipe(tmp_path / "wrong.toml", tmp_path)


def test_a_misspelt_setting_is_refused(run_dir, tmp_path):
    text = (RECIPES / "scenes-from-nothing.toml").read_text()
    (tmp_path / "wrong.toml").write_text(text.replace("warmup = 200", "warmpu = 200"))
    (tmp_path / "crops").symlink_to(run_dir / "crops")
    with pytest.raises(ValueError, match="warmpu"):
        Recipe(tmp_path / "wrong.toml", tmp_path, smoke=True).run()


def test_views_and_surface_of_a_crop_are_the_same_places(run_dir):
    """Queries lie as far from the clean surface in the teacher's box as in the crop, and views near it."""
    crops = Crops(run_dir / "crops")
    settings = SceneTraining(batch=1, queries=200, max_noise=0, max_thinning=1)
    batch = make_batch(crops, settings, 0, 0)
    points, owner = batch["points"].numpy(), batch["owner"].numpy()
    assert set(owner) == {0, 1, 2} and points.min() >= 0 and points.max() < settings.side
    near = [
        np.linalg.norm(points[owner == box][:, None] - q.numpy(), axis=2).min(axis=0)
        for box, q in enumerate(batch["queries"])
    ]
    assert np.median(near[2]) < 1.0 and all(np.median(distance) < 2.5 for distance in near[:2])
