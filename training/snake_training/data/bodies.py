"""Bodies with known correspondences: posed skeletons, chairs and lamps with joints, aeroplanes of other proportions, bent clouds.

`write_bodies` writes data for `snake_training.evaluation semantic`: `annotated/`, shapes with landmarks in KeypointNet's layout, and `posed/`, pairs of
bodies whose points i are the same point of the surface. With a corpus it adds `bent/`, pairs of an animal or a character and a bent
copy of it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..augment import random_rotation
from .datasets import Corpus, ShapeError
from .landmarks import write_annotated
from .shapes import draw_on, triangles
from .skeletons import CLASSES, toward

BENT = ("animal", "character")
NUM_PROPORTIONS = 8
# The largest change of a proportion between the two bodies of a pair, as a share of its range.
CHANGE = 0.15


@dataclass(frozen=True)
class Posed:
    """A posed body. Each bone has a rotation (3, 3) and a position (3,) in the body's frame."""

    bones: list
    rotations: np.ndarray
    positions: np.ndarray

    def moved(self, bone, points):
        """Points (N, 3) of the frames of bones (N,) in the body's frame."""
        return np.einsum("nij,nj->ni", self.rotations[bone], points) + self.positions[bone]

    def is_inside(self, points, but):
        """Which points (N, 3) lie inside a solid other than that of bone `but` (N,)."""
        inside = np.zeros(len(points), bool)
        for number, bone in enumerate(self.bones):
            local = (points - self.positions[number]) @ self.rotations[number]
            inside |= bone.solid.contains(local) & (but != number)
        return inside

    def landmarks(self):
        """The positions (K, 3) of all landmarks, and the bone (K,) of each."""
        bone = np.array([number for number, bone in enumerate(self.bones) for _ in bone.landmarks])
        return self.moved(bone, np.array([position for bone in self.bones for position in bone.landmarks], float)), bone


def rotation_by(vector):
    """The rotation matrix of a rotation vector (3,), in radians."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def posed(bones, angles):
    """The bones with joint rotations `angles` (B, 3), each from -1 to 1 in shares of the bone's swing."""
    rotations, positions = [], []
    for bone, angle in zip(bones, angles, strict=True):
        rotation, position = (
            (np.eye(3), np.zeros(3)) if bone.parent < 0 else (rotations[bone.parent], positions[bone.parent])
        )
        positions.append(position + rotation @ np.asarray(bone.offset, float))
        rotations.append(rotation @ toward(bone.direction) @ rotation_by(angle * np.asarray(bone.swing)))
    return Posed(bones, np.array(rotations), np.array(positions))


def surface_pair(first, second, number, rng):
    """The same points of the surface on two bodies of a class: points (number, 3) on each, and the bone (number,) of each.

    They are uniform over the area of the first body, without those that lie inside another solid in either body.
    """
    corners = [[triangles(bone.solid.patches) for bone in body.bones] for body in (first, second)]
    bone_of = np.repeat(np.arange(len(first.bones)), [len(own) for own in corners[0]])
    corners = [np.concatenate(own) for own in corners]
    kept, count = [], 0
    while count < number:
        chosen, weights = draw_on(corners[0], number, rng)
        bone = bone_of[chosen]
        one, other = (
            body.moved(bone, (weights[:, :, None] * own[chosen]).sum(axis=1))
            for body, own in zip((first, second), corners, strict=True)
        )
        is_outside = ~(first.is_inside(one, bone) | second.is_inside(other, bone))
        kept.append((one[is_outside], other[is_outside], bone[is_outside]))
        count += is_outside.sum()
    return [np.concatenate(part)[:number] for part in zip(*kept, strict=True)]


