"""The modules of the package import each other without a circle, inside functions too."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import snake_training

PACKAGE = Path(snake_training.__file__).parent


def imported(path):
    """Names of the sibling modules that a file imports."""
    package = path.parent.relative_to(PACKAGE).parts
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level > 0:
            base = package[: len(package) - node.level + 1]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            yield from (".".join((*base, name)) for name in names)


def test_modules_import_each_other_without_a_circle():
    name = lambda path: ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
    graph = {name(path): set(imported(path)) for path in PACKAGE.rglob("*.py")}
    assert {"model", "config"} <= graph["export"] and "config" in graph["train"]
    assert list(TopologicalSorter(graph).static_order())
