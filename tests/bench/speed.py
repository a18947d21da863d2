"""Seconds of snake-rs beside PyTorch and OpenVINO, which take turns: `make bench`, or `python tests/bench/speed.py [--avx2]`.

The network is the paper's, 64^3, with seeded random weights: speed does not depend on their values. Its decoders are fitted so that as
many queries pass each threshold as on a typical object. All are float32, and their volumes agree within a thousandth of the largest value.
"""

import argparse
import copy
import os
import time
import warnings
from functools import partial
from tempfile import TemporaryDirectory

import numpy as np
import torch

from snake_training.augment import normalize
from snake_training.data import Procedural
from snake_training.detection import DetectOptions, near_points, query_grid, refine, select
from snake_training.export import write_weights
from snake_training.model import NetworkConfig, SnakeNetwork, voxel_index

AVX2 = dict(SNAKE_SIMD="avx2", ONEDNN_MAX_CPU_ISA="AVX2", MKL_ENABLE_INSTRUCTIONS="AVX2", ATEN_CPU_CAPABILITY="avx2")
PAUSE = 0.05  # seconds before each call, in which the threads of the one before stop spinning


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
        volume, queries = network.encode(unit[None]), query_grid(config, query_resolution, "cpu")
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


def detect_torch(network, points, options):
    """The number of refined queries of the plain PyTorch detection, with the volume computed once."""
    unit, center, scale = normalize(points, options.normalization)
    unit = torch.from_numpy(unit)
    with torch.no_grad():
        volume, queries = network.encode(unit[None]), query_grid(network.config, options.query_resolution, "cpu")
        if options.query_band:
            queries = queries[near_points(network.config, unit, queries, options.query_band)]
        occupancy = torch.cat([network.occupancy(volume, chunk[None])[0] for chunk in queries.split(1 << 15)])
        queries = queries[occupancy > options.occupancy_threshold]
    position, score = refine(network, volume, queries, options)
    select(position * float(scale) + torch.from_numpy(center), score, options)
    return len(queries)


def openvino_unet(unet, volume, threads):
    """A call of the U-Net in OpenVINO at float32; None where it is not installed."""
    try:
        import openvino
    except ImportError:
        print("OpenVINO is not installed (pip install snake-training[bench])")
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch calls the tracing that OpenVINO converts by deprecated
        converted = openvino.convert_model(unet, example_input=volume, input=[list(volume.shape)])
    settings = dict(INFERENCE_PRECISION_HINT="f32", INFERENCE_NUM_THREADS=threads, NUM_STREAMS=1, PERFORMANCE_HINT="LATENCY")  # fmt: skip
    request = openvino.Core().compile_model(converted, "CPU", settings).create_infer_request()
    return lambda: request.infer([volume.numpy()], share_inputs=True)[0]


def calls(config, num_points, occupied, options, threads):
    """The rows of the table: names and calls."""
    import snake_rs  # after the environment: its threads start with the first use

    points = Procedural(points=num_points)[0]
    network = seeded_network(config, points, occupied, options.query_resolution)
    with TemporaryDirectory() as folder:
        write_weights(f"{folder}/network.safetensors", config, network.state_dict())
        model = snake_rs.Model.load(f"{folder}/network.safetensors")
    encoder = network.encoder
    with torch.no_grad():
        unit = torch.from_numpy(normalize(points)[0])[None]
        voxels = voxel_index(unit, config)
        volume = encoder.scatter_mean(encoder.point_features(unit, voxels), voxels).contiguous()
        reference, ours = encoder.unet3d(volume).numpy(), model.encode(points).volume[None]
    in_openvino = openvino_unet(encoder.unet3d, volume, threads)
    unet = copy.deepcopy(encoder.unet3d).to(memory_format=torch.channels_last_3d)
    inner = volume.contiguous(memory_format=torch.channels_last_3d)
    unets = {
        "U-Net: PyTorch, channels_last_3d": torch.inference_mode()(lambda: unet(inner).numpy()),
        "U-Net: OpenVINO": in_openvino,
        "U-Net: snake-rs, with PointNet and scattering": lambda: model.encode(points),
    }
    results = [ours, *(call() for call in list(unets.values())[:2] if call)]
    if any(np.abs(result - reference).max() > 1e-3 * np.abs(reference).max() for result in results):
        raise SystemExit("the volumes differ by more than a thousandth of the largest value")
    refined = snake_rs.detect(points, model, **vars(options)).counts["occupied"]
    theirs = detect_torch(network, points, options)
    if abs(theirs - refined) > 0.01 * refined:
        raise SystemExit(f"PyTorch refines {theirs} queries, snake-rs {refined}")
    rows = {name: call for name, call in unets.items() if call}
    for label, band in (("", 0), (", query_band 2", 2)):
        own = DetectOptions(**vars(options) | {"query_band": band})
        rows[f"detection: PyTorch{label}"] = lambda own=own: detect_torch(network, points, own)
        rows[f"detection: snake-rs{label}"] = lambda own=own: snake_rs.detect(points, model, **vars(own))
    for name in ("compact", "standard"):
        rows[f"detection: {name}"] = partial(snake_rs.detect, points, name)
    return rows


def medians(rows, runs):
    """Median seconds of each call over `runs` rounds, after one that is not counted."""
    seconds = {name: [] for name in rows}
    for _ in range(runs + 1):
        for name, call in rows.items():
            time.sleep(PAUSE)
            start = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(some[1:])) for name, some in seconds.items()}


def main():
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads of each [default: all]")
    parser.add_argument("--runs", type=int, default=5, help="counted runs of each [default: 5]")
    parser.add_argument("--avx2", action="store_true", help="no instructions beyond AVX2")
    arguments = parser.parse_args()
    os.environ |= AVX2 if arguments.avx2 else {}
    os.environ["RAYON_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = str(arguments.threads)
    torch.set_num_threads(arguments.threads)
    rows = calls(NetworkConfig(), 4096, 12000, DetectOptions(), arguments.threads)
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print(f"| {arguments.threads} threads | seconds |\n|---|---|")
    for name, seconds in medians(rows, arguments.runs).items():
        print(f"| {name} | {seconds:.3f} |")


if __name__ == "__main__":
    main()
