"""The figures of reconstructed surfaces, on meshes whose distances are known and on the field of a body."""

import numpy as np
import pytest

from snake_training.data import Procedural, write_corpus
from snake_training.reconstruction import draw_surface, figures, main, poisson_mesh, view

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32), np.array([[0, 1, 2], [1, 3, 2]])


def plane(height, number=40_000):
    """Points on the square at a height."""
    return np.column_stack([np.random.default_rng(3).random((number, 2)), np.full(number, height)])


def sphere(number, seed=0):
    direction = np.random.default_rng(seed).normal(size=(number, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def test_points_of_a_mesh_are_uniform_by_area():
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    points = draw_surface(vertices, np.array([[0, 1, 2], [0, 2, 3]]), 40_000, np.random.default_rng(0))
    on_first = points[:, 2] == 0
    assert on_first.mean() == pytest.approx(0.75, abs=0.01)
    np.testing.assert_allclose(points[on_first].mean(axis=0), [1, 1 / 3, 0], atol=0.02)
    assert (points >= 0).all() and (points[on_first] @ [1 / 3, 1, 0] <= 1 + 1e-6).all()


def test_a_shifted_square_is_as_far_off_as_it_is_shifted():
    accuracy, completeness, near, far = figures(SQUARE, plane(0.04))
    assert accuracy == pytest.approx(0.04, abs=0.002) and completeness == pytest.approx(0.04, abs=0.002)
    assert near == 0 and far == pytest.approx(1, abs=1e-3)
    half = SQUARE[0], SQUARE[1][:1]
    accuracy, completeness, near, _ = figures(half, plane(0.0))
    # Half of the points lie on the triangle that is there: precision 1, recall a little above 0.5.
    assert accuracy < 0.01 and completeness > 0.05 and near == pytest.approx(2 * 0.52 / 1.52, abs=0.02)
    nothing = figures((SQUARE[0], SQUARE[1][:0]), plane(0.0))
    assert np.isnan(nothing[:2]).all() and nothing[2:].tolist() == [0, 0]


def test_a_view_is_thinned_and_noisy():
    shape, rng = sphere(3000), np.random.default_rng(1)
    assert len(view(shape, 2000, 8, 0, rng)) == 250
    radii = np.linalg.norm(view(shape, 2000, 1, 0.05, rng), axis=1)
    assert radii.std() == pytest.approx(0.05, abs=0.005)


def test_the_middle_of_the_shell_is_nearer_than_the_level(tmp_path, capsys):
    pytest.importorskip("snake_rs")
    procedural, rng = Procedural(), np.random.default_rng(0)
    write_corpus(tmp_path, [procedural.cloud(rng) for _ in range(3)], points=4096)
    main([str(tmp_path), "--limit", "2", "--resolution", "48", "--downsample", "8", "--noise", "0.03"])
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[:2] for row in rows[::3]] == [["middle", "clean"], ["level", "clean"]]
    assert [row[1] for row in rows[:3]] == ["clean", "1 in 8", "σ 0.03"]
    for middle, level in zip(rows[:3], rows[3:], strict=True):
        accuracy, completeness = (np.float64(middle[i]) / np.float64(level[i]) for i in (2, 3))
        assert accuracy < 0.75 and completeness < 0.75 and float(middle[5]) > float(level[5])


def test_poisson_reconstructs_a_sphere():
    pytest.importorskip("open3d", exc_type=ImportError)
    accuracy, _, _, share = figures(poisson_mesh(sphere(4000)), sphere(8000, seed=1))
    assert accuracy < 0.03 and share > 0.9


def test_what_cannot_be_is_an_error(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path / "nowhere")])
    assert "no such folder" in capsys.readouterr().err
