"""Shapes that know their own landmarks: corners of boxes and nuts, the ends of legs, tips of wings, noses, tails and ears.

`write_landmarks` writes them in KeypointNet's layout, which `snake_training.evaluation semantic` reads: the share of the landmarks with a keypoint nearby
says whether keypoints are where a person expects them.
"""

import json
import os
from pathlib import Path

import numpy as np

from ..augment import normalize, random_rotation
from .shapes import box, moved, sample_surface, superquadric, tube

SIGNS = (-1, 1)


def corners(size, offset=(0, 0, 0)):
    """The eight corners (8, 3) of a box."""
    return np.array([(x, y, z) for x in SIGNS for y in SIGNS for z in SIGNS]) * np.asarray(size) / 2 + offset


def boxes(rng):
    """One box, or a smaller one on top of it."""
    size = rng.uniform(0.4, 1.2, 3)
    patches, positions = box(size), [corners(size)]
    if rng.random() < 0.5:
        top = size * rng.uniform(0.35, 0.65, 3)
        offset = np.array([*((size - top)[:2] / 2 * rng.uniform(-0.7, 0.7, 2)), (size[2] + top[2]) / 2])
        patches, positions = patches + moved(box(top), offset), [*positions, corners(top, offset)[1::2]]
    return patches, np.concatenate(positions)


def nuts(rng):
    """A hexagonal nut with its hole."""
    radius, height = rng.uniform(0.6, 1.0), rng.uniform(0.3, 0.9)
    hole = radius * rng.uniform(0.4, 0.65)
    angle = np.linspace(0, 2 * np.pi, 7)
    hexagon = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * radius
    fine = np.linspace(0, 2 * np.pi, 7 * 6 + 1 - 6)
    ring = np.stack([np.cos(fine), np.sin(fine)], axis=-1) * hole
    outline = np.stack([np.interp(fine, angle, hexagon[:, axis]) for axis in (0, 1)], axis=-1)
    at = lambda flat, z: np.concatenate([flat, np.full((len(flat), 1), z)], axis=1)
    low, high = -height / 2, height / 2
    patches = [
        np.stack([at(hexagon, low), at(hexagon, high)]),
        np.stack([at(ring, low), at(ring, high)]),
        *(np.stack([at(outline, z), at(ring, z)]) for z in (low, high)),
    ]
    return patches, np.concatenate([at(hexagon[:6], low), at(hexagon[:6], high)])


def tables(rng):
    """A top on four legs: the top's upper corners and the ends of the legs."""
    width, depth, height, thick = rng.uniform((0.8, 0.5, 0.4, 0.04), (1.5, 1.0, 0.9, 0.1))
    leg = rng.uniform(0.05, 0.1)
    feet = np.array([(x * (width - leg) / 2, y * (depth - leg) / 2, -height) for x in SIGNS for y in SIGNS])
    patches = box((width, depth, thick))
    for foot in feet:
        patches = patches + moved(box((leg, leg, height)), foot + (0, 0, height / 2))
    return patches, np.concatenate([corners((width, depth, thick))[1::2], feet])


def chairs(rng):
    """Seat, four legs and a back: the back's upper corners, the seat's front corners and the ends of the legs."""
    width, depth, height, thick, back = rng.uniform((0.4, 0.4, 0.35, 0.04, 0.4), (0.7, 0.7, 0.6, 0.08, 0.9))
    feet = np.array([(x * (width - thick) / 2, y * (depth - thick) / 2, -height) for x in SIGNS for y in SIGNS])
    patches = box((width, depth, thick)) + moved(box((width, thick, back)), (0, (depth - thick) / 2, back / 2))
    for foot in feet:
        patches = patches + moved(box((thick, thick, height)), foot + (0, 0, height / 2))
    upper = [(x * width / 2, (depth - thick) / 2, back) for x in SIGNS]
    front = [(x * width / 2, -depth / 2, 0) for x in SIGNS]
    return patches, np.concatenate([upper, front, feet])


def aeroplanes(rng):
    """Fuselage along x, swept wings, tail wings and fin: nose, tail and the tips."""
    length, body, span, chord, thick = rng.uniform((1.0, 0.08, 0.9, 0.12, 0.02), (1.4, 0.16, 1.6, 0.3, 0.05))
    sweep = rng.uniform(0.1, 0.5)
    patches = [q[..., [2, 1, 0]] for q in superquadric((body, body, length), rng.uniform(0.6, 1), 1)]
    positions = [(length / 2, 0, 0), (-length / 2, 0, 0)]
    for scale, x in ((1, 0), (0.4, -length * 0.42)):
        for side in SIGNS:
            wing = moved(box((chord, span / 2, thick)), (0, side * span / 4, 0))
            swept = [q - np.stack([sweep * np.abs(q[..., 1]), 0 * q[..., 1], 0 * q[..., 1]], axis=-1) for q in wing]
            patches = patches + [q * scale + (x, 0, 0) for q in swept]
            positions.append(np.array((-sweep * span / 2, side * span / 2, 0)) * scale + (x, 0, 0))
    fin = rng.uniform(0.15, 0.25)
    patches = patches + moved(box((chord * 0.5, thick, fin)), (-length * 0.42, 0, fin / 2))
    return patches, np.array([*positions, (-length * 0.42, 0, fin)])


