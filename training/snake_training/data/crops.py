"""Crops for training a network of scenes: a ball of a made room or street as two sensors see it, queries near its clean surface,
and the saliency that the network learns there.

`write_crops` writes them in files of 25, `Crops` reads them. Stored positions are in voxels about the crop's center.
"""

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt

from .sensors import View, depth_camera, fused, holes, seen, spinning_lidar, standpoint, toward_ball, upright
from .worlds import room, street

POINTS_RADIUS, QUERY_RADIUS = 28.0, 18.0  # voxels: any turned box of 32 lies within the first
POINTS, QUERIES, SURFACE = 4000, 3000, 12000  # at most: points of a view, queries and surface points of a crop
CELL = 0.5  # voxels, of the grid that responses are computed on
DENSITY = 9  # surface points a square voxel
QUANTUM = 1 / 1024  # voxels, of stored positions
EDGE, CORNER = 0.0015, 0.025  # responses that count as none and as a strong corner


def room_views(world, size, rng, center, radius):
    """Two views of a ball in a room: of one depth image, of several that are fused, or of a scanner on a tripod."""
    views, scanner = [], rng.random() < 0.15
    eye = standpoint(size, rng)
    for _ in range(2):
        if scanner:
            eye = standpoint(size, rng)
            rays = toward_ball(eye, center, radius, rng.integers(3000, 15000), rng)
            view = View(np.broadcast_to(eye, rays.shape), rays, rng.uniform(0.001, 0.006))
            views.append(seen(world, view, center, radius, rng))
            continue
        images, at = [], eye
        quadratic = rng.uniform(0.0008, 0.004)
        for _ in range(1 if rng.random() < 0.45 else rng.integers(2, 7)):
            rays, _ = depth_camera(at, center + rng.normal(size=3) * 0.4, rng)
            view = View(np.broadcast_to(at, rays.shape), rays, 0.001, quadratic, 4.5, 0.4)
            points, clean = seen(world, view, center, radius, rng)
            left = holes(points, at, rng)
            images.append(np.stack([points[left], clean[left]]))
            at = at + rng.normal(size=3) * (0.3, 0.3, 0.1)
        points, clean = np.concatenate(images, axis=1)
        views.append(fused(points, clean, rng.uniform(0.008, 0.025)) if len(points) else np.stack([points, clean]))
        eye = eye + rng.normal(size=3) * rng.choice([0.25, 0.8]) * (1, 1, 0.25)
    return views


def street_views(world, half, rng, center, radius, eye):
    """Two views of a ball in a street: sweeps of one kind of LiDAR, scans from tripods, or flights over it."""
    kind = rng.choice(["sweep", "tripod", "air"], p=[0.75, 0.1, 0.15])
    views, beams = [], rng.choice([16, 32, 64, 64, 64, 128])
    for number in range(2):
        moved = world
        if number:
            eye = eye + (rng.uniform(-12, 12), rng.normal() * 0.7, rng.normal() * 0.05)
            moved = world.later(rng.uniform(-6, 6))
        if kind == "sweep":
            rays = spinning_lidar(rng, beams) @ upright(rng).T
            view = View(np.broadcast_to(eye, rays.shape), rays, rng.uniform(0.005, 0.03), 0, 100, 1.5)
        elif kind == "tripod":
            rays = toward_ball(eye, center, radius, rng.integers(2000, 12000), rng)
            view = View(np.broadcast_to(eye, rays.shape), rays, rng.uniform(0.002, 0.01))
        else:
            tilt = np.array([rng.normal() * 0.3, rng.normal() * 0.3, -1])
            rays = tilt + rng.normal(size=(rng.integers(1500, 10000), 3)) * 0.02
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            below = center + rng.uniform(-1, 1, rays.shape) * radius
            view = View(below - rays * 60, rays, rng.uniform(0.01, 0.05))
        views.append(seen(moved, view, center, radius, rng))
    return views


