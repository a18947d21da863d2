"""The page of results says what its figures say."""

import importlib.util
from pathlib import Path

import pytest

spec = importlib.util.spec_from_file_location("results", Path(__file__).parents[1] / "docs/results.py")
results = importlib.util.module_from_spec(spec)
spec.loader.exec_module(results)

METHODS = ["snake", "iss", "harris3d", "sift3d", "fps", "random"]


def rows(shares: dict[str, tuple[float, float, float]], coverage: dict[str, float]) -> list[dict]:
    """Shares of each method at ε 0.04 and 0.1 undisturbed, and at ε 0.04 of noisy views."""
    made = []
    for noise in (0.0, 0.1):
        for method in METHODS:
            near, far, noisy = shares.get(method, (0.0, 0.0, 0.0))
            share = {0.04: near, 0.1: far} if noise == 0 else {0.04: noisy, 0.1: 1.0}
            view = {"downsample": 1, "noise": noise, "coverage": coverage.get(method, 0.1)}
            made.append({"method": method, **view, "repeatability": share, "pairs": 3})
    return made


def test_it_says_where_others_do_as_well():
    made = rows({"snake": (0.7, 0.9, 0.5), "fps": (0.4, 0.88, 0.1), "random": (0.1, 0.4, 0.6)}, {})
    assert results.as_good(made, "fps") == ["ε 0.1 (0.88 to 0.90)"]
    assert results.as_good(made, "random") == ["1 in 1, σ 0.1 (0.60 to 0.50)"]
    text = results.page(made, "TABLE A\n", "TABLE B\n", "TABLE C\n")
    assert "- farthest-point: ε 0.1 (0.88 to 0.90)\n- random: 1 in 1, σ 0.1" in text
    assert "- ISS: nowhere" in text and "on 3 objects" in text
    assert text.index("TABLE A") < text.index("TABLE B") < text.index("TABLE C")


@pytest.mark.parametrize(("model", "clusters"), [(0.25, True), (0.05, False)])
def test_it_says_whether_the_models_keypoints_cluster(model, clusters):
    text = results.page(rows({}, {"snake": model, "random": 0.1}), "", "", "")
    assert f"{model:.3f} for the model" in text
    assert ("keypoints cluster" in text) == clusters
