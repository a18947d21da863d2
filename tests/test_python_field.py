"""Fields in Python: queries and the values of the reference network."""

import numpy as np
import pytest


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
