"""Presets equal the paper's table of hyper-parameters and the released configurations; exports recommend their options."""

import pytest
import torch
from safetensors import safe_open

from conftest import arguments
from snake_training.command_line import parse_arguments
from snake_training.config import PRESETS, to_json
from snake_training.export import main as export
from snake_training.export import recommended_options, write_weights
from snake_training.model import NetworkConfig, SnakeNetwork
from snake_training.tasks.objects import Objects
from snake_training.train import learning_rate, make_optimizer

# N, R, H_l, U, n, b, the share of the epochs before the rate drops, occupancy queries; jitter and its clip, down-sampling.
TABLE = {
    "keypointnet": (2048, 64, 8, 8, 500, 16, 40 / 60, 1000, 0.005, 0.01, 1),
    "smpl": (2048, 64, 8, 8, 500, 16, 20 / 30, 1000, 0.005, 0.01, 1),
    "modelnet40": (5000, 64, 8, 6, 500, 16, 40 / 60, 2000, 0.01, 0.03, 4),
    "redwood": (10000, 100, 10, 8, 150, 6, 15 / 20, 3000, 0.005, 0.01, 4),
    "3dmatch": (2048, 64, 6, 12, 500, 16, 40 / 60, 1000, 0.005, 0.01, 1),
}
COLUMNS = (
    "num_points", "resolution", "grid_size", "grid_fraction", "num_grids", "batch", "drop_after", "num_occupancy",
    "jitter_sigma", "jitter_clip", "max_downsampling",
)  # fmt: skip


@pytest.mark.parametrize("name", TABLE)
def test_a_preset_has_the_papers_values(name):
    config = parse_arguments(["--preset", name], "")[0]
    assert tuple(getattr(config, column) for column in COLUMNS) == pytest.approx(TABLE[name])
    assert (config.optimizer, config.weight_decay, config.learning_rate, config.warmup) == ("adam", 5e-4, 1e-4, 0)
    assert (config.unet_levels, config.unet_base_channels, config.c_dim, config.scatter) == (4, 32, 32, "hard")
    assert (config.clip_norm, config.ema_decay, config.procedural_share, config.best_by) == (0, 0, 0, "loss")
    assert config.rotation == "euler" and config.with_replacement and config.validation_samples == 0
    assert config.validate_every == (3000 if name == "redwood" else 1000)
    assert (config.translation, config.recenter) == ((0.3, True) if name == "redwood" else (0, False))
    assert config.normalization == ("unit-cube" if name == "redwood" else "unit-sphere")
    assert set(TABLE) == set(PRESETS) - {"compact"}


@pytest.mark.parametrize(("name", "epochs", "drop"), [("redwood", 20, 15), ("smpl", 30, 20), ("modelnet40", 60, 40)])
def test_the_rate_drops_after_the_papers_epoch(name, epochs, drop):
    config = parse_arguments(["--preset", name, "--steps", str(epochs * 10)], "")[0]
    rates = [learning_rate(config, 10 * epoch) for epoch in range(epochs)]
    assert rates == pytest.approx([1e-4] * drop + [1e-5] * (epochs - drop))


def test_adam_has_the_penalty_on_everything(network, tiny):
    """Without a gradient of the losses, the first step of L2 inside Adam moves every weight by the rate towards 0."""
    before = {name: p.detach().clone() for name, p in network.named_parameters()}
    optimizer = make_optimizer(network, tiny(optimizer="adam", learning_rate=1e-3, weight_decay=5e-4))
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    optimizer.step()
    for name, parameter in network.named_parameters():
        large = before[name].abs() > 1e-2  # far from Adam's 1e-8
        moved = before[name] - parameter
        assert torch.allclose(moved[large], 1e-3 * before[name].sign()[large], atol=2e-5), name


def test_the_best_validation_is_of_the_least_total_loss(tiny):
    values = dict(occupancy=0.1, repeatability=0.2, surface=0.3, sparsity=0.4)
    values |= {"repeatability_nms_0.01": 0.5, "repeatability_nms_0.05": 0.25}
    assert Objects(tiny(best_by="loss", weight_surface=2.0)).score(values) == pytest.approx(-1.3)
    assert Objects(tiny()).score(values) == 0.75


# Options that an export recommends


def recommended(path):
    """The metadata of a weight file."""
    with safe_open(path, "pt") as file:
        return file.metadata().get("recommended_options")


