"""Worlds of solids, each an affine image of a cube, a ball or a cylinder: rays meet them, surfaces are sampled, in closed form.

Rooms are cubes that rays meet from inside: they have no surface to sample, and nothing lies in them.

Lengths are metres; x, y are horizontal, z is up.
"""

import numpy as np

# |x|, |y|, |z| <= 1; x^2 + y^2 + z^2 <= 1; x^2 + y^2 <= 1 with |z| <= 1; and the first and the third from inside.
CUBE, BALL, CYLINDER, ROOM = range(4)


def about_axis(axis, angle):
    """Rotation matrix (3, 3) about one of the axes."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[a, a] = turn[b, b] = np.cos(angle)
    turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
    return turn


def dot(a, b):
    """Row by row, of (N, 3) arrays."""
    return np.einsum("ij,ij->i", a, b)


class Solids:
    """A growing list of solids. `kind` (S,), `center` (S, 3), `axes` (S, 3, 3), whose columns are the half axes, `fuzz` (S,),
    how deep rays go into foliage, 0 for all else, and `moving` (S,)."""

    def __init__(self, rows=()):
        self.rows = list(rows)

    def add(self, kind, center, half, turn=None, fuzz=0.0, moving=False):
        """A solid of half extents (3,) about a center (3,), turned by a rotation matrix (3, 3)."""
        axes = (np.eye(3) if turn is None else turn) * np.asarray(half, float)
        self.rows.append((kind, np.asarray(center, float), axes, fuzz, moving))

    def group(self, part, at, yaw=0.0, moving=False):
        """Another list of solids, turned about z and moved to `at` (3,)."""
        turn = about_axis(2, yaw)
        for kind, center, axes, fuzz, _ in part.rows:
            self.rows.append((kind, turn @ center + at, turn @ axes, fuzz, moving))

    def arrays(self):
        """The lists as arrays."""
        kind, center, axes, fuzz, moving = (np.array(column) for column in zip(*self.rows, strict=True))
        return kind, center, axes, fuzz, moving

    def chosen(self, mask):
        """The solids of a mask (S,)."""
        return Solids(row for row, keep in zip(self.rows, mask, strict=True) if keep)

    def later(self, shift):
        """The solids after the moving ones have gone `shift` metres along x."""
        return Solids(
            (kind, center + (shift, 0, 0) if moving else center, axes, fuzz, moving)
            for kind, center, axes, fuzz, moving in self.rows
        )

    def about(self, center, radius):
        """The solids that may come within `radius` of `center`."""
        _, middle, axes, _, _ = self.arrays()
        return self.chosen(np.linalg.norm(middle - center, axis=1) <= np.linalg.norm(axes, axis=(1, 2)) + radius)

    def toward(self, eyes, center, radius):
        """The solids that may hide or hold something within `radius` of `center` from the `eyes` (E, 3)."""
        _, middle, axes, _, _ = self.arrays()
        size = np.linalg.norm(axes, axis=(1, 2))
        span = center - eyes
        share = ((middle[:, None] - eyes) * span).sum(axis=2) / np.maximum((span**2).sum(axis=1), 1e-9)
        nearest = eyes + share.clip(0, 1)[:, :, None] * span
        away = np.linalg.norm(middle[:, None] - nearest, axis=2)
        return self.chosen((away <= size[:, None] + radius * np.maximum(share.clip(0, 1), 0.15)).any(axis=1))

    def cast(self, origins, directions):
        """Rays (R, 3) from origins (R, 3) along unit vectors: distance (R,), infinite where they meet nothing, the solid
        (R,) they meet, and the cosine (R,) between ray and surface."""
        kinds, centers, axes, _, _ = self.arrays()
        best, which, slope = np.full(len(origins), np.inf), np.zeros(len(origins), int), np.ones(len(origins))
        for row, (kind, center, axis) in enumerate(zip(kinds, centers, axes, strict=True)):
            # Only rays that come near the ball around the solid go on.
            to = center - origins
            ahead, radius = dot(to, directions), np.linalg.norm(axis)
            near = np.flatnonzero((dot(to, to) - ahead**2 <= radius**2) & (ahead >= -radius))
            if len(near) == 0:
                continue
            inverse = np.linalg.inv(axis)
            t, normal = entry(kind, -to[near] @ inverse.T, directions[near] @ inverse.T)
            closer = (t > 1e-3) & (t < best[near])
            rows = near[closer]
            best[rows], which[rows] = t[closer], row
            outward = normal[closer] @ inverse
            outward /= np.linalg.norm(outward, axis=1, keepdims=True)
            slope[rows] = np.abs(dot(outward, directions[rows]))
        return best, which, slope

    def inside(self, points, shrink=1e-3):
        """Which of the points (N, 3) lie within any solid by more than `shrink` metres."""
        found = np.zeros(len(points), bool)
        for kind, center, axis in (row[:3] for row in self.rows if row[0] < ROOM):
            half = np.linalg.norm(axis, axis=0)
            limit = 1 - shrink / half
            near = np.flatnonzero(dot(points - center, points - center) < (half**2).sum())
            local = np.abs((points[near] - center) @ np.linalg.inv(axis).T) / limit
            if kind == CUBE:
                within = (local < 1).all(axis=1)
            elif kind == BALL:
                within = (local**2).sum(axis=1) < 1
            else:
                within = ((local[:, :2] ** 2).sum(axis=1) < 1) & (local[:, 2] < 1)
            found[near[within]] = True
        return found

    def surface(self, center, radius, density, rng):
        """Points (M, 3) of the surface within `radius` of `center`, `density` a square metre, inside no other solid."""
        parts = [sample(*row[:3], center, radius, density, rng) for row in self.rows if row[0] < ROOM]
        points = np.concatenate([np.empty((0, 3)), *parts])
        points = points[((points - center) ** 2).sum(axis=1) < radius**2]
        return points[~self.inside(points)]


def directions(elevation, azimuth, indexing="xy"):
    """Unit vectors (E * A, 3) of a grid of angles in radians; in the order of `numpy.meshgrid`: "xy" azimuth by azimuth."""
    e, a = (values.ravel() for values in np.meshgrid(elevation, azimuth, indexing=indexing))
    return np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def scan(world, t_world_sensor, rays, noise, furthest, rng):
    """The points (N, 3) that rays (R, 3) of a sensor at a pose (4, 4) meet, both in its frame, with noise along the rays."""
    at = np.broadcast_to(t_world_sensor[:3, 3], rays.shape)
    reach = world.about(at[0], furthest).cast(at, rays @ t_world_sensor[:3, :3].T)[0]
    seen = reach < furthest
    return rays[seen] * (reach[seen] + noise * rng.normal(size=seen.sum()))[:, None]


def entry(kind, o, d):
    """Where rays o + t d meet a unit solid: t (R,), infinite where they miss, and the normal (R, 3) in its coordinates.

    That is where they enter it, or leave a room.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        if kind in (CUBE, ROOM):
            low, high = (-1 - o) / d, (1 - o) / d
            first, last = np.minimum(low, high), np.maximum(low, high)
            axis = first.argmax(axis=1) if kind == CUBE else last.argmin(axis=1)
            enter, leave = first.max(axis=1), last.min(axis=1)
            return np.where(enter <= leave, enter if kind == CUBE else leave, np.inf), np.eye(3)[axis]
        round_axes = slice(0, 3) if kind == BALL else slice(0, 2)
        a, b = (d[:, round_axes] ** 2).sum(axis=1), (o * d)[:, round_axes].sum(axis=1)
        root = b * b - a * ((o[:, round_axes] ** 2).sum(axis=1) - 1)
        enter, leave = (-b - np.sqrt(root)) / a, (-b + np.sqrt(root)) / a
        if kind == BALL:
            return np.where(root >= 0, enter, np.inf), o + enter[:, None] * d
        caps = np.sort(np.stack([(-1 - o[:, 2]) / d[:, 2], (1 - o[:, 2]) / d[:, 2]]), axis=0)
        is_hit = (root >= 0) & (np.maximum(enter, caps[0]) <= np.minimum(leave, caps[1]))
        by_cap = caps[0] > enter
        normal = o + enter[:, None] * d
        normal[:, 2] = 0
        normal[by_cap] = 0, 0, 1
        return np.where(is_hit, np.where(by_cap, caps[0], enter), np.inf), normal


