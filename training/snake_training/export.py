"""Weight files: `python -m snake_training.export RUN_OR_CHECKPOINT -o model.safetensors`, and loading them back."""

import argparse
import hashlib
import json
from pathlib import Path

import torch
import yaml
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from .config import from_json
from .model import NetworkConfig, SnakeNetwork


def load_network(path, device="cpu"):
    """A network in evaluation mode from a weight file, a checkpoint of ours or a run folder."""
    path = Path(path)
    if path.suffix == ".safetensors":
        with safe_open(path, "pt") as file:
            config = NetworkConfig.from_metadata(file.metadata() or {})
        tensors = {name: tensor.float() for name, tensor in load_file(path).items()}
    else:
        config, tensors = read_checkpoint(path)
    network = SnakeNetwork(config)
    network.load_state_dict(tensors, strict=True)
    return network.to(device).eval()


def read_checkpoint(path, config=None):
    """(NetworkConfig, tensors) of a run folder (its best checkpoint), our checkpoint, or an official `model_best.pth`."""
    path = Path(path)
    if path.is_dir():
        path = path / "best.pt" if (path / "best.pt").exists() else path / "last.pt"
    if not path.exists():
        raise SystemExit(f"{path}: no such checkpoint")
    state = torch.load(path, map_location="cpu", weights_only=True)
    if "config" in state:
        return from_json(state["config"]).network, state["ema"]
    for key in ("state_dict", "model", "model_state_dict"):
        state = state[key] if isinstance(state.get(key), dict) else state
    tensors = {name.removeprefix("module."): tensor.float() for name, tensor in state.items()}
    return config or NetworkConfig(), tensors


def config_from_yaml(path):
    """NetworkConfig of an official experiment's config.yaml, wherever in its tree the keys stand."""
    found = {}

    def walk(node):
        for key, value in node.items() if isinstance(node, dict) else ():
            found.setdefault(key, value)
            walk(value)

    walk(yaml.safe_load(Path(path).read_text()))
    resolution = found.get("grid_resolution", found.get("grid_reso", found.get("grid_res", 64)))
    return NetworkConfig(
        resolution=tuple(resolution) if isinstance(resolution, list) else (int(resolution),) * 3,
        padding=float(found.get("padding", 0.125)), c_dim=int(found.get("c_dim", 32)),
        hidden_dim=int(found.get("hidden_dim", 32)), decoder_hidden_dim=int(found.get("hidden_size", 32)),
        unet_levels=int(found.get("num_levels", 4)), unet_base_channels=int(found.get("f_maps", 32)),
    )  # fmt: skip


def write_weights(path, config, tensors, dtype=torch.float32, extra=None):
    """Write our weight file (temporary name, then rename); `extra` metadata strings are added, and a digest."""
    SnakeNetwork(config).load_state_dict(tensors, strict=True)  # names and shapes
    tensors = {name: tensor.detach().cpu().to(dtype).contiguous() for name, tensor in sorted(tensors.items())}
    digest = hashlib.sha256()
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise SystemExit(f"{name}: has values that are not finite")
        digest.update(name.encode() + tensor.numpy().tobytes())
    metadata = config.to_metadata() | {"digest": "sha256:" + digest.hexdigest()} | (extra or {})
    temporary = Path(f"{path}.partial")
    save_file(tensors, temporary, metadata=metadata)
    temporary.replace(path)


def main(argv=None):
    """Command line of the export."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.export",
        description="Write the weight file of snake-rs from a run, a checkpoint, or an official model_best.pth.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("source", help="run folder or checkpoint")
    parser.add_argument("-o", "--output", required=True, help="weight file to write")
    parser.add_argument("--float16", action="store_true", help="store the tensors as float16")
    parser.add_argument("--metadata", nargs="*", default=[], metavar="KEY=VALUE", help="added metadata: licence, data, options")
    official = parser.add_argument_group("official checkpoints", "whose configuration is not inside the file")
    official.add_argument("--yaml", help="the experiment's config.yaml")
    official.add_argument("--resolution", type=int, help="voxels a side")
    official.add_argument("--unet-levels", type=int)
    official.add_argument("--unet-base-channels", type=int)
    official.add_argument("--padding", type=float)
    arguments = parser.parse_args(argv)
    config = config_from_yaml(arguments.yaml) if arguments.yaml else NetworkConfig()
    overrides = {k: getattr(arguments, k) for k in ("unet_levels", "unet_base_channels", "padding")}
    overrides["resolution"] = arguments.resolution and (arguments.resolution,) * 3
    config = NetworkConfig(**vars(config) | {k: v for k, v in overrides.items() if v is not None})
    config, tensors = read_checkpoint(arguments.source, config)
    extra = dict(item.split("=", 1) for item in arguments.metadata)
    write_weights(arguments.output, config, tensors, torch.float16 if arguments.float16 else torch.float32, extra)
    print(json.dumps({"output": arguments.output, "parameters": sum(t.numel() for t in tensors.values())} | vars(config)))


if __name__ == "__main__":
    main()
