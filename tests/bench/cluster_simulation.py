"""Simulates `keypoints_of_tiles` on N nodes from the points of the tiles of a cloud.

python tests/bench/cluster_simulation.py FOLDER.tiles --area 10000 --overhead 0.012 [--nodes 1 .. 1000] [--square-km 1]

The folder is that of `snake_rs.tiles`. A tile takes `--seconds` a million points on a node, which is one core. As in Ray, a node that
is idle takes the next tile, and the driver hands out one tile after another, `--overhead` seconds each. The second pass takes
`--second` of the time of the first, and the driver sorts the table at the end, `--sort` seconds a square kilometre.
"""

import argparse
import heapq
import json
from pathlib import Path

import numpy as np


def points_of_tiles(folder: Path) -> np.ndarray:
    """The millions of points of each tile."""
    plan = json.loads((folder / "plan.json").read_text().splitlines()[0])  # the second line is a checksum
    return np.array([tile["num_points"] / 1e6 for tile in plan["tiles"]])


def makespan(times: np.ndarray, nodes: int, overhead: float) -> float:
    """The seconds until all tiles are done."""
    free = [0.0] * nodes
    for index, time in enumerate(times):
        begin = max(heapq.heappop(free), index * overhead)
        heapq.heappush(free, begin + overhead + time)
    return max(free)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--nodes", type=int, nargs="+", default=[1, 2, 5, 10, 20, 50, 100, 200, 500, 1000])
    parser.add_argument("--area", type=float, required=True, help="square metres of the cloud")
    parser.add_argument("--seconds", type=float, required=True, help="seconds of a core a million points")
    parser.add_argument("--square-km", type=float, default=1.0)
    parser.add_argument("--overhead", type=float, required=True, help="seconds a task")
    parser.add_argument("--second", type=float, default=0.16, help="time of the second pass, as a part of the first")
    parser.add_argument("--sort", type=float, default=40.0, help="seconds of the driver at the end, a square kilometre")
    given = parser.parse_args()
    known = given.seconds * points_of_tiles(given.folder)
    number = round(given.square_km * 1e6 / given.area * len(known))
    times = np.random.default_rng(0).choice(known, number)
    print(f"{len(known)} tiles of {known.min():.0f} to {known.max():.0f} s; {number} simulated tiles")
    print("| nodes | hours | speed-up | efficiency |\n|---:|---:|---:|---:|")
    alone = None
    for nodes in given.nodes:
        seconds = makespan(times, nodes, given.overhead) + makespan(given.second * times, nodes, given.overhead)
        seconds += given.sort * given.square_km
        alone = alone or seconds * nodes
        speed_up = alone / seconds
        print(f"| {nodes} | {seconds / 3600:.3g} | {speed_up:.4g} | {speed_up / nodes:.0%} |")


if __name__ == "__main__":
    main()
