"""Writes a made city as COPC by copclib: python generate.py FILE.copc.laz LOTS POINTS_PER_LOT; city.copc.laz has 2 and 3000.

Streets, houses with windows in their facades, and trees stand on LOTS by LOTS lots of 20 by 20 m, in UTM 32N.
"""

import sys

import copclib
import numpy as np

LOT = 20.0
PLACE = np.array([691_000, 5_336_000, 512])
POINTS_OF_NODE = 1000
RECORD = np.dtype([("at", "<i4", 3), ("intensity", "<u2"), ("returns", "u1"), ("rest", "u1", 15)])
WKT = 'PROJCS["ETRS89 / UTM zone 32N",UNIT["metre",1],AUTHORITY["EPSG","25832"]]'


def lot(rng, number):
    """Points (N, 3) of a lot in metres, spread by area."""
    height = 3.0 * rng.integers(2, 6)
    roof, facades, tree = (rng.random((number, 3)) for _ in range(3))
    roof = [4, 4, height] + roof * [12, 12, 0]
    roof[np.any((roof[:, :2] < 4.3) | (roof[:, :2] > 15.7), axis=1), 2] += 0.5
    along, z, side = (facades * [12, height, 4]).T
    depth = np.where((abs(along % 3 - 1.5) < 0.6) & (abs(z % 3 - 1.7) < 0.7), 0.2, 0.0)
    across = np.where(side < 2, 4 + depth, 16 - depth)
    is_north = side.astype(int) % 2 == 0
    facades = np.column_stack([np.where(is_north, 4 + along, across), np.where(is_north, across, 4 + along), z])
    angle, up, is_trunk = tree[:, 0] * 2 * np.pi, 2 * tree[:, 1] - 1, tree[:, 2] < 0.1
    radius = np.where(is_trunk, 0.15, 1.5 * np.sqrt(1 - up**2))
    z = np.where(is_trunk, 1.25 * (up + 1), 3.5 + 1.5 * up)
    tree = np.column_stack([2 + radius * np.cos(angle), 2 + radius * np.sin(angle), z])
    ground = np.column_stack([rng.uniform(0, LOT, (number, 2)), np.zeros(number)])
    ground[np.all(abs(ground[:, :2] - LOT / 2) < 9, axis=1), 2] = 0.15
    area = np.array([144, 48 * height, 30, 256])
    chosen = rng.choice(4, number, p=area / area.sum())
    return np.stack([roof, facades, tree, ground])[chosen, np.arange(number)]


def main(path, lots, number):
    rng = np.random.default_rng(0)
    corners = [[x * LOT, y * LOT, 0] for y in range(lots) for x in range(lots)]
    points = np.concatenate([lot(rng, number) + corner for corner in corners]).round(3)
    config = copclib.CopcConfigWriter(6, [0.001] * 3, PLACE.tolist(), WKT)
    half = lots * LOT / 2
    config.las_header.min, config.las_header.max = (list(bound(points, axis=0) + PLACE) for bound in (np.min, np.max))
    config.copc_info.center_x, config.copc_info.center_y, config.copc_info.center_z = PLACE + half
    config.copc_info.halfsize, config.copc_info.spacing = half, 1.0
    writer = copclib.FileWriter(path, config)
    records = np.zeros(len(points), RECORD)
    records["at"], records["returns"] = np.round(points * 1000), 0x11
    open_nodes = [((0, 0, 0, 0), rng.permutation(records))]
    for (level, *key), own in open_nodes:  # Its children follow.
        writer.AddNode(
            copclib.VoxelKey(level, *key), copclib.VectorChar(np.frombuffer(own[:POINTS_OF_NODE].tobytes(), np.int8))
        )
        rest = own[POINTS_OF_NODE:]
        child = np.minimum(rest["at"] * 2 ** (level + 1) // int(2000 * half), 2 ** (level + 1) - 1)
        for place in np.unique(child, axis=0):
            open_nodes.append(((level + 1, *place.tolist()), rest[np.all(child == place, axis=1)]))
    writer.Close()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
