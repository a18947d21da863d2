"""Recipes run from end to end, go on where they stopped, and refuse what does not fit."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from snake_training.config import SceneTraining, check
from snake_training.data.crops import Crops
from snake_training.export import load_network
from snake_training.losses import losses_of
from snake_training.recipes import Recipe, main
from snake_training.scene_model import SceneConfig
from snake_training.tasks.scenes import Scenes
from snake_training.train import run

RECIPES = Path(__file__).resolve().parents[1] / "recipes"
MODELS = RECIPES.parents[1] / "crates/snake-core/models"


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """The recipe of scenes, run with next to no work."""
    folder = tmp_path_factory.mktemp("run")
    Recipe(RECIPES / "scenes.toml", folder, smoke=True).run()
    return folder


def test_the_recipe_of_scenes_ends_with_a_weight_file_and_its_map(run_dir):
    weights = run_dir / "scenes.safetensors"
    assert load_network(weights).config.to_metadata()["coordinates"] == "voxel" and weights.stat().st_size < 1_000_000
    with safe_open(weights, "numpy") as file:
        knots = json.loads(file.metadata()["confidence"])["knots"]
    assert all(0 <= probability <= 1 for _, probability in knots) and knots == sorted(knots)
    pairs = json.loads((run_dir / "drives/pairs.json").read_text())
    assert [pair["source"] for pair in pairs] == ["drive100_1", "drive100_2"]


def test_what_is_done_is_not_done_again(run_dir):
    before = {path: path.stat().st_mtime_ns for path in run_dir.rglob("*.*")}
    Recipe(RECIPES / "scenes.toml", run_dir, smoke=True).run()
    assert before == {path: path.stat().st_mtime_ns for path in run_dir.rglob("*.*")}


@pytest.mark.nightly
def test_the_recipe_of_the_papers_network_runs(tmp_path):
    text = (RECIPES / "paper.toml").read_text()
    (tmp_path / "paper.toml").write_text(text.replace("unet_base_channels = 32", "unet_base_channels = 8"))
    main([f"{tmp_path}/paper.toml", "--smoke", "--device", "cpu", "--run-dir", str(tmp_path)])
    check_end_of_objects(tmp_path / "paper", 1_000_000, 8)


def check_end_of_objects(run_dir, max_bytes, channels):
    """The results of a recipe of objects."""
    weights = run_dir / f"{run_dir.name}.safetensors"
    assert weights.stat().st_size < max_bytes
    assert load_network(weights).config.unet_base_channels == channels
    figures = json.loads((run_dir / "figures/figures.json").read_text())
    assert [method.partition(":")[0] for method in figures] == [str(weights), "iss"]
    assert all({"coverage", "keypoints"} < set(row) for row in figures.values())
    done = json.loads((run_dir / "figures/done.json").read_text())
    assert done["processor"] and done["seconds"] >= 0


@pytest.mark.parametrize("name", ["compact", "scenes", "paper"])
def test_a_recipe_names_the_released_file(name, tmp_path):
    """Where a recipe states the digest of the released file, it is that file's. Those that are not built in lie in parts."""
    recipe = Recipe(RECIPES / f"{name}.toml", "runs")
    released = MODELS / f"{name}.safetensors"
    if name == "paper":
        released = tmp_path / released.name
        parts = sorted(RECIPES.parents[1].glob(f"models/{released.name}.?"))
        released.write_bytes(b"".join(part.read_bytes() for part in parts))
    if recipe.stages[name].digest:
        with safe_open(released, "numpy") as file:
            assert file.metadata()["digest"] == recipe.stages[name].digest


def test_a_network_of_scenes_has_the_widths_of_its_settings():
    task = Scenes(SceneTraining(c_dim=16, unet_base_channels=8, num_grids=1), [])
    assert task.network_config == SceneConfig(c_dim=16, unet_base_channels=8)
    with pytest.raises(ValueError, match="c_dim or unet_base_channels does not divide into groups"):
        check(SceneTraining(c_dim=12))


def test_training_goes_on_from_its_checkpoint_bit_for_bit(run_dir, tmp_path):
    crops = Crops(run_dir / "crops")
    settings = SceneTraining(steps=3, batch=1, side=16, queries=50, num_occupancy=20, warmup=1, bf16=False)

    def trained(folder, *minutes):
        for limit in minutes:
            run(Scenes(settings, crops), folder, "cpu", limit)
        return torch.load(folder / "last.pt", weights_only=True)["network"]

    once, twice = trained(tmp_path / "once", 0), trained(tmp_path / "twice", 1e-9, 0)
    assert all(torch.equal(once[name], twice[name]) for name in once)


def test_scenes_learn_by_the_four_losses_too(run_dir):
    """Local grids are the same points in both views: distances within them agree."""
    settings = SceneTraining(batch=2, side=24, num_occupancy=20, num_grids=6, grid_size=3, bf16=False)
    task = Scenes(settings, Crops(run_dir / "crops"))
    batch = task.ready(task.batch(0, 2))
    assert batch["inside"].shape == (2, 2, 6, 27) and batch["queries"].shape == (2, 2, 40 + 6 * 27, 3)
    grids = batch["queries"][:, :, 40:]
    first, second = ((view[:, :, None] - view[:, None]).norm(dim=3) for view in grids.unbind(1))
    assert torch.allclose(first, second, atol=1e-4)
    losses, _ = losses_of(*task.answer(task.network(), batch, False), batch)
    assert set(losses) == {"occupancy", "repeatability", "surface", "sparsity"}
    assert all(torch.isfinite(loss) for loss in losses.values())


