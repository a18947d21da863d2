"""Every command of docs/reproduce.md runs, on miniature data in the official layouts."""

import re
import runpy
import shlex
import sys

import pytest
import torch

from conftest import FOLDER
from snake_training.model import NetworkConfig, SnakeNetwork
from snake_training.paper_tables import ITEMS
from test_official import official_folder

PAGE = (FOLDER / "docs/reproduce.md").read_text()
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.replace("\\\n", " ").splitlines()
    if line.strip()
]
# Options that make a command of the page small, by its module; the later ones override the page's own.
SMALL = {
    "snake_training.reconstruction": ["--resolution", "16", "--limit", "1"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with data/, and an official checkpoint with its configuration."""
    folder = tmp_path_factory.mktemp("paper")
    official_folder(folder / "data")
    config = NetworkConfig(resolution=(8,) * 3, unet_levels=2, unet_base_channels=8)
    torch.save(SnakeNetwork(config).state_dict(), folder / "model_best.pth")
    (folder / "config.yaml").write_text(
        "dataset_name: ModelNet40\ngrid_resolution: [8, 8, 8]\nnum_levels: 2\nf_maps: 8\nhidden_size: 32\n"
    )
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page_runs(folder, snake_cli, command, monkeypatch, capsys):
    """The commands run in the order of the page, in one folder of runs: networks are trained once. The tables have figures of both."""
    words = shlex.split(command)
    assert words[:2] == ["python", "-m"]
    if words[2] == "snake_training.paper":
        words += ["--smoke", "--seeds", "1", "--device", "cpu", "--snake-cli", snake_cli.path]
    monkeypatch.chdir(folder)
    words += SMALL.get(words[2], [])
    monkeypatch.setattr(sys, "argv", ["python", *map(str, words[3:])])
    # In this process: to import PyTorch takes longer than a command.
    runpy.run_module(words[2], run_name="__main__")
    printed = capsys.readouterr().out
    for name in words if "--dry-run" not in words else ():
        if name in ITEMS and ITEMS[name].cells:
            rows = re.findall(
                r"\| .+: .+ \| (\S+) \| (\S+) \|", printed.partition(f"{name}: ")[2].partition("\n\n|")[2]
            )
            assert rows and all(float(ours) >= 0 for _, ours in rows), printed
            assert any(paper != "-" for paper, _ in rows), printed
        elif name in ITEMS:
            outputs = [picture.words.split()[-1].format(run="runs/paper") for picture in ITEMS[name].pictures]
            assert outputs and all((folder / output).stat().st_size > 100 for output in outputs)


def test_the_page_has_every_item_of_the_driver():
    named = {word for command in COMMANDS for word in shlex.split(command)}
    assert set(ITEMS) <= named


def test_every_table_and_figure_has_a_row():
    """The paper's 14 tables and its figures of results."""
    named = {int(number) for number in re.findall(r"Tab\. (\d+)", PAGE)}
    assert named == set(range(1, 15))
    assert all(f"Fig. 5{letter}" in PAGE for letter in "abcdefgh") and len(PAGE.split()) <= 1200


def test_the_papers_figures_are_those_of_the_paper():
    """Where the paper lies beside the repository, each figure of the tables stands in it."""
    paper = FOLDER.parent / "shared/paper/snake_arxiv.tex.txt"
    if not paper.exists():
        pytest.skip("the paper's text is not part of the repository: its figures are not compared")
    text = paper.read_text()
    rows = [
        row.split("|") for row in PAGE.splitlines() if row.startswith("| ") and re.search(r"Tab|Sec|recall|ratio", row)
    ]
    figures = [number for row in rows for number in re.findall(r"\d+\.\d+", " ".join(row[2:-1]))]
    assert len(figures) > 50
    assert [number for number in figures if number not in text and str(float(number)) not in text] == []
