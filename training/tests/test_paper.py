"""The driver of the paper's tables: what it shares, resumes, refuses and prints. `test_reproduce` runs all of it in miniature."""

import re
import shlex

import pytest

from snake_training import paper
from snake_training.paper import Programme, main
from snake_training.paper_tables import ITEMS
from snake_training.train import train
from test_official import official_folder


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The authors' folder in miniature."""
    return official_folder(tmp_path_factory.mktemp("paper") / "data")


def words(data, run_dir, snake_cli, *more):
    """A command line with next to no work."""
    folders = ["--data", str(data), "--run-dir", str(run_dir), "--snake-cli", snake_cli.path]
    return [*more, *folders, "--smoke", "--device", "cpu"]


def test_tables_share_their_networks_and_go_on_where_they_stopped(data, tmp_path, snake_cli, capsys, monkeypatch):
    trained = []
    monkeypatch.setattr(paper, "train", lambda config, *more: trained.append(config.run_dir) or train(config, *more))
    given = words(data, tmp_path, snake_cli, "--seeds", "2")
    main(["tab8", *given])
    assert [run.removeprefix(f"{tmp_path}/") for run in trained] == ["modelnet40/seed1", "modelnet40/seed2"]
    # Means with deviations of two networks, beside the paper's.
    assert re.search(r"\| modelnet40: ε 0.04 \| 0.864 \| \d\.\d{3} ±\d\.\d{3} \|", capsys.readouterr().out)
    main(["tab8", *given, "--seeds", "1"])  # the tables of one network lie beside those of two
    capsys.readouterr()
    main(["tab9", "sec4.4", *given])
    printed = capsys.readouterr().out
    assert len(trained) == 2 and (tmp_path / "tab9.md").read_text() in printed
    # One network, so without the deviation over pairs.
    assert re.search(r"\| step-size-0.001: ε 0.04 \| 0.854 \| \d\.\d{3} \|", printed)
    with pytest.raises(SystemExit, match="was trained with other settings"):
        main(["tab8", *(word for word in given if word != "--smoke")])


def test_the_minutes_end_it_and_the_same_command_goes_on(data, tmp_path, snake_cli, capsys):
    given = words(data, tmp_path, snake_cli, "tab6", "--seeds", "1")
    main([*given, "--minutes", "1e-9"])
    assert "the minutes are over before keypointnet, seed 1, is done" in capsys.readouterr().out
    assert not (tmp_path / "keypointnet/seed1/weights.safetensors").exists()
    main(given)
    assert (tmp_path / "keypointnet/seed1/weights.safetensors").exists() and (tmp_path / "tab6.md").exists()
    assert len((tmp_path / "keypointnet_test_630.txt").read_text().split()) == 3


def test_everything_that_is_missing_is_said_at_once_before_anything_runs(data, tmp_path, snake_cli):
    absent = (
        "modelnet40/modelnet40-test_rotated_numpy/transform.npy", "smpl_model/pose_test_100.npy", "split/match3d_val.txt",
        "d3feat/scene/cloud_bin_0.npz", "d3feat/scene/cloud_bin_1.npz", "d3feat/scene/cloud_bin_2.npz",
    )  # fmt: skip
    held = {path: (data / path).read_bytes() for path in absent}
    try:
        for path in absent:
            (data / path).unlink()
        with pytest.raises(SystemExit) as stop:
            main(words(data, tmp_path / "run", snake_cli, "--all"))
    finally:
        for path, content in held.items():
            (data / path).write_bytes(content)
    lines = stop.value.code.splitlines()[1:]
    assert len(lines) == 4 and all(": from " in line or ": the transforms" in line for line in lines)
    for path in ("transform.npy", "pose_test_100.npy", "split/match3d_val.txt", "d3feat/*/cloud_bin_*.npz"):
        assert any(path in line for line in lines), path
    assert not (tmp_path / "run").exists()


def test_a_list_of_other_shapes_and_an_absent_program_are_said_too(data, tmp_path, snake_cli):
    lists = tmp_path / "lists"
    lists.mkdir()
    for name in ("modelnet40_train.txt", "modelnet40_val.txt"):
        (lists / name).write_text("chair_9999\n")
    given = words(data, tmp_path / "run", snake_cli, "tab8", "fig4", "--lists", str(lists))
    given[given.index("--snake-cli") + 1] = "no-such-program"
    with pytest.raises(SystemExit) as stop:
        main(given)
    assert stop.value.code.count("shapes: 1 of 1 are missing, such as chair_9999") == 2
    assert "no-such-program" in stop.value.code


@pytest.mark.parametrize("given", [["tab99"], [], ["tab8", "--seeds", "0"], ["tab8", "--minutes", "-1"]])
def test_other_tables_are_refused(given, tmp_path):
    with pytest.raises(SystemExit) as stop:
        main([*given, "--data", str(tmp_path)])
    assert stop.value.code == 2


def test_a_dry_run_prints_every_command_with_samples_and_hours(tmp_path, capsys):
    main(["--all", "--data", "data", "--dry-run", "--run-dir", str(tmp_path / "run")])
    lines = capsys.readouterr().out.splitlines()
    assert not (tmp_path / "run").exists()
    trained = [shlex.split(line) for line in lines if " snake_training.train " in line]
    assert len(trained) == 39 and len({line[line.index("--run-dir") + 1] for line in trained}) == 39
    # Ablations are judged on the validation split, and nothing else of a run differs but what the row says.
    assert all("--validation-split" in line for line in trained if "smpl" not in line)
    assert "# modelnet40, seed 6: 590400 samples, about 5.7 hours of an H100" in lines
    (coarse,) = (line for line in trained if "--resolution" in line and line[line.index("--resolution") + 1] == "32")
    assert coarse[coarse.index("--grid-size") + 1] == "4"  # queries a grid grow with the resolution
    evaluated = [line for line in lines if "snake_training.evaluation repeatability" in line and "modelnet40" in line]
    assert evaluated and all("normalization=half" in line for line in evaluated)
    assert {line[2:].partition(":")[0] for line in lines if line.startswith("#")} >= set(ITEMS)


def test_what_is_printed_is_what_runs(data, tmp_path, snake_cli, monkeypatch):
    """The commands of a dry run are those of the run, word for word."""
    programme = Programme(["tab10", "fig4"], data, data / "split", tmp_path, 1, smoke=True)
    printed = [shlex.split(line) for line in programme.describe() if not line.startswith("#")]
    ran = []
    monkeypatch.setattr(paper, "parse_arguments", lambda given, _: ran.append(["train", *given]) or [None])
    monkeypatch.setattr(paper, "train", lambda *_: True)
    monkeypatch.setattr(paper.export, "main", lambda given: ran.append(["export", *given]))
    monkeypatch.setattr(paper, "evaluate", lambda given: ran.append(["evaluation", *given]))
    monkeypatch.setattr(paper.subprocess, "run", lambda given, **_: ran.append(given))
    monkeypatch.setattr(Programme, "rows", lambda *_: [])
    assert programme.run("snake-cli")
    assert ran == [words[2:] if words[0] == "python" else words for words in [clean(words) for words in printed]]


def clean(words):
    """A printed command with its module's short name."""
    return [word.removeprefix("snake_training.") for word in words]
