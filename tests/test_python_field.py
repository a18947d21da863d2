"""Fields in Python: queries and the values of the reference network."""

import numpy as np
import pytest
from golden_network import GOLDEN
from safetensors import safe_open
from safetensors.numpy import load_file

import snake_rs


def test_fields_answer_queries(model, field, points):
    queries = points[:50]
    for value, both in (
        (field.occupancy, field.occupancy_and_gradient),
        (field.saliency, field.saliency_and_gradient),
    ):
        values, gradients = both(queries)
        assert value(queries).dtype == values.dtype == gradients.dtype == np.float32
        assert values.shape == (50,) and gradients.shape == (50, 3) and gradients.any()
        assert np.allclose(value(queries), values, atol=1e-6)
        assert 0 <= values.min() < values.max() <= 1
    assert not np.array_equal(field.occupancy(queries), field.saliency(queries))
    descriptors = field.descriptors(queries)
    assert descriptors.shape == (50, 32) and descriptors.dtype == np.float32
    assert np.linalg.norm(descriptors, axis=1) == pytest.approx(np.ones(50), abs=1e-5)


def test_empty_queries_give_empty_results(field):
    for dtype in (np.float32, np.float64):
        none = np.zeros((0, 3), dtype)
        assert field.occupancy(none).shape == field.saliency(none).shape == (0,)
        for values, gradients in (field.occupancy_and_gradient(none), field.saliency_and_gradient(none)):
            assert values.shape == (0,) and gradients.shape == (0, 3)
        assert field.descriptors(none).shape == (0, 32)


@pytest.mark.parametrize("name", ["tiny", "odd", "anisotropic"])
def test_golden_networks_give_the_reference_values(name):
    golden = load_file(GOLDEN / name / "io.safetensors")
    with safe_open(GOLDEN / name / "io.safetensors", "np") as file:
        resolution = int(file.metadata()["query_resolution"])
    model = snake_rs.Model.load(GOLDEN / name / "weights.safetensors")
    field = model.encode(golden["points"], normalization="none")
    volume = field.volume
    x, y, z = model.config["resolution"]
    assert volume.shape == (model.config["c_dim"], z, y, x) and volume.dtype == np.float32
    flat = volume.reshape(len(volume), -1).T
    assert np.abs(flat[golden["volume_sample_index"]] - golden["volume_sample_values"]).max() < 1e-4
    for quantity in ("occupancy", "saliency"):
        values, gradients = getattr(field, f"{quantity}_and_gradient")(golden["queries"])
        assert np.abs(values - golden[quantity]).max() < 1e-4
        error = np.linalg.norm(gradients - golden[f"{quantity}_grad"], axis=1)
        assert np.percentile(error, 99) < 1e-3 * np.linalg.norm(golden[f"{quantity}_grad"], axis=1).max()
    found = field.detect(query_resolution=resolution, refine_steps=0)
    assert found.counts["occupied"] == pytest.approx(len(golden["refine_start"]), abs=1)
