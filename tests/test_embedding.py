"""The blocks of docs/embedding.md are parts of examples, and its commands run."""

import re
import subprocess
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "embedding.md").read_text()
FILES = [path for folder in ("crates", "tests") for path in (ROOT / folder).glob("*/examples/**/*.[rc]*")]
EXAMPLES = {path: path.read_text() for path in FILES if path.is_file()}


def test_every_block_of_code_is_a_part_of_an_example():
    blocks = re.findall(r"```(?:rust|cpp)\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) >= 6
    for block in blocks:
        body = textwrap.indent(block, "    ")  # the blocks are parts of main
        assert any(body in example for example in EXAMPLES.values()), block


COMMANDS = re.findall(r"^cargo run --release -p \S+ --example \S+(?: -- .*)?$", PAGE, re.MULTILINE)
# The output of an example, where it shows that the example did its work.
PRINTED = {
    "pointcloud2": "400 points skipped",
    "frames": "pairs with the keypoints",
    "mcap_replay": "2 of 2 clouds have keypoints",
}


def name_of(command):
    return re.search(r"--example (\S+)", command)[1]


@pytest.fixture(scope="module")
def examples(compiled):
    return compiled / "examples"


def test_every_example_of_the_core_is_on_the_page():
    names = {path.stem for path in EXAMPLES if path.parts[-3] == "snake-core"}
    assert names <= {name_of(command) for command in COMMANDS}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_names_the_crate_of_its_example(command):
    crate, name = re.search(r"-p (\S+) --example (\S+)", command).groups()
    assert (ROOT / "crates" / crate / "examples" / f"{name}.rs").is_file()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_example_runs(command, examples, tmp_path):
    name = name_of(command)
    arguments = {
        "frames": ["samples/room/1.ply", "samples/room/2.ply"],
        "mcap_replay": ["tests/data/io/drive.mcap", str(tmp_path / "keypoints.mcap")],
    }
    run = [examples / name, *arguments.get(name, [])]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert PRINTED.get(name, "") in done.stdout
    if name == "mcap_replay":
        assert b"/keypoints" in (tmp_path / "keypoints.mcap").read_bytes()
