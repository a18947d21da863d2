"""The network against the outputs of the authors' released one, in tests/golden (README.md there)."""

import importlib.util
from pathlib import Path

import pytest
from safetensors import safe_open

REPOSITORY = Path(__file__).resolve().parents[2]
GOLDEN = REPOSITORY / "tests" / "golden"
FULL = REPOSITORY.parent / "shared" / "golden" / "full"


def load_generator():
    """tests/golden/generate.py as a module; it is a script in no package."""
    spec = importlib.util.spec_from_file_location("generate", GOLDEN / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = load_generator()


@pytest.mark.parametrize("name", ["tiny", "odd", "anisotropic"])
def test_every_stage_agrees_with_the_released_network(name, capsys):
    assert generate.main(["--check", str(GOLDEN / name)]) == 0
    printed = capsys.readouterr().out
    with safe_open(GOLDEN / name / "io.safetensors", "pt") as file:
        compared = set(file.keys())
    # Inputs are not compared with themselves.
    inputs = {"points", "queries", "volume_sample_index", "occupancy_output_bias", "saliency_output_bias"}
    assert all(f"  {tensor} " in printed for tensor in compared - inputs)
    assert "seeded weights" in printed and "MISMATCH" not in printed


@pytest.mark.skipif(
    not FULL.exists(), reason=f"{FULL} is not here: the paper's network (20 MB) is not in the repository"
)
def test_the_papers_network_agrees():
    assert generate.main(["--check", str(FULL)]) == 0
