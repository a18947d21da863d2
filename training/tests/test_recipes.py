"""Recipes run from end to end, go on where they stopped, move to another machine, and refuse what does not fit."""

import hashlib
import io
import json
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from snake_training import moving
from snake_training.config import SceneTraining, check
from snake_training.data import Procedural, write_corpus
from snake_training.data.crops import Crops
from snake_training.data.datasets import Corpus, write_carried
from snake_training.export import Moved, load_network
from snake_training.losses import losses_of
from snake_training.model import SnakeNetwork
from snake_training.recipes import Recipe, main
from snake_training.scene_model import SceneConfig
from snake_training.stages import ConfidenceStage, FigureStage, ObjectStage, SceneStage, TeacherStage
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
        knots = json.loads(file.metadata()["confidence"])
    assert all(0 <= probability <= 1 for _, probability in knots) and knots == sorted(knots)
    pairs = json.loads((run_dir / "drives/pairs.json").read_text())
    assert [pair["source"] for pair in pairs] == ["drive100_1", "drive100_2"]


def test_what_is_done_is_not_done_again(run_dir):
    before = {path: path.stat().st_mtime_ns for path in run_dir.rglob("*.*")}
    Recipe(RECIPES / "scenes.toml", run_dir, smoke=True).run()
    assert before == {path: path.stat().st_mtime_ns for path in run_dir.rglob("*.*")}


@pytest.mark.nightly
def test_the_recipe_of_the_papers_network_takes_a_quarter_of_an_hour_of_a_gpu(tmp_path, monkeypatch, capsys):
    """Two calls on a machine without snake_rs: the first is spent at 64³, the second ends it. At most eight files come back."""
    carried, runs, pieces = tmp_path / "carried", tmp_path / "runs", tmp_path / "pieces"
    write_corpus(tmp_path / "corpus", [Procedural()[row] for row in range(2)], 500)
    write_carried(carried, tmp_path / "corpus", tmp_path / "corpus", 300, 1)
    assert np.load(carried / "train/points.npy").shape == (2, 300, 3) and len(Corpus(carried / "val")) == 1
    text = (RECIPES / "paper.toml").read_text()
    (tmp_path / "paper.toml").write_text(text.replace("unet_base_channels = 32", "unet_base_channels = 8"))
    data = f"{carried}/train --validation-data {carried}/val"
    words = f"{tmp_path}/paper.toml --smoke --device cpu --data {data}".split()
    at_work = [*words, "--run-dir", str(runs), "--pack", str(pieces)]
    in_time = Recipe.in_time
    with monkeypatch.context() as there:
        there.setitem(sys.modules, "snake_rs", None)
        there.setattr(Recipe, "in_time", lambda self, name: 1e-9 if name == "fine" else in_time(self, name))
        main([*at_work, "--minutes", "9.3", "--later", "2.4"])
        said = capsys.readouterr().out
        assert "the minutes are over within fine" in said and "step 1: occupancy=" in said
        first = torch.load(runs / "paper/fine/last.pt", weights_only=True)
        assert first["step"] == 1 and 0 < first["spent"] < 1
        assert {"best", "judged"} <= json.loads((runs / "paper/coarse/done.json").read_text()).keys()
        assert len(list((pieces / "paper").iterdir())) == 2  # of the network at 64³ alone, and the list
        there.setattr(Recipe, "in_time", in_time)
        main([*at_work, "--minutes", "2.4", "--later", "0"])
        said = capsys.readouterr().out
        assert "step 2: occupancy=" in said and "the stages that are left need it" in said
    state = torch.load(runs / "paper/fine/last.pt", weights_only=True)
    assert state["step"] == 2 and state["spent"] > first["spent"]
    chosen = json.loads((runs / "paper/coarse/done.json").read_text())["best"]
    settings = json.loads(state["settings"])
    assert (settings["scatter"], settings["sparsity_ridge"]) == (chosen.split("_")[0], 0.9 if "ridge" in chosen else 0)
    main([*words, "--run-dir", str(tmp_path / "here"), "--unpack", str(pieces)])
    check_end_of_objects(tmp_path / "here/paper", 1_000_000, 8)
    # A call that ends before the choice brings four networks.
    recipe = Recipe(RECIPES / "paper.toml", runs)
    network = SnakeNetwork(recipe.stages["hard"].settings.network)
    assert 4 * 2 * sum(tensor.numel() for tensor in network.state_dict().values()) < 6.9 * moving.PIECE


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda path: path.stem)
def test_no_training_comes_after_what_needs_the_module(path):
    """A machine that is there for its GPU may not have snake_rs: it ends at the first stage that needs it. Teachers run by
    PyTorch there."""
    stages = list(Recipe(path, "runs").stages.values())
    needing = [row for row, stage in enumerate(stages) if isinstance(stage, ConfidenceStage | FigureStage)]
    training = [row for row, stage in enumerate(stages) if isinstance(stage, ObjectStage | SceneStage | TeacherStage)]
    assert needing and training and max(training) < min(needing)


def check_end_of_objects(run_dir, max_bytes, channels):
    """The results of a recipe of objects."""
    weights = run_dir / f"{run_dir.name}.safetensors"
    assert weights.stat().st_size < max_bytes
    assert load_network(weights).config.unet_base_channels == channels
    figures = json.loads((run_dir / "figures/figures.json").read_text())
    assert set(figures) == {"repeatability", "keypoints", "options"}
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


