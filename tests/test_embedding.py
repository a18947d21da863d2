"""The blocks of docs/embedding.md are parts of examples, and its commands run."""

import re
import subprocess
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "embedding.md").read_text()
EXAMPLES = {path: path.read_text() for path in ROOT.glob("crates/*/examples/**/*.[rc]*") if path.is_file()}


def test_every_block_of_code_is_a_part_of_an_example():
    blocks = re.findall(r"```(?:rust|cpp)\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) >= 6
    for block in blocks:
        body = textwrap.indent(block, "    ")  # the blocks are parts of main
        assert any(body in example for example in EXAMPLES.values()), block


COMMANDS = re.findall(r"^cargo run --release -p \S+(?: --features \S+)? --example \S+$", PAGE, re.MULTILINE)
# What an example prints, where it shows that the example did its work.
PRINTED = {
    "geometry": "the same with nalgebra: true",
    "pointcloud2": "400 points skipped",
    "arrow_cloud": "keypoints of 3600 points",
    "realtime_loop": "p99",
}


def test_the_clouds_of_a_recording_have_keypoints(tmp_path):
    command = next(line for line in PAGE.splitlines() if "mcap_replay" in line and line.startswith("cargo"))
    words = command.replace("keypoints.mcap", str(tmp_path / "keypoints.mcap")).split()
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "2 of 2 clouds have keypoints" in done.stdout
    assert b"/keypoints" in (tmp_path / "keypoints.mcap").read_bytes()


def test_every_example_of_the_core_is_on_the_page():
    names = {path.stem for path in EXAMPLES if path.parts[-3] == "snake-core"}
    assert names <= {command.split()[-1] for command in COMMANDS}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_runs(command):
    name = command.split()[-1]
    arguments = ["--", "5", "20000"] if name == "realtime_loop" else []
    done = subprocess.run([*command.split(), *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert PRINTED.get(name, "") in done.stdout
