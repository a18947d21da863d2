"""Each loss and each mask on values worked out by hand."""

import math

import numpy as np
import pytest
import torch

from conftest import judged
from snake_training.augment import inside_volume
from snake_training.config import check
from snake_training.data import Procedural
from snake_training.losses import (
    loss_options,
    losses_of,
    occupancy_loss,
    repeatability_loss,
    sparsity_loss,
    surface_loss,
)
from snake_training.tasks.objects import make_batch
from snake_training.train import total_loss

ALL = torch.ones(1, 10, dtype=torch.bool)


def inside(number, of):
    """One grid of which `number` of `of` points are inside."""
    return (torch.arange(of) < number)[None]


def test_inside_volume_is_the_padded_cube():
    points = np.array([[0.5625, 0, 0], [0.5626, 0, 0], [0, -0.5625, 0], [0, 0, -0.57]])
    assert inside_volume(points).tolist() == [True, False, True, False]


def test_occupancy_loss_is_cross_entropy():
    value = occupancy_loss(torch.tensor([[0.25, 0.75]]), torch.tensor([1.0, 0.0]))
    assert value.item() == pytest.approx(-math.log(0.25 + 1e-5), rel=1e-6)


def test_repeatability_loss_of_equal_scaled_and_orthogonal_grids():
    first = torch.tensor([[1.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    second = torch.tensor([[0.5, 0.0], [1.0, 1.0], [0.0, 1.0]])
    seen = torch.ones(3, 2, dtype=torch.bool)
    assert repeatability_loss(first, second, seen, seen).item() == pytest.approx(1 / 3, abs=1e-6)


@pytest.mark.parametrize(("first", "second", "counts"), [(10, 10, True), (9, 10, False), (10, 9, False)])
def test_repeatability_counts_grids_over_nine_tenths_inside_in_both_views(first, second, counts):
    one, other = torch.zeros(1, 10), torch.zeros(1, 10)
    one[0, 0] = other[0, 1] = 1
    assert repeatability_loss(one, other, inside(first, 10), inside(second, 10)).item() == counts


def test_repeatability_averages_over_the_grids_that_count():
    one, other = torch.tensor([[1.0, 0.0]] * 2), torch.tensor([[0.0, 1.0]] * 2)
    mask = torch.tensor([[True, True], [True, False]])
    assert repeatability_loss(one, other, mask, mask).item() == 1


def test_surface_loss_weighs_saliency_off_the_surface_over_counted_queries():
    occupancy, saliency = torch.tensor([1.0, 0.0, 0.5, 0.0]), torch.tensor([0.9, 0.6, 0.4, 1.0])
    counted = torch.tensor([True, True, True, False])
    assert surface_loss(occupancy, saliency, counted).item() == pytest.approx((0.6 + 0.2) / 3)


def test_sparsity_loss_is_one_minus_peak_over_mean_on_the_surface():
    # Three occupied points; 0.5 is occupied, the salient fourth point is not on the surface.
    occupancy = torch.tensor([[0.9, 0.5, 0.7, 0.49]])
    saliency = torch.tensor([[0.8, 0.1, 0.3, 1.0]])
    value = sparsity_loss(occupancy, saliency, torch.ones(1, 4, dtype=torch.bool))
    assert value.item() == pytest.approx(1 - (0.8 - 1.2 / 3), abs=1e-5)


def test_sparsity_with_a_ridge_does_not_count_the_rim():
    occupancy, saliency = torch.tensor([[1.0, 0.95, 0.6, 0.2]]), torch.tensor([[0.5, 0.3, 0.9, 0.0]])
    everywhere = torch.ones(1, 4, dtype=torch.bool)
    assert sparsity_loss(occupancy, saliency, everywhere).item() == pytest.approx(1 - (0.9 - 1.7 / 3), abs=1e-4)
    assert sparsity_loss(occupancy, saliency, everywhere, ridge=0.9).item() == pytest.approx(1 - (0.5 - 0.4), abs=1e-4)


@pytest.mark.parametrize(("points_inside", "counts"), [(9, True), (8, False)])
def test_sparsity_counts_grids_over_eight_tenths_inside(points_inside, counts):
    occupancy, saliency = torch.ones(1, 10), torch.full((1, 10), 0.5)
    assert sparsity_loss(occupancy, saliency, inside(points_inside, 10)).item() == pytest.approx(
        float(counts), abs=1e-5
    )


@pytest.mark.parametrize(("occupied", "counts"), [(2, True), (1, False), (0, False)])
def test_sparsity_counts_grids_over_a_twentieth_occupied(occupied, counts):
    occupancy = inside(occupied, 20).float()
    loss = sparsity_loss(occupancy, torch.full((1, 20), 0.5), torch.ones(1, 20, dtype=torch.bool))
    assert loss.item() == pytest.approx(float(counts), abs=1e-5)


def test_surface_and_sparsity_send_no_gradient_to_the_occupancy():
    occupancy, saliency = (torch.full((1, 10), 0.6, requires_grad=True) for _ in range(2))
    (surface_loss(occupancy, saliency, ALL) + sparsity_loss(occupancy, saliency, ALL)).backward()
    assert occupancy.grad is None
    assert saliency.grad.abs().sum() > 0


def test_no_grid_inside_gives_zero_and_no_nan_in_value_or_gradient():
    occupancy = torch.ones(1, 10)
    saliency = torch.zeros(1, 10, requires_grad=True)  # cosine similarity of zeros, too
    losses = (
        repeatability_loss(saliency, saliency, ~ALL, ~ALL),
        surface_loss(occupancy, saliency, ~ALL),
        sparsity_loss(occupancy, saliency, ~ALL),
    )
    sum(losses).backward()
    assert [loss.item() for loss in losses] == [0, 0, 0]
    assert torch.equal(saliency.grad, torch.zeros(1, 10))


def test_losses_of_puts_each_query_where_it_belongs():
    """Two occupancy queries and one grid of two points a view, all four losses by hand."""
    # View 1: both right. View 2: the surface one is wrong.
    occupancy = torch.tensor([[[1.0, 0, 1, 1], [0.0, 0, 1, 0]]])
    saliency = torch.tensor([[[0.1, 0.2, 0.3, 0.1], [0.1, 0.4, 0.3, 0.7]]])
    # One grid of two points, of which view 2 has one outside.
    batch = {"label": torch.tensor([1.0, 0.0]), "inside": torch.tensor([[[[True, True]], [[True, False]]]])}
    losses, share = losses_of(occupancy, saliency, batch)
    assert losses["occupancy"].item() == pytest.approx((3 * -math.log(1 + 1e-5) - math.log(1e-5)) / 4, rel=1e-5)
    assert losses["repeatability"].item() == 0  # the only grid is half outside in view 2
    # Off the surface: 0.2 of four in view 1; 0.1 and 0.4 of three in view 2, whose grid point outside is not counted.
    # The mean of the two views' means, as the released code has it, not the mean of all seven.
    assert losses["surface"].item() == pytest.approx((0.2 / 4 + (0.1 + 0.4) / 3) / 2, rel=1e-5)
    assert losses["sparsity"].item() == pytest.approx((1 - (0.3 - 0.2)) / 2, abs=1e-5)  # view 2 has no grid and adds 0
    assert share.item() == 0


def test_without_an_occupancy_decoder_all_points_of_a_grid_count(tiny):
    """Table 4, first row: 1 - (maximum - mean) over the whole grid, whatever an untrained decoder says."""
    occupancy = torch.tensor([[[1.0, 0, 0.9, 0.1, 0.2, 0.3]] * 2])
    saliency = torch.tensor([[[0.1, 0.2, 0.3, 0.1, 0.8, 0.4]] * 2])
    batch = {"label": torch.tensor([1.0, 0.0]), "inside": torch.ones(1, 2, 1, 4, dtype=torch.bool)}
    settings = tiny(occupancy_decoder=False, weight_occupancy=0, weight_surface=0)
    losses, _ = losses_of(occupancy, saliency, batch, **loss_options(settings))
    assert losses["sparsity"].item() == pytest.approx(1 - (0.8 - 0.4), abs=1e-5)
    masked, _ = losses_of(occupancy, saliency, batch, **loss_options(tiny()))
    assert masked["sparsity"].item() == pytest.approx(1 - (0.3 - 0.3), abs=1e-4)  # one occupied point of four
    for weights in (dict(weight_occupancy=0), dict(weight_surface=0), {}):
        with pytest.raises(ValueError, match="without occupancy_decoder weight_occupancy and weight_surface must be 0"):
            check(tiny(occupancy_decoder=False, **weights))


def test_a_weight_of_zero_switches_a_loss_off(tiny, network):
    config = tiny()
    batch = make_batch(Procedural(), config, 0, 2)
    losses, _ = judged(network, batch)
    assert total_loss(losses, config).item() == pytest.approx(sum(loss.item() for loss in losses.values()))
    only = tiny(weight_repeatability=0, weight_surface=0, weight_sparsity=0, weight_occupancy=2)
    loss = total_loss(losses, only)
    assert loss.item() == pytest.approx(2 * losses["occupancy"].item())
    loss.backward()
    assert all(not parameter.grad.any() for parameter in network.decoder_keypoint.parameters())
    assert all(parameter.grad.any() for parameter in network.decoder_occup.parameters())


def test_losses_of_a_real_sample_are_finite_and_reach_every_weight(tiny, network):
    config = tiny()
    batch = make_batch(Procedural(), config, 0, 2)
    assert {name: tuple(value.shape) for name, value in batch.items()} == {
        "points": (2, 2, 128, 3),
        "queries": (2, 2, 64 + 8 * 27, 3),
        "inside": (2, 2, 8, 27),
        "label": (64,),
    }
    losses, saturated = judged(network, batch)
    assert all(torch.isfinite(loss) for loss in losses.values())
    assert 0 <= saturated <= 1
    total_loss(losses, config).backward()
    untouched = [name for name, parameter in network.named_parameters() if not parameter.grad.any()]
    assert untouched == []
