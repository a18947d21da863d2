"""The page of results holds the tables of its evaluations."""

import importlib.util
import re
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("snake_training", reason="pip install ./training")
spec = importlib.util.spec_from_file_location("results", Path(__file__).parents[1] / "docs/results.py")
results = importlib.util.module_from_spec(spec)
spec.loader.exec_module(results)


def test_parts_hold_the_tables_of_real_evaluations(tmp_path, monkeypatch):
    """The parts on objects, bodies and rooms, by the methods that need no network."""
    from snake_training.data import write_corpus
    from snake_training.data.bodies import write_bodies
    from snake_training.data.shapes import Procedural

    monkeypatch.chdir(tmp_path)
    Path("docs").mkdir()
    for name, methods in {"OURS": ("fps",), "CLASSICAL": ("random",), "CORNERS": ()}.items():
        monkeypatch.setattr(results, name, methods)
    write_corpus("objects", [Procedural()[row] for row in range(3)], 600)
    text = results.objects_part("objects", ("--limit", "2"))
    assert (
        "on 2 objects" in text
        and "| method | ε 0.02 | ε 0.04 | ε 0.1 | coverage | 1 in 8 | σ 0.06 | beyond ε 0.04 | on flat places |" in text
    )
    assert len(re.findall(r"^\| fps( \| -?[01]\.\d{3}){8} \|$", text, re.MULTILINE)) == 1
    assert Path("docs/repeatability.svg").stat().st_size > 1000
    write_bodies("bodies", number=8, points=300)
    text = results.bodies_part(Path("bodies"), ())
    assert "| method | annotated 0.05 | annotated 0.1 | found 0.05 | found 0.1 | posed 0.05 | posed 0.1 |" in text
    assert "bent:" not in text and len(re.findall(r"^\| random( \| -?[01]\.\d{3}){6} \|$", text, re.MULTILINE)) == 1


def test_the_part_on_surfaces_holds_the_table_of_its_module(tmp_path, monkeypatch):
    def run(words, **_):
        assert words[1:4] == ["-m", "snake_training.reconstruction", str(tmp_path)] and "poisson" in words
        return subprocess.CompletedProcess(words, 0, stdout="| method |\n|---|\n| middle |\n")

    monkeypatch.setattr(subprocess, "run", run)
    text = results.surfaces_part(str(tmp_path))
    assert text.startswith("## Reconstruction\n") and text.endswith("|---|\n| middle |\n")


def test_a_part_that_is_not_made_anew_stays():
    first = results.page(
        {"Semantic consistency": "## Semantic consistency\n\nA\n\n### More\n", "Scenes": "## Scenes\n\nB\n"}, ""
    )
    assert first.startswith("# Results\n") and first.index("## Semantic") < first.index("## Scenes")
    again = results.page({"Scenes": "## Scenes\n\nC\n"}, first)
    assert "\nA\n\n### More\n" in again and "\nC\n" in again and "\nB\n" not in again
    assert "Scenes" not in results.page({"Objects": "## Objects\n\nA\n"}, "").replace("SCENES", "")
