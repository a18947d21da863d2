"""The package: stub and documentation."""

import ast
import importlib.metadata
import subprocess
import sys
import tarfile
from pathlib import Path
from types import ModuleType

import pytest

import snake_rs

STUB = Path(__file__).parents[1] / "python" / "snake_rs" / "_core.pyi"


def test_the_stub_lists_every_option(model):
    classes = [node for node in ast.parse(STUB.read_text()).body if isinstance(node, ast.ClassDef)]
    names = {c.name: [n.target.id for n in c.body if isinstance(n, ast.AnnAssign)] for c in classes}
    parts = names["_EncodeOptions"] + names["_DetectOptions"] + names["_Options"]
    assert parts == list(model.recommended)
    assert set(names["_Config"]) == set(model.config)


def test_the_stub_matches_the_module():
    pytest.importorskip("mypy.stubtest")
    # The other modules are of Python and have no stub.
    words = [sys.executable, "-m", "mypy.stubtest", "snake_rs._core"]
    result = subprocess.run(words, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


def test_everything_public_is_documented():
    public = [getattr(snake_rs, name) for name in snake_rs.__all__ if name != "__version__"]
    classes, parts = ([thing for thing in public if isinstance(thing, kind)] for kind in (type, ModuleType))
    assert len(classes) > 20 and parts == [snake_rs.baselines, snake_rs.steps]
    functions = [getattr(part, name) for part in parts for name in part.__all__]
    functions += [thing for thing in public if thing not in (*classes, *parts)]
    members = [getattr(c, name) for c in classes for name in vars(c) if not name.startswith("_")]
    assert len(members) > 20
    assert all(thing.__doc__ for thing in (snake_rs, *parts, *functions, *classes, *members))
    assert {c.__module__ for c in classes} == {"snake_rs"}


def test_a_source_distribution_has_the_modules_of_python(tmp_path):
    """`make sdist` compiles what it has of Rust."""
    root = STUB.parents[2]
    words = [sys.executable, "-m", "maturin", "sdist", "--manifest-path", root / "python/Cargo.toml", "--out", tmp_path]
    subprocess.run(list(map(str, words)), check=True, capture_output=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        names = {name.partition("/")[2] for name in tar.getnames()}
    sources = [path for pattern in ("*.py", "*.pyi", "py.typed") for path in STUB.parent.glob(pattern)]
    assert {f"snake_rs/{path.name}" for path in sources} <= names and len(sources) > 6
    assert {"pyproject.toml", "crates/snake-core/models/compact.safetensors"} <= names


def test_the_package_brings_the_licences_of_what_it_contains():
    try:
        (path,) = (path for path in importlib.metadata.files("snake-rs") if path.name == "LICENSE-THIRD-PARTY")
    except importlib.metadata.PackageNotFoundError:
        # `make test` compiles the module and does not install it.
        path = Path(__file__).parents[1] / "python/LICENSE-THIRD-PARTY"
    text = path.read_text()
    for crate in ("laz", "pyo3", "nalgebra", "ruzstd"):
        assert f"\n{crate} " in text, crate
    for words in ("Permission is hereby granted, free of charge", "Redistributions of source code must retain"):
        assert words in text
