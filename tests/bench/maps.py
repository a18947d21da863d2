"""Scans of rooms in a map of 20 rooms: how many are found, and the time beside the pair of scan and room.

    python tests/bench/maps.py FOLDER [--seeds 7,8,9]

A map is made of 20 fragments that no published pair links, 6 m apart. The scans are other fragments, of which one of the 20 sees at
least 0.5, and none of the others 0.1.
"""

import argparse
import os
import random
import time
from pathlib import Path

import numpy as np
import scene_pairs

ROOMS, APART, VOXEL = 20, 6.0, 0.05
MIN_OVERLAP, MAX_OTHER, SCANS_PER_ROOM = 0.5, 0.1, 4


def floor_plan(pairs: list[scene_pairs.Pair], seed: int) -> tuple[list[Path], list[scene_pairs.Pair]]:
    """The rooms of a map, of all scenes by turns, and the pairs of a scan and its room."""
    rng = random.Random(seed)
    overlaps: dict[Path, dict[Path, float]] = {}
    for pair in pairs:
        for a, b in ((pair.source, pair.target), (pair.target, pair.source)):
            overlaps.setdefault(a, {})[b] = max(pair.overlap, overlaps.get(a, {}).get(b, 0.0))
    seen = {pair.target for pair in pairs if pair.overlap >= MIN_OVERLAP}
    by_scene: dict[str, list[Path]] = {}
    for path in sorted(overlaps):
        by_scene.setdefault(path.stem.split("__")[0], []).append(path)
    for paths in by_scene.values():
        rng.shuffle(paths)
    rooms: list[Path] = []
    while len(rooms) < ROOMS and any(by_scene.values()):
        for paths in by_scene.values():
            while paths:
                path = paths.pop(0)
                if path in seen and not any(room in overlaps[path] for room in rooms):
                    rooms.append(path)
                    break
    rooms = rooms[:ROOMS]
    scans: dict[Path, scene_pairs.Pair] = {}
    rng.shuffle(pairs)
    for pair in pairs:
        others = [overlaps[pair.source].get(room, 0.0) for room in rooms if room != pair.target]
        is_scan = pair.target in rooms and pair.source not in rooms and pair.overlap >= MIN_OVERLAP
        count = sum(scan.target == pair.target for scan in scans.values())
        if is_scan and max(others) < MAX_OTHER and count < SCANS_PER_ROOM:
            scans.setdefault(pair.source, pair)
    return rooms, list(scans.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, help="folder with train/ and val/")
    parser.add_argument("--seeds", default="7,8,9", help="a map for each (default: %(default)s)")
    arguments = parser.parse_args()
    os.environ["SNAKE_THREADS"] = "1"
    import snake_rs

    for seed in map(int, arguments.seeds.split(",")):
        pairs = [pair for split in ("train", "val") for pair in scene_pairs.overlapping(arguments.scenes, split)]
        # Two names of one kitchen, and tables without a room, would make the answer ambiguous.
        pairs = [pair for pair in pairs if not any(name in pair.name for name in ("1cm", "tabletop"))]
        rooms, scans = floor_plan(pairs, seed)
        clouds, shifts = [np.load(room) for room in rooms], {}
        for number, (room, cloud) in enumerate(zip(rooms, clouds, strict=True)):
            shifts[room] = np.array([number % 5 * APART, number // 5 * APART, 0.0]) - cloud.mean(axis=0)
        points = np.concatenate([cloud + shifts[room] for room, cloud in zip(rooms, clouds, strict=True)])
        prepared = snake_rs.PreparedMap(points, voxel_size=VOXEL)
        counts, seconds = np.zeros(4, int), np.zeros(2)
        for number, scan in enumerate(scans):
            source, target = scan.clouds()
            started = time.perf_counter()
            in_map = prepared.register(source)
            queried = time.perf_counter()
            in_room = snake_rs.register(source, target, voxel_size=VOXEL, use_viewpoints=False)
            # The first query also makes the descriptors of the map.
            if number > 0:
                seconds += queried - started, time.perf_counter() - queried
            t_room_source = in_map.t_target_source.copy()
            t_room_source[:3, 3] -= shifts[scan.target]
            is_right = scene_pairs.is_right(t_room_source, scan.t_target_source)
            is_reliable = in_map.verdict.is_reliable
            alone = scene_pairs.is_right(in_room.t_target_source, scan.t_target_source)
            counts += is_right, is_right and is_reliable, is_reliable and not is_right, alone
        right, reliable, wrong, alone = counts
        print(
            f"seed {seed}: {len(rooms)} rooms, {len(scans)} scans: {right} right, {reliable} of them reliable, {wrong} wrong and "
            f"reliable; {alone} right in their room alone; a query takes {seconds[0] / seconds[1]:.2f} times as long"
        )


if __name__ == "__main__":
    main()
