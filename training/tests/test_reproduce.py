"""Every command of docs/reproduce.md runs, on miniature data in the official layouts."""

import json
import re
import runpy
import shlex
import shutil
import sys

import numpy as np
import pytest
import torch

from conftest import FOLDER
from snake_training.model import NetworkConfig, SnakeNetwork
from test_official import SMPL, TINY, fragments, keypointnet, match3d, modelnet40, smpl

PAGE = (FOLDER / "docs/reproduce.md").read_text()
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.replace("\\\n", " ").splitlines()
    if line.strip()
]
SHAPE = "1021a0914a7207aff927ed529ad90a11"  # of KeypointNet, which a command names
# What makes a command small, by its beginning; the later ones override the page's own.
SMALL = {
    "snake_training.train": TINY,
    "eval": ["--limit", "1"],
    "repeatability": ["--methods", "snake,random"],
    "semantic": ["--methods", "snake,random"],
    "registration": ["--detectors", "snake"],
    "snake_training.curve": ["--num-points", "100", "--limit", "1"],
    "snake_training.times": ["--points", "100", "--steps", "0", "1", "--limit", "1"],
    "snake_training.reconstruction": ["--resolution", "16", "--limit", "1"],
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with data/, split/, and an official checkpoint with its configuration."""
    folder = tmp_path_factory.mktemp("paper")
    data, split = folder / "data", folder / "split"
    split.mkdir()
    _, names = keypointnet(data / "keypointnet_pcds")
    for name in ("keypointnet_train", "keypointnet_val", "keypointnet_test_630"):
        shutil.copy(names, split / f"{name}.txt")
    names.unlink()
    annotated = json.loads((data / "keypointnet_pcds/annotations/airplane.json").read_text())
    shutil.copy(data / "keypointnet_pcds/02691156/0abc.pcd", data / f"keypointnet_pcds/02691156/{SHAPE}.pcd")
    annotated.append(annotated[0] | {"model_id": SHAPE})
    (data / "keypointnet_pcds/annotations/airplane.json").write_text(json.dumps(annotated))
    shutil.copy(shutil.move(modelnet40(data / "modelnet40")[1], split), split / "modelnet40_val.txt")
    smpl(data / "smpl_model")
    shutil.copy(SMPL / "model.pkl", data / "smpl_model")
    shutil.copy(shutil.move(match3d(data)[1], split / "match3d_train_new_40k.txt"), split / "match3d_val.txt")
    (data / "redwood/numpy_gt_normal").mkdir()
    for name in ("room", "transform.npy", "redwood_pair.txt"):
        shutil.move(data / "redwood" / name, data / "redwood/numpy_gt_normal" / name)
    fragments(data / "3DMatch_eval_downsample")
    described(data / "3DMatch_eval_downsample/scene", data / "d3feat/scene")
    config = NetworkConfig(resolution=(8,) * 3, unet_levels=2, unet_base_channels=8)
    torch.save(SnakeNetwork(config).state_dict(), folder / "model_best.pth")
    (folder / "config.yaml").write_text(
        "dataset_name: ModelNet40\ngrid_resolution: [8, 8, 8]\nnum_levels: 2\nf_maps: 8\nhidden_size: 32\n"
    )
    return folder


def described(scene, folder):
    """Files as of D3Feat, of each cloud of a scene: its points, each with a score and a descriptor."""
    folder.mkdir(parents=True)
    for cloud in scene.glob("*.ply"):
        points = np.loadtxt(cloud, skiprows=7)
        np.savez(
            folder / f"{cloud.stem}.npz", keypoints=points, scores=points[:, 0], descriptors=points @ np.eye(3, 32)
        )


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page_runs(place, snake_cli, command, monkeypatch):
    """In the order of the page: what trains comes first."""
    words = shlex.split(command)
    for name, added in SMALL.items():
        words += added if name in words else []
    if words[0] == "snake-cli":
        snake_cli(*words[1:], cwd=place)
        return
    assert words[:2] == ["python", "-m"]
    monkeypatch.chdir(place)
    monkeypatch.setenv("SNAKE_CLI", snake_cli.path)
    monkeypatch.setattr(sys, "argv", ["python", *map(str, words[3:])])
    # In this process: to import PyTorch takes longer than a command.
    runpy.run_module(words[2], run_name="__main__")


def test_every_table_and_figure_has_a_row():
    """The paper's 14 tables and its figures of results."""
    named = {int(number) for number in re.findall(r"Tab\. (\d+)", PAGE)}
    assert named == set(range(1, 15))
    assert all(f"Fig. 5{letter}" in PAGE for letter in "abcdefgh") and len(PAGE.split()) <= 1200


def test_the_papers_figures_are_those_of_the_paper():
    """Where the paper lies beside the repository, each figure of the tables stands in it."""
    paper = FOLDER.parent / "shared/paper/snake_arxiv.tex.txt"
    if not paper.exists():
        pytest.skip(f"no {paper}")
    text = paper.read_text()
    rows = [
        row.split("|") for row in PAGE.splitlines() if row.startswith("| ") and re.search(r"Tab|Sec|recall|ratio", row)
    ]
    figures = [number for row in rows for number in re.findall(r"\d+\.\d+", " ".join(row[2:-1]))]
    assert len(figures) > 50
    assert [number for number in figures if number not in text and str(float(number)) not in text] == []