def test_minutes_end_a_recipe_and_what_it_reached_goes_on_elsewhere(tmp_path, capsys, monkeypatch):
    """A GPU may be there for ten minutes: the weights come back in pieces, and another machine takes them up."""
    monkeypatch.setattr(moving, "PIECE", 100_000)
    words = [str(RECIPES / "compact.toml"), "--smoke", "--device", "cpu"]
    here, there, pieces = tmp_path / "here", tmp_path / "there", tmp_path / "pieces"
    with monkeypatch.context() as patched:
        patched.setattr(Recipe, "in_time", lambda *_: 1e-9)
        main([*words, "--run-dir", str(here), "--minutes", "9", "--pack", str(pieces)])
    assert "the minutes are over within field" in capsys.readouterr().out
    files = sorted(path for path in (pieces / "compact").iterdir() if path.name != moving.LIST)
    assert len(files) > 3 and all(path.stat().st_size <= 100_000 for path in files)
    # Weights that were unpacked and not trained further are packed again.
    recipe = Recipe(RECIPES / "compact.toml", tmp_path / "between/compact", smoke=True)
    moving.unpack(pieces / "compact", recipe.run_dir)
    moving.pack(recipe.run_dir, tmp_path / "again", recipe.unneeded())
    assert {path.name for path in (tmp_path / "again").iterdir()} >= {path.name for path in files}
    main([*words, "--run-dir", str(there), "--unpack", str(pieces), "--pack", str(pieces)])
    state = torch.load(there / "compact/field/last.pt", weights_only=True)
    assert (state["step"], state["began"]) == (2, 1)
    check_end_of_objects(there / "compact", 1_000_000, 16)
    # Finished stages move too, so nothing is trained again; of the start of a network that has begun only the mark moves.
    parts = sorted(path for path in (pieces / "compact").iterdir() if path.name != moving.LIST)
    with tarfile.open(fileobj=io.BytesIO(b"".join(path.read_bytes() for path in parts))) as tar:
        moved = tar.getnames()
    assert "field/done.json" in moved and "field/weights.safetensors" not in moved
    assert "longer/weights.safetensors" in moved
    main([*words, "--run-dir", str(tmp_path / "third"), "--unpack", str(pieces)])
    assert not list((tmp_path / "third").rglob("last.pt"))
    files = sorted(path for path in (pieces / "compact").iterdir() if path.name != moving.LIST)
    files[0].write_bytes(b"x")
    with pytest.raises(ValueError, match="is not the one that was written"):
        moving.unpack(pieces / "compact", tmp_path / "other")
    files[0].unlink()
    with pytest.raises(ValueError, match="not all pieces"):
        moving.unpack(pieces / "compact", tmp_path / "other")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("keep")
    with pytest.raises(ValueError, match="something else"):
        moving.pack(there / "compact", tmp_path / "mine")


@pytest.mark.parametrize("listed", ["3", "[3]", '{"a": 3}', "[]", "{"])
def test_a_list_of_something_else_is_refused(tmp_path, listed):
    (tmp_path / moving.LIST).write_text(listed)
    with pytest.raises(ValueError, match="pieces of a run"):
        moving.unpack(tmp_path, tmp_path / "run/deep")
    assert [path.name for path in tmp_path.iterdir()] == [moving.LIST]


@pytest.mark.parametrize("name", ["../../harm/done.json", "../done.json", "/a/done.json", "a/harm.sh", "done.json"])
def test_files_of_something_else_are_refused(tmp_path, name):
    with tarfile.open(tmp_path / "000", "w") as tar:
        tar.addfile(tarfile.TarInfo(name))
    (tmp_path / moving.LIST).write_text(json.dumps([hashlib.sha256((tmp_path / "000").read_bytes()).hexdigest()]))
    with pytest.raises(ValueError, match="no file of a run"):
        moving.unpack(tmp_path, tmp_path / "run/deep")
    assert len(list(tmp_path.iterdir())) == 2


def test_moved_weights_are_known_by_their_step(run_dir, tmp_path):
    Moved(load_network(run_dir / "corners/weights.safetensors"), 7).write(tmp_path / Moved.NAME)
    assert Moved.read(tmp_path / Moved.NAME).step == 7
    with pytest.raises(ValueError, match="not the weights of a run"):
        Moved.read(run_dir / "corners/weights.safetensors")


def test_other_settings_than_those_of_the_results_are_refused(run_dir, tmp_path):
    text = (RECIPES / "scenes.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace("steps = 6000", "steps = 6001"))
    with pytest.raises(ValueError, match="corners was made with other settings"):
        Recipe(tmp_path / "other.toml", run_dir, smoke=True).run()


def test_a_smoke_is_not_taken_for_the_real_run(run_dir):
    with pytest.raises(ValueError, match="crops was made with other settings"):
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
        ('[[stages]]\nname = "a"\nkind = "objects"\nshare = 2', "share must be within"),
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
    for words in (
        ["absent.toml"],
        ["wrong.toml"],
        ["wrong.toml", "--minutes", "-1"],
        ["wrong.toml", "--later", "1"],
        ["wrong.toml", "--unpack", "none"],
    ):
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
