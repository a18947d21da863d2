"""Runs methods on pairs of clouds and keeps the results in a file, so that an interrupted run continues."""

import hashlib
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import snake_rs

OURS = "snake-rs"
PEERS = [f"{name}/{size}" for size in (0.03, 0.05, 0.08) for name in ("kiss", "ransac", "fgr")] + [
    "ransac/0.05/oriented",
    "fgr/0.05/oriented",
]


class Task(NamedTuple):
    """A pair of clouds under a name that is unique in the file of results; `clouds` gives source and target (N, 3)."""

    name: str
    clouds: Callable[[], tuple[np.ndarray, np.ndarray]]


def build() -> str:
    """Identifies the build of the module: results of another build are not used."""
    return hashlib.sha256(Path(snake_rs._core.__file__).read_bytes()).hexdigest()[:12]


def run_ours(source: np.ndarray, target: np.ndarray) -> dict:
    """Our transform with what the verdict follows from; no transform counts as the identity."""
    start = time.perf_counter()
    try:
        found = snake_rs.register(source, target)
    except ValueError:
        return {"refined": np.eye(4).tolist(), "score": 0.0, "seconds": time.perf_counter() - start}
    seconds = time.perf_counter() - start
    verdict, fit, matches = found.verdict, found.fit, found.matches
    names = ("slide_margin", "free_space_violation", "is_ambiguous", "weakest_constraint", "repeat_fit")
    evidence = {name: getattr(verdict, name) for name in names}
    evidence |= {name: getattr(matches, name) for name in ("num_agreeing", "num_rival_agreeing")}
    evidence |= {"fitness": fit.fitness, "match_spread": matches.spread / fit.inlier_distance}
    transform = found.t_target_source.tolist()
    return {"refined": transform, "score": verdict.confidence, "seconds": seconds, "evidence": evidence}


def run(method: str, source: np.ndarray, target: np.ndarray) -> dict:
    if method == OURS:
        return run_ours(source, target)
    import registration_peers

    return registration_peers.run(method, source, target)


def load(cache: Path) -> dict[tuple[str, str], dict]:
    """The stored results by (pair, method). The line at which a run was killed is left out, and our other builds."""
    found, this_build = {}, build()
    for line in cache.read_text().splitlines() if cache.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if row["method"] != OURS or row.get("build") == this_build:
            found[row["pair"], row["method"]] = row
    return found


def results(label: str, tasks: Iterable[Task], methods: list[str], cache: Path) -> dict[tuple[str, str], dict]:
    """The results of all methods on all pairs by (pair, method). Methods alternate pair by pair; those that are stored do
    not run again."""
    found = load(cache)
    missing = [(task, method) for task in tasks for method in methods if (task.name, method) not in found]
    cache.parent.mkdir(parents=True, exist_ok=True)
    with cache.open("a") as out:
        if out.tell() > 0:
            out.write("\n")
        current, clouds = None, None
        for task, method in tqdm(missing, label, mininterval=1):
            if task is not current:
                current, clouds = task, task.clouds()
            row = {"pair": task.name, "method": method, **run(method, *clouds)}
            if method == OURS:
                row["build"] = build()
            out.write(json.dumps(row) + "\n")
            out.flush()
            found[task.name, method] = row
    return found
