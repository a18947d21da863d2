"""The page of results holds the tables of its evaluations."""

import importlib.util
import re
from pathlib import Path

import pytest

pytest.importorskip("snake_training", reason="pip install ./training")
spec = importlib.util.spec_from_file_location("results", Path(__file__).parents[1] / "docs/results.py")
results = importlib.util.module_from_spec(spec)
spec.loader.exec_module(results)


def test_parts_hold_the_tables_of_real_evaluations(tmp_path, monkeypatch):
    """The parts on objects and bodies, by the methods that need no network."""
    from snake_training.data import write_corpus
    from snake_training.data.bodies import write_bodies
    from snake_training.data.shapes import Procedural

    monkeypatch.chdir(tmp_path)
    Path("docs").mkdir()
    for name, methods in {"OURS": ("fps",), "CLASSICAL": ("random",), "CORNERS": ()}.items():
        monkeypatch.setattr(results, name, methods)
    write_corpus("objects", [Procedural()[row] for row in range(3)], 600)
    tables = results.objects_tables("objects", "--limit 2")
    assert (
        set(tables) == {"objects", "the paper's protocol"} and "| beyond ε 0.04 | on flat places |" in tables["objects"]
    )
    assert len(re.findall(r"^\| fps( \| -?[01]\.\d{3}){8} \|$", tables["objects"], re.MULTILINE)) == 1
    assert Path("docs/repeatability.svg").stat().st_size > 1000
    write_bodies("bodies", number=8, points=300)
    text = results.bodies_tables(Path("bodies"), "")["bodies"]
    assert "| method | annotated 0.05 | annotated 0.1 | found 0.05 | found 0.1 | posed 0.05 | posed 0.1 |" in text
    assert len(re.findall(r"^\| random( \| -?[01]\.\d{3}){6} \|$", text, re.MULTILINE)) == 1


def test_the_page_has_a_place_for_each_table_and_keeps_the_rest():
    before = (Path(__file__).parents[1] / "docs/results.md").read_text()
    named = ("objects", "landmarks", "bodies", "reconstruction", "scenes", "registration recall")
    after = results.page({name: f"| {name} |\n|---|\n" for name in named}, before)
    assert all(f"<!-- table: {name} -->\n| {name} |\n|---|\n\n" in after + "\n" for name in named)
    assert [line for line in after.splitlines() if line[:1] == "#"] == [
        line for line in before.splitlines() if line[:1] == "#"
    ]
    with pytest.raises(ValueError, match="not enough values"):
        results.page({"other": ""}, before)