def animals(rng):
    """A body of tubes with legs, neck, tail and ears: the ends of all of them."""
    length, height, thick = rng.uniform((0.6, 0.3, 0.07), (1.0, 0.6, 0.14))
    line = lambda a, b: np.linspace(a, b, 8)
    capped = lambda a, b, radius: tube(line(a, b), radius) + ball(a, radius) + ball(b, radius)
    patches = capped((-length / 2, 0, 0), (length / 2, 0, 0), thick)
    positions = []
    for x in SIGNS:
        for y in SIGNS:
            foot = (x * length * 0.45 + rng.uniform(-0.1, 0.1), y * thick * 1.3, -height)
            patches = patches + capped((x * length * 0.45, y * thick * 0.6, 0), foot, thick * 0.35)
            positions.append(foot)
    head = np.array([length / 2 + rng.uniform(0.1, 0.3), 0, rng.uniform(0.2, 0.5)])
    nose = head + (rng.uniform(0.15, 0.3), 0, rng.uniform(-0.1, 0.05))
    tail = np.array([-length / 2 - rng.uniform(0.2, 0.5), rng.uniform(-0.1, 0.1), rng.uniform(-0.2, 0.3)])
    patches = patches + capped((length / 2, 0, 0), head, thick * 0.6) + capped(head, nose, thick * 0.5)
    patches = patches + capped((-length / 2, 0, 0), tail, thick * 0.25)
    ears = [head + (0, y * thick * 0.9, rng.uniform(0.15, 0.25)) for y in SIGNS]
    for ear in ears:
        patches = patches + capped(head, ear, thick * 0.25)
    return patches, np.array([*positions, nose, tail, *ears])


def ball(center, radius):
    """A sphere that closes the end of a tube."""
    return moved(superquadric(np.full(3, 2 * radius), 1, 1), center)


RECIPES = {"chair": chairs, "table": tables, "airplane": aeroplanes, "animal": animals, "nut": nuts, "box": boxes}


def landmarks(name, rng, points=4096):
    """A shape of that class, rotated at random, of radius 1: points (points, 3) and the indices of its landmarks."""
    patches, positions = RECIPES[name](rng)
    stretch = rng.uniform(0.85, 1.2, 3)
    cloud = sample_surface([patch * stretch for patch in patches], points, rng)
    positions = positions * stretch
    rotation = random_rotation(rng)
    nearest = np.linalg.norm(cloud[None] - positions[:, None], axis=2).argmin(axis=1)
    return (2 * normalize(cloud)[0] @ rotation.T).astype(np.float32), nearest


def write_pcd(path, points):
    """A binary PCD file of points (N, 3)."""
    header = (
        f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def write_annotated(folder, shapes):
    """Shapes (class, points (N, 3), indices of the landmarks) in KeypointNet's layout; the annotations are written last."""
    folder, annotations = Path(folder), {}
    for row, (name, cloud, indices) in enumerate(shapes):
        model = f"{row:04d}"
        (folder / "pcds" / name).mkdir(parents=True, exist_ok=True)
        write_pcd(folder / "pcds" / name / f"{model}.pcd", cloud)
        marked = [{"pcd_info": {"point_index": int(index)}} for index in dict.fromkeys(indices.tolist())]
        annotations.setdefault(name, []).append({"class_id": name, "model_id": model, "keypoints": marked})
    (folder / "annotations").mkdir(exist_ok=True)
    for name, rows in annotations.items():
        temporary = folder / "annotations" / f".{name}.json"
        temporary.write_text(json.dumps(rows))
        os.replace(temporary, folder / "annotations" / f"{name}.json")


def write_landmarks(folder, number=200, points=4096, seed=1):
    """`number` shapes, class by class in turn. Raises ValueError for less than one of each class, or less than 256 points."""
    if number < len(RECIPES) or points < 256:
        raise ValueError(f"number must be {len(RECIPES)} or more, points 256 or more")
    names = [list(RECIPES)[row % len(RECIPES)] for row in range(number)]
    seeds = (np.random.default_rng([seed, row, 0x1A4D]) for row in range(number))
    write_annotated(folder, ((name, *landmarks(name, rng, points)) for name, rng in zip(names, seeds, strict=True)))
