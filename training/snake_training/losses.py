"""The four losses of SNAKE (section 3.2) on one view or a pair of views, with the masks of the released code, and the
losses of distillation.

Occupancy and saliency are probabilities; a local grid is a row of H^3 values. `inside` marks grid points within the
volume. Occupancies are detached wherever they weigh a saliency, so that only the occupancy loss shapes the surface.
"""

from functools import partial

import torch
import torch.distributed as dist
import torch.nn.functional as F

from .augment import BOUND

LOSSES = "occupancy", "repeatability", "surface", "sparsity"


def inside_volume(queries):
    """(..., 3) -> (...): within the padded volume."""
    return (queries.abs() <= BOUND).all(dim=-1)


def masked_mean(values, mask, processes=1):
    """Mean of the values where the mask is set; 0 where it nowhere is.

    With several processes the divisor is their mean count: then the mean of their losses, whose gradient
    DistributedDataParallel takes, is the mean over the whole batch, however unevenly the masks fall.
    """
    count = mask.sum().float()
    if processes > 1:
        dist.all_reduce(count)
    return processes * (mask * values).sum() / count.clamp(min=1)


def mean_of_views(loss, *fields, processes=1):
    """Mean of a loss over the two views of fields (B, 2, ...), each view with its own mean, as in the released code."""
    views = zip(*(field.unbind(1) for field in fields))
    return sum(loss(*view, processes) for view in views) / 2


def occupancy_loss(occupancy, target):
    """Binary cross-entropy of eq. 2, with the released code's log(x + 1e-5)."""
    return -(target * torch.log(occupancy + 1e-5) + (1 - target) * torch.log(1 - occupancy + 1e-5)).mean()


def repeatability_loss(saliency_1, saliency_2, inside_1, inside_2, processes=1):
    """Eq. 3: one minus the mean cosine similarity of local grids (..., G, H^3) that lie over 90 % inside both views."""
    seen = (inside_1.float().mean(dim=-1) > 0.9) & (inside_2.float().mean(dim=-1) > 0.9)
    similarity = F.cosine_similarity(saliency_1, saliency_2, dim=-1)
    return masked_mean(1 - similarity, seen, processes)


def surface_loss(occupancy, saliency, counted, processes=1):
    """Eq. 4: saliency where there is no surface, mean over the counted queries."""
    return masked_mean((1 - occupancy.detach()) * saliency, counted, processes)


def sparsity_loss(occupancy, saliency, inside, processes=1, ridge=0.0):
    """Eq. 5: one minus (maximum - mean) of the saliency over the occupied points of each local grid (..., G, H^3).

    Counts grids that lie over 80 % inside and are occupied in more than 5 % of their points. Occupied are points of
    occupancy 0.5; with `ridge`, only those that also have this share of the highest occupancy of their grid.
    """
    occupancy = occupancy.detach()
    occupied = occupancy >= 0.5
    seen = (inside.float().mean(dim=-1) > 0.8) & (occupied.float().mean(dim=-1) > 0.05)
    occupied &= occupancy >= ridge * occupancy.amax(dim=-1, keepdim=True)
    on_surface = saliency * occupied
    mean = on_surface.sum(dim=-1) / (occupied.sum(dim=-1) + 1e-5)
    peakedness = on_surface.amax(dim=-1) - mean
    return masked_mean(1 - peakedness, seen, processes)


def snake_losses(network, batch, autocast, processes=1, ridge=0.0):
    """The four losses of a batch of two-view samples, by name, and the share of saturated grid points on the surface.

    batch: points (B, 2, N, 3), occupancy_queries (B, 2, 2 K, 3), grids (B, 2, G, H^3, 3), one of equal parts if there
    are several processes.
    """
    points, queries, grids = batch["points"], batch["occupancy_queries"], batch["grids"]
    size, _, number, _ = queries.shape
    _, _, num_grids, cells, _ = grids.shape
    everywhere = torch.cat([queries, grids.flatten(2, 3)], dim=2).flatten(0, 1)
    occupancy, saliency = network(points.flatten(0, 1), everywhere, autocast)
    occupancy, saliency = (field.unflatten(0, (size, 2)) for field in (occupancy, saliency))
    grid_occupancy, grid_saliency = (
        field[:, :, number:].unflatten(2, (num_grids, cells)) for field in (occupancy, saliency)
    )
    inside = inside_volume(grids)
    counted = torch.cat([torch.ones_like(queries[..., 0], dtype=torch.bool), inside.flatten(2, 3)], dim=2)
    target = (torch.arange(number, device=points.device) < number // 2).float()
    losses = {
        "occupancy": occupancy_loss(occupancy[:, :, :number], target),
        "repeatability": repeatability_loss(*grid_saliency.unbind(1), *inside.unbind(1), processes),
        "surface": mean_of_views(surface_loss, occupancy, saliency, counted, processes=processes),
        "sparsity": mean_of_views(
            partial(sparsity_loss, ridge=ridge), grid_occupancy, grid_saliency, inside, processes=processes
        ),
    }
    on_surface = inside & (grid_occupancy >= 0.5)
    return losses, masked_mean((grid_saliency.detach() > 0.9).float(), on_surface, processes)


def distillation_losses(network, batch, autocast, processes=1):
    """Occupancy (eq. 2), distance of both views' saliency to the target and to each other; share of saturated queries.

    Distances are Huber's, of log-odds. batch: that of `snake_losses` with queries (B, 2, Q, 3) of target (B, Q) in
    place of the grids. Means over equal parts need no correction for several processes.
    """
    points, surface, queries, target = (batch[k] for k in ("points", "occupancy_queries", "queries", "target"))
    size, _, number, _ = surface.shape
    occupancy, saliency = network(points.flatten(0, 1), torch.cat([surface, queries], dim=2).flatten(0, 1), autocast)
    occupancy, saliency = (field.unflatten(0, (size, 2)) for field in (occupancy, saliency))
    student = torch.logit(saliency[:, :, number:], eps=1e-6)
    label = (torch.arange(number, device=points.device) < number // 2).float()
    losses = {
        "occupancy": occupancy_loss(occupancy[:, :, :number], label),
        "distillation": F.smooth_l1_loss(student, target[:, None].expand_as(student)),
        "consistency": F.smooth_l1_loss(*student.unbind(1)),
    }
    return losses, (saliency[:, :, number:].detach() > 0.9).float().mean()
