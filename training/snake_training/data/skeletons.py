"""Bodies of eight classes as skeletons: solids on joints, each of which swings.

A class is a function of numbers from 0 to 1, its proportions. It always has the same bones, joints and patches, so a point of a patch
is the same point of every body of the class. Lengths are about 1; x is forward, z up.
"""

from dataclasses import dataclass

import numpy as np

from .shapes import box, moved, revolve, superquadric

SIDES = (-1, 1)
UP, DOWN, FORWARD, BACK = (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0)


@dataclass(frozen=True)
class Solid:
    """A closed surface in a bone's frame: its patches, and what tells which points (N, 3) lie inside."""

    patches: list
    contains: object


def capsule(length, radius):
    """A cylinder along z from 0 to `length` with half balls at both ends."""
    arc = np.linspace(0, np.pi / 2, 7)
    profile = np.concatenate([np.sin(arc), np.cos(arc)]) * radius
    height = np.concatenate([-np.cos(arc) * radius, length + np.sin(arc) * radius])
    axis = lambda p: np.stack([0 * p[:, 2], 0 * p[:, 2], p[:, 2].clip(0, length)], axis=1)
    return Solid(revolve(profile, height), lambda p: np.linalg.norm(p - axis(p), axis=1) < radius)


def block(size, center=(0, 0, 0)):
    """A box of full side lengths `size` (3,) about `center`."""
    size, center = np.asarray(size, float), np.asarray(center, float)
    return Solid(moved(box(size), center), lambda p: (np.abs(p - center) < size / 2).all(axis=1))


def ellipsoid(size, center=(0, 0, 0)):
    """An ellipsoid of full extents `size` (3,) about `center`."""
    size, center = np.asarray(size, float), np.asarray(center, float)
    return Solid(moved(superquadric(size, 1, 1), center), lambda p: (((p - center) / (size / 2)) ** 2).sum(axis=1) < 1)


@dataclass(frozen=True)
class Bone:
    """A solid on a joint of its parent's frame; the root's parent is -1.

    offset: the joint (3,). direction: where the bone's z axis points at rest. swing: the largest rotation, in radians, about each
    of the bone's axes. landmarks: the points (3,) of the bone that a person would mark.
    """

    parent: int
    offset: tuple
    direction: tuple
    solid: Solid
    swing: tuple = (0.35, 0.35, 0.35)
    landmarks: tuple = ()


