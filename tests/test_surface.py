"""The surface of a field beside scikit-image's marching cubes on the same samples (`pytest tests/test_surface.py`)."""

import pickle

import numpy as np
import pytest
from skimage import measure

import snake_rs


@pytest.fixture(scope="module")
def field():
    """A bumpy sphere in the network's frame, so that the samples have the same bits here and there."""
    direction = np.random.default_rng(0).normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = direction * (0.35 + 0.1 * np.sin(5 * direction[:, :1]))
    return snake_rs.Model.builtin().encode(points.astype(np.float32), normalization="none")


def samples(field, resolution, level):
    """Log-odds of the occupancy [x, y, z] on the grid of `Field.mesh`, the level, and the coordinates along each axis."""
    padding = np.float32(snake_rs.Model.builtin().config["padding"])
    low, high = np.float32(-0.5) * (1 + padding), np.float32(0.5) * (1 + padding)
    share = np.arange(resolution, dtype=np.float32) / np.float32(resolution - 1)
    along = low * (1 - share) + high * share
    grid = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1)
    occupancy = field.occupancy(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    level, occupancy = (np.clip(np.float32(v), np.float32(1e-6), np.float32(1 - 1e-6)) for v in (level, occupancy))
    return np.log(occupancy / (1 - occupancy)), np.log(level / (1 - level)), along


@pytest.mark.parametrize(("resolution", "level"), [(40, 0.4), (61, 0.8), (128, 0.4)])
@pytest.mark.parametrize("method", ["lorensen", "lewiner"])
def test_it_agrees_with_scikit_image(field, method, resolution, level):
    values, height, along = samples(field, resolution, level)
    spacing = (along[-1] - along[0]) / (resolution - 1)
    vertices, triangles, _, _ = measure.marching_cubes(values, height, method=method)
    mesh = field.mesh(resolution=resolution, level=level, surface="level")
    assert len(mesh.triangles) > 2000
    ours = (mesh.vertices - along[0]) / spacing

    def crossings(points):
        """Points on edges of the grid, by their edges."""
        fraction = np.abs(points - np.round(points)) > 1e-3
        points = points[fraction.sum(axis=1) == 1]
        fraction = np.abs(points - np.round(points)) > 1e-3
        low = np.where(fraction, np.floor(points), np.round(points)).astype(int)
        edges = map(tuple, np.column_stack([low, fraction.argmax(axis=1)]))
        return dict(zip(edges, points, strict=True))

    # Vertices within cells, which lewiner has, and those next to a sample, which rounding could give to any edge, aside.
    ours, theirs = crossings(ours), crossings(vertices)
    shared = sorted(ours.keys() & theirs.keys())
    # Rounding may put a vertex on either side of the limit, but hardly ever.
    assert len(shared) > 0.98 * len(mesh.vertices) and len(ours.keys() ^ theirs.keys()) <= 1e-4 * len(shared)
    np.testing.assert_allclose([ours[edge] for edge in shared], [theirs[edge] for edge in shared], atol=1e-3)
    # Where occupied corners alternate around a face or a cell, there are several surfaces with these vertices, and the
    # methods differ; among so many samples there are hardly any such cells.
    if resolution == 128:
        area = measure.mesh_surface_area(mesh.vertices, mesh.triangles)
        assert area == pytest.approx(measure.mesh_surface_area(vertices * spacing, triangles), rel=1e-3)


def test_a_mesh_is_three_arrays(field):
    mesh = field.mesh(resolution=32)
    assert mesh.vertices.shape == mesh.normals.shape == (len(mesh.vertices), 3)
    assert mesh.vertices.dtype == mesh.normals.dtype == np.float32
    assert mesh.triangles.dtype == np.uint32 and mesh.triangles.max() == len(mesh.vertices) - 1
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    # Triangles and their normals face out.
    mesh = field.mesh(resolution=64, surface="level")
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    outwards = (np.cross(b - a, c - a)[:, None] * mesh.normals[mesh.triangles]).sum(axis=2)
    assert (outwards.min(axis=1) > 0).mean() > 0.9
    assert repr(mesh) == f"Mesh({len(mesh.vertices)} vertices, {len(mesh.triangles)} triangles)"
    again = pickle.loads(pickle.dumps(mesh))
    assert all(
        np.array_equal(getattr(again, name), getattr(mesh, name)) for name in ("vertices", "normals", "triangles")
    )


def test_what_cannot_be_is_refused(field):
    for options, expected in (
        ({"resolution": 4096}, "allowed is 8 to 512"),
        ({"resolution": 2.5}, "a whole number"),
        ({"surface": "ridge"}, "middle.*level"),
        ({"level": 0.0}, "allowed is 0.001 to 0.999"),
        ({"level": float("nan")}, "finite"),
    ):
        with pytest.raises(ValueError, match=expected):
            field.mesh(**options)
    with pytest.raises(TypeError, match="resolution"):
        field.mesh(threshold=0.5)