def body_pair(name, points, seed, row):
    """Two bodies of a class in two poses and of slightly other proportions, aeroplanes of quite other ones.

    The same `points` points of the surface on each, float32 (points, 3), the first of radius 1 about its mean, the second by the same scale.
    """
    rng = np.random.default_rng([seed, row, 0xB0D1])
    numbers = rng.random(NUM_PROPORTIONS)
    change = rng.uniform(-CHANGE, CHANGE, NUM_PROPORTIONS)
    others = rng.random(NUM_PROPORTIONS) if name == "aeroplane" else (numbers + change).clip(0, 1)
    pair = []
    for shape in (numbers, others):
        bones = CLASSES[name](shape)
        pair.append(posed(bones, rng.uniform(-1, 1, (len(bones), 3))))
    one, other, _ = surface_pair(*pair, points, rng)
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    radius = np.linalg.norm(one, axis=1).max()
    return (one / radius).astype(np.float32), (other / radius).astype(np.float32)


def annotated(name, points, seed, row):
    """A body of a class in a pose, float32 (points, 3) with a bounding box of diagonal 1, and the index of each landmark's point."""
    rng = np.random.default_rng([seed, row, 0xA770])
    bones = CLASSES[name](rng.random(NUM_PROPORTIONS))
    body = posed(bones, rng.uniform(-1, 1, (len(bones), 3)))
    cloud, _, bone = surface_pair(body, body, points, rng)
    positions, on = body.landmarks()
    distance = np.where(bone == on[:, None], np.linalg.norm(cloud - positions[:, None], axis=2), np.inf)
    center, diagonal = (cloud.min(axis=0) + cloud.max(axis=0)) / 2, np.linalg.norm(np.ptp(cloud, axis=0))
    return ((cloud - center) / diagonal).astype(np.float32), distance.argmin(axis=1)


def bent(points, twist, bend):
    """Points (N, 3) twisted about z by `twist` radians a length, then bent towards x with curvature `bend` (Barr 1984).

    Lengths along the z axis stay. The map is one to one where bend * x < 1.
    """
    x, y, z = points.T
    cos, sin = np.cos(twist * z), np.sin(twist * z)
    x, y = cos * x - sin * y, sin * x + cos * y
    if bend == 0:
        return np.stack([x, y, z], axis=1)
    radius = 1 / bend
    return np.stack([radius - (radius - x) * np.cos(bend * z), y, (radius - x) * np.sin(bend * z)], axis=1)


def bent_pair(points, rng):
    """Points (N, 3) of radius 1 and where a bend of up to 80 degrees and a twist of up to 70, about a random axis, take them."""
    rotation = random_rotation(rng)
    moved = bent(points @ rotation.T, *rng.uniform(-1, 1, 2) * (0.6, 0.7)) @ rotation
    return points.astype(np.float32), moved.astype(np.float32)


def write_pairs(folder, pairs):
    """body_1.npy and body_2.npy, float32 (S, N, 3)."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, bodies in enumerate(zip(*pairs, strict=True), 1):
        np.save(folder / f"body_{number}.npy", np.stack(bodies))


def write_bodies(folder, number=200, points=2048, seed=1, corpus=(), bends=4):
    """`number` annotated shapes and as many pairs, class by class in turn, and `bends` bent copies of each animal and character of the
    corpus folders. Raises ValueError for less than one of each class, less than 256 points, or no bent copy."""
    if number < len(CLASSES) or points < 256 or bends < 1:
        raise ValueError(f"number must be {len(CLASSES)} or more, points 256 or more, bends 1 or more")
    folder, names = Path(folder), [list(CLASSES)[row % len(CLASSES)] for row in range(number)]
    write_annotated(
        folder / "annotated", ((name, *annotated(name, points, seed, row)) for row, name in enumerate(names))
    )
    write_pairs(folder / "posed", [body_pair(name, points, seed, row) for row, name in enumerate(names)])
    shapes = [
        collection[row][:points]
        for collection in map(Corpus, corpus)
        for row, entry in enumerate(collection.index)
        if entry.get("category") in BENT
    ]
    if corpus and not shapes:
        raise ShapeError(f"{', '.join(map(str, corpus))}: no shape of the categories {', '.join(BENT)}")
    pairs = [
        bent_pair(shape, np.random.default_rng([seed, row, copy, 0xBE47]))
        for row, shape in enumerate(shapes)
        for copy in range(bends)
    ]
    if pairs:
        write_pairs(folder / "bent", pairs)
