"""The examples of the README run, or compile, as they stand."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_python_example_runs(capsys):
    text = (ROOT / "README.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    assert "Keypoints(" in capsys.readouterr().out


def test_rust_example_is_the_one_that_cargo_compiles():
    (example,) = re.findall(r"```rust\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert example == (ROOT / "crates/snake-io/examples/keypoints.rs").read_text()