def test_minutes_end_a_recipe_and_the_same_command_goes_on(tmp_path, capsys, monkeypatch):
    words = [str(RECIPES / "compact.toml"), "--smoke", "--device", "cpu", "--run-dir", str(tmp_path)]
    with monkeypatch.context() as patched:
        patched.setattr(Recipe, "in_time", lambda *_: 1e-9)
        main([*words, "--minutes", "9"])
    assert "the minutes are over within field" in capsys.readouterr().out
    assert torch.load(tmp_path / "compact/field/last.pt", weights_only=True)["step"] == 1
    main(words)
    check_end_of_objects(tmp_path / "compact", 1_000_000, 16)


def test_other_settings_than_those_of_the_results_are_refused(run_dir, tmp_path):
    text = (RECIPES / "scenes.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace("steps = 6000", "steps = 6001"))
    with pytest.raises(ValueError, match="corners was made with other settings"):
        Recipe(tmp_path / "other.toml", run_dir, smoke=True).run()
    with pytest.raises(ValueError, match="crops was made with other settings"):  # a smoke is not the real run
        Recipe(RECIPES / "scenes.toml", run_dir).run()


CROPS = '[[stages]]\nname = "c"\nkind = "crops"\nfiles = [[1, 1]]\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not a recipe"),
        ("stages = 3", "not a recipe"),
        ("stages = [3]", "not a recipe"),
        ("\xff[", "not a recipe"),
        ('[[stages]]\nname = "a"\nkind = "bake"', "kind 'bake'"),
        ('[[stages]]\nname = "a"\nkind = 3', "of kind '3'"),
        ('[[stages]]\nname = ["a"]\nkind = "crops"', "names differ"),
        ('[[stages]]\nname = "../../x"\nkind = "crops"\nfiles = [[1, 1]]', "names differ"),
        ('[[stages]]\nname = "/x"\nkind = "crops"\nfiles = [[1, 1]]', "names differ"),
        (CROPS + CROPS, "names differ"),
        ('[[stages]]\nname = "a"\nkind = "crops"\nfiles = [["x", 1]]', "files must be pairs"),
        ('[[stages]]\nname = "a"\nkind = "crops"\nfiles = [[1, 0]]', "files must be pairs"),
        ('[[stages]]\nname = "a"\nkind = "crops"', "files"),
        ('[[stages]]\nname = "a"\nkind = "scenes"\ninit = "b"\ncrops = "c"', "no stage 'b' before it"),
        ('[[stages]]\nname = "a"\nkind = "export"\nof = "b"\noutput = "x"', "no stage 'b' before it"),
        ('[[stages]]\nname = "a"\nlike = "b"', "no stage 'b' before it"),
        ('[[stages]]\nname = "a"\nkind = "teacher"\nof = ["b"]\nscales = [1, 2]', "got 2 for 1"),
        ('[[stages]]\nname = "a"\nkind = "teacher"\nof = []', "no network to learn from"),
        (CROPS + '[[stages]]\nname = "a"\nkind = "export"\nof = "c"\noutput = "/abs/file"', "not the name of a file"),
        (CROPS + '[[stages]]\nname = "a"\nkind = "export"\nof = "c"\noutput = "../up"', "not the name of a file"),
        (CROPS + '[[stages]]\nname = "a"\nkind = "scenes"\ncrops = "c"\nwarmpu = 3', "unknown setting 'warmpu'"),
        (CROPS + '[[stages]]\nname = "a"\nkind = "scenes"\ncrops = "c"\nsteps = "3"', "steps must be of type int"),
        (CROPS + '[[stages]]\nname = "a"\nkind = "scenes"\ncrops = "c"\nsteps = 0', "steps must be positive"),
        ('[[stages]]\nname = "a"\nkind = "objects"\nrun_dir = "elsewhere"', "unknown setting 'run_dir'"),
        ('[[stages]]\nname = "a"\nkind = "objects"\nbatch = 0', "batch must be positive"),
        ('[[stages]]\nname = "a"\nkind = "objects"\nfresh_saliency = true', "needs init"),
    ],
)
def test_a_recipe_that_cannot_run_is_refused_before_anything_runs(tmp_path, text, said):
    (tmp_path / "wrong.toml").write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=said):
        Recipe(tmp_path / "wrong.toml", tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.toml"]


def test_the_command_says_in_one_line_what_is_wrong(tmp_path, capsys):
    (tmp_path / "wrong.toml").write_text("stages = 3")
    for words in (["absent.toml"], ["wrong.toml"], ["wrong.toml", "--minutes", "-1"]):
        with pytest.raises(SystemExit) as stop:
            main([str(tmp_path / words[0]), *words[1:], "--run-dir", str(tmp_path)])
        assert stop.value.code == 2 and "Traceback" not in capsys.readouterr().err


def test_views_and_surface_of_a_crop_are_the_same_places(run_dir, monkeypatch):
    """Queries lie as far from the clean surface in the teacher's box as in the crop, and views near it."""
    monkeypatch.setattr("snake_training.tasks.scenes.MAX_NOISE", 0)
    monkeypatch.setattr("snake_training.tasks.scenes.MAX_THINNING", 1)
    settings = SceneTraining(batch=1, queries=200)
    batch = Scenes(settings, Crops(run_dir / "crops")).batch(0, 1)
    points, owner, surface = batch["points"].numpy(), batch["owner"].numpy(), batch["surface_points"].numpy()
    assert set(owner) == {0, 1} and points.min() >= 0 and points.max() < settings.side
    queries = batch["queries"][0, :, len(batch["label"]) :].numpy()

    def apart(queries, points):
        return np.median(np.linalg.norm(points[:, None] - queries, axis=2).min(axis=0))

    assert apart(batch["surface_queries"][0].numpy(), surface) < 1.0
    assert all(apart(queries[view], points[owner == view]) < 2.5 for view in range(2))
