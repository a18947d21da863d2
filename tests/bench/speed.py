"""Speed of snake-rs beside its peers, alternating in one run: `python tests/bench/speed.py`.

The network is the paper's, 64^3, with seeded random weights: speed does not depend on their values. Its decoders are
fitted so that as many queries pass each threshold as on a typical object. Peers that are not installed are named, not
counted; `pip install snake-training[bench]` has them all.
"""

import functools
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from datetime import datetime, timezone
from importlib import metadata
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from speed_peers import open3d_iss, unet_peers

from snake_training.arguments import option, parser_of
from snake_training.augment import normalize
from snake_training.data import Procedural
from snake_training.detection import DetectOptions, near_points, query_grid, refine, select
from snake_training.export import write_weights
from snake_training.model import NetworkConfig, SnakeNetwork, voxel_index

PACKAGES = ("snake-rs", "torch", "onnxruntime", "openvino", "open3d")
STAGES = ("encode", "occupancy", "refine", "nms", "total")
QUERY_BAND = 2  # voxels, of the opt-in mode
AVX2 = {
    "SNAKE_SIMD": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "MKL_ENABLE_INSTRUCTIONS": "AVX2",
    "ATEN_CPU_CAPABILITY": "avx2",
}
MAX_QUERY_DIFFERENCE = 0.01  # the share by which the refined queries of two engines may differ
MAX_DIFFERENCE = 1e-3  # from PyTorch's volume; a float32 peer that is farther off gets no ratio
PAUSE = 0.05  # seconds before each call, in which the threads of the one before stop spinning
NOT_INSTALLED = "not installed (pip install snake-training[bench])"


