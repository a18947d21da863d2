"""Two views of a cloud and the queries of the losses (SNAKE section 3.2). Arrays are float32, in network units."""

import numpy as np

BOUND = 0.5625  # half the side of the padded volume, 0.5 * (1 + padding)
MAX_THINNING, MAX_NOISE = 16.0, 0.045  # of degraded views: one point of so many is kept; standard deviation


def normalize(points, method="unit-sphere", rng=None):
    """Points (N, 3) of any unit into the cube +-0.5: (points, center, scale) with network = (cloud - center) / scale.

    About the mean, by the largest distance from it (unit-sphere) or the largest coordinate (unit-cube), or by an extent
    that `rng` draws between these two (mixed).
    """
    if method not in ("unit-sphere", "unit-cube", "mixed", "none"):
        raise ValueError(f"normalization {method!r} is none of unit-sphere, unit-cube, mixed, none")
    if method == "none":
        return points.astype(np.float32), np.zeros(3, np.float32), np.float32(1)
    center = points.mean(axis=0, dtype=np.float64)
    offset = points - center
    cube, sphere = np.abs(offset).max(), np.sqrt((offset**2).sum(axis=1)).max()
    extent = rng.uniform(cube, sphere) if method == "mixed" else cube if method == "unit-cube" else sphere
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


def draw(rng, points, number, replacement):
    """`number` random points: with replacement, as the released code draws them, or by `choose`."""
    return points[rng.integers(len(points), size=number)] if replacement else choose(rng, points, number)


def within_bounds(points):
    """The points inside the padded volume, as the released code drops the rest; all of them if none is inside."""
    inside = (np.abs(points) <= BOUND).all(axis=1)
    return points[inside] if inside.any() else points


def degraded(points, rng):
    """The points (N, 3) thinned, with noise, or both: a third of the views each, so that a network learns each alone."""
    is_thinned, is_noisy = [(True, False), (False, True), (True, True)][rng.integers(3)]
    if is_thinned:
        points = choose(rng, points, max(int(len(points) / MAX_THINNING ** rng.random()), 2))
    if is_noisy:
        noise = rng.uniform(0, MAX_NOISE) * rng.standard_normal(points.shape)
        points = points + noise.astype(np.float32)
    return points


def occupancy_queries(surface, config, rng):
    """Queries (2 K, 3): the first K on the clean surface (M, 3), the others anywhere in the padded volume."""
    uniform = rng.uniform(-BOUND, BOUND, (config.num_occupancy, 3))
    return np.concatenate([choose(rng, surface, config.num_occupancy), uniform])


def local_grid(size, side):
    """The points (size^3, 3) of a local grid about the origin; its side is `side` long."""
    axis = np.linspace(-0.5, 0.5, size) * side
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def inside_volume(queries):
    """(..., 3) -> (...): within the padded volume."""
    return (np.abs(queries) <= BOUND).all(axis=-1)


def two_views(cloud, config, rng):
    """One sample for the four losses from a cloud (M, 3) of any unit, as float32 arrays by name.

    points (2, N, 3); queries (2, 2 K + G H^3, 3), K on the surface, K anywhere and G local grids, the same physical points in
    both views; inside (2, G, H^3): which grid points lie within the padded volume. The first view is the cloud as it is, the
    second is turned, with noise and fewer points. What turn and shift move out of the volume is cut off before the rest is
    moved to the origin, as in the released code: otherwise the shift would have no effect.
    """
    clean, _, _ = normalize(cloud, config.normalization, rng)
    rotation = random_rotation(rng, config.rotation)
    shift = rng.uniform(-config.translation, config.translation, 3).astype(np.float32)
    moved = within_bounds(clean @ rotation.T + shift)
    if config.recenter:
        mean = moved.mean(axis=0)
        moved, shift = within_bounds(moved - mean), shift - mean
    views = clean, moved
    rng.random()  # unused; without it, all samples would be others
    if rng.random() < config.degraded_share:
        shown = within_bounds(degraded(choose(rng, moved, config.num_points), rng))
        repeats = choose(rng, shown, config.num_points)
    else:
        noise = config.jitter_sigma * rng.standard_normal(moved.shape, dtype=np.float32)
        noisy = within_bounds(moved + noise.clip(-config.jitter_clip, config.jitter_clip))
        kept = max(int(config.num_points / rng.uniform(1, config.max_downsampling)), 1)
        thinned = draw(rng, noisy, kept, config.with_replacement)
        repeats = choose(rng, thinned, config.num_points)  # all of the thinned points, some of them several times
    inputs = draw(rng, views[0], config.num_points, config.with_replacement), repeats
    surface = [occupancy_queries(within_bounds(view), config, rng) for view in views]
    grids = choose(rng, inputs[0], config.num_grids)[:, None] + local_grid(config.grid_size, 1 / config.grid_fraction)
    grids = np.stack([grids, grids @ rotation.T + shift])
    queries = np.concatenate([np.stack(surface), grids.reshape(2, -1, 3)], axis=1)
    return {
        "points": np.stack(inputs).astype(np.float32),
        "queries": queries.astype(np.float32),
        "inside": inside_volume(grids),
    }


def student_views(shape, config, rng):
    """One sample for a student from a row of `Targets`, as float32 arrays by name: two views of a shape, each turned at random.

    A share of them is `degraded`. A view is normalised with its noise, as in detection. points (2, N, 3); queries (2, 2 K + Q, 3):
    K on the surface, K anywhere, and Q targets, the same points in both views, half of them among the fifth of highest target;
    target (Q,).
    """
    cloud, positions, target = shape
    rng.random()  # unused, as in `two_views`
    rotations = [random_rotation(rng) for _ in range(2)]
    best = target.argsort()[-max(len(positions) // 5, 1) :]
    chosen = rng.integers(len(positions), size=config.num_targets)
    chosen[::2] = best[rng.integers(len(best), size=len(chosen[::2]))]
    points, queries = [], []
    for rotation in rotations:
        shown = cloud @ rotation.T
        seen = degraded(shown, rng) if rng.random() < config.degraded_share else shown
        seen, center, scale = normalize(seen, config.normalization, rng)
        points.append(choose(rng, seen, config.num_points))
        surface = occupancy_queries((shown - center) / scale, config, rng)
        queries.append(np.concatenate([surface, (positions[chosen] @ rotation.T - center) / scale]))
    return {
        "points": np.stack(points).astype(np.float32),
        "queries": np.stack(queries).astype(np.float32),
        "target": target[chosen],
    }
