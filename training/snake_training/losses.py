"""The losses (SNAKE section 3.2): the four of the paper, with the masks of the released code, and those of a student.

A task draws points, queries and what is known of them; the network answers; `losses_of` judges, the same for objects and scenes.
Occupancy and saliency are probabilities; a local grid is a row of H^3 values. `inside` marks grid points within the volume.
Occupancies are detached wherever they weigh a saliency, so that only the occupancy loss shapes the surface.
"""

from functools import partial

import torch
import torch.distributed as dist
import torch.nn.functional as F

LOSSES = "occupancy", "repeatability", "surface", "sparsity"


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


def occupancy_loss(occupancy, label):
    """Binary cross-entropy of eq. 2, with the released code's log(x + 1e-5)."""
    return -(label * torch.log(occupancy + 1e-5) + (1 - label) * torch.log(1 - occupancy + 1e-5)).mean()


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
    occupancy 0.5; with `ridge`, which is not in the paper, those that also have this share of the highest of their grid.
    """
    occupancy = occupancy.detach()
    occupied = occupancy >= 0.5
    seen = (inside.float().mean(dim=-1) > 0.8) & (occupied.float().mean(dim=-1) > 0.05)
    occupied &= occupancy >= ridge * occupancy.amax(dim=-1, keepdim=True)
    on_surface = saliency * occupied
    mean = on_surface.sum(dim=-1) / (occupied.sum(dim=-1) + 1e-5)
    peakedness = on_surface.amax(dim=-1) - mean
    return masked_mean(1 - peakedness, seen, processes)


def losses_of(occupancy, saliency, batch, processes=1, ridge=0.0, has_occupancy=True):
    """The losses of a batch by name, and the share of saturated queries.

    occupancy, saliency (B, 2, K + Q): the network's answers for two views of B samples, first at K occupancy queries whose
    `label` (K,) says which lie on the surface. batch holds either `inside` (B, 2, G, H^3), of the local grids that the other
    Q = G H^3 queries are, or their `target` (B, Q), log-odds of the saliency that a student learns. It is one of equal parts
    if there are several processes. `ridge` is `sparsity_loss`'s. Without `has_occupancy` nothing has learnt the surface, and all
    points of the local grids count as occupied (table 4, first row).
    """
    label = batch["label"]
    number = len(label)
    losses = {"occupancy": occupancy_loss(occupancy[:, :, :number], label)}
    if "target" in batch:
        return losses | student_losses(saliency[:, :, number:], batch["target"]), saturated(saliency[:, :, number:])
    inside = batch["inside"]
    grid_occupancy, grid_saliency = (
        field[:, :, number:].unflatten(2, inside.shape[2:]) for field in (occupancy, saliency)
    )
    if not has_occupancy:
        grid_occupancy = torch.ones_like(grid_occupancy)
    counted = torch.cat([torch.ones_like(occupancy[..., :number], dtype=torch.bool), inside.flatten(2)], dim=2)
    losses |= {
        "repeatability": repeatability_loss(*grid_saliency.unbind(1), *inside.unbind(1), processes),
        "surface": mean_of_views(surface_loss, occupancy, saliency, counted, processes=processes),
        "sparsity": mean_of_views(
            partial(sparsity_loss, ridge=ridge), grid_occupancy, grid_saliency, inside, processes=processes
        ),
    }
    return losses, saturated(grid_saliency, inside & (grid_occupancy >= 0.5), processes)


def loss_options(settings):
    """The options of `losses_of` that settings of a run choose."""
    return {"ridge": settings.sparsity_ridge, "has_occupancy": settings.occupancy_decoder}


def student_losses(saliency, target):
    """Distance of both views' saliency (B, 2, Q) to the target (B, Q), and to each other: Huber's, of log-odds.

    Means over equal parts need no correction for several processes.
    """
    student = saliency_log_odds(saliency)
    return {
        "distillation": F.smooth_l1_loss(student, target[:, None].expand_as(student)),
        "consistency": F.smooth_l1_loss(*student.unbind(1)),
    }


def saliency_log_odds(saliency):
    """Log-odds of the saliency, within +-13.8."""
    return torch.logit(saliency, eps=1e-6)


def saturated(saliency, counted=None, processes=1):
    """Share of the counted queries with a saliency above 0.9."""
    above = (saliency.detach() > 0.9).float()
    return above.mean() if counted is None else masked_mean(above, counted, processes)
