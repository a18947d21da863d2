"""The network against the outputs of the authors' released one, in tests/golden (README.md there)."""

import importlib.util
import shutil
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

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


@pytest.mark.parametrize(
    ("file", "tensor", "said"),
    [
        *(("io", name, f"tiny: {name} differ") for name in ("occupancy", "saliency_grid", "refine_adam_end")),
        ("io", "scatter_voxels_dhw", ""),
        ("weights", "encoder.fc_pos.bias", "weights differ"),
    ],
)
def test_a_changed_value_is_noticed(tmp_path, capsys, file, tensor, said):
    shutil.copytree(GOLDEN / "tiny", tmp_path / "tiny")
    path = tmp_path / "tiny" / f"{file}.safetensors"
    stored = load_file(path)
    with safe_open(path, "pt") as opened:
        metadata = opened.metadata()
    if file == "weights":
        stored[tensor][3] += 1e-6
    else:
        stored[tensor] = stored[tensor] + (1 if stored[tensor].dtype == torch.int32 else 1e-3)
    save_file(stored, path, metadata=metadata)
    assert generate.main([*(["--check"] if file == "io" else []), str(tmp_path / "tiny")]) == 1
    assert said in capsys.readouterr().out


def test_a_folder_without_golden_files_is_an_error(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        generate.main([str(tmp_path)])
    assert stop.value.code == 2 and "io.safetensors" in capsys.readouterr().err
