"""How far the sensors that are found in made clouds are from the true ones, and whether clouds of no or several sensors have one.

    python tests/bench/sensors.py target/release/snake-cli [--seeds 0 8]

Worlds and sensors are those of training. A cloud is in the coordinates of a site: turned by any angle, its sensor metres from the origin.
"""

import argparse
import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from made_pairs import SIZE, camera, clear, furnished, lidar, pose, yaw

from snake_training.data import sensors
from snake_training.data.solids import Solids, scan
from snake_training.data.worlds import room, street

NEAR = 0.2  # metres


def free_place(world: Solids, place) -> np.ndarray:
    """A place that is in no solid; `place` draws one."""
    while world.inside((at := place())[None], -0.25).any():
        pass
    return at


def clouds(rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, np.ndarray | None]]:
    """Kinds, clouds (N, 3) and the places (3,) of their sensors, None for those that have no single one."""
    world = furnished(rng)
    eyes = [clear(world, rng) for _ in range(2)]
    scans = []
    for rays in (lidar(96, 400, -60, 60), lidar(96, 240, -85, 85)):
        scans.append([scan(world, pose(eye), rays, 0.004, 30.0, rng) + eye for eye in eyes])
        yield f"scanner in a room, {len(scans)}", scans[-1][0], eyes[0]
    yield "two scans of a room", np.concatenate(scans[0]), None
    yield "two scans in voxels", sensors.fused(*[np.concatenate(scans[0])] * 2, 0.05)[0], None
    look = pose(eyes[0], np.degrees(np.arctan2(*(np.array(SIZE) / 2 - eyes[0])[1::-1])))
    yield "camera in a room", scan(world, look, camera(), 0.003, 9.0, rng) @ look[:3, :3].T + eyes[0], eyes[0]
    world, size = room(rng)
    eye = free_place(world, lambda: sensors.standpoint(size, rng))
    yield "tripod in a room", sensors.tripod_scan(world, eye, 15.0, rng), eye
    world, half = street(rng)
    eye = free_place(world, lambda: np.array([rng.uniform(-30, 30), rng.normal() * half / 3, rng.uniform(1.5, 2.0)]))
    yield "tripod in a street", sensors.tripod_scan(world, eye, 100.0, rng), eye
    rays = sensors.spinning_lidar(rng) @ sensors.upright(rng).T
    view = sensors.View(np.broadcast_to(eye, rays.shape), rays, 0.02, 0, 100, 1.5)
    yield "sweep in a street", sensors.whole_view(world, view, rng), eye
    faces = rng.uniform(-0.5, 0.5, (20000, 3))
    faces[np.arange(20000), np.arange(20000) % 3] = rng.choice([-0.5, 0.5], 20000)
    yield "box, sampled evenly", faces * rng.uniform(0.5, 3, 3), None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--seeds", type=int, nargs=2, default=[0, 8], help="first seed, and the one after the last")
    arguments = parser.parse_args()
    rows: dict[str, list[float | None]] = {}
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "cloud.npy")
        for seed in range(*arguments.seeds):
            rng = np.random.default_rng([seed, 0x5E25])
            for kind, points, eye in clouds(rng):
                turn, shift = yaw(rng.uniform(0, 360)), rng.uniform(-20, 20, 3)
                np.save(file, points @ turn.T + shift)
                command = [arguments.program, "register", file, file, "--json", "--threads", "1"]
                found = subprocess.run(command, capture_output=True, text=True)
                place = json.loads(found.stdout)["clouds"][0]["position"] if found.stdout else None
                truth = np.zeros(3) if eye is None else turn @ eye + shift
                off = float(np.linalg.norm(place - truth)) if place else None
                rows.setdefault(f"{kind}{'' if eye is None else ' *'}", []).append(off)
    print(f"| kind (* has one sensor) | clouds | found | within {NEAR} m | farthest |\n|---|---|---|---|---|")
    for kind, offs in rows.items():
        near = [off for off in offs if off is not None]
        count = sum(off < NEAR for off in near)
        print(f"| {kind} | {len(offs)} | {len(near)} | {count} | {max(near, default=0.0):.2f} |")


if __name__ == "__main__":
    main()