def toward(direction):
    """A rotation whose z axis points along `direction`; its x axis is as near as can be to x, or to z along x."""
    z = np.asarray(direction, float) / np.linalg.norm(direction)
    near = np.array([1.0, 0, 0]) if abs(z[0]) < 0.9 else np.array([0, 0, 1.0])
    x = near - (near @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def between(numbers, low, high):
    """The first of `numbers`, from 0 to 1, as values between `low` and `high`."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    return low + numbers[: len(low)] * (high - low)


def limb(bones, parent, offset, direction, parts, bend=(0, 0, 1), swing=(0.35, 0.35, 0.35)):
    """Adds capsules of `parts`, (length, radius), one at the end of another; the end of the last is a landmark."""
    for number, (length, radius) in enumerate(parts):
        tip = ((0, 0, length + radius),) if number == len(parts) - 1 else ()
        bones.append(Bone(parent, offset, direction, capsule(length, radius), swing, tip))
        parent, offset, direction = len(bones) - 1, (0, 0, length), bend


def person(numbers):
    """Trunk, head, and arms, legs and feet."""
    trunk, wide, arm, leg, thin, head = between(
        numbers, (0.45, 0.1, 0.22, 0.36, 0.03, 0.09), (0.6, 0.15, 0.32, 0.46, 0.05, 0.13)
    )
    bones = [Bone(-1, (0, 0, 0), UP, capsule(trunk, wide), (0, 0, 0))]
    limb(bones, 0, (0, 0, trunk + wide), UP, [(head, head)])
    for side in SIDES:
        limb(bones, 0, (0, side * wide, trunk), (0, side, -0.4), [(arm, thin * 1.2), (arm, thin)])
        limb(bones, 0, (0, side * wide * 0.6, 0), (0, side * 0.2, -1), [(leg, thin * 1.7), (leg, thin * 1.3)])
        bones.append(
            Bone(len(bones) - 1, (0, 0, leg), FORWARD, capsule(leg * 0.4, thin), landmarks=((0, 0, leg * 0.4 + thin),))
        )
    return bones


def quadruped(numbers):
    """Trunk, neck, head with ears, tail and four legs."""
    trunk, wide, neck, head, leg, tail, thin = between(
        numbers, (0.5, 0.09, 0.15, 0.12, 0.18, 0.2, 0.025), (0.8, 0.16, 0.35, 0.25, 0.32, 0.5, 0.045)
    )
    # The trunk's x axis is up, its y axis to the right.
    bones = [Bone(-1, (0, 0, 0), FORWARD, capsule(trunk, wide), (0, 0, 0))]
    limb(bones, 0, (0, 0, trunk), (0.7, 0, 0.7), [(neck, wide * 0.6), (head, wide * 0.5)], bend=(-0.8, 0, 0.6))
    skull = len(bones) - 1
    for side in SIDES:
        limb(bones, skull, (wide * 0.3, side * wide * 0.3, 0), (1, side * 0.5, 0), [(wide * 0.9, thin)])
    limb(bones, 0, (0, 0, 0), (0.3, 0, -1), [(tail, thin)])
    for point in (0, trunk):
        for side in SIDES:
            limb(bones, 0, (0, side * wide * 0.7, point), (-1, 0, 0), [(leg, thin * 1.6), (leg, thin)])
    return bones


def hand(numbers):
    """A palm with a thumb and four fingers of two parts."""
    wide, long, thick, finger, thin = between(numbers, (0.4, 0.4, 0.1, 0.2, 0.035), (0.55, 0.6, 0.16, 0.32, 0.05))
    bones = [Bone(-1, (0, 0, 0), UP, block((thick, wide, long), (0, 0, long / 2)), (0, 0, 0))]
    for number, share in enumerate((0.85, 1, 1.05, 0.75)):
        point = (0, (number - 1.5) / 4 * wide, long)
        limb(bones, 0, point, UP, [(finger * share, thin), (finger * share * 0.8, thin)], swing=(0.1, 0.5, 0.05))
    limb(bones, 0, (0, -wide / 2, long * 0.3), (0, -1, 0.6), [(finger, thin * 1.1), (finger * 0.7, thin)])
    return bones


def bird(numbers):
    """Trunk, head with a beak, tail, wings of two parts and legs."""
    trunk, wide, head, span, chord, leg, tail = between(
        numbers, (0.35, 0.1, 0.07, 0.3, 0.12, 0.1, 0.2), (0.55, 0.18, 0.1, 0.5, 0.25, 0.25, 0.4)
    )
    bones = [Bone(-1, (0, 0, 0), FORWARD, capsule(trunk, wide), (0, 0, 0))]
    limb(bones, 0, (0, 0, trunk), (0.6, 0, 0.8), [(wide, head), (head * 2, head * 0.3)], bend=(-0.6, 0, 0.8))
    flat = block((chord * 0.15, chord, tail), (0, 0, tail / 2))
    corners = tuple((0, side * chord / 2, tail) for side in SIDES)
    bones.append(Bone(0, (0, 0, -wide * 0.7), (0, 0, -1), flat, landmarks=corners))
    for side in SIDES:
        # Along the wings z is the span, y the chord.
        inner = block((chord * 0.12, chord, span), (0, 0, span / 2))
        outer = block((chord * 0.1, chord * 0.8, span), (0, 0, span / 2))
        bones.append(Bone(0, (wide * 0.5, side * wide * 0.6, trunk / 2), (0.2, side, 0), inner, (0.1, 0.4, 0.1)))
        tips = tuple((0, edge * chord * 0.4, span) for edge in SIDES)
        bones.append(Bone(len(bones) - 1, (0, 0, span), UP, outer, (0.1, 0.4, 0.1), tips))
        limb(bones, 0, (-wide * 0.7, side * wide * 0.4, trunk * 0.3), (-1, side * 0.2, 0.1), [(leg + wide * 0.5, 0.02)])
    return bones


def insect(numbers):
    """Thorax, abdomen, head with feelers and six legs of two parts."""
    thorax, wide, rear, leg, thin = between(numbers, (0.2, 0.06, 0.25, 0.25, 0.015), (0.35, 0.12, 0.5, 0.45, 0.03))
    bones = [Bone(-1, (0, 0, 0), FORWARD, capsule(thorax, wide), (0, 0, 0))]
    limb(bones, 0, (0, 0, -wide), (0, 0, -1), [(rear, wide * 1.3)], swing=(0.2, 0.2, 0.2))
    bones.append(Bone(0, (0, 0, thorax + wide), UP, ellipsoid((wide * 1.8, wide * 2, wide * 2)), (0.2, 0.2, 0.2)))
    skull = len(bones) - 1
    for side in SIDES:
        limb(bones, skull, (wide * 0.4, side * wide * 0.4, wide * 0.6), (0.5, side * 0.6, 1), [(leg * 0.7, thin * 0.8)])
        for number in range(3):
            at, lean = thorax * number / 2, (number - 1) * 0.6
            limb(
                bones, 0, (0, side * wide * 0.8, at), (0.5, side, lean), [(leg, thin), (leg * 1.3, thin)], (-1, 0, 0.6)
            )
    return bones


def chair(numbers):
    """A seat with a back and four legs, all on hinges."""
    width, depth, thick, back, leg, thin = between(
        numbers, (0.4, 0.4, 0.04, 0.4, 0.35, 0.04), (0.65, 0.65, 0.1, 0.8, 0.6, 0.07)
    )
    front = tuple((depth / 2, side * width / 2, thick / 2) for side in SIDES)
    bones = [Bone(-1, (0, 0, 0), UP, block((depth, width, thick)), (0, 0, 0), front)]
    corners = tuple((0, side * width / 2, back) for side in SIDES)
    support = block((thick, width, back), (0, 0, back / 2))
    bones.append(Bone(0, ((thick - depth) / 2, 0, thick / 2), UP, support, (0, 0.5, 0), corners))
    for x in SIDES:
        for y in SIDES:
            point = (x * (depth - thin) / 2, y * (width - thin) / 2, -thick / 2)
            post = block((thin, thin, leg), (0, 0, leg / 2))
            bones.append(Bone(0, point, DOWN, post, (0.25, 0.25, 0), ((0, 0, leg),)))
    return bones


def lamp(numbers):
    """A foot, two arms and a shade, as on a desk."""
    foot, thick, arm, thin, shade = between(numbers, (0.25, 0.03, 0.35, 0.015, 0.12), (0.4, 0.08, 0.6, 0.03, 0.22))
    corners = tuple((x * foot / 2, y * foot / 2, -thick / 2) for x in SIDES for y in SIDES)
    bones = [Bone(-1, (0, 0, 0), UP, block((foot, foot, thick)), (0, 0, 0), corners)]
    bones.append(Bone(0, (0, 0, thick / 2), (-0.3, 0, 1), capsule(arm, thin), (0.1, 0.4, 0.5)))
    bones.append(Bone(1, (0, 0, arm), (0.9, 0, 0.5), capsule(arm, thin), (0.1, 0.5, 0.1)))
    hood = block((shade, shade, shade), (0, 0, shade / 2))
    rim = tuple((x * shade / 2, y * shade / 2, shade) for x in SIDES for y in SIDES)
    bones.append(Bone(2, (0, 0, arm), (-0.9, 0, 0.4), hood, (0.3, 0.5, 0.3), rim))
    return bones


def aeroplane(numbers):
    """Fuselage, wings with engines, tail wings and a fin: nose, tail and tips. The wings hardly swing."""
    length, body, span, chord, thick, sweep, tail = between(
        numbers, (1.0, 0.1, 0.4, 0.12, 0.02, 0.0, 0.12), (1.4, 0.2, 0.8, 0.3, 0.05, 0.6, 0.25)
    )
    ends = ((0, 0, length / 2), (0, 0, -length / 2))
    bones = [Bone(-1, (0, 0, 0), FORWARD, ellipsoid((body, body, length)), (0, 0, 0), ends)]
    rear, stiff = -length * 0.42, (0.08, 0.08, 0.08)

    def wing(parent_place, direction, size):
        tip = ((0, 0, size[2]),)
        bones.append(Bone(0, parent_place, direction, block(size, (0, 0, size[2] / 2)), stiff, tip))

    for side in SIDES:
        # In the fuselage's frame x is up, z forward; along a wing z is the span, x the thickness.
        wing((0, 0, length * 0.05), (0, side, -sweep), (thick, chord, span))
        engine = len(bones) - 1
        limb(
            bones,
            engine,
            (-body * 0.25, -side * chord * 0.2, span * 0.4),
            (0, side, sweep),
            [(chord * 0.6, body * 0.15)],
            swing=stiff,
        )
        wing((0, 0, rear), (0, side, -sweep), (thick * 0.7, chord * 0.5, span * 0.4))
    wing((0, 0, rear), (1, 0, -0.5), (chord * 0.5, thick * 0.7, tail + body / 2))
    return bones


CLASSES = {
    "aeroplane": aeroplane, "bird": bird, "chair": chair, "hand": hand,
    "insect": insect, "lamp": lamp, "person": person, "quadruped": quadruped,
}  # fmt: skip
