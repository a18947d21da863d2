"""Whole detection, snake-rs against PyTorch with the volume computed once: `python -m snake_training.benchmark`.

The paper's 64^3 network with seeded random weights (speed does not depend on their values) whose occupancy bias is set
so that as many grid queries are occupied as on a typical object.
"""

import argparse
import json
import os
import platform
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from .augment import normalize
from .data import Procedural
from .evaluate import DetectOptions, query_grid, refine, select
from .export import write_weights
from .model import NetworkConfig, SnakeNetwork

STAGES = ("encode", "occupancy", "refine", "total")


def seeded_network(config, points, occupied, seed=0):
    """A random network that finds `occupied` of the 64^3 grid queries of the cloud occupied."""
    torch.manual_seed(seed)
    network = SnakeNetwork(config).eval()
    for name, parameter in network.named_parameters():
        if name.endswith("fc_1.weight"):  # zero in a fresh network
            torch.nn.init.normal_(parameter, std=0.1)
    with torch.no_grad():
        volume = network.encode(torch.from_numpy(normalize(points)[0])[None])
        queries = query_grid(config, 64, "cpu")
        logits = torch.cat([network.occupancy(volume, q[None])[0].logit() for q in queries.split(1 << 15)])
        network.decoder_occup.fc_out.bias -= logits.sort().values[-occupied]
    return network


def run_torch(network, points, options):
    """Seconds of each stage of the plain PyTorch detection."""
    start = time.perf_counter()
    unit, center, scale = normalize(points, options.normalization)
    with torch.no_grad():
        volume = network.encode(torch.from_numpy(unit)[None])
        encoded = time.perf_counter()
        queries = query_grid(network.config, options.query_resolution, "cpu")
        occupancy = torch.cat([network.occupancy(volume, chunk[None])[0] for chunk in queries.split(1 << 15)])
        queries = queries[occupancy > options.occupancy_threshold]
    filtered = time.perf_counter()
    position, score = refine(network, volume, queries, options)
    refined = time.perf_counter()
    select(position * float(scale) + torch.from_numpy(center), score, options)
    return encoded - start, filtered - encoded, refined - filtered, time.perf_counter() - start


def run_snake_rs(model, points, options):
    """Seconds of each stage of snake-rs."""
    start = time.perf_counter()
    field = model.encode(points, normalization=options.normalization)
    encoded = time.perf_counter()
    shared = {k: v for k, v in vars(options).items() if k != "normalization"}
    timing = field.detect(**shared).timing_seconds
    return encoded - start, timing["occupancy"], timing["refine"], time.perf_counter() - start


def main(argv=None):
    """Prints medians of alternating runs and their ratios, as text and JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.benchmark",
        description=__doc__,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads of both")
    parser.add_argument("--runs", type=int, default=5, help="counted runs of each, after one that is not")
    parser.add_argument("--num-points", type=int, default=4096)
    parser.add_argument("--occupied", type=int, default=12000, help="occupied grid queries")
    parser.add_argument("--json", action="store_true", help="print JSON only")
    arguments = parser.parse_args(argv)
    os.environ["RAYON_NUM_THREADS"] = str(arguments.threads)
    import snake_rs  # after the environment: its threads start with the first use

    torch.set_num_threads(arguments.threads)
    points = Procedural(points=arguments.num_points)[0]
    options = DetectOptions()
    network = seeded_network(NetworkConfig(), points, arguments.occupied)
    with tempfile.TemporaryDirectory() as folder:
        write_weights(Path(folder) / "network.safetensors", network.config, network.state_dict())
        model = snake_rs.Model.load(Path(folder) / "network.safetensors")
    peers = {
        "PyTorch": lambda: run_torch(network, points, options),
        "snake-rs": lambda: run_snake_rs(model, points, options),
    }
    seconds = {name: [] for name in peers}
    for _ in range(arguments.runs + 1):
        for name, run in peers.items():
            seconds[name].append(run())
    medians = {name: dict(zip(STAGES, np.median(rows[1:], axis=0).tolist())) for name, rows in seconds.items()}
    report = {
        "machine": platform.processor() or platform.machine(), "threads": arguments.threads, "torch": torch.__version__,
        "num_points": arguments.num_points, "occupied": arguments.occupied, "median_seconds": medians,
        "ratio": {stage: medians["PyTorch"][stage] / medians["snake-rs"][stage] for stage in STAGES},
    }  # fmt: skip
    if not arguments.json:
        print(
            f"64^3 network, {arguments.num_points} points, J = 10, {arguments.threads} threads, medians of {arguments.runs} runs"
        )
        print(f"{'seconds':10}" + "".join(f"{stage:>11}" for stage in STAGES))
        for name, row in medians.items():
            print(f"{name:10}" + "".join(f"{row[stage]:11.3f}" for stage in STAGES))
        print(f"{'ratio':10}" + "".join(f"{report['ratio'][stage]:11.2f}" for stage in STAGES))
    print(json.dumps(report))


if __name__ == "__main__":
    main()
