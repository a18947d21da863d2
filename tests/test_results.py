"""The page of results holds the tables of its evaluations."""

import importlib.util
import re
import subprocess
from pathlib import Path

spec = importlib.util.spec_from_file_location("results", Path(__file__).parents[1] / "docs/results.py")
results = importlib.util.module_from_spec(spec)
spec.loader.exec_module(results)


def table(text: str) -> str:
    """A caption and a table of one method."""
    return f"At ε 0.04:\n\n| method | ε 0.04 |\n|---|---|\n| TABLE {text} | 0.5 |\n"


def test_tables_of_one_evaluation_are_joined():
    tables = """Mean:\n\n| method | ε 0.02 | coverage |\n|---|---|---|\n| iss | 0.1 | 0.2 |\n| iss (paper) | - | - |
\nOver noise:\n\n| method | σ 0 | σ 0.06 |\n|---|---|---|\n| iss | 0.1 | 0.3 |\n"""
    lines = results.joined(tables).splitlines()
    assert lines[0] == "| method | ε 0.02 | coverage | σ 0.06 |" and lines[1] == "|---|---|---|---|"
    assert lines[2:] == ["| iss | 0.1 | 0.2 | 0.3 |", "| iss (paper) | - | - | - |"]


def test_of_the_figures_beyond_chance_one_column_is_shown():
    beyond = (
        "| method | beyond ε 0.02 | beyond ε 0.04 | on flat places |\n|---|---|---|---|\n| iss | 0.3 | 0.4 | 0.5 |\n"
    )
    tables = "Mean:\n\n| method | ε 0.04 |\n|---|---|\n| iss | 0.1 |\n\nBeyond:\n\n" + beyond
    assert results.joined(tables, "0.04").splitlines()[::2] == [
        "| method | ε 0.04 | beyond ε 0.04 | on flat places |",
        "| iss | 0.1 | 0.4 | 0.5 |",
    ]
    assert results.joined(tables).splitlines()[0] == "| method | ε 0.04 |"


def test_parts_hold_their_tables():
    corners = table("C").replace("TABLE C", "snakex4")
    text = results.objects_part(({"pairs": 4}, table("A")), corners, table("B"))
    assert re.findall("TABLE .", text) == ["TABLE A", "TABLE B"] and "on 4 objects" in text
    assert "| TABLE A | 0.5 |\n| snakex4, corners | 0.5 |\n" in text
    tables = "".join(
        f"{title}:\n\n| keypoints | 500 |\n|---|---|\n| {title[:3]} | 1 |\n\n"
        for title in ("Feature", "Inlier", "Registration recall")
    )
    text = results.registration({"scenes": ["kitchen"], "pairs": 9}, tables)
    assert "9 pairs of 1 scene;" in text and "| Fea | 1 |" in text and "| Reg | 1 |" in text and "Inl" not in text


def test_the_part_on_surfaces_holds_the_table_of_its_module(tmp_path, monkeypatch):
    def run(words, **_):
        assert words[1:4] == ["-m", "snake_training.reconstruction", str(tmp_path)] and "poisson" in words
        return subprocess.CompletedProcess(words, 0, stdout="| method |\n|---|\n| middle |\n")

    (tmp_path / "index.json").write_text("[{}, {}, {}]")
    monkeypatch.setattr(subprocess, "run", run)
    text = results.surfaces(str(tmp_path))
    assert text.startswith("## Reconstruction\n") and "on 3 objects" in text and text.endswith("|---|\n| middle |\n")


def test_a_part_that_is_not_made_anew_stays():
    first = results.page({"Objects": "## Objects\n\nA\n\n### More\n", "Scenes": "## Scenes\n\nB\n"}, "")
    assert first.startswith("# Results\n") and first.index("## Objects") < first.index("## Scenes")
    assert results.page({"Scenes": "## Scenes\n\nB\n"}, first) == first
    again = results.page({"Scenes": "## Scenes\n\nC\n"}, first)
    assert "\nA\n\n### More\n" in again and "\nC\n" in again and "\nB\n" not in again
    assert "Scenes" not in results.page({"Objects": "## Objects\n\nA\n"}, "").replace("SCENES", "")


def report(method: str, shapes: int = 4) -> dict:
    """A report of semantic consistency, of one method and one class."""
    figures = {"strict": [0.1, 0.2], "recall": [0.7, 0.8], "keypoints": 12.34}
    rows = [{"method": method, "class": None} | figures, {"method": method, "class": "chair"} | figures]
    return {"shapes": shapes, "rows": rows}


def test_bodies_have_a_row_a_method_and_bent_ones_only_if_there_are_any():
    reports = {
        "annotated": [report("iss"), report("paper")],
        "posed": [report("iss", 5), report("paper", 5)],
        "bent": [],
    }
    text = results.bodies_part(reports)
    assert (
        "4 shapes of 8 classes" in text
        and "5 pairs of such bodies" in text
        and "bent" not in text.replace("--bends", "")
    )
    assert "| method | annotated 0.05 | annotated 0.1 | found 0.05 | found 0.1 | posed 0.05 | posed 0.1 |" in text
    row = "0.100 | 0.200 | 0.700 | 0.800 | 0.100 | 0.200 |\n"
    assert f"| iss | {row}" in text and f"| paper | {row}" in text
    text = results.bodies_part(reports | {"bent": [report("iss", 7), report("paper", 7)]})
    assert "7 pairs of a validation object" in text and f"| iss | {row[:-1]} 0.100 | 0.200 |" in text


def test_a_part_with_two_words_in_its_heading_stays():
    first = results.page({"Semantic consistency": "## Semantic consistency\n\nA\n", "Scenes": "## Scenes\n\nB\n"}, "")
    assert "\nA\n" in results.page({"Scenes": "## Scenes\n\nC\n"}, first)
