"""The pages are true: commands and examples run as they stand, and links lead somewhere.

A command of ours runs in a folder where every input that it names exists: files of the repository, and copies of samples under all
other names. A command whose data only the reader has names it in CAPITALS: its options are checked, and it runs until it misses the
data. Of commands that take minutes (training, make, cargo) the target, module, options and paths are checked. Programs of others are
not run.
"""

import contextlib
import io
import itertools
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import warnings
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import tomllib

import snake_rs

ROOT = Path(__file__).parents[1]
LISTED = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
PAGES = [name for name in LISTED.split() if not name.startswith("docs/archive/") and (ROOT / name).is_file()]
OUTPUTS = ("-o", "--output", "--aligned", "--merged", "--view", "--tile-folder", "--screenshot")
DATA_OF_THE_READER = re.compile(r"(?<![=\w])[A-Z]{4,}\b")


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text_of(page), re.DOTALL | re.MULTILINE)


def commands(page: str) -> list[str]:
    """The commands of a page, each on one line, without comments."""
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
    bare = (re.sub(r"(^|\s)#.*", "", line).strip() for line in lines)
    return [line.removeprefix("/usr/bin/time -v ") for line in bare if line]


# training/tests/test_reproduce.py runs the commands of this page on its data sets in miniature.
IN_MINIATURE = "docs/reproduce.md"
COMMANDS = [(page, command) for page in PAGES if page != IN_MINIATURE for command in commands(page)]


