"""The README's Python example runs as it stands."""

import re
from pathlib import Path


def test_python_example_runs(capsys):
    text = (Path(__file__).parents[1] / "README.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    assert "Keypoints(" in capsys.readouterr().out
