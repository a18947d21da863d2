"""The blocks of docs/embedding.md are parts of examples, which cargo compiles, and its commands name examples."""

import re
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "embedding.md").read_text()
EXAMPLES = {path: path.read_text() for path in ROOT.glob("crates/*/examples/*.rs")}


def test_every_block_of_rust_is_a_part_of_an_example():
    blocks = re.findall(r"```rust\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) >= 6
    for block in blocks:
        body = textwrap.indent(block, "    ")  # the blocks are parts of main
        assert any(body in example for example in EXAMPLES.values()), block


def test_every_command_names_an_example():
    commands = re.findall(r"^cargo run --release -p (\S+) --example (\S+)$", PAGE, re.MULTILINE)
    assert len(commands) >= 6
    for crate, name in commands:
        assert ROOT / "crates" / crate / "examples" / f"{name}.rs" in EXAMPLES