def seeded_network(config, points, occupied, query_resolution=64, seed=0):
    """A random network that finds `occupied` grid queries of a cloud (N, 3) occupied, nearly all close to its points.

    Half of those are on the surface (occupancy above 0.8) and two fifths salient (above 0.7), so that every stage of
    detection has its work. The last layers of the decoders are fitted to that.
    """
    torch.manual_seed(seed)
    network = SnakeNetwork(config).eval()
    for name, parameter in network.named_parameters():
        if name.endswith("fc_1.weight"):  # zero in a fresh network
            torch.nn.init.normal_(parameter, std=0.1)
    surface, salient = np.log(0.8 / 0.2), np.log(np.expm1(0.7 / 0.3))  # the thresholds as logits
    last, hidden = network.decoder_occup.fc_out, []
    hook = last.register_forward_pre_hook(lambda _, inputs: hidden.append(inputs[0][0]))
    with torch.no_grad():
        unit = torch.from_numpy(normalize(points)[0])
        volume = network.encode(unit[None])
        queries = query_grid(config, query_resolution, "cpu")
        for chunk in queries.split(1 << 15):
            network.occupancy(volume, chunk[None])
        hook.remove()
        hidden = torch.cat(hidden)
        near = near_points(config, unit, queries, 1).float()
        direction = torch.linalg.lstsq(hidden - hidden.mean(dim=0), near[:, None]).solution
        highest = (hidden @ direction)[:, 0].sort(descending=True)
        lowest, median = highest.values[occupied - 1], highest.values[occupied // 2]
        gain = surface / (median - lowest)
        last.weight.copy_(gain * direction.T)
        last.bias.fill_(-gain * lowest)
        saliency = network.occupancy_and_saliency(volume, queries[highest.indices[:occupied]][None])[1][0]
        logit = (saliency / (1 - saliency)).expm1().log()
        network.decoder_keypoint.fc_out.bias += salient - logit.quantile(0.6)
    return network


def run_torch(network, points, options):
    """Seconds of each stage of the plain PyTorch detection, the volume computed once, and the number of refined queries."""
    start = time.perf_counter()
    unit, center, scale = normalize(points, options.normalization)
    unit = torch.from_numpy(unit)
    with torch.no_grad():
        volume = network.encode(unit[None])
        encoded = time.perf_counter()
        queries = query_grid(network.config, options.query_resolution, "cpu")
        if options.query_band:
            queries = queries[near_points(network.config, unit, queries, options.query_band)]
        occupancy = torch.cat([network.occupancy(volume, chunk[None])[0] for chunk in queries.split(1 << 15)])
        queries = queries[occupancy > options.occupancy_threshold]
    filtered = time.perf_counter()
    position, score = refine(network, volume, queries, options)
    refined = time.perf_counter()
    select(position * float(scale) + torch.from_numpy(center), score, options)
    end = time.perf_counter()
    seconds = (encoded - start, filtered - encoded, refined - filtered, end - refined, end - start)
    return dict(zip(STAGES, seconds)) | {"refined": len(queries)}


def run_snake_rs(model, points, options=None):
    """Seconds of each stage of snake-rs; without options, with those that the model recommends."""
    import snake_rs  # after the environment: its threads start with the first use

    start = time.perf_counter()
    keypoints = snake_rs.detect(points, model, **vars(options) if options else {})
    total = time.perf_counter() - start
    return keypoints.timing_seconds | {"total": total, "refined": keypoints.counts["occupied"]}


def seconds_of(call):
    """A call that returns its own seconds instead of its result."""

    def run():
        start = time.perf_counter()
        call()
        return {"seconds": time.perf_counter() - start}

    return run


def alternate(calls, runs):
    """{name: call returning {column: number}} to medians over `runs` rounds, after one round that is not counted."""
    rounds = {name: [] for name in calls}
    for _ in range(runs + 1):
        for name, call in calls.items():
            time.sleep(PAUSE)
            rounds[name].append(call())
    return {
        name: {stage: float(np.median([row[stage] for row in rows[1:]])) for stage in rows[0]}
        for name, rows in rounds.items()
    }


def compare_unet(network, model, points, threads, runs):
    """Rows of the U-Net's peers against the whole encoding of snake-rs, which does more: the handicap is ours."""
    encoder = network.encoder
    with torch.no_grad():
        unit = torch.from_numpy(normalize(points)[0])[None]
        voxels = voxel_index(unit, network.config)
        volume = encoder.scatter_mean(encoder.point_features(unit, voxels), voxels).contiguous()
    calls, missing = {}, {}
    for name, prepare in unet_peers(encoder.unet3d, volume, threads).items():
        try:
            calls[name] = prepare()
        except ImportError:
            missing[name] = {"note": NOT_INSTALLED}
        except RuntimeError as error:  # OpenVINO has bfloat16 not on every processor
            missing[name] = {"note": f"cannot run here: {str(error).strip().splitlines()[-1]}"}
    outputs = {name: call() for name, call in calls.items()}
    calls["snake-rs (whole encode)"] = lambda: model.encode(points)
    outputs["snake-rs (whole encode)"] = model.encode(points).volume[None]
    reference = outputs["PyTorch contiguous"]
    rows = alternate({name: seconds_of(call) for name, call in calls.items()}, runs)
    ours = rows["snake-rs (whole encode)"]["seconds"]
    for name, row in rows.items():
        row["difference"] = float(np.abs(outputs[name] - reference).max())
        if "bfloat16" in name:
            row["note"] = "for information: not float32"
        elif row["difference"] > MAX_DIFFERENCE:
            row["note"] = f"no ratio: differs from PyTorch by more than {MAX_DIFFERENCE:g}"
        else:
            row["ratio"] = row["seconds"] / ours
    return rows | missing


def compare_detect(network, model, points, options, runs):
    """Rows of the whole detection stage by stage, without and with the opt-in query band, and the ratios."""
    band = DetectOptions(**vars(options) | {"query_band": QUERY_BAND})
    rows = alternate(
        {
            "PyTorch": lambda: run_torch(network, points, options),
            "snake-rs": lambda: run_snake_rs(model, points, options),
            f"PyTorch, query_band {QUERY_BAND}": lambda: run_torch(network, points, band),
            f"snake-rs, query_band {QUERY_BAND}": lambda: run_snake_rs(model, points, band),
        },
        runs,
    )
    modes = ("", f", query_band {QUERY_BAND}")
    return rows, {
        f"PyTorch / snake-rs{mode}": detect_ratio(rows[f"PyTorch{mode}"], rows[f"snake-rs{mode}"]) for mode in modes
    }


def detect_ratio(peer, ours):
    """The ratio of each stage, or a note where the two refined different numbers of queries."""
    if abs(peer["refined"] - ours["refined"]) > MAX_QUERY_DIFFERENCE * ours["refined"]:
        return {"note": f"no ratio: {peer['refined']:.0f} queries refined, by snake-rs {ours['refined']:.0f}"}
    return {stage: peer[stage] / ours[stage] for stage in STAGES}


def compare_compact(model, points, runs):
    """Rows of the whole detection with the built-in model's recommended options, and of Open3D's ISS."""
    calls = {"snake-rs, built-in model": lambda: run_snake_rs(model, points)}
    missing = {}
    try:
        find = seconds_of(open3d_iss(points))
        calls["Open3D ISS"] = lambda: {"total": find()["seconds"]}
    except ImportError:
        missing = {"Open3D ISS": {"note": NOT_INSTALLED}}
    return alternate(calls, runs) | missing


@functools.cache
def load_model(path):
    """The snake-rs model of a weight file, read once a process."""
    import snake_rs

    return snake_rs.Model.load(path)


def detect_in_child(weights, points, options):
    """Seconds of each stage of snake-rs, for a process of its own."""
    return run_snake_rs(load_model(weights), points, options)


def compare_threads(weights, points, options, threads, runs):
    """Rows of the whole detection of snake-rs in processes of one and of `threads` threads, and their ratio."""
    with ExitStack() as stack:
        calls = {}
        for number in sorted({1, threads}):
            os.environ["RAYON_NUM_THREADS"] = str(number)  # a process has it from its start
            pool = stack.enter_context(ProcessPoolExecutor(1, get_context("spawn")))
            submit = functools.partial(pool.submit, detect_in_child, weights, points, options)
            submit().result()
            name = "1 thread" if number == 1 else f"{number} threads"
            calls[name] = lambda submit=submit: submit().result()
        rows = alternate(calls, runs)
    if threads == 1:
        return rows, {}
    one, several = rows["1 thread"], rows[f"{threads} threads"]
    return rows, {f"1 / {threads} threads": {stage: one[stage] / several[stage] for stage in STAGES}}


CHILD = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 2**20)
"""


def peak_mib(words):
    """The largest resident memory of a command in MiB. A small process starts it: on Linux a child begins with its parent's peak."""
    command = [sys.executable, "-c", CHILD, *map(str, words)]
    return float(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def measure_memory(weights, cloud, threads):
    """Peak MiB of `snake-cli detect` on a cloud with the network and with the built-in model; empty without it."""
    built = Path(__file__).parents[2] / "target/release/snake-cli"
    binary = str(built) if built.exists() else shutil.which("snake-cli")
    if binary is None:
        return {}
    detect = [binary, "detect", cloud, "--threads", str(threads)]
    return {"the network": peak_mib([*detect, "--model", weights]), "built-in model": peak_mib(detect)}


def machine():
    """Processor, number of cores, load and date."""
    cpu = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu)
    date = datetime.now(timezone.utc).isoformat(timespec="minutes")
    return {"cpu": cpu, "cores": os.cpu_count(), "load_before": round(os.getloadavg()[0], 2), "date": date}


