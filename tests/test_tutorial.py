"""The tutorial and the notebook run, and what they say is so."""

import re
import runpy
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "docs" / "tutorial.ipynb"
NUMBER = r"\d\.\d+(?:e-\d+)?"
TUTORIAL = Path(__file__).parents[1] / "docs" / "tutorial.py"


def test_tutorial(capsys):
    runpy.run_path(str(TUTORIAL), run_name="__main__")
    text = capsys.readouterr().out
    steps = re.findall(r"^(\d)\. ", text, re.MULTILINE)
    assert sorted(set(steps)) == list("12345678") and len(steps) == len(text.splitlines())
    on_surface, far_away = map(float, re.search(r"occupancy (\S+) on the points, (\S+) off", text).groups())
    assert on_surface > 0.8 and far_away < 0.5
    assert float(re.search(r"motion by (\S+) at most", text).group(1)) < 0.05


def results(notebook):
    """The data of the results of all cells."""
    return [output.data for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output]


def test_notebook():
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    stored = results(notebook)
    nbclient.NotebookClient(notebook, timeout=60, resources={"metadata": {"path": NOTEBOOK.parent}}).execute()
    made = results(notebook)
    # A reader gets the outputs of the repository, but for last bits and seconds.
    rounded = [[re.sub(r"[\d.]+(e-\d+)?", "#", data["text/plain"]) for data in outputs] for outputs in (stored, made)]
    assert rounded[0] == rounded[1] and stored[0]["text/plain"] == made[0]["text/plain"], "execute the notebook anew"
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert len(text) < 600_000 and not re.search(r"/(home|root|tmp|Users|work)/", text)
    keypoints, page, occupancies, registration = made
    assert "<svg" in keypoints["text/html"]
    assert page["text/html"].startswith("<iframe srcdoc=") and "plane: keypoints" in page["text/html"]
    on_surface, far_away = map(float, re.findall(NUMBER, occupancies["text/plain"]))
    assert on_surface > 0.8 and far_away < 0.5
    assert float(re.findall(NUMBER, registration["text/plain"])[-1]) < 0.05
