"""Two views of a cloud and the queries of the losses (SNAKE section 3.2). Arrays are float32, in network units."""

import numpy as np

BOUND = 0.5625  # half the side of the padded volume, 0.5 * (1 + padding)


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


def visible(points, pixel, tolerance):
    """Which points (M, 3) in a camera's frame it sees: all in front of it that no other point hides.

    A point is hidden by one in the same pixel, of size `pixel` (tangent), that is nearer by more than the share
    `tolerance` of its depth. The pixel must be wider than the gaps between the points.
    """
    depth = points[:, 2]
    in_front = depth > 1e-6
    image = numbered(np.floor(points[in_front, :2] / depth[in_front, None] / pixel))
    _, pixel_of = np.unique(image, return_inverse=True)
    nearest = np.full(pixel_of.max(initial=-1) + 1, np.inf)
    np.minimum.at(nearest, pixel_of.ravel(), depth[in_front])
    seen = np.zeros(len(points), bool)
    seen[in_front] = depth[in_front] <= nearest[pixel_of.ravel()] * (1 + tolerance)
    return seen


def numbered(cells):
    """A number of each cell (.., 2 or 3) of integers below 2^20: a sort of numbers is far faster than one of rows."""
    return cells.astype(np.int64) @ (1 << 20 * np.arange(cells.shape[-1]))


def facing(points, rng):
    """Which points (N, 3) of an object within the cube +-0.5 a camera before it sees, one that looks along z."""
    camera = points + (0, 0, rng.uniform(1.2, 3))
    gap = np.sqrt(np.pi / len(points))  # between the points if they lay on a sphere of radius 0.5
    return visible(camera, 2 * gap / camera[:, 2].mean(), 0.04)


def within_bounds(points):
    """The points inside the padded volume, as the released code drops the rest; all of them if none is inside."""
    inside = (np.abs(points) <= BOUND).all(axis=1)
    return points[inside] if inside.any() else points


def two_views(cloud, config, rng):
    """One training sample from a cloud (M, 3) of any unit.

    Returns a dict: points (2, N, 3); occupancy_queries (2, 2 K, 3), the first K on the surface;
    grids (2, G, H^3, 3), the same physical places in both views.
    """
    clean, _, _ = normalize(cloud, config.normalization, rng)
    rotation = random_rotation(rng, config.rotation)
    shift = rng.uniform(-config.translation, config.translation, 3).astype(np.float32)
    moved = clean @ rotation.T + shift
    views = clean, moved - moved.mean(axis=0) if config.recenter else moved
    shift = shift - moved.mean(axis=0) if config.recenter else shift
    noise = config.jitter_sigma * rng.standard_normal(clean.shape, dtype=np.float32)
    noisy = within_bounds(views[1] + noise.clip(-config.jitter_clip, config.jitter_clip))
    kept = max(int(config.num_points / rng.uniform(1, config.max_downsampling)), 1)
    thinned = draw(rng, noisy, kept, config.with_replacement)
    repeats = choose(rng, thinned, config.num_points)  # all of the thinned points, some of them several times
    inputs = draw(rng, views[0], config.num_points, config.with_replacement), repeats

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


WINDOW_CORE = 0.42  # of a window of radius 0.5, in network units: what lies within has its surroundings in the window


def window(points, rng):
    """A ball of radius 0.4 to 0.5 near the origin: which points (N, 3) lie in it, its center and its diameter.

    All points of a ball that leaves the padded volume may not be there, so it stays within.
    """
    radius = rng.uniform(0.4, 0.5)
    direction = rng.normal(size=3)
    center = direction / np.linalg.norm(direction) * rng.uniform(0, BOUND - radius)
    inside = np.linalg.norm(points - center, axis=1) < radius
    return (inside if inside.any() else ~inside), center, 2 * radius


def degraded(points, config, rng):
    """The points (N, 3) thinned, with noise, or both: a third of the views each, so that a student learns each alone."""
    is_thinned, is_noisy = [(True, False), (False, True), (True, True)][rng.integers(3)]
    if is_thinned:
        points = choose(rng, points, max(int(len(points) / config.max_downsampling ** rng.random()), 2))
    if is_noisy:
        noise = rng.uniform(0, config.max_noise) * rng.standard_normal(points.shape)
        points = points + noise.astype(np.float32)
    return points


def distillation_views(shape, config, rng):
    """One sample from `Targets.sample`: two views, each rotated at random, a share of them `degraded`.

    Of a shape with several views two are taken, each cut out as a `window`. A view of one whole object is normalised as
    it is seen, noise and all, as in detection; of a share of these samples one view sees one side.
    Returns a dict: points (2, N, 3); occupancy_queries (2, 2 K, 3), the first K on the surface that is seen; queries
    (2, Q, 3), the same physical places in both views, near what both see, half of them among the fifth of highest
    target; target (Q,).
    """
    clouds, queries, target = shape
    whole = len(clouds) == 1
    one_sided = rng.integers(2) if whole and rng.random() < config.partial_share else None
    pair = (0, 0) if whole else rng.choice(len(clouds), 2, replace=False)
    views, common = [], np.ones(len(queries), bool)
    for view in range(2):
        cloud, rotation = clouds[pair[view]], random_rotation(rng)
        frame = None
        if not whole:
            inside, center, scale = window(cloud, rng)
            cloud, frame = cloud[inside], (rotation @ center, scale)
            common &= near(queries, cloud) & (np.linalg.norm(queries - center, axis=1) < WINDOW_CORE * scale)
        shown = cloud @ rotation.T
        if view == one_sided:
            side = facing(shown, rng)
            shown = shown[side]
            common = near(queries, cloud[side])
        views.append((rotation, shown, frame))
    common = np.flatnonzero(common) if common.any() else np.arange(len(queries))
    best = common[target[common].argsort()[-max(len(common) // 5, 1) :]]
    chosen = common[rng.integers(len(common), size=config.num_targets)]
    chosen[::2] = best[rng.integers(len(best), size=len(chosen[::2]))]
    sample = {"points": [], "occupancy_queries": [], "queries": []}
    for rotation, shown, frame in views:
        seen = shown
        if rng.random() < config.degraded_share:
            seen = degraded(seen, config, rng)
        if frame:
            center, scale = frame
            seen = (seen - center) / scale
        else:
            seen, center, scale = normalize(seen, config.normalization, rng)
        uniform = rng.uniform(-BOUND, BOUND, (config.num_occupancy, 3))
        on_surface = (choose(rng, shown, config.num_occupancy) - center) / scale
        sample["points"].append(choose(rng, seen, config.num_points))
        sample["occupancy_queries"].append(np.concatenate([on_surface, uniform]))
        sample["queries"].append((queries[chosen] @ rotation.T - center) / scale)
    return {name: np.stack(views).astype(np.float32) for name, views in sample.items()} | {"target": target[chosen]}


def near(queries, points):
    """Which queries (Q, 3) lie in a cell with points (N, 3), of 16 cells along each axis of the padded volume."""
    return np.isin(cells(queries), cells(points))


def cells(points):
    """The cell (N,) that each point (N, 3) within the padded volume lies in: 16 along each axis."""
    x, y, z = np.floor((points + BOUND) * (16 / (2 * BOUND))).astype(int).clip(0, 15).T
    return (z * 16 + y) * 16 + x
