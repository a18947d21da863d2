"""Where keypoints lie beside the corners of made rooms: python tests/bench/places.py

A made room is a floor, two walls and boxes, turned, far from the origin, and sampled anew for each row. Its corners are in the default
list if a keypoint lies within the row's distance. `inside` is the share of errors within what their covariance says for 95 %.
`on walls` is the share of default keypoints more than 0.2 m from every edge."""

import argparse

import numpy as np
from scipy.spatial import cKDTree

import snake_rs

CORNER_CASES = (  # spacing, noise, noise per squared metre of distance, the distance that counts
    (0.01, 0.003, 0.0, 0.015),
    (0.02, 0.003, 0.0, 0.015),
    (0.04, 0.003, 0.0, 0.04),
    (0.02, 0.001, 0.0007, 0.04),
    (0.02, 0.001, 0.0015, 0.06),
)
CHI_SQUARED = 7.81  # 95 % of three degrees of freedom


def rotation(rng):
    """A random rotation (3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def made_room(seed, spacing, noise, quadratic):
    """Points (N, 3) of a room, its corners (K, 3) and its edges, pairs of ends (E, 2, 3)."""
    rng = np.random.default_rng(seed)
    size = rng.uniform((3.5, 3.0, 2.2), (6.0, 5.0, 3.0))
    x, y, z = np.diag(size)
    faces, corners = [(0 * x, x, y), (0 * x, x, z), (0 * x, y, z)], [0 * x]
    edges = [(0 * x, x), (0 * x, y), (0 * x, z), (x, x + y), (y, x + y), (x, x + z), (y, y + z), (z, x + z), (z, y + z)]
    for place in (0.15, 0.6):
        angle = rng.uniform(-0.5, 0.5)
        u = rng.uniform(0.5, 1.0) * np.array([np.cos(angle), np.sin(angle), 0])
        v = rng.uniform(0.5, 0.9) * np.array([-np.sin(angle), np.cos(angle), 0])
        up, at = (
            np.array([0, 0, rng.uniform(0.4, 1.0)]),
            np.array([place * size[0] + 0.35, size[1] * rng.uniform(0.25, 0.5), 0]),
        )
        faces += [(at + up, u, v), (at, u, up), (at + v, u, up), (at, v, up), (at + u, v, up)]
        ring = [at, at + u, at + u + v, at + v]
        corners += ring + [corner + up for corner in ring]
        edges += [(corner, corner + up) for corner in ring]
        edges += [(a + h, b + h) for h in (0 * up, up) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
    grid = lambda length: np.arange(0, length, spacing) / length
    sides = lambda u, v: np.stack(np.meshgrid(*(grid(np.linalg.norm(side)) for side in (u, v))), axis=-1).reshape(-1, 2)
    points = np.concatenate([at + sides(u, v) @ np.stack([u, v]) for at, u, v in faces])
    offset = points - (0.8 * size[0], 0.8 * size[1], 1.5)
    reach = np.linalg.norm(offset, axis=1, keepdims=True)
    points = points + offset * (quadratic * reach * rng.normal(size=reach.shape)) + rng.normal(0, noise, points.shape)
    turn, shift = rotation(rng), rng.uniform(-100, 100, 3)
    return points @ turn.T + shift, np.array(corners) @ turn.T + shift, np.array(edges) @ turn.T + shift


def to_edges(points, edges):
    """The distance (K,) of points from the nearest edge."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    offset = points[:, None] - start
    share = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0, 1)
    return np.linalg.norm(offset - share[..., None] * along, axis=-1).min(axis=1)


def corners_row(spacing, noise, quadratic, reach, rooms):
    """A row of the table of made rooms."""
    rows, errors = [], []
    for seed in rooms:
        points, corners, edges = made_room(seed, spacing, noise, quadratic)
        keypoints = snake_rs.detect(points, model="scenes")
        positions = np.asarray(keypoints.points).reshape(-1, 3)
        if not len(positions):
            rows.append((0, 0, np.nan, np.nan))
            continue
        distance, nearest = cKDTree(positions).query(corners)
        for corner, index in zip(corners[distance < 0.1], nearest[distance < 0.1], strict=True):
            covariance = keypoints.covariance[index].astype(float)
            if np.isfinite(covariance).all():
                error = positions[index] - corner
                errors.append(error @ np.linalg.solve(covariance, error) < CHI_SQUARED)
        rows.append(
            (len(positions), (distance < reach).mean(), np.median(distance), (to_edges(positions, edges) > 0.2).mean())
        )
    number, found, median, walls = np.nanmean(rows, axis=0)
    return f"| {spacing} | {noise} + {quadratic} z² | {number:.0f} | {found:.2f} within {reach} | {median:.3f} | {np.mean(errors):.2f} | {walls:.2f} |"


def main():
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=3, help="made rooms of each row")
    parser.add_argument("--seed", type=int, default=11)
    given = parser.parse_args()
    print(
        "| spacing, m | noise | default keypoints | corners | median distance | inside | on walls |\n|---|---|---|---|---|---|---|"
    )
    for case in CORNER_CASES:
        print(corners_row(*case, range(given.seed, given.seed + given.rooms)), flush=True)


if __name__ == "__main__":
    main()
