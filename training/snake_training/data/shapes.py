"""Random objects composed of primitives, so that anyone can train with no data: chair-, table-, lamp-, plane- and
tool-like shapes and free compositions. Every primitive is a parametric surface on a grid, meshed and sampled by area.

A part is a list of patches, each an array (U, V, 3) of surface points; x, y are horizontal, z is up.
"""

import numpy as np


class Procedural:
    """Seeded random shapes; `shapes[i]` is the same cloud on every machine with the same numpy."""

    def __init__(self, length=256, points=4096):
        self.length, self.points = length, points

    def __len__(self):
        return self.length

    def __getitem__(self, row):
        return self.cloud(np.random.default_rng([row, 0x5AE]))

    def cloud(self, rng):
        """A random shape as points (M, 3), uniform by area."""
        recipe = RECIPES[rng.integers(len(RECIPES))]
        patches = recipe(rng)
        if recipe is not compose:
            stretch = rng.uniform(0.8, 1.25, 3)
            patches = [patch * stretch for patch in patches]
        return sample_surface(patches, self.points, rng)


def sample_surface(patches, number, rng):
    """`number` points drawn uniformly by area from the patches' triangles."""
    corners = triangles(patches)
    chosen, weights = draw_on(corners, number, rng)
    return (weights[:, :, None] * corners[chosen]).sum(axis=1).astype(np.float32)


def triangles(patches):
    """The corners (T, 3, 3) of the patches' triangles."""
    all_corners = []
    for p in patches:
        a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
        all_corners += [np.stack(t, axis=-2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))]
    return np.concatenate(all_corners)


def draw_on(corners, number, rng):
    """Random points on triangles (T, 3, 3), uniform by area: the triangle (number,) of each and weights (number, 3) of its corners."""
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    chosen = rng.choice(len(corners), number, p=area / area.sum())
    u, v = np.sort(rng.random((2, number)), axis=0)
    return chosen, np.stack([u, v - u, 1 - v], axis=1)


# Primitives, all centred on the origin.


def box(size):
    """Six faces; size (3,) of full side lengths."""
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), axis=-1) * size
    return [np.take(corners, side, axis=axis) for axis in range(3) for side in (0, 1)]


def revolve(radius, height, turns=1.0, segments=25):
    """Surface of revolution about z of the profile radius(s), height(s); both 1-D arrays."""
    angle = np.linspace(0, 2 * np.pi * turns, segments)[:, None]
    return [
        np.stack(
            [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(height, angle.shape[:1] + radius.shape)],
            axis=-1,
        )
    ]


def cone(bottom, top, height):
    """Closed truncated cone; equal radii make a cylinder."""
    return revolve(np.array([0, bottom, top, 0.0]), np.array([-0.5, -0.5, 0.5, 0.5]) * height)


def torus(major, minor, turns=1.0):
    """Torus about z, or an arc of one."""
    s = np.linspace(0, 2 * np.pi, 13)
    return revolve(major + minor * np.cos(s), minor * np.sin(s), turns)


def superquadric(size, e1, e2, rows=15, columns=25):
    """Superellipsoid of full extents `size` and exponents e1 (vertical), e2 (horizontal); 1 is an ellipsoid."""
    v, u = np.linspace(-np.pi / 2, np.pi / 2, rows)[:, None], np.linspace(-np.pi, np.pi, columns)[None]
    power = lambda x, e: np.sign(x) * np.abs(x) ** e
    x, y = power(np.cos(v), e1) * power(np.cos(u), e2), power(np.cos(v), e1) * power(np.sin(u), e2)
    return [np.stack([x, y, power(np.sin(v), e1) + 0 * u], axis=-1) * size / 2]


def tube(path, radius):
    """Circle of `radius` swept along the polyline path (K, 3)."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-9
    side = np.cross(tangent, np.eye(3)[np.abs(tangent).mean(axis=0).argmin()])
    side /= np.linalg.norm(side, axis=1, keepdims=True) + 1e-9
    up = np.cross(tangent, side)
    angle = np.linspace(0, 2 * np.pi, 9)[None, :, None]
    return [path[:, None] + radius * (np.cos(angle) * side[:, None] + np.sin(angle) * up[:, None])]


def moved(part, offset=(0, 0, 0), rotation=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    """The part rotated, then shifted."""
    return [patch @ np.asarray(rotation).T + offset for patch in part]


def about(axis, angle):
    """Rotation by `angle` radians about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.roll(np.roll(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), axis, axis=0), axis, axis=1)


