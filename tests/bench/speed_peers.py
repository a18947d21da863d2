"""The peers of snake-rs in `tests/bench/speed.py`: other engines of the U-Net, and another detector.

Each function prepares one peer and returns a call without arguments; it raises ImportError where the peer's package is
not installed. All take the number of threads explicitly.
"""

import copy
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch


def torch_unet(unet, volume, threads, memory_format):
    """The U-Net in PyTorch with its weights and volume (1, C, D, H, W) in one memory format."""
    unet = copy.deepcopy(unet).to(memory_format=memory_format)
    volume = volume.contiguous(memory_format=memory_format)

    def run():
        torch.set_num_threads(threads)
        with torch.inference_mode():
            return unet(volume).numpy()

    return run


def onnxruntime_unet(unet, volume, threads):
    """The U-Net in ONNX Runtime, float32."""
    import onnx  # noqa: F401  (torch's exporter needs it)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.force_spinning_stop", "1")  # it may spin while it runs, not after
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that needs no further package calls itself deprecated
        file = str(Path(folder) / "unet.onnx")
        torch.onnx.export(unet, (volume,), file, dynamo=False, input_names=["volume"])
        session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    values = volume.numpy()
    return lambda: session.run(None, {"volume": values})[0]


def openvino_unet(unet, volume, threads, precision):
    """The U-Net in OpenVINO at a precision ("f32" or "bf16") that it may not lower."""
    import openvino

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch calls the tracing that OpenVINO converts by deprecated
        converted = openvino.convert_model(unet, example_input=volume, input=[list(volume.shape)])
    settings = {
        "INFERENCE_PRECISION_HINT": precision, "INFERENCE_NUM_THREADS": threads, "NUM_STREAMS": 1,
        "PERFORMANCE_HINT": "LATENCY",
    }  # fmt: skip
    request = openvino.Core().compile_model(converted, "CPU", settings).create_infer_request()
    values = volume.numpy()
    return lambda: request.infer([values], share_inputs=True)[0]


def unet_peers(unet, volume, threads):
    """{name: function that prepares it} of the engines of the U-Net on a contiguous volume (1, C, D, H, W).

    The first is the one whose output the others are compared with.
    """
    return {
        "PyTorch contiguous": lambda: torch_unet(unet, volume, threads, torch.contiguous_format),
        "PyTorch channels_last_3d": lambda: torch_unet(unet, volume, threads, torch.channels_last_3d),
        "ONNX Runtime float32": lambda: onnxruntime_unet(unet, volume, threads),
        "OpenVINO float32": lambda: openvino_unet(unet, volume, threads, "f32"),
        "OpenVINO bfloat16": lambda: openvino_unet(unet, volume, threads, "bf16"),
    }


def open3d_iss(points):
    """ISS keypoints (K, 3) of a cloud (N, 3) by Open3D with its own radii; its threads are OMP_NUM_THREADS."""
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.astype(np.float64)))
    return lambda: np.asarray(open3d.geometry.keypoint.compute_iss_keypoints(cloud).points)
