"""The first command, the tests and the Python module compile the same where they can."""

import json
import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text()


def units(*words):
    """The names of the units that Cargo would compile, by all that decides whether another build can use them."""
    # The plan of a build is an unstable output of Cargo. Nothing is compiled.
    environment = os.environ | {"RUSTC_BOOTSTRAP": "1", "PYO3_BUILD_EXTENSION_MODULE": "1"}
    command = ["cargo", "build", "--release", *words, "--unit-graph", "-Zunstable-options"]
    printed = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, check=True).stdout
    graph = json.loads(printed)["units"]
    keys = {}

    def key(index):
        if index not in keys:
            unit = graph[index]
            own = [unit["pkg_id"], unit["target"], unit["mode"], unit["features"], unit["profile"], unit["platform"]]
            keys[index] = hash((json.dumps(own), *sorted(key(used["index"]) for used in unit["dependencies"])))
        return keys[index]

    return {key(index): graph[index]["target"]["name"] for index in range(len(graph))}


def test_features_do_not_have_crates_compiled_twice():
    packages = re.search(r"^PACKAGES := (.+)$", MAKEFILE, re.MULTILINE)[1].split()
    quick = re.search(r"^QUICK := (.+)$", MAKEFILE, re.MULTILINE)[1].split()
    first, module = units("--bin", "snake-cli"), units("-p", "snake-rs-python", "--lib")
    tests = units(*packages, "--lib", "--bins", "--tests", "--examples")
    assert len(first) > 100 and len(module) > 100
    assert {name for key, name in first.items() if key not in tests} == set()
    assert {name for key, name in module.items() if key not in tests} == set()
    after_edits = units(*quick, "--lib", "--test", "cli")
    assert {name for key, name in first.items() if key not in after_edits} == set()


def test_the_default_program_has_few_packages():
    tree = ["cargo", "tree", "-p", "snake-keypoints", "-e", "normal,build", "--prefix", "none", "--format", "{p}"]
    printed = subprocess.run(tree, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert len({line.removesuffix(" (*)") for line in printed.splitlines()}) <= 147
