"""Where default keypoints of made rooms lie, and the measures of it."""

import numpy as np

from snake_training.data.solids import CUBE, Solids
from snake_training.evaluation.places import NOISES, corner_row, from_edges, main, scan_row


def test_the_distance_to_edges():
    world = Solids()
    world.add(CUBE, (1, 0, 0), (1, 2, 3))
    points = np.array([[0, -2, 1.5], [2, 2, 4], [1, 0, 3.0], [0, 0, 0]])
    assert np.allclose(from_edges(points, world), [0, 1, 1, 2])


def test_corners_of_made_rooms_are_found_and_their_walls_are_not():
    seeds = range(100, 104)
    for spacing in (0.02, 0.04):
        _, number, found, within, _ = corner_row(spacing, seeds)
        assert (number, found) == (36, "36 of 36") and int(within.split()[0]) > 31
    for noise in NOISES[1], None:
        _, number, _, _, far = scan_row(noise, seeds)
        assert number > 15 and int(far.split()[0]) <= 0.05 * number, (noise, far)


def test_the_table_has_all_rows(capsys, monkeypatch):
    monkeypatch.setattr("snake_training.evaluation.places.CORNERS", {0.04: 0.04})
    main(["--seeds", "0", "1"])
    assert len(capsys.readouterr().out.splitlines()) == 2 + 1 + len(NOISES) + 1
