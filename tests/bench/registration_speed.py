"""Seconds a pair on a number of cores. `registration.py` starts it once for each number.

python tests/bench/registration_speed.py FOLDER --cores 2 --methods snake-rs kiss/0.05
"""

import argparse
import os
from pathlib import Path


def name(pair: str, cores: int) -> str:
    """The name of a pair in the file of results: timings have rows of their own."""
    return f"{pair} on {cores}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--cores", type=int, required=True)
    parser.add_argument("--pairs", type=int, required=True)
    parser.add_argument("--methods", nargs="+", required=True)
    parser.add_argument("--cache", type=Path, required=True)
    arguments = parser.parse_args()
    # Before the libraries start their threads: each counts the cores that it may use.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: arguments.cores])
    os.environ["OMP_NUM_THREADS"] = str(arguments.cores)

    import registration_runs as runs
    import scene_pairs

    chosen = scene_pairs.subset(scene_pairs.overlapping(arguments.scenes, "val"), arguments.pairs)
    tasks = [runs.Task(name(pair.name, arguments.cores), pair.clouds) for pair in chosen]
    runs.run(arguments.methods[0], *tasks[0].clouds())  # The first call loads the model and starts threads.
    runs.results(f"speed on {arguments.cores}", tasks, arguments.methods, arguments.cache)


if __name__ == "__main__":
    main()
