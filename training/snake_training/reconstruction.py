"""Surfaces that are reconstructed from thinned and noisy clouds, beside the dense cloud (SNAKE, shape reconstruction):

    python -m snake_training.reconstruction CORPUS/val

Each shape is scaled to radius 1. A method sees some of its points and gives a mesh, which is compared with all points of the shape:
accuracy is the mean distance from the mesh to the nearest point, completeness that from a point to the mesh, and the F-score at a
distance the harmonic mean of the shares that are nearer. Methods: `middle` and `level` are the surfaces of `snake-cli reconstruct`,
`poisson` is Open3D's Poisson reconstruction (`pip install open3d`).
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from .arguments import DATA, MODEL, option, parser_of
from .augment import choose, normalize
from .data import open_shapes
from .progress import bar

F_DISTANCES = 0.02, 0.05
FIGURES = "accuracy", "completeness", *(f"F {distance}" for distance in F_DISTANCES)
MESH_POINTS = 20_000  # drawn from a mesh
NORMAL_NEIGHBORS = 30  # of a normal for Poisson's method
POISSON_DEPTH = 8
# Share of Poisson's vertices with the fewest points about them, which are cut off: the best of 0, 0.02 and 0.05 on objects.
POISSON_CUT = 0.05


def draw_surface(vertices, triangles, number, rng):
    """Points (`number`, 3) on a mesh, uniform by area."""
    first, *others = (vertices[triangles[:, corner]].astype(np.float64) for corner in range(3))
    edges = [other - first for other in others]
    area = np.linalg.norm(np.cross(*edges), axis=1)
    chosen = rng.choice(len(triangles), number, p=area / area.sum())
    share = rng.random((number, 2))
    beyond = share.sum(axis=1) > 1
    share[beyond] = 1 - share[beyond]
    return first[chosen] + share[:, :1] * edges[0][chosen] + share[:, 1:] * edges[1][chosen]


def figures(mesh, truth):
    """The FIGURES of a mesh, vertices (V, 3) and triangles (T, 3), beside points (N, 3) of the true surface.

    Without a triangle the distances are NaN, and the F-scores 0.
    """
    vertices, triangles = mesh
    if len(triangles) == 0:
        return np.array([np.nan, np.nan, 0.0, 0.0])
    drawn = draw_surface(vertices, triangles, MESH_POINTS, np.random.default_rng(0))
    to_truth, to_mesh = cKDTree(truth).query(drawn)[0], cKDTree(drawn).query(truth)[0]
    scores = []
    for distance in F_DISTANCES:
        precision, recall = np.mean(to_truth < distance), np.mean(to_mesh < distance)
        scores.append(2 * precision * recall / max(precision + recall, 1e-12))
    return np.array([to_truth.mean(), to_mesh.mean(), *scores])


def field_mesh(model, resolution, surface):
    """A function from points to the mesh of their field."""

    def mesh(points):
        field = model.encode(points.astype(np.float32))
        made = field.mesh(resolution=resolution, surface=surface)
        return made.vertices, made.triangles

    return mesh


def poisson_mesh(points):
    """The mesh of Open3D's Poisson reconstruction, without the parts that are far from all points."""
    import open3d as o3d  # the only use

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBORS))
    cloud.orient_normals_consistent_tangent_plane(NORMAL_NEIGHBORS // 2)
    made, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=POISSON_DEPTH)
    density, triangles = np.asarray(density), np.asarray(made.triangles)
    is_kept = density > np.quantile(density, POISSON_CUT)
    return np.asarray(made.vertices), triangles[is_kept[triangles].all(axis=1)]


def methods(names, model, resolution):
    """The functions from points to a mesh, by their names."""
    import snake_rs  # the only use

    loaded = snake_rs.Model.load(model) if Path(model).exists() else snake_rs.Model.builtin(model)
    fields = {surface: field_mesh(loaded, resolution, surface) for surface in ("middle", "level")}
    return {name: (fields | {"poisson": poisson_mesh})[name] for name in names}


def view(shape, num_points, downsample, noise, rng):
    """A method's view of a shape (N, 3) of radius 1: some of `num_points` points, with noise."""
    points = choose(rng, shape, min(num_points, len(shape)) // downsample)
    return points + noise * rng.normal(size=points.shape)


def measure(shapes, methods, conditions, num_points):
    """The means of FIGURES over the shapes that have them, by method and condition (downsample, noise)."""
    rows = {(name, condition): [] for name in methods for condition in conditions}
    for index in bar(range(len(shapes)), unit="shape"):
        truth = 2 * normalize(shapes[index])[0].astype(np.float64)
        for condition in conditions:
            points = view(truth, num_points, *condition, np.random.default_rng(index))
            for name, method in methods.items():
                rows[name, condition].append(figures(method(points), truth))
    return {key: np.ma.masked_invalid(found).mean(axis=0).filled(np.nan) for key, found in rows.items()}


def table(rows):
    """The rows of `measure` in Markdown."""
    lines = [f"| method | input | {' | '.join(FIGURES)} |", "|---" * (2 + len(FIGURES)) + "|"]
    for (name, (downsample, noise)), found in rows.items():
        shown = f"1 in {downsample}" if downsample > 1 else f"σ {noise:g}" if noise else "clean"
        lines.append(f"| {name} | {shown} | {' | '.join(f'{value:.3f}' for value in found)} |")
    return "\n".join(lines)


def main(argv=None):
    """Command line."""
    names = "middle", "level", "poisson"
    arguments = {
        "--methods": option(["middle", "level"], "surfaces", str, nargs="+", choices=names),
        "--downsample": option([8], "one point in N is kept", int, nargs="+"),
        "--noise": option([0.03], "standard deviation, in radii", float, nargs="+"),
        "--num-points": option(5000, "points of a cloud that is not thinned"),
        "--resolution": option(64, "samples of the occupancy along each axis"),
        "--limit": dict(type=int, help="so many shapes, evenly spaced; all by default"),
    }
    parser = parser_of("reconstruction", __doc__, DATA | MODEL | arguments)
    given = parser.parse_args(argv)
    conditions = [(1, 0.0), *((rate, 0.0) for rate in given.downsample), *((1, sigma) for sigma in given.noise)]
    try:
        shapes = open_shapes(given.data)
        number = min(given.limit or len(shapes), len(shapes))
        chosen = [shapes[row] for row in np.linspace(0, len(shapes) - 1, number).astype(int)]
        found = methods(given.methods, given.model, given.resolution)
        print(table(measure(chosen, found, list(dict.fromkeys(conditions)), given.num_points)))
    except (OSError, ValueError, ImportError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