def sample(kind, middle, axes, center, radius, density, rng):
    """Points of one solid's surface about a ball, uniform by area; cubes and cylinders only where the ball is."""
    half = np.linalg.norm(axes, axis=0)
    at = np.linalg.solve(axes, center - middle)
    low, high = np.maximum(at - radius / half, -1), np.minimum(at + radius / half, 1)
    if (low >= high).any():
        return np.empty((0, 3))
    local = []
    if kind == BALL:
        # Points of the sphere are kept by the stretch of the area there.
        number = int(4 * np.pi * half.prod() / half.min() * density)
        p = rng.standard_normal((number, 3))
        p /= np.linalg.norm(p, axis=1, keepdims=True)
        local.append(p[rng.random(number) < np.linalg.norm(p / half, axis=1) * half.min()])
    else:
        for axis in range(3) if kind == CUBE else (2,):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            for side in (-1, 1):
                if not low[axis] <= side <= high[axis]:
                    continue
                number = rng.poisson((high[a] - low[a]) * (high[b] - low[b]) * half[a] * half[b] * density)
                p = rng.uniform(low, high, (number, 3))
                p[:, axis] = side
                local.append(p if kind == CUBE else p[(p[:, :2] ** 2).sum(axis=1) < 1])
        if kind == CYLINDER:
            number = rng.poisson(2 * np.pi * np.sqrt(half[0] * half[1]) * (high[2] - low[2]) * half[2] * density)
            angle = rng.uniform(0, 2 * np.pi, number)
            local.append(np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(low[2], high[2], number)]))
    return np.concatenate(local) @ axes.T + middle if local else np.empty((0, 3))
