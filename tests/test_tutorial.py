"""The tutorial runs, and what it says is so."""

import re
import runpy
from pathlib import Path


def test_tutorial(capsys):
    runpy.run_path(str(Path(__file__).parents[1] / "docs/tutorial.py"), run_name="__main__")
    text = capsys.readouterr().out
    steps = re.findall(r"^(\d)\. ", text, re.MULTILINE)
    assert sorted(set(steps)) == list("12345678") and len(steps) == len(text.splitlines())
    on_surface, far_away = map(float, re.search(r"occupancy (\S+) on the points, (\S+) off", text).groups())
    assert on_surface > 0.8 and far_away < 0.5
    assert float(re.search(r"motion by (\S+) at most", text).group(1)) < 0.05
