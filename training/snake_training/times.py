"""Seconds and memory of detection beside ISS (SNAKE table 14 and its appendix on memory):

    python -m snake_training.times data/modelnet40/modelnet40-test_rotated_numpy/original --model modelnet40.safetensors

Of each number of points and of refinement steps J, the median seconds of a cloud, from its points to its keypoints, by
`snake-cli detect` (the program in SNAKE_CLI, where that is set), and the most memory that the program had (on Linux and macOS). ISS
is that of snake_rs, with its default options, on as many points.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from .arguments import DATA, MODEL, option, parser_of
from .augment import choose
from .data import open_shapes

CHILD = """
import json, resource, subprocess, sys
done = subprocess.run(sys.argv[1:], check=True, capture_output=True, text=True)
memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
print(json.dumps([done.stdout, memory]))
"""


def measured(words):
    """The output of a command, and its largest resident memory in MiB.

    A small process starts it: its children's memory is that of the largest one, and on Linux a child that a large process
    starts begins with that one's peak.
    """
    done = subprocess.run(
        [sys.executable, "-c", CHILD, *map(str, words)], check=True, stdout=subprocess.PIPE, text=True
    )
    output, memory = json.loads(done.stdout)
    return output, memory / 2**20


def detect(files, model, steps, threads):
    """Median seconds a cloud and the most memory in MiB of `snake-cli detect` on files of points."""
    command = [os.environ.get("SNAKE_CLI", "snake-cli"), "detect", *files, "--model", model, "--json"]
    command += ["--set", f"refine_steps={steps}", *(["--threads", threads] if threads else [])]
    lines, memory = measured(command)
    stages = [json.loads(line)["timing_seconds"] for line in lines.splitlines()]
    return np.median([sum(row[name] for name in ("encode", "occupancy", "refine", "nms")) for row in stages]), memory


def iss(clouds):
    """Median seconds a cloud of ISS."""
    import snake_rs  # the only use

    def seconds(points):
        start = time.perf_counter()
        snake_rs.baselines.iss(points)
        return time.perf_counter() - start

    return np.median([seconds(points) for points in clouds])


def measure(shapes, model, points, steps, threads, folder):
    """Rows (number of points, method, seconds, MiB or None); `folder` is for files of points."""
    rows = []
    for number in points:
        clouds = [choose(np.random.default_rng(i), shape, number) for i, shape in enumerate(shapes)]
        files = [folder / f"{number}-{i}.npy" for i in range(len(clouds))]
        for file, cloud in zip(files, clouds, strict=True):
            np.save(file, cloud.astype(np.float32))
        rows.append((number, "ISS", iss(clouds), None))
        rows += [(number, f"SNAKE, J = {j}", *detect(files, model, j, threads)) for j in steps]
    return rows


def main(argv=None):
    """Command line."""
    arguments = {
        "--points": option([2048, 4096], "numbers of points", int, nargs="+"),
        "--steps": option([0, 5, 10], "refinement steps J", int, nargs="+"),
        "--limit": option(10, "clouds at most"),
        "--threads": dict(type=int, help="of snake-cli; all by default"),
    }
    parser = parser_of("times", __doc__, DATA | MODEL | arguments)
    given = parser.parse_args(argv)
    try:
        shapes = open_shapes(given.data)
        shapes = [shapes[row] for row in range(min(given.limit, len(shapes)))]
        with TemporaryDirectory() as folder:
            rows = measure(shapes, given.model, given.points, given.steps, given.threads, Path(folder))
    except (OSError, ValueError, ImportError, subprocess.CalledProcessError) as error:
        parser.error(str(error))
    print("| points | method | seconds | memory, MiB |\n|---|---|---|---|")
    for number, name, seconds, memory in rows:
        print(f"| {number} | {name} | {seconds:.3f} | {'–' if memory is None else f'{memory:.0f}'} |")


if __name__ == "__main__":
    main()
