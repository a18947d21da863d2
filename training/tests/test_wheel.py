"""`pip install ./training` installs everything: its wheel, in an environment of its own, away from the repository."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from conftest import FOLDER

RECIPE = '[[stages]]\nname = "field"\nkind = "objects"\n'


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of a copy of the package: the build leaves its files beside the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    source = shutil.copytree(
        FOLDER / "training", folder / "training", ignore=shutil.ignore_patterns("*.egg-info", "build")
    )
    words = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source]
    subprocess.run([sys.executable, *map(str, words)], check=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """python(*words) -> what an interpreter did that has the wheel, and beside it what the package needs."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    interpreter = folder / "venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    words = ["--python", interpreter, "install", "--quiet", "--no-deps", "--no-index", wheel]
    subprocess.run([sys.executable, "-m", "pip", *map(str, words)], check=True)
    # Folders that a .pth file names come after those of the environment, and their own .pth files are not read: an editable
    # installation of this repository stays out.
    site = next((folder / "venv").rglob("site-packages"))
    (site / "dependencies.pth").write_text("\n".join({sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}))
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"OMP_NUM_THREADS": "1"}

    def run(*words):
        done = subprocess.run(
            [interpreter, *map(str, words)], check=False, capture_output=True, text=True, cwd=folder, env=environment
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_a_wheel_has_every_module(wheel):
    package = FOLDER / "training/snake_training"
    modules = {path.relative_to(package.parent).as_posix() for path in package.rglob("*.py")}
    packed = {name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".py")}
    assert packed == modules and len(modules) > 20


def test_an_installed_wheel_trains(python, tmp_path):
    origin = Path(python("-c", "import snake_training; print(snake_training.__file__)").strip())
    assert "site-packages" in origin.parts and not origin.is_relative_to(FOLDER)
    (tmp_path / "smallest.toml").write_text(RECIPE)
    words = ["--smoke", "--device", "cpu", "--run-dir", tmp_path / "runs"]
    python("-m", "snake_training.recipes", tmp_path / "smallest.toml", *words)
    assert (tmp_path / "runs/smallest/field/weights.safetensors").stat().st_size > 1000
