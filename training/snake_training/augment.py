"""Two views of a cloud and the queries of the losses (SNAKE section 3.2). Arrays are float32, in network units."""

import numpy as np

BOUND = 0.5625  # half the side of the padded volume, 0.5 * (1 + padding)


def normalize(points, method="unit-sphere"):
    """Points (N, 3) of any unit into the cube +-0.5: (points, center, scale) with network = (cloud - center) / scale.

    About the mean, by the largest distance from it (unit-sphere) or the largest coordinate (unit-cube).
    """
    if method not in ("unit-sphere", "unit-cube", "none"):
        raise ValueError(f"normalization {method!r} is none of unit-sphere, unit-cube, none")
    if method == "none":
        return points.astype(np.float32), np.zeros(3, np.float32), np.float32(1)
    center = points.mean(axis=0, dtype=np.float64)
    offset = points - center
    extent = np.abs(offset).max() if method == "unit-cube" else np.sqrt((offset**2).sum(axis=1)).max()
    if not 0 < extent < np.inf:
        raise ValueError("points must be finite and not all in one place")
    scale = 2 * extent
    return (offset / scale).astype(np.float32), center.astype(np.float32), np.float32(scale)


def random_rotation(rng, kind="so3"):
    """A rotation matrix for column vectors: uniform on SO(3) from a unit quaternion, or from three uniform angles.

    The released code multiplies rows by Rz Ry Rx, so "euler" returns its transpose.
    """
    if kind == "euler":
        angles = rng.uniform(0, 2 * np.pi, 3)
        (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
        rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        return (rz @ ry @ rx).T.astype(np.float32)
    quaternion = rng.normal(size=4)
    w, x, y, z = quaternion = quaternion / np.linalg.norm(quaternion)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    vector = quaternion[1:]
    return ((w * w - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) + 2 * w * cross).astype(np.float32)


def choose(rng, points, number):
    """`number` random points: without replacement where there are enough, all of them and repeats where not."""
    if len(points) >= number:
        return points[rng.choice(len(points), number, replace=False)]
    return np.concatenate([points, points[rng.choice(len(points), number - len(points))]])


def within_bounds(points):
    """The points inside the padded volume, as the released code drops the rest; all of them if none is inside."""
    inside = (np.abs(points) <= BOUND).all(axis=1)
    return points[inside] if inside.any() else points


def two_views(cloud, config, rng):
    """One training sample from a cloud (M, 3) of any unit.

    Returns a dict: points (2, N, 3); occupancy_queries (2, 2 K, 3), the first K on the surface;
    grids (2, G, H^3, 3), the same physical places in both views.
    """
    clean, _, _ = normalize(cloud, config.normalization)
    rotation = random_rotation(rng, config.rotation)
    shift = rng.uniform(-config.translation, config.translation, 3).astype(np.float32)
    views = clean, clean @ rotation.T + shift
    noise = config.jitter_sigma * rng.standard_normal(clean.shape, dtype=np.float32)
    noisy = within_bounds(views[1] + noise.clip(-config.jitter_clip, config.jitter_clip))
    kept = max(int(len(noisy) / rng.uniform(1, config.max_downsampling)), 1)
    inputs = choose(rng, views[0], config.num_points), choose(rng, choose(rng, noisy, kept), config.num_points)

    queries = []
    for view in views:
        uniform = rng.uniform(-BOUND, BOUND, (config.num_occupancy, 3))
        queries.append(np.concatenate([choose(rng, within_bounds(view), config.num_occupancy), uniform]))

    side = np.linspace(-0.5, 0.5, config.grid_size) / config.grid_fraction
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    grids = choose(rng, inputs[0], config.num_grids)[:, None] + grid
    return {
        "points": np.stack(inputs).astype(np.float32),
        "occupancy_queries": np.stack(queries).astype(np.float32),
        "grids": np.stack([grids, grids @ rotation.T + shift]).astype(np.float32),
    }


def distillation_views(shape, config, rng):
    """One sample from `Targets.sample`: two views, each rotated at random, a share of them thinned and noisy.

    A view is normalised as it is seen, noise and all, as in detection. Returns a dict: points (2, N, 3);
    occupancy_queries (2, 2 K, 3), the first K on the surface; queries (2, Q, 3), the same physical places in both
    views, half of them among the fifth of the shape's queries of highest target; target (Q,).
    """
    cloud, queries, target = shape
    best = target.argsort()[-max(len(target) // 5, 1) :]
    chosen = rng.integers(len(target), size=config.num_targets)
    chosen[::2] = best[rng.integers(len(best), size=len(chosen[::2]))]
    sample = {"points": [], "occupancy_queries": [], "queries": []}
    for _ in range(2):
        rotation = random_rotation(rng)
        seen = cloud @ rotation.T
        if rng.random() < config.degraded_share:
            kept = max(int(len(seen) / config.max_downsampling ** rng.random()), 2)
            noise = rng.uniform(0, config.max_noise) * rng.standard_normal((kept, 3))
            seen = choose(rng, seen, kept) + noise.astype(np.float32)
        seen, center, scale = normalize(seen, config.normalization)
        uniform = rng.uniform(-BOUND, BOUND, (config.num_occupancy, 3))
        on_surface = (choose(rng, cloud, config.num_occupancy) @ rotation.T - center) / scale
        sample["points"].append(choose(rng, seen, config.num_points))
        sample["occupancy_queries"].append(np.concatenate([on_surface, uniform]))
        sample["queries"].append((queries[chosen] @ rotation.T - center) / scale)
    return {name: np.stack(views).astype(np.float32) for name, views in sample.items()} | {"target": target[chosen]}
