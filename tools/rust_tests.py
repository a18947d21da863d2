"""Runs `cargo test --release` with the given words, and prints the ten slowest tests: python tools/rust_tests.py --workspace.

The time of a test is an unstable option of the test programs, which they take from this variable; it does not reach the compiler.
"""

import os
import re
import subprocess
import sys

LINE = re.compile(r"^test (.+) \.\.\. ok <([\d.]+)s>$")


def host() -> str:
    text = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    return re.search(r"^host: (\S+)$", text, re.MULTILINE)[1]


def main() -> int:
    words = ["cargo", "test", "--release", *sys.argv[1:]]
    runner = f"CARGO_TARGET_{host().upper().replace('-', '_')}_RUNNER"
    environment = os.environ | {runner: "env RUSTC_BOOTSTRAP=1"}
    programs = ["--lib", "--bins", "--tests", "--examples", "--", "-Zunstable-options", "--report-time"]
    slowest = []
    with subprocess.Popen([*words, *programs], env=environment, stdout=subprocess.PIPE, text=True) as running:
        for line in running.stdout:
            sys.stdout.write(line)
            sys.stdout.flush()
            if found := LINE.match(line):
                slowest.append((float(found[2]), found[1]))
    # Documentation is tested by rustdoc, which has no times.
    code = running.returncode or subprocess.run([*words, "--doc"], check=False).returncode
    print("\nslowest tests of Rust:")
    for seconds, name in sorted(slowest, reverse=True)[:10]:
        print(f"{seconds:6.1f} s  {name}")
    return code


if __name__ == "__main__":
    sys.exit(main())
