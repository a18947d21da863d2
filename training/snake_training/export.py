"""Weight files: `python -m snake_training.export RUN_OR_CHECKPOINT -o model.safetensors`, and loading them back."""

import argparse
import hashlib
import json
import re
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path, PosixPath, PurePosixPath

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from .arguments import parser_of
from .config import PRESETS
from .model import NetworkConfig, SnakeNetwork
from .scene_model import SceneConfig, SceneNetwork


@contextmanager
def replacing(path):
    """A temporary name for a file that replaces `path` once it is whole, with its mode."""
    temporary = Path(f"{path}.partial")
    try:
        yield temporary
        if Path(path).exists():
            shutil.copymode(path, temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def load_network(path, device="cpu"):
    """A network in evaluation mode from a weight file, a checkpoint of ours or a run folder."""
    return build_network(*read_checkpoint(path)).to(device).eval()


def recommended_options(path):
    """The options that a weight file, checkpoint or run folder recommends, as JSON; empty if it recommends none."""
    path = Path(path)
    try:
        if path.suffix == ".safetensors":
            with safe_open(path, "pt") as file:
                return (file.metadata() or {}).get("recommended_options", "")
        return json.loads(read_state(checkpoint_of(path)).get("settings", "{}")).get("recommended_options", "")
    except (OSError, SafetensorError, ValueError):
        return ""


def checkpoint_of(path):
    """The checkpoint of a run folder: its best, else its last; a file is one itself."""
    path = Path(path)
    if path.is_dir():
        return path / "best.pt" if (path / "best.pt").exists() else path / "last.pt"
    return path


def config_of(metadata):
    """The NetworkConfig or SceneConfig of a weight file's metadata."""
    scenes = metadata.get("coordinates") == "voxel"
    return (SceneConfig if scenes else NetworkConfig).from_metadata(metadata)


def network_of(config):
    """A new network of a configuration."""
    return (SceneNetwork if isinstance(config, SceneConfig) else SnakeNetwork)(config)


def build_network(config, tensors):
    """A network of a weight file's tensors; an unknown, missing or misshapen one is a ValueError."""
    network = network_of(config)
    try:
        network.load_folded(tensors) if hasattr(network, "folded") else network.load_state_dict(tensors, strict=True)
    except RuntimeError as error:
        raise ValueError(f"the tensors do not fit {config}: {error}") from error
    return network


# What released code keeps beside tensors: scores of NumPy (1 and 2 name their module differently), settings, paths. None of it
# runs anything when it is read.
ARRAYS = np.zeros(1).__reduce__()[0], np.float64(0).__reduce__()[0]
PLAIN = [
    argparse.Namespace, PurePosixPath, PosixPath, np.ndarray, np.dtype, *(type(np.dtype(name)) for name in ("f4", "f8", "i4", "i8", "bool")),
    *((of, f"numpy.{module}.multiarray.{of.__name__}") for of in ARRAYS for module in ("core", "_core")),
]  # fmt: skip


def read_state(path):
    """The dictionary of a checkpoint of tensors and plain values; anything else is a ValueError, and nothing in it is run."""
    try:
        with torch.serialization.safe_globals(PLAIN):
            state = torch.load(path, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception as error:  # the restricted unpickler's own refusal, or whatever a cut file makes it trip over
        found = re.search(r"GLOBAL ([\w.]+)", str(error))
        reason = f"it holds a {found[1]}; save its state_dict alone" if found else "it is cut short, or something else"
        raise ValueError(f"{path}: not a checkpoint of plain tensors ({reason}); nothing in it was run") from error
    if not isinstance(state, dict):
        raise ValueError(f"{path}: expected a dictionary of tensors, found {type(state).__name__}")
    return state


def read_checkpoint(path, config=None):
    """(NetworkConfig, tensors) of a run folder (its best), a checkpoint of ours, a weight file, or an official `model_best.pth`,
    whose configuration is given."""
    path = checkpoint_of(path)
    if path.suffix == ".safetensors":
        try:
            with safe_open(path, "pt") as file:
                config = config_of(file.metadata() or {})
            return config, {name: tensor.float() for name, tensor in load_file(path).items()}
        except (SafetensorError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from error
    state = read_state(path)
    if "network_config" in state:  # ours
        network = network_of(config_of(state["network_config"]))
        network.load_state_dict(state["ema"])
        return network.config, weights_of(network)
    for key in ("state_dict", "model", "model_state_dict"):
        state = state[key] if isinstance(state.get(key), dict) else state
    others = [str(name) for name, value in state.items() if not isinstance(value, torch.Tensor)]
    if others or not state:
        raise ValueError(f"{path}: expected a dictionary of tensors, found {', '.join(others) or 'nothing'} in it")
    return config or NetworkConfig(), {name.removeprefix("module."): tensor.float() for name, tensor in state.items()}


def weights_of(network):
    """The tensors of a network's weight file."""
    return network.folded() if hasattr(network, "folded") else network.state_dict()


def read_yaml(path):
    """An official experiment's config.yaml: its keys by name, wherever in its tree they stand."""
    import yaml  # the only use; training does without it

    found = {}

    def walk(node):
        for key, value in node.items() if isinstance(node, dict) else ():
            found.setdefault(key, value)
            walk(value)

    try:
        walk(yaml.safe_load(Path(path).read_text()))
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: {error}") from error
    return found


def config_from_yaml(path):
    """NetworkConfig of an official experiment's config.yaml."""
    found = read_yaml(path)
    resolution = found.get("grid_resolution", found.get("grid_reso", found.get("grid_res", 64)))
    return NetworkConfig(
        resolution=tuple(resolution) if isinstance(resolution, list) else (int(resolution),) * 3,
        padding=float(found.get("padding", 0.125)), c_dim=int(found.get("c_dim", 32)),
        hidden_dim=int(found.get("hidden_dim", 32)), decoder_hidden_dim=int(found.get("hidden_size", 32)),
        unet_levels=int(found.get("num_levels", 4)), unet_base_channels=int(found.get("f_maps", 32)),
    )  # fmt: skip


def preset_from_yaml(path):
    """The preset of an official experiment's config.yaml or config_test.yaml, by its data; None if they are unknown.

    Two networks are trained on KeypointNet: that of the registration tables has local grids of a twelfth.
    """
    found = read_yaml(path)
    data = str(found.get("dataset_name", "")).lower()
    if data == "keypointnet" and found.get("grid_reso") == 12:
        return "3dmatch"
    known = {"match3d": "redwood", "match3d_test": "3dmatch"} | {name: name for name in PRESETS if name != "compact"}
    return known.get(data)


def write_weights(path, config, tensors, dtype=torch.float32, extra=None):
    """Write our weight file (temporary name, then rename); `extra` metadata strings are added, and a digest.

    The digest is the SHA-256 of each tensor's name and little-endian values, by ascending name.
    """
    build_network(config, tensors)  # checks names and shapes
    tensors = {name: tensor.detach().cpu().to(dtype).contiguous() for name, tensor in sorted(tensors.items())}
    digest = hashlib.sha256()
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise ValueError(f"{name}: has values that are not finite as {dtype}")
        digest.update(name.encode() + tensor.numpy().tobytes())
    metadata = (extra or {}) | config.to_metadata() | {"digest": "sha256:" + digest.hexdigest()}
    with replacing(path) as temporary:
        save_file(tensors, temporary, metadata=metadata)


def main(argv=None):
    """Command line of the export."""
    arguments = {
        "source": dict(help="run folder, checkpoint or weight file"),
        "-o": dict(dest="output", metavar="OUTPUT", required=True, help="weight file to write"),
        "--float16": dict(action="store_true", help="store the tensors as float16"),
        "--metadata": dict(nargs="*", default=[], metavar="KEY=VALUE", help="added metadata: licence, data, options"),
    }
    about = "Write the weight file of snake-rs from a run, a checkpoint, or an official model_best.pth."
    usage = "python -m snake_training.export SOURCE -o OUTPUT [options]"
    parser = parser_of("export", about, arguments, usage=usage)
    official = parser.add_argument_group(
        "official checkpoints", "their configuration is not in the file; these are not used for ours"
    )
    official.add_argument("--yaml", help="the experiment's config.yaml, which also chooses the preset")
    official.add_argument(
        "--preset", choices=sorted(set(PRESETS) - {"compact"}), help="whose options of detection the file recommends"
    )
    official.add_argument("--resolution", type=int, help="voxels a side")
    official.add_argument("--unet-levels", type=int)
    official.add_argument("--unet-base-channels", type=int)
    official.add_argument("--padding", type=float)
    arguments = parser.parse_args(argv)
    if not all("=" in item for item in arguments.metadata):
        parser.error("--metadata takes KEY=VALUE")
    extra = dict(item.split("=", 1) for item in arguments.metadata)
    overrides = {k: getattr(arguments, k) for k in ("unet_levels", "unet_base_channels", "padding")}
    overrides["resolution"] = arguments.resolution and (arguments.resolution,) * 3
    try:
        config = config_from_yaml(arguments.yaml) if arguments.yaml else NetworkConfig()
        config = NetworkConfig(**vars(config) | {k: v for k, v in overrides.items() if v is not None})
        config, tensors = read_checkpoint(arguments.source, config)
        preset = arguments.preset or (arguments.yaml and preset_from_yaml(arguments.yaml))
        options = recommended_options(arguments.source) or (preset and PRESETS[preset]["recommended_options"])
        extra = ({"recommended_options": options} if options else {}) | extra
        if "recommended_options" not in extra:
            print(
                "no options of detection are recommended, so the file detects as for ModelNet40; give --preset, or the --yaml "
                "of an official checkpoint",
                file=sys.stderr,
            )
        write_weights(arguments.output, config, tensors, torch.float16 if arguments.float16 else torch.float32, extra)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print(
        json.dumps({"output": arguments.output, "parameters": sum(t.numel() for t in tensors.values())} | vars(config))
    )


if __name__ == "__main__":
    main()
