"""Makes the archive of a release in target/dist, snake-cli-VERSION-TRIPLE.tar.gz (.zip for Windows).

It holds the program, completions of all shells, the README, the changelog and the licences, also those of the crates within.
Needs cargo and nothing else.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHELLS = {
    "bash": "snake-cli.bash",
    "zsh": "_snake-cli",
    "fish": "snake-cli.fish",
    "powershell": "_snake-cli.ps1",
    "elvish": "snake-cli.elv",
}


def host() -> str:
    text = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    return re.search(r"^host: (\S+)$", text, re.MULTILINE)[1]


def build(target: str) -> Path:
    """Compiles the program for a target and returns its path."""
    # The folder of the host's own builds, so that nothing is compiled twice.
    other = [] if target == host() else ["--target", target]
    subprocess.run(
        ["cargo", "build", "--release", "--locked", "-p", "snake-keypoints", *other],
        cwd=ROOT,
        check=True,
    )
    metadata = ["cargo", "metadata", "--no-deps", "--format-version", "1"]
    found = json.loads(subprocess.run(metadata, cwd=ROOT, capture_output=True, check=True).stdout)
    folder = Path(found["target_directory"])
    return folder / (target if other else "") / "release" / f"snake-cli{'.exe' if 'windows' in target else ''}"


def fill(folder: Path, program: Path) -> None:
    """Writes the content of the archive. The program is run: it must be one of this machine."""
    (folder / "completions").mkdir(parents=True)
    shutil.copy2(program, folder)
    for shell, name in SHELLS.items():
        script = subprocess.run([program, "completions", shell], capture_output=True, check=True).stdout
        (folder / "completions" / name).write_bytes(script)
    for name in ("README.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE"):
        shutil.copy(ROOT / name, folder)
    licences = [sys.executable, ROOT / "python/third_party_licenses.py", "--package", "snake-keypoints"]
    subprocess.run([*licences, "--output", folder / "LICENSE-THIRD-PARTY"], check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--target", default=host(), help="triple of the target; this machine must be able to run its programs"
    )
    target = parser.parse_args().target
    version = re.search(r'^version = "(.*)"$', (ROOT / "Cargo.toml").read_text(encoding="utf-8"), re.MULTILINE)[1]
    folder = ROOT / "target/dist" / f"snake-cli-{version}-{target}"
    shutil.rmtree(folder, ignore_errors=True)
    fill(folder, build(target))
    kind = "zip" if "windows" in target else "gztar"
    print(shutil.make_archive(str(folder), kind, folder.parent, folder.name))


if __name__ == "__main__":
    main()
