"""Models in Python: loading, names, recommended options."""

import json
import pickle

import numpy as np
import pytest
from golden_network import EASY, GOLDEN, same, with_metadata
from safetensors.numpy import load_file

import snake_rs


def test_a_model_has_its_configuration_and_metadata(model):
    assert model.config["resolution"] == (25, 25, 25)
    assert (model.config["c_dim"], model.config["padding"], model.config["unet_levels"]) == (32, 0.125, 3)
    assert model.metadata["format"] == "snake-field" and model.metadata["resolution"] == "[25, 25, 25]"
    # Older files do not name the scattering and the point encoder.
    assert set(model.config) - {"scatter"} < set(model.metadata)
    assert model.config["scatter"] == "hard"
    tensors = load_file(GOLDEN / "odd" / "weights.safetensors")
    assert model.num_parameters == sum(tensor.size for tensor in tensors.values())
    assert (
        repr(model)
        == f"Model(weights.safetensors, {model.num_parameters} parameters, volume 25 x 25 x 25 voxels of 32 channels)"
    )


def test_load_and_from_bytes_give_the_same_model(model, field, points):
    path = GOLDEN / "odd" / "weights.safetensors"
    for other in (snake_rs.Model.from_bytes(path.read_bytes()), snake_rs.Model.load(str(path))):
        assert other.metadata == model.metadata
        assert np.array_equal(other.encode(points).volume, field.volume)


def test_models_can_be_pickled(model, field, points):
    copy = pickle.loads(pickle.dumps(model))
    assert np.array_equal(copy.encode(points).volume, field.volume)


def test_built_in_models_have_names(points):
    scenes = snake_rs.Model.builtin("scenes")
    assert scenes.recommended["nms_radius"] == "6.5v" and scenes.metadata["name"] == "scenes"
    kept = pickle.dumps(scenes)
    assert len(kept) < 1000 and pickle.loads(kept).metadata == scenes.metadata
    assert snake_rs.Model.builtin("compact").metadata == snake_rs.Model.builtin().metadata != scenes.metadata
    assert len(snake_rs.detect(points, scenes, min_confidence=0)) > 0
    with pytest.raises(ValueError, match="compact, standard or scenes"):
        snake_rs.Model.builtin("potatoes")


def test_unreadable_files_raise_os_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match="No such file") as error:
        snake_rs.Model.load(tmp_path / "missing.safetensors")
    assert error.value.errno == 2 and error.value.filename == str(tmp_path / "missing.safetensors")
    with pytest.raises(IsADirectoryError):
        snake_rs.Model.load(tmp_path)
    with pytest.raises(ValueError, match="safetensors"):
        snake_rs.Model.from_bytes(b"not a weight file")


def test_presets_replace_the_recommended_options(points):
    encode = {"normalization": "unit-cube", "max_points": 300, "seed": 5}
    recommended = {"encode": encode, "detect": EASY | {"nms_radius": 0.5}}
    model = snake_rs.Model.from_bytes(with_metadata("odd", recommended_options=json.dumps(recommended)))
    assert model.recommended == model.recommended | recommended["encode"] | recommended["detect"]
    assert model.recommended["max_keypoints"] == 64 and model.recommended["saliency_threshold"] == 0.0
    field = model.encode(points)
    assert "300 of 700 points" in repr(field)
    assert np.ptp((points - field.normalization[0]) / field.normalization[1]) == pytest.approx(1.0, abs=0.2)
    found = field.detect()
    assert found.counts["queries"] == 12**3 and len(found) > 1
    assert same(found, snake_rs.detect(points, model))
    assert same(found, snake_rs.detect(points, model, **model.recommended))
    assert same(found, snake_rs.detect(points, model, preset=None))
    other = model.encode(points, preset="modelnet40")
    assert np.array_equal(other.volume, model.encode(points, normalization="unit-sphere", max_points=None).volume)
    assert not np.array_equal(other.volume, field.volume)
    named = field.detect(preset="keypointnet", query_resolution=9)
    assert named.counts["queries"] == 9**3
    plain = {"refine_steps": 10, "surface_threshold": 0.8, "saliency_threshold": 0.7, "nms_radius": 0.1}
    assert same(named, field.detect(**plain, query_resolution=9))
