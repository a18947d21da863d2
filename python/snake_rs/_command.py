"""The command `snake-cli`, the same program as of the Rust package."""

import signal
import sys

from snake_rs._core import run_command


def main() -> int:
    """Runs the program with the arguments of the process, and returns its exit code."""
    # The program ends at Ctrl-C, but never within a file. Python's handler would wait for the end of the work.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_command(["snake-cli", *sys.argv[1:]])