def primitive(rng, size):
    """A random primitive of about the full extents `size` (3,)."""
    kind, r = rng.integers(6), size[:2].mean() / 2
    if kind == 0:
        return box(size)
    if kind == 1:
        return cone(r, r * rng.choice([0, rng.uniform(0.2, 1), 1]), size[2])
    if kind == 2:
        return torus(r, r * rng.uniform(0.1, 0.4), rng.choice([0.5, 0.75, 1]))
    if kind == 3:
        return superquadric(size, *rng.uniform(0.2, 1.8, 2))
    if kind == 4:
        return box(size * np.roll([0.06, 1, 1], rng.integers(3)))
    steps = np.cumsum(rng.normal(size=(12, 3)) * 0.5 + rng.normal(size=3), axis=0)
    steps = (steps - steps.mean(axis=0)) / (np.ptp(steps, axis=0).max() + 1e-9)
    return tube(steps * size.max(), size.min() * rng.uniform(0.05, 0.2))


# Recipes: rng -> patches.


def legs(rng, width, depth, height, thick):
    """Four legs below z = 0, one column, or two side plates."""
    kind = rng.integers(3)
    if kind == 0:
        leg = (
            box((thick, thick, height))
            if rng.random() < 0.5
            else cone(thick / 2, thick * rng.uniform(0.4, 0.8), height)
        )
        corners = [(x, y, -height / 2) for x in (-1, 1) for y in (-1, 1)]
        return [q for x, y, z in corners for q in moved(leg, (x * (width - thick) / 2, y * (depth - thick) / 2, z))]
    if kind == 1:
        foot = cone(min(width, depth) * rng.uniform(0.2, 0.45), thick, thick)
        return moved(cone(thick, thick * rng.uniform(0.5, 1), height), (0, 0, -height / 2)) + moved(
            foot, (0, 0, -height)
        )
    plate = box((thick / 2, depth * rng.uniform(0.6, 1), height))
    return [q for x in (-1, 1) for q in moved(plate, (x * (width - thick) / 2, 0, -height / 2))]


def table(rng):
    """A top on legs, sometimes with a drawer block or a shelf."""
    width, depth, height, thick = rng.uniform((0.6, 0.4, 0.3, 0.03), (1.6, 1.0, 1.0, 0.12))
    round_top = rng.random() < 0.3
    parts = cone(width / 2, width / 2, thick) if round_top else box((width, depth, thick))
    parts = parts + legs(
        rng, *((width * 0.7, width * 0.7) if round_top else (width, depth)), height, thick * rng.uniform(0.6, 1.3)
    )
    if rng.random() < 0.4:
        parts += moved(
            box((width * rng.uniform(0.2, 0.5), depth * 0.8, height * rng.uniform(0.2, 0.7))),
            (width * rng.uniform(-0.2, 0.2), 0, -height * 0.35),
        )
    return parts


def chair(rng):
    """Seat, legs, back (plate, slats or hoop), sometimes arms."""
    width, depth, height, thick, back = rng.uniform((0.4, 0.4, 0.3, 0.03, 0.3), (0.7, 0.7, 0.6, 0.1, 0.9))
    parts = box((width, depth, thick)) + legs(rng, width, depth, height, thick * rng.uniform(0.6, 1.2))
    lean, kind = about(0, rng.uniform(0, 0.3)), rng.integers(3)
    if kind == 0:
        support = moved(box((width, thick * 0.7, back)), (0, 0, back / 2))
    elif kind == 1:
        slats = rng.integers(3, 7)
        support = [
            q
            for x in np.linspace(-0.45, 0.45, slats)
            for q in moved(box((thick * 0.6, thick * 0.6, back)), (x * width, 0, back / 2))
        ]
        support += moved(box((width, thick, thick * 1.5)), (0, 0, back))
    else:
        support = moved(torus(width / 2, thick / 2, 0.5), (0, 0, back * 0.3), about(0, np.pi / 2))
    parts += moved(support, (0, depth / 2 - thick / 2, thick / 2), lean)
    if rng.random() < 0.4:
        arm, post = box((thick, depth * 0.9, thick)), box((thick, thick, back * 0.4))
        for x in (-1, 1):
            parts += moved(arm, (x * width / 2, 0, back * 0.4)) + moved(post, (x * width / 2, -depth * 0.4, back * 0.2))
    return parts


def lamp(rng):
    """Base, a straight or bent pole, a shade."""
    base, pole, shade, height = rng.uniform((0.15, 0.01, 0.12, 0.5), (0.35, 0.04, 0.35, 1.4))
    bend = rng.choice([0, rng.uniform(0.1, 0.5)])
    s = np.linspace(0, 1, 16)
    path = np.stack([bend * s**3, 0 * s, height * np.sin(s * np.pi / 2) if bend else height * s], axis=-1)
    top = (
        cone(shade, shade * rng.uniform(0.2, 1), shade * rng.uniform(0.5, 1.5))
        if rng.random() < 0.7
        else superquadric(np.full(3, shade * 2), 1, 1)
    )
    return (
        cone(base, base * rng.uniform(0.3, 1), base * rng.uniform(0.1, 0.5))
        + tube(path, pole)
        + moved(top, path[-1], about(1, bend * 2))
    )