def version(package):
    """Version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return NOT_INSTALLED


def measure(config, num_points, occupied, options, threads, runs):
    """The report of one level of instructions."""
    os.environ["RAYON_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = str(threads)
    import snake_rs  # after the environment: its threads start with the first use

    torch.set_num_threads(threads)
    report = {
        "versions": {package: version(package) for package in PACKAGES},
        "settings": {
            "threads": threads, "runs": runs, "num_points": num_points, "resolution": config.resolution,
            "query_resolution": options.query_resolution, "refine_steps": options.refine_steps,
        },
    }  # fmt: skip
    points = Procedural(points=num_points)[0]
    network = seeded_network(config, points, occupied, options.query_resolution)
    with TemporaryDirectory() as folder:
        weights, cloud = str(Path(folder) / "network.safetensors"), str(Path(folder) / "cloud.npy")
        write_weights(weights, config, network.state_dict())
        np.save(cloud, points)
        model = load_model(weights)
        report["counts"] = snake_rs.detect(points, model, **vars(options)).counts
        report["unet_seconds"] = compare_unet(network, model, points, threads, runs)
        report["detect_seconds"], report["detect_ratio"] = compare_detect(network, model, points, options, runs)
        report["compact_seconds"] = compare_compact(snake_rs.Model.builtin(), points, runs)
        report["thread_seconds"], report["thread_ratio"] = compare_threads(weights, points, options, threads, runs)
        report["peak_mib"] = measure_memory(weights, cloud, threads)
    return report


def measure_levels(*arguments):
    """Yields (level, report as it is written to the JSON file), each measured in a process of its own.

    The levels are all instructions that the processor has and, if it has more, AVX2. The load is that before the first level,
    because the second one would see the load of the first.
    """
    host = machine()
    levels = {"all instructions of the processor": {}}
    if torch.backends.cpu.get_cpu_capability() == "AVX512":
        levels["held to AVX2 (ONNX Runtime is not)"] = AVX2
    for level, environment in levels.items():
        os.environ.update(environment)  # a process has it from its start
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            yield level, {"machine": host, **pool.submit(measure, *arguments).result()}


def table(title, rows, digits=4):
    """Aligned text of {row: {column: number or text}}."""
    columns = list(dict.fromkeys(column for row in rows.values() for column in row if column != "note"))
    formats = {"difference": ".0e", "ratio": ".2f", "refined": ".0f"}
    width = max(map(len, rows))
    lines = [f"\n{title}", " " * width + "".join(f"{column:>11}" for column in columns)]
    for name, row in rows.items():
        cells = (f"{row[c]:{formats.get(c, f'.{digits}f')}}" if c in row else "" for c in columns)
        lines.append(f"{name:{width}}" + "".join(f"{cell:>11}" for cell in cells) + f"  {row.get('note', '')}".rstrip())
    return "\n".join(lines)


def text(report):
    """The report for people."""
    host, settings, counts = report["machine"], report["settings"], report["counts"]
    x, y, z = settings["resolution"]
    lines = [
        f"{host['cpu']}, {host['cores']} cores (load before: {host['load_before']}), {host['date']}",
        "; ".join(f"{package} {number}" for package, number in report["versions"].items()),
        f"threads of each: {settings['threads']}, medians of {settings['runs']} alternating runs",
        f"{settings['num_points']} points, volume {x} x {y} x {z}, J = {settings['refine_steps']}; queries: "
        + ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in counts.items() if name != "queries")
        + f" of {counts['queries']}",
        table(
            "U-Net: seconds, largest difference from PyTorch contiguous, ratio to snake-rs\n"
            "(snake-rs: normalisation, PointNet and scatter-mean too)",
            report["unet_seconds"],
        ),
        table(
            "Whole detection: seconds, PyTorch with the volume computed once, and the number of refined queries",
            report["detect_seconds"],
        ),
        table("ratios", report["detect_ratio"], digits=2),
        table("Built-in model, recommended options: seconds", report["compact_seconds"]),
        table("snake-rs by threads, whole detection: seconds", report["thread_seconds"]),
    ]
    if host["load_before"] > host["cores"]:
        lines.insert(1, "BUSY MACHINE: the ratios favour whoever waits least for other threads; repeat on an idle one")
    if report["thread_ratio"]:
        lines.append(table("ratio", report["thread_ratio"], digits=2))
    lines.append("\nPeak resident memory of snake-cli detect")
    lines += [f"{name}: {mib:.0f} MiB" for name, mib in report["peak_mib"].items()]
    if not report["peak_mib"]:
        lines.append("not measured: no snake-cli found (cargo build --release)")
    return "\n".join(lines)


def main(argv=None):
    """Prints the tables of each level of instructions, and writes the same as JSON."""
    options = {
        "--threads": option(os.cpu_count(), "threads of each"),
        "--runs": option(5, "counted runs of each, after one that is not"),
        "--num-points": option(4096, "points of the cloud"),
        "--occupied": option(12000, "occupied grid queries, of 64^3"),
        "--json": dict(metavar="FILE", type=Path, help="write the report there as well"),
    }
    parser = parser_of("", __doc__, options, prog="python tests/bench/speed.py")
    arguments = parser.parse_args(argv)
    for name, most in (("threads", 1024), ("runs", 1000), ("num_points", 10**7), ("occupied", 64**3 // 2)):
        if not 1 <= getattr(arguments, name) <= most:
            parser.error(f"--{name.replace('_', '-')} must be 1 to {most}")
    reports = {}
    for level, report in measure_levels(
        NetworkConfig(), arguments.num_points, arguments.occupied, DetectOptions(), arguments.threads, arguments.runs
    ):
        print(f"## {level}\n\n{text(report)}\n", flush=True)
        reports[level] = report
        if arguments.json:
            arguments.json.write_text(json.dumps(reports, indent=1) + "\n")


if __name__ == "__main__":
    main()