def smooth(grid, sigma):
    """Gaussian of `sigma` cells over each channel of (C, X, X, X); a product with a matrix an axis, the fastest here."""
    at = torch.arange(grid.shape[-1], dtype=torch.float32)
    kernel = torch.exp(-0.5 * ((at[:, None] - at) / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
    for _ in range(3):
        grid = (grid @ kernel).permute(0, 3, 1, 2).contiguous()
    return grid


@torch.no_grad()
def corner_response(surface, radius, width=1.1, window=2.0):
    """How much of a corner each cell is: (response, mass), both (X, Y, Z), of a surface (M, 3) in voxels about 0.

    The surface's mass is smoothed with `width` voxels. Where its gradients within `window` voxels point in all three
    directions there is a corner, the end of a pole or of an edge (Foerstner and Harris in 3-D): the response is the
    least eigenvalue of their mean outer product, which is zero on planes and along edges, times what draws its peaks from
    a corner's inside onto its surface. The mass is 1 on a plane.
    """
    side = 2 * int(np.ceil(radius / CELL)) + 1
    at = torch.from_numpy(((surface + radius) / CELL).round().astype(np.int64))
    at = at[((at >= 0) & (at < side)).all(dim=1)]
    mass = torch.zeros(side**3).index_add(0, (at[:, 0] * side + at[:, 1]) * side + at[:, 2], torch.ones(len(at)))
    scale = np.sqrt(2 * np.pi) * width / (DENSITY * CELL**3)  # of a smoothed plane
    density = smooth(mass.reshape(1, side, side, side), width / CELL)[0] * scale
    x, y, z = (torch.gradient(density, spacing=CELL, dim=axis)[0] for axis in range(3))
    xx, yy, zz, xy, xz, yz = smooth(torch.stack([x * x, y * y, z * z, x * y, x * z, y * z]), window / CELL)
    # The least eigenvalue in closed form (Smith 1961).
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = ((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6).sqrt().clamp(min=1e-9)
    half = (a * b * c + 2 * xy * xz * yz - a * yz * yz - b * xz * xz - c * xy * xy) / (2 * spread**3)
    angle = torch.acos(half.clamp(-1, 1)) / 3 + 2 * np.pi / 3
    away = distance_transform_edt((mass == 0).reshape(density.shape).numpy()) * CELL
    near = torch.from_numpy(np.exp(-0.5 * (away / 0.8) ** 2).astype(np.float32))
    return (mean + 2 * spread * torch.cos(angle)) * near, density


def levels(response):
    """Responses as levels: 0 for what counts as none, 1 for a strong corner, in between by their logarithm."""
    return (torch.log(response.clamp(min=1e-9) / EDGE) / np.log(CORNER / EDGE)).clamp(0, 1.3)


def read(grid, queries, radius):
    """Trilinear values (Q,) of a grid (X, Y, Z) at queries (Q, 3) in voxels about 0."""
    span = (np.array(grid.shape) - 1) / 2 * CELL
    at = torch.from_numpy((queries + radius - span) / span).float()[None, None, None]
    return F.grid_sample(grid[None, None].transpose(2, 4), at, align_corners=True)[0, 0, 0, 0].numpy()


def make_crop(rng):
    """The crops of a made world as arrays, where the sensors see enough; at most four."""
    indoors = rng.random() < 0.5
    world, extent = room(rng) if indoors else street(rng)
    voxel = np.exp(rng.uniform(*np.log((0.03, 0.08) if indoors else (0.15, 0.4))))
    eye = standpoint(extent, rng) if indoors else np.array([rng.uniform(-30, 30), rng.uniform(-0.6, 0.6) * extent, 1.8])
    rays = rng.normal(size=(400, 3)) * (1, 1, 0.6 if indoors else 0.15)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    reach, which, _ = world.cast(np.broadcast_to(eye, rays.shape), rays)
    big = np.array([np.linalg.norm(axes, axis=0).max() for _, _, axes, _, _ in world.rows]) > (2 if indoors else 50)
    usable = np.flatnonzero(
        (reach > 4 * voxel) & (reach < (4 if indoors else 45)) & ~(big[which] & (rng.random(400) < 0.8))
    )
    crops = []
    for row in rng.permutation(usable)[:4]:
        center = eye + rays[row] * reach[row] + rng.normal(size=3) * 4 * voxel
        radius = POINTS_RADIUS * voxel
        views = (
            room_views(world, extent, rng, center, radius)
            if indoors
            else street_views(world, extent, rng, center, radius, eye)
        )
        views = [(view - center) / voxel for view in views]
        near = [int((np.linalg.norm(points, axis=1) < 14).sum()) for points, _ in views]
        if min(near) < 60:
            continue
        crop = crop_of(world, center, voxel, views, rng)
        if crop:
            crops.append(crop)
    return crops


def crop_of(world, center, voxel, views, rng):
    """The stored arrays of a crop: of views (2, 2, M, 3), with and without noise, in voxels about its center."""
    radius = QUERY_RADIUS + 4
    still = type(world)(row for row in world.rows if row[3] == 0 and not row[4]).about(center, (radius + 1) * voxel)
    surface = (still.surface(center, radius * 1.2 * voxel, DENSITY / voxel**2, rng) - center) / voxel
    if len(surface) < 1000:
        return None
    response, density = corner_response(surface, radius)
    target = levels(response)
    cells = [occupied(clean[~np.isnan(clean[:, 0])]) for _, clean in views]
    common = np.intersect1d(*cells)
    if len(common) < 30:
        return None
    inner = surface[np.linalg.norm(surface, axis=1) < QUERY_RADIUS]
    inner = inner[np.isin(numbers(inner), common)]
    if len(inner) < 100:
        return None
    number = 4 * QUERIES
    spread = rng.choice([0.3, 0.7, 1.5], (number, 1), p=[0.6, 0.3, 0.1])
    queries = inner[rng.integers(len(inner), size=number)] + spread * rng.standard_normal((number, 3))
    values = read(target, queries, radius)
    order = values.argsort()
    best = order[-number // 6 :]
    chosen = np.concatenate(
        [rng.choice(best, QUERIES * 2 // 5, replace=False), rng.choice(number, QUERIES * 3 // 5, replace=False)]
    )
    shown = [points[rng.permutation(len(points))[:POINTS]] for points, _ in views]
    solid = [clean[~np.isnan(clean[:, 0])] for _, clean in views]
    solid = [clean[np.linalg.norm(clean, axis=1) < QUERY_RADIUS] for clean in solid]
    free = rng.uniform(-QUERY_RADIUS, QUERY_RADIUS, (3000, 3))
    free = free[(read(density, free, radius) < 0.05) & (np.linalg.norm(free, axis=1) < QUERY_RADIUS)][:800]
    beside = inner[rng.integers(len(inner), size=3000)] + rng.normal(size=(3000, 3)) * 2
    beside = beside[read(density, beside, radius) < 0.25][:600]
    return {
        "surface": surface[rng.permutation(len(surface))[:SURFACE]], "points_0": shown[0], "points_1": shown[1], "queries": queries[chosen], "target": values[chosen].astype(np.float16),
        "solid_0": solid[0][rng.permutation(len(solid[0]))[:1000]], "solid_1": solid[1][rng.permutation(len(solid[1]))[:1000]],
        "free": np.concatenate([free, beside]),
    }  # fmt: skip


def numbers(points, side=2.0):
    """The number of the cell that each point (N, 3), in voxels, lies in."""
    x, y, z = np.floor(points / side).astype(int).T + 64
    return (x * 128 + y) * 128 + z


def occupied(points, side=2.0):
    """The numbers of the cells with points or beside them."""
    step = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 1, 3)
    return np.unique(numbers((points + step * side).reshape(-1, 3))) if len(points) else np.empty(0, int)


def write_part(path, seed, number=25):
    """`number` crops of one seed in a file, their arrays end to end; positions as int16."""
    rng, crops = np.random.default_rng([seed, 0xC409]), []
    while len(crops) < number:
        crops += make_crop(rng)
    stored = {}
    for name in crops[0]:
        arrays = [crop[name] for crop in crops[:number]]
        stored[f"{name}_ends"] = np.cumsum([len(a) for a in arrays])
        whole = np.concatenate(arrays)
        stored[name] = whole if name == "target" else (whole / QUANTUM).round().clip(-32767, 32767).astype(np.int16)
    partial = Path(f"{path}.partial.npz")
    np.savez(partial, **stored)
    partial.replace(path)


def write_crops(folder, number=3000, seed=1):
    """Files of 25 crops, the first of `seed`, the others of the seeds after it. Files that are there stay."""
    torch.set_num_threads(1)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for part in range(seed, seed - (-number // 25)):
        if not (path := folder / f"{part:05d}.npz").exists():
            write_part(path, part)


class Crops:
    """The crops of a folder; `crops[i]` is a dictionary of float32 arrays."""

    def __init__(self, folder):
        self.folder, self.parts, self.rows = Path(folder), {}, []
        self.refresh()
        if not self.rows:
            raise ValueError(f"{folder}: no crops; python -m snake_training.make crops -o {folder} writes them")

    def refresh(self):
        """Takes up files that were written since."""
        for path in sorted(self.folder.glob("*.npz")):
            if path.name not in self.parts and ".partial" not in path.name:
                with np.load(path) as file:
                    self.parts[path.name] = dict(file)
                number = len(self.parts[path.name]["target_ends"])
                self.rows += [(path.name, row) for row in range(number)]

    def __len__(self):
        return len(self.rows)

    def __getitem__(self, index):
        name, row = self.rows[index]
        part, crop = self.parts[name], {}
        for key in (key for key in part if not key.endswith("_ends")):
            ends = part[f"{key}_ends"]
            values = part[key][ends[row - 1] if row else 0 : ends[row]].astype(np.float32)
            crop[key] = values if key == "target" else values * np.float32(QUANTUM)
        return crop