def plane(rng):
    """Fuselage, wings, tail, sometimes engines."""
    length, body, span, chord, thick = rng.uniform((0.8, 0.08, 0.8, 0.1, 0.01), (1.4, 0.2, 1.6, 0.35, 0.05))
    sweep = rng.uniform(0, 0.5)
    parts = moved(superquadric((body, body, length), rng.uniform(0.5, 1), 1), rotation=about(1, np.pi / 2))
    for side in (-1, 1):
        wing = [
            q + np.stack([-sweep * np.abs(q[..., 1]), 0 * q[..., 1], 0.1 * np.abs(q[..., 1])], axis=-1)
            for q in moved(box((chord, span / 2, thick)), (0, side * span / 4, 0))
        ]
        parts += wing + [q * 0.35 + (-length * 0.45, 0, 0) for q in wing]
        if rng.random() < 0.5:
            parts += moved(
                cone(body * 0.35, body * 0.25, chord),
                (chord * 0.3 - sweep * span / 4, side * span / 4, -body * 0.3),
                about(1, np.pi / 2),
            )
    return parts + moved(box((chord * 0.7, thick, length * 0.2)), (-length * 0.43, 0, length * 0.1))


def tool(rng):
    """A handle with a head: hammer, wrench, mug, bolt, bracket."""
    length, grip = rng.uniform((0.5, 0.03), (1.2, 0.1))
    handle = moved(
        superquadric((grip * 2, grip * 2 * rng.uniform(0.5, 1), length), 0.3, rng.uniform(0.3, 1)), (0, 0, -length / 2)
    )
    kind = rng.integers(5)
    if kind == 0:
        return handle + moved(primitive(rng, rng.uniform(0.1, 0.5, 3)), rotation=about(rng.integers(3), np.pi / 2))
    if kind == 1:
        return handle + moved(torus(grip * 2.5, grip, 0.75), (0, 0, grip * 2), about(0, np.pi / 2))
    if kind == 2:
        radius, height = rng.uniform(0.2, 0.5, 2)
        cup = revolve(
            np.array([0, radius, radius * 1.1, radius, radius * 0.9, 0]),
            np.array([-0.5, -0.5, 0.5, 0.5, -0.42, -0.42]) * height * 2,
        )
        return cup + moved(torus(height * 0.6, radius * 0.12, 0.5), (0, radius, 0), about(1, np.pi / 2))
    if kind == 3:
        return handle + cone(grip * 3, grip * 3, grip * 2)
    arm = box((grip * 2, length * rng.uniform(0.4, 1), grip))
    return box((length, grip * 4, grip)) + moved(
        arm, (length * rng.uniform(-0.5, 0.5), 0, length * 0.3), about(0, np.pi / 2)
    )


def shelf(rng):
    """A carcass with boards and sometimes boxes on them."""
    width, depth, height, thick = rng.uniform((0.4, 0.2, 0.5, 0.02), (1.0, 0.5, 1.5, 0.06))
    parts = [q for x in (-0.5, 0.5) for q in moved(box((thick, depth, height)), (x * width, 0, 0))]
    for z in np.linspace(-0.5, 0.5, rng.integers(2, 6)) * height:
        parts += moved(box((width, depth, thick)), (0, 0, z))
        if rng.random() < 0.4:
            size = rng.uniform(0.1, 0.3, 3) * (width, depth * 2, width)
            parts += moved(box(size), (rng.uniform(-0.3, 0.3) * width, 0, z + size[2] / 2))
    return parts


def compose(rng):
    """Two to six primitives of mixed size, each touching an earlier one; sometimes mirrored."""
    parts, centers = [], [np.zeros(3)]
    mirrored = rng.random() < 0.4
    for _ in range(rng.integers(2, 7)):
        size = rng.uniform(0.1, 0.8, 3)
        offset = centers[rng.integers(len(centers))] + rng.uniform(-0.5, 0.5, 3)
        rotation = about(rng.integers(3), rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)]))
        part = moved(primitive(rng, size), offset, rotation)
        parts += part + ([patch * (-1, 1, 1) for patch in part] if mirrored else [])
        centers.append(offset)
    return parts


RECIPES = (table, chair, lamp, plane, tool, shelf, compose, compose, compose)
