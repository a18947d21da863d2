"""The page of results says what its figures say."""

import importlib.util
import re
from pathlib import Path

spec = importlib.util.spec_from_file_location("results", Path(__file__).parents[1] / "docs/results.py")
results = importlib.util.module_from_spec(spec)
spec.loader.exec_module(results)

METHODS = ["snake", "snakex4", "surface-variation", "iss", "harris3d", "sift3d", "fps", "random"]


def repeatability(shares: dict[str, tuple[float, float, float]]) -> dict:
    """Shares of each method at ε 0.04 and 0.1 undisturbed, and at ε 0.04 of noisy views; their standard error is 0.1."""
    rows = []
    for noise in (0.0, 0.1):
        for method in METHODS:
            near, far, noisy = shares.get(method, (0.0, 0.0, 0.0))
            share = [near, far] if noise == 0 else [noisy, 1.0]
            view = {"downsample": 1, "noise": noise}
            rows.append({"method": method, **view, "repeatability": share, "deviation": [0.2, 0.2]})
    return {"settings": {"epsilon": [0.04, 0.1]}, "pairs": 4, "rows": rows}


def registration(recall: dict[str, tuple[float, float]]) -> dict:
    """Recall of each detector with FPFH at 500 and 100 keypoints."""
    rows = [
        {"detector": detector, "descriptor": "fpfh", "keypoints": keypoints, "mean": {"registration_recall": share}}
        for detector in METHODS
        if detector != "snakex4"
        for keypoints, share in zip((500, 100), recall.get(detector, (0.0, 0.0)), strict=True)
    ]
    return {"scenes": ["kitchen"], "pairs": 9, "rows": rows}


def table(text: str) -> str:
    """A caption and a table of one method."""
    return f"At ε 0.04:\n\n| method | ε 0.04 |\n|---|---|\n| TABLE {text} | 0.5 |\n"


def test_tables_of_one_evaluation_are_joined():
    tables = """Mean:\n\n| method | ε 0.02 | coverage |\n|---|---|---|\n| iss | 0.1 | 0.2 |\n| iss (paper) | - | - |
\nOver noise:\n\n| method | σ 0 | σ 0.06 |\n|---|---|---|\n| iss | 0.1 | 0.3 |\n"""
    lines = results.joined(tables).splitlines()
    assert lines[0] == "| method | ε 0.02 | coverage | σ 0.06 |" and lines[1] == "|---|---|---|---|"
    assert lines[2:] == ["| iss | 0.1 | 0.2 | 0.3 |", "| iss (paper) | - | - | - |"]


def test_it_says_where_others_do_as_well():
    report = repeatability({"snake": (0.7, 0.9, 0.5), "fps": (0.4, 0.88, 0.1), "random": (0.1, 0.4, 0.6)})
    assert results.as_good(report, "fps", 0.04) == ["ε 0.1 (0.88 to 0.90)"]
    assert results.as_good(report, "random", 0.04) == ["1 in 1, σ 0.1 (0.60 to 0.50)"]
    text = results.objects_part((report, table("A")), table("B"), table("C"))
    assert "- farthest-point: ε 0.1 (0.88 to 0.90)\n- random: 1 in 1, σ 0.1" in text
    assert "- ISS: nowhere" in text and "on 4 objects" in text
    assert re.findall("TABLE .", text) == ["TABLE A", "TABLE B", "TABLE C"]


def test_it_says_who_registers_as_many_pairs():
    report = registration({"snake": (0.5, 0.25), "fps": (0.5, 0.24), "random": (0.6, 0.3)})
    text = results.registers_as_many(report)
    assert (
        "- farthest-point: fpfh 500 (0.50 to 0.50)\n- random: fpfh 500 (0.60 to 0.50), fpfh 100 (0.30 to 0.25)" in text
    )
    assert "- ISS: nowhere" in text
    assert "Of 2 columns" in text and "or more in 2, farthest points in 1." in " ".join(text.split())


def test_a_part_that_is_not_made_anew_stays():
    first = results.page({"Objects": "## Objects\n\nA\n\n### More\n", "Scenes": "## Scenes\n\nB\n"}, "")
    assert first.startswith("# Results\n") and first.index("## Objects") < first.index("## Scenes")
    assert results.page({"Scenes": "## Scenes\n\nB\n"}, first) == first
    again = results.page({"Scenes": "## Scenes\n\nC\n"}, first)
    assert "\nA\n\n### More\n" in again and "\nC\n" in again and "\nB\n" not in again
    assert "Scenes" not in results.page({"Objects": "## Objects\n\nA\n"}, "").replace("SCENES", "")
