"""Two views of a cloud and the queries of the losses (SNAKE section 3.2). Arrays are float32, in network units."""

import numpy as np


def normalize(points, method="unit-sphere"):
    """Points (N, 3) into the cube +-0.5: (points, center, scale) with network = (cloud - center) / scale."""
    if method == "none":
        return points.astype(np.float32), np.zeros(3, np.float32), np.float32(1)
    center = points.mean(axis=0, dtype=np.float64)
    offset = points - center
    extent = np.abs(offset).max() if method == "unit-cube" else np.sqrt((offset**2).sum(axis=1)).max()
    scale = 2 * extent
    return (offset / scale).astype(np.float32), center.astype(np.float32), np.float32(scale)


def random_rotation(rng, kind="so3"):
    """A rotation matrix: uniform on SO(3) from a unit quaternion, or Rz Ry Rx of three uniform angles (released code)."""
    if kind == "euler":
        (cx, cy, cz), (sx, sy, sz) = (f(rng.uniform(0, 2 * np.pi, 3)) for f in (np.cos, np.sin))
        rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        return (rz @ ry @ rx).astype(np.float32)
    w, x, y, z = quaternion = (lambda q: q / np.linalg.norm(q))(rng.normal(size=4))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    vector = quaternion[1:]
    return ((w * w - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) + 2 * w * cross).astype(np.float32)


def choose(rng, points, number):
    """`number` random points: without replacement where there are enough, all of them and repeats where not."""
    if len(points) >= number:
        return points[rng.choice(len(points), number, replace=False)]
    return np.concatenate([points, points[rng.choice(len(points), number - len(points))]])


def two_views(cloud, config, rng):
    """One training sample from a cloud (M, 3) of any unit.

    Returns a dict: points (2, N, 3); occupancy_queries (2, 2 K, 3), the first K on the surface;
    grids (2, G, H^3, 3), the same physical places in both views.
    """
    clean, _, _ = normalize(cloud)
    rotation = random_rotation(rng, config.rotation)
    shift = rng.uniform(-config.translation, config.translation, 3).astype(np.float32)
    views = clean, clean @ rotation.T + shift
    noise = (config.jitter_sigma * rng.standard_normal(clean.shape, dtype=np.float32)).clip(-config.jitter_clip, config.jitter_clip)
    kept = max(int(len(clean) / rng.uniform(1, config.max_downsampling)), 1)
    inputs = choose(rng, views[0], config.num_points), choose(rng, choose(rng, views[1] + noise, kept), config.num_points)

    queries = []
    for view in views:
        uniform = rng.uniform(-0.5625, 0.5625, (config.num_occupancy, 3))
        queries.append(np.concatenate([choose(rng, view, config.num_occupancy), uniform]))

    side = np.linspace(-0.5, 0.5, config.grid_size) / config.grid_fraction
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    grids = choose(rng, inputs[0], config.num_grids)[:, None] + grid
    return {
        "points": np.stack(inputs).astype(np.float32),
        "occupancy_queries": np.stack(queries).astype(np.float32),
        "grids": np.stack([grids, grids @ rotation.T + shift]).astype(np.float32),
    }
