"""The command `snake-cli` of the Python package is the program."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "samples/plane.ply"
# The script that pip makes of the entry point.
COMMAND = [sys.executable, "-c", "import sys; from snake_rs._command import main; sys.exit(main())"]


def run(*words, **settings):
    return subprocess.run([*map(str, words)], capture_output=True, check=False, cwd=ROOT, **settings)


@pytest.mark.parametrize(
    "words",
    [
        ["detect", "samples/plane.ply", "-o", "-", "--format", "csv", "--quiet"],
        ["--version"],
        ["detect", "none.ply"],
        ["detect", "--no-such-option"],
        ["detect", os.fsdecode(b"\xff\x1b.ply")],
        [],
    ],
)
def test_it_prints_and_returns_what_the_program_does(compiled, words):
    ours, program = run(*COMMAND, *words), run(compiled / "snake-cli", *words)
    assert (ours.returncode, ours.stdout, ours.stderr) == (program.returncode, program.stdout, program.stderr)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_it_as_the_program(tmp_path):
    wait = tmp_path / "cloud.xyz"
    os.mkfifo(wait)
    # A shell's background process ignores the signal.
    heard = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {COMMAND[2]}"
    with subprocess.Popen([*COMMAND[:2], heard, "detect", wait], stderr=subprocess.PIPE) as running:
        with open(wait, "w"):  # opens when the command reads it
            time.sleep(0.1)
            running.send_signal(signal.SIGINT)
            assert running.wait(timeout=30) == 130
        assert running.stderr.read().strip() == b"interrupted"