def of(*programs: str) -> list:
    return [pytest.param(c, id=f"{page}: {c[:60]}") for page, c in COMMANDS if c.split()[0] in programs]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the samples, in which a test works."""
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    (tmp_path / "docs/gallery").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def stand_in(path: Path) -> None:
    """Makes a file or a folder of this name from a sample."""
    path.parent.mkdir(parents=True, exist_ok=True)
    sample = ROOT / "samples/plane.ply"
    points = snake_rs.read_points(sample)
    recording, suffix = ROOT / "tests/data/io/drive.mcap", path.suffix
    if not suffix and path.name.startswith("drive"):
        stand_in(path / "drive.mcap")
    elif not suffix:
        stand_in(path / "a.ply")
        stand_in(path / "b.ply")
    elif suffix == ".npy":
        np.save(path, points)
    elif suffix == ".csv":
        np.savetxt(path, np.hstack([points, points]), delimiter=",", header="e,n,h,x,y,z", comments="")
    elif suffix in (".las", ".laz"):
        snake_rs.detect(8 * points, max_keypoints=None, nms_radius=None, mode_radius=None).save(
            path.with_suffix(".laz")
        )
        path.with_suffix(".laz").rename(path)
    else:
        given = {
            ".mcap": recording,
            ".safetensors": ROOT / "crates/snake-core/models/compact.safetensors",
            ".ply": sample,
        }
        shutil.copy(given[suffix], path)


def with_inputs(command: str) -> list[str]:
    """The words of a command, each input of which exists then."""
    words = shlex.split(command)
    for i, (before, word) in enumerate(itertools.pairwise(words), 1):
        words[i] = word.lstrip("/") if before in OUTPUTS else word
        path = Path(word.replace("*", "a"))
        is_file = path.suffix in (".ply", ".npy", ".csv", ".las", ".laz", ".mcap", ".safetensors")
        if before not in OUTPUTS and (is_file or word.endswith("/")) and not path.exists():
            stand_in(path)
    return words


@pytest.mark.parametrize("command", of("snake-cli"))
def test_command_runs(command, compiled, folder):
    done = subprocess.run(
        [compiled / "snake-cli", *with_inputs(command)[1:]], capture_output=True, text=True, check=False
    )
    if needs_data := DATA_OF_THE_READER.search(command):
        # It is the data that is missing: every option is known and has a value that it takes.
        assert done.returncode == 2 and needs_data[0] in done.stderr, done.stderr
        assert "Usage" not in done.stderr and "--help" not in done.stderr, done.stderr
    else:
        assert done.returncode == 0, done.stderr
        assert "0 keypoints" not in done.stdout.replace("10 keypoints", ""), done.stdout


def test_commands_of_the_readme_run_as_they_stand(compiled, tmp_path):
    """They run one after another, with the files of a fresh clone alone."""
    tracked = subprocess.run(["git", "ls-files", "samples"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in tracked.stdout.split():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    ours = [c for c in commands("README.md") if "snake-cli " in c and not c.startswith("cargo install")]
    assert ours[0] == "cargo run --release --bin snake-cli -- detect samples/plane.ply" and len(ours) > 5
    assert commands("README.md")[1] == "make test"
    for command in ours:
        words = shlex.split(command.replace("cargo run --release --bin snake-cli -- ", "snake-cli "))
        done = subprocess.run([compiled / "snake-cli", *words[1:]], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        assert "not reliable" not in done.stdout and "warning" not in done.stderr, (
            f"{command}: {done.stdout}{done.stderr}"
        )


def test_the_samples_are_small_and_their_script_makes_them(tmp_path, monkeypatch, generate):
    monkeypatch.setattr(generate, "FOLDER", tmp_path)
    generate.main()
    made = {path.relative_to(tmp_path): path for path in tmp_path.rglob("*.ply")}
    assert len(made) == 4
    for name, path in made.items():
        # Sines differ in the last digit between machines.
        one, other = snake_rs.read_points(path), snake_rs.read_points(ROOT / "samples" / name)
        np.testing.assert_allclose(one, other, atol=1e-4)
    assert sum(path.stat().st_size for path in (ROOT / "samples").rglob("*.ply")) < 400_000


@pytest.mark.parametrize("command", of("make"))
def test_target_exists(command):
    assert re.search(rf"^{command.split()[1]}:.* ## ", (ROOT / "Makefile").read_text(), re.MULTILINE)


@cache
def help_of(program: str, *kind: str) -> str:
    """The help of a module or of the script of a path, in this process: each process would import PyTorch again.

    kind: of the data that `snake_training.make` makes, or of an evaluation.
    """
    run = runpy.run_path if program.endswith(".py") else runpy.run_module
    with (
        mock.patch.object(sys, "argv", [program, *kind, "--help"]),
        mock.patch.object(sys, "path", [str(Path(program).parent), *sys.path]),  # as Python does for a script
        contextlib.redirect_stdout(io.StringIO()) as printed,
        warnings.catch_warnings(action="ignore", category=RuntimeWarning),  # the module is imported already
        pytest.raises(SystemExit, match=r"^(0|None)$"),
    ):
        run(program, run_name="__main__")
    return printed.getvalue()


@pytest.mark.parametrize("command", of("python", "python3"))
def test_options_of_python_exist(command):
    words = shlex.split(command.split(" -- ")[0])
    flags = [word.split("=")[0] for word in words[2:] if word.startswith("--")]
    if words[1] == "-m" and words[2].startswith("snake_training"):
        pytest.importorskip("snake_training", reason="pip install ./training")
        program = words[2]
    else:
        found = [folder / words[1] for folder in (ROOT, ROOT / "training") if (folder / words[1]).is_file()]
        assert found, f"{words[1]} is not in the repository"
        program = str(found[0])
    kind = words[3:4] if program in ("snake_training.make", "snake_training.evaluation") else []
    assert not flags or not (unknown := [flag for flag in flags if flag not in help_of(program, *kind)]), unknown


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "c")])
def test_c_compiles(page, folder):
    if not (compiler := shutil.which("cc")):
        pytest.skip("no C compiler")
    (block,) = blocks(page, "c")
    (folder / "block.c").write_text(f'#include <stdio.h>\n#include "snake_rs.h"\nvoid block(void) {{\n{block}}}\n')
    include = ROOT / "crates/snake-capi/include"
    done = subprocess.run([compiler, "-fsyntax-only", "-I", include, "block.c"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", of("cargo", "pip"))
def test_paths_of_installers_exist(command):
    words = shlex.split(command.split(" -- ")[0])
    members = [path for folder in ("crates", "tests") for path in (ROOT / folder).iterdir()]
    manifests = [tomllib.loads(path.read_text()) for member in members for path in member.glob("Cargo.toml")]
    packages = {manifest["package"]["name"] for manifest in manifests}
    for before, word in itertools.pairwise(words):
        if before == "--path" or word.startswith("./"):
            assert (ROOT / word.split("[")[0]).is_dir()
        if before == "-p" or (before == "install" and words[0] == "cargo" and not word.startswith("-")):
            assert word in packages
        if before == "--example":
            assert any((member / f"examples/{word}.rs").exists() for member in members)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_python_runs(page, folder, monkeypatch, capsys):
    """Blocks run one after another; those that need other packages than ours are compiled."""
    opened, names = [], {}
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    for block in blocks(page, "python"):
        code = compile(block, page, "exec")
        imported = set(re.findall(r"^(?:import|from) (\w+)", block, re.MULTILINE))
        if imported <= {"snake_rs", "numpy"}:
            for name in re.findall(r'"([\w./]+\.(?:ply|mcap))"', block):
                if not Path(name).exists():
                    stand_in(Path(name))
            exec(code, names | {"snake_rs": snake_rs})
    if page == "README.md":
        assert "Keypoints(34" in capsys.readouterr().out


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", text_of(page)):
        if "://" not in link:
            name, _, anchor = link.partition("#")
            target = (ROOT / page).parent / name if name else ROOT / page
            assert target.exists(), link
            assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize(
    "folder", [path.parent for path in sorted(ROOT.glob("crates/*/Cargo.toml"))], ids=lambda path: path.name
)
def test_a_published_crate_carries_its_page_and_licences(folder):
    for name in ("README.md", "LICENSE-MIT", "LICENSE-APACHE"):
        assert (folder / name).is_file(), name
    package = tomllib.loads((folder / "Cargo.toml").read_text())["package"]
    assert package["description"] and package.get("readme", "README.md")
