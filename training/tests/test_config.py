"""Settings: from words and files to a configuration and back, and which are refused."""

import dataclasses
import json
import math

import pytest

from conftest import TINY, arguments
from snake_training.command_line import parse_arguments
from snake_training.config import PRESETS, TrainConfig, check, from_table, to_json


@pytest.mark.parametrize("table", [{"step": 3}, {"steps": 3.5}, {"steps": True}, {"data": "folder"}, {"bf16": 1}])
def test_a_table_with_an_unknown_name_or_a_wrong_type_is_refused(table):
    with pytest.raises(ValueError, match=next(iter(table))):
        from_table(TrainConfig, table)


def test_arguments_and_json_give_the_configuration_back(tiny, tmp_path):
    config = tiny(data=("a", "b"), rotation="euler", translation=0.1, bf16=True)
    assert parse_arguments(arguments(config), "") == (config, "auto", 0.0, 0)
    assert from_table(TrainConfig, json.loads(to_json(config))) == config
    # A run from before a setting existed resumes with its default.
    older = {name: value for name, value in json.loads(to_json(config)).items() if name != "normalization"}
    assert from_table(TrainConfig, older) == config


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_parse_and_can_be_overridden(preset):
    config = parse_arguments(["--preset", preset], "")[0]
    assert all(getattr(config, name) == value for name, value in PRESETS[preset].items())
    assert parse_arguments(["--batch", "7", "--preset", preset], "")[0] == dataclasses.replace(config, batch=7)


@pytest.mark.parametrize("preset", ["compact", "smpl"])
def test_help_explains_every_setting_with_the_presets_value(preset, capsys):
    with pytest.raises(SystemExit) as stop:
        parse_arguments(["--preset", preset, "--help"], "what it does")
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    for field in dataclasses.fields(TrainConfig):
        assert f"--{field.name.replace('_', '-')}" in text
        assert len(field.metadata["help"]) > 10
        assert " ".join(field.metadata["help"].split()) in text
    batch = PRESETS[preset].get("batch", TrainConfig.batch)
    assert f"samples a step, over all processes (default: {batch})" in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"batch": 0}, "batch must be positive, got 0"),
        ({"steps": -1}, "steps must be positive"),
        ({"learning_rate": math.nan}, "learning_rate must be positive, got nan"),
        ({"learning_rate": math.inf}, "learning_rate must be positive, got inf"),
        ({"jitter_sigma": -0.1}, "jitter_sigma must be 0 or more"),
        ({"weight_surface": -1.0}, "weight_surface must be 0 or more"),
        ({"clip_norm": -1.0}, "clip_norm must be 0 or more"),
        ({"procedural_share": 1.5}, "procedural_share must be within"),
        ({"ema_decay": 1.0}, "ema_decay must be within"),
        ({"max_downsampling": 0.5}, "max_downsampling must be 1 or more"),
        ({"degraded_share": -0.1}, "degraded_share must be within"),
        ({"jitter_clip": math.nan}, "jitter_clip must be 0 or more"),
        ({"num_targets": 0}, "num_targets must be positive, got 0"),
        ({"fresh_saliency": True}, "fresh_saliency needs init"),
        ({"resolution": 4, "unet_levels": 4}, "4 levels do not fit a volume of 4 voxels"),
        ({"c_dim": 12}, "divide"),
        ({"unet_base_channels": 12}, "divide"),
    ],
)
def test_settings_that_cannot_train_are_refused(changes, message):
    with pytest.raises(ValueError, match=message.replace("[", r"\[")):
        check(TrainConfig(**TINY | changes))


@pytest.mark.parametrize(
    "words", [["--rotation", "quaternion"], ["--batch", "many"], ["--preset", "small"], ["--unknown", "1"]]
)
def test_words_that_mean_nothing_are_refused(words, capsys):
    with pytest.raises(SystemExit) as stop:
        parse_arguments(words, "")
    assert stop.value.code == 2 and words[0] in capsys.readouterr().err