YAML = "data_info: {{dataset_name: {}}}\npublic_params: {{grid_reso: {}, encoder_kwargs: {{grid_resolution: {}}}}}\n"
OFFICIAL = [
    ("KeypointNet", 8, 64, "keypointnet"), ("KeypointNet", 12, 64, "3dmatch"), ("SMPL", 8, 64, "smpl"),
    ("ModelNet40", 6, 64, "modelnet40"), ("match3d", 8, 100, "redwood"), ("Redwood", 8, 100, "redwood"),
    ("Match3d_test", 12, 64, "3dmatch"), ("KITTI", 8, 64, None),
]  # fmt: skip


@pytest.fixture
def official(tmp_path):
    """A tiny checkpoint as the authors write them."""
    torch.manual_seed(0)
    torch.save(SnakeNetwork(SMALL).state_dict(), tmp_path / "model_best.pth")
    return tmp_path / "model_best.pth"


SMALL = NetworkConfig(resolution=(16,) * 3, unet_levels=2, unet_base_channels=8)
FLAGS = ["--resolution", "16", "--unet-levels", "2", "--unet-base-channels", "8"]


def test_given_metadata_overrides_the_preset(tmp_path, official):
    added = ["--metadata", 'recommended_options={"detect":{"nms_radius":0.5}}']
    export([str(official), "-o", str(tmp_path / "out.safetensors"), *FLAGS, "--preset", "smpl", *added])
    assert recommended(tmp_path / "out.safetensors") == '{"detect":{"nms_radius":0.5}}'


def checkpoint(config, network):
    """The checkpoint of a run of these settings, without Adam."""
    own = {"settings": to_json(config), "network_config": network.config.to_metadata()}
    return own | {"step": 1, "best": 0.0, "ema": network.state_dict()}


def test_a_fine_tuned_export_keeps_the_options_of_its_start(tmp_path, tiny, network):
    """An export recommends them from a weight file, and from a run that began with one."""
    options = '{"detect":{"nms_radius":"10%"}}'
    start = tmp_path / "start.safetensors"
    write_weights(start, network.config, network.state_dict(), extra={"recommended_options": options})
    words = [word for word in arguments(tiny()) if word not in ("--init", "--recommended-options", "")]
    for init in (start, tmp_path / "first.pt"):
        config = parse_arguments([*words, "--init", str(init)], "")[0]
        assert config.recommended_options == options
        torch.save(checkpoint(config, network), tmp_path / "first.pt")
    export([str(tmp_path / "first.pt"), "-o", str(tmp_path / "out.safetensors")])
    assert recommended(tmp_path / "out.safetensors") == options == recommended_options(tmp_path / "out.safetensors")


def test_a_resumed_run_keeps_the_options_of_its_start_when_that_is_gone(tmp_path, tiny, network):
    options = '{"detect":{"nms_radius":"10%"}}'
    config = tiny(recommended_options=options)
    (tmp_path / "run").mkdir()
    torch.save(checkpoint(config, network), tmp_path / "run/last.pt")
    words = [word for word in arguments(tiny()) if word not in ("--init", "--recommended-options", "")]
    found, *_ = parse_arguments([*words, "--init", str(tmp_path / "gone.safetensors")], "")
    assert found.recommended_options == options


@pytest.mark.parametrize(("data", "grid", "resolution", "preset"), OFFICIAL)
def test_an_export_recommends_what_the_official_yaml_says_or_says_that_it_does_not(
    tmp_path, official, capsys, data, grid, resolution, preset
):
    """The page's command is enough: KeypointNet, SMPL and Redwood do not detect as ModelNet40."""
    (tmp_path / "config.yaml").write_text(YAML.format(data, grid, [resolution] * 3))
    export([str(official), "-o", str(tmp_path / "out.safetensors"), "--yaml", str(tmp_path / "config.yaml"), *FLAGS])
    assert recommended(tmp_path / "out.safetensors") == (PRESETS[preset]["recommended_options"] if preset else None)
    assert ("no options of detection are recommended" in capsys.readouterr().err) == (preset is None)


@pytest.mark.parametrize("text", ["{", "nms"])
def test_options_that_are_no_json_are_refused(text):
    with pytest.raises(SystemExit, match="recommended_options must be JSON"):
        parse_arguments(["--recommended-options", text], "")
