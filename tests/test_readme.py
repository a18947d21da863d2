"""The examples of the READMEs run, or compile, as they stand."""

import re
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_python_example_runs(capsys):
    text = (ROOT / "README.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    assert "Keypoints(" in capsys.readouterr().out


def test_example_of_the_python_package_runs(tmp_path, monkeypatch):
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "python" / "README.md").read_text(), re.DOTALL)
    shutil.copy(ROOT / "samples" / "plane.ply", tmp_path / "scan.ply")
    shutil.copy(ROOT / "tests" / "data" / "io" / "drive.mcap", tmp_path)
    opened = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = {}
    exec(compile(example, "README.md", "exec"), names)
    assert len(opened) == 1 and (tmp_path / "keypoints.csv").stat().st_size > 100
    assert len(names["keypoints"]) > 0


def test_rust_example_is_the_one_that_cargo_compiles():
    (example,) = re.findall(r"```rust\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert example == (ROOT / "crates/snake-io/examples/keypoints.rs").read_text()
