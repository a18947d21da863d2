"""`snake-cli eval` compares methods where their keypoints cover alike, and those of other programs from files."""

import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

import snake_rs


def report(compiled, folder, *arguments):
    """The rows of an evaluation without disturbances, by method."""
    results = Path(tempfile.mkdtemp(dir=folder))
    command = [compiled / "snake-cli", "eval", "repeatability", folder, "-o", results, "--epsilon", "0.02"]
    command += ["--downsample", "1", "--noise", "0", *arguments]
    subprocess.run([str(word) for word in command], check=True, capture_output=True)
    rows = json.loads((results / "repeatability.json").read_text())["rows"]
    return {row["method"]: row for row in rows}


@pytest.fixture
def pair(tmp_path):
    """Two clouds of one surface, the second moved by 1 along x, and the folder of the data set."""
    points = snake_rs.read_points("samples/plane.ply")
    np.save(tmp_path / "a.npy", points)
    np.save(tmp_path / "b.npy", points + np.float32([1, 0, 0]))
    to_a = np.eye(4)
    to_a[0, 3] = -1
    pairs = [{"source": "b.npy", "target": "a.npy", "T": to_a.tolist()}]
    (tmp_path / "pairs.json").write_text(json.dumps(pairs))
    return tmp_path, points


def test_methods_cover_as_asked(compiled, pair):
    folder, _ = pair
    asked = 0.088
    methods = ["--methods", "snake,iss", "--model", "compact", "--max-keypoints", "40"]
    alike = report(compiled, folder, *methods, "--coverage", asked)
    assert all(0.9 * asked < row["coverage"] <= 1.001 * asked for row in alike.values()), alike
    own = report(compiled, folder, *methods)
    assert max(own[method]["coverage"] for method in own) > 1.2 * asked


def test_keypoints_of_files_are_ranked_by_their_scores(compiled, pair):
    """The best 20 of one file are the best 20 of the other, in another order; the rest have no partner."""
    folder, points = pair
    (folder / "found").mkdir()
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(points), 60, replace=False)
    best, others = points[chosen[:20]], points[chosen[20:]]
    for name, shift, rest in (("a", 0, others[:20]), ("b", 1, others[20:] + np.float32([0, 0, 5]))):
        keypoints, scores = np.vstack([rest, best]), np.r_[np.zeros(20), np.ones(20)]
        order = rng.permutation(40)
        moved = keypoints[order] + np.float32([shift, 0, 0])
        np.savez(folder / f"found/{name}.npz", keypoints=moved, scores=scores[order])
    external = ["--methods", "random", "--external", f"other={folder / 'found'}"]
    assert report(compiled, folder, *external, "--max-keypoints", "20")["other"]["repeatability"] == [1.0]
    whole = report(compiled, folder, *external, "--max-keypoints", "40")["other"]
    assert whole["keypoints"] == 40 and 0.5 <= whole["repeatability"][0] < 0.75


def test_keypoints_of_files_are_in_the_frame_of_far_clouds(compiled, tmp_path):
    """All points that are keypoints are found again, in georeferenced clouds too."""
    points = snake_rs.read_points("samples/plane.ply").astype(np.float64)
    (tmp_path / "found").mkdir()
    for name, shift in (("a", [5e5, 5e6, 100]), ("b", [5e5, 5e6 + 1, 100])):
        np.save(tmp_path / f"{name}.npy", points + shift)
        np.savez(tmp_path / f"found/{name}.npz", keypoints=points[:60] + shift)
    to_a = np.eye(4)
    to_a[1, 3] = -1
    (tmp_path / "pairs.json").write_text(json.dumps([{"source": "b.npy", "target": "a.npy", "T": to_a.tolist()}]))
    found = report(compiled, tmp_path, "--methods", "random", "--external", f"other={tmp_path / 'found'}")
    assert found["other"]["repeatability"] == [1.0] and found["other"]["coverage"] < 1


def test_files_that_are_wrong_are_named(compiled, pair):
    folder, points = pair
    (folder / "found").mkdir()

    def error(**arrays):
        np.savez(folder / "found/a.npz", **arrays)
        with pytest.raises(subprocess.CalledProcessError) as failure:
            report(compiled, folder, "--methods", "random", "--external", f"other={folder / 'found'}")
        return failure.value.stderr.decode()

    assert "keypoints" in error(points=points)
    assert "(K, 3)" in error(keypoints=points[:, :2])
    assert "scores" in error(keypoints=points, scores=np.zeros(3))
    assert "not finite" in error(keypoints=np.full((4, 3), np.nan))


def test_semantic_suppresses_until_keypoints_cover_as_asked(compiled, tmp_path):
    """Every ninth point on a line is a keypoint, on both bodies; the second has no more than these."""
    line = np.zeros((101, 3), np.float32)
    line[:, 0] = np.arange(101)
    for body, step in ((1, 1), (2, 9)):
        np.save(tmp_path / f"body_{body}.npy", line[None])
        (tmp_path / "found").mkdir(exist_ok=True)
        np.savez(tmp_path / f"found/body_{body}_0.npz", keypoints=line[::step])

    def share(*arguments):
        external = ["--methods", "random", "--external", f"other={tmp_path / 'found'}", "--max-keypoints", 11]
        command = [compiled / "snake-cli", "eval", "semantic", tmp_path, "-o", Path(tempfile.mkdtemp(dir=tmp_path))]
        command += ["--threshold", 0.5, *external, *arguments]
        subprocess.run([str(word) for word in command], check=True, capture_output=True)
        rows = json.loads((command[5] / "semantic.json").read_text())["rows"]
        return next(row["strict"] for row in rows if row["method"] == "other")

    # Every ninth point covers the line at 2.55, every eighth at 3.65.
    assert share("--coverage", 2.6) == [1.0]
    assert share()[0] < 0.2
