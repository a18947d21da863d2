"""PointNet++ (Qi et al. 2017), the second point encoder: features of points from two sizes of neighbourhood.

Neighbourhoods are balls about centres that farthest-point sampling chooses. Each has the maximum of a small network over its
points. Features return from the centres to the points by interpolation. Two things differ from the released PointNet++: a ball
holds all points within its radius instead of a fixed number, so the order of the points does not matter, and there is no
batch normalisation, so a cloud's features do not depend on other clouds.
"""

import torch
from torch import nn

CENTERS = 512, 128  # of the fine and of the coarse balls
RADII = 0.1, 0.25  # in network units
FAR = 1e3  # where centres are put that a cloud of few distinct points does not have


def two_layers(size_in, size_hidden, size_out):
    """Two fully connected layers, each with a ReLU."""
    return nn.Sequential(nn.Linear(size_in, size_hidden), nn.ReLU(), nn.Linear(size_hidden, size_out), nn.ReLU())


@torch.no_grad()
def farthest_points(points, number):
    """Indices (B, number) of points (B, N, 3), each the farthest from all before it, and how many are distinct, (B,).

    The first is the farthest from the mean, so the choice rotates with the cloud. Of equally far points it is the first.
    """
    points = points.double()
    rows = torch.arange(len(points), device=points.device)
    gap = (points - points.mean(dim=1, keepdim=True)).square().sum(dim=2)
    nearest = torch.full_like(gap, torch.inf)
    chosen, distinct = [], torch.ones_like(rows)
    for count in range(number):
        farthest = gap.argmax(dim=1)
        if count:
            distinct += gap[rows, farthest] > 0
        chosen.append(farthest)
        nearest = torch.minimum(nearest, (points - points[rows, farthest, None]).square().sum(dim=2))
        gap = nearest
    return torch.stack(chosen, dim=1), distinct


def distances(a, b):
    """Distances (B, P, Q) of points (B, P, 3) from points (B, Q, 3), without the rounding of matrix products."""
    return torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")


class PointNet2(nn.Module):
    """Points (B, N, 3) -> features (B, N, hidden)."""

    def __init__(self, hidden):
        super().__init__()
        self.fine = two_layers(3, hidden, hidden)
        self.coarse = two_layers(3 + hidden, 2 * hidden, 2 * hidden)
        self.to_fine = two_layers(3 * hidden, 2 * hidden, hidden)
        self.to_points = two_layers(hidden + 3, hidden, hidden)

    def forward(self, points):
        chosen, distinct = farthest_points(points, min(CENTERS[0], points.shape[1]))
        fine = points.gather(1, chosen.unsqueeze(2).expand(-1, -1, 3))
        absent = torch.arange(fine.shape[1], device=points.device) >= distinct.unsqueeze(1)
        fine = fine.masked_fill(absent.unsqueeze(2), FAR)
        coarse = fine[:, : CENTERS[1]]  # the first ones of the fine centres are what sampling them again would choose
        of_fine = maxima(self.fine, RADII[0], fine, points)
        of_coarse = maxima(self.coarse, RADII[1], coarse, fine, of_fine)
        of_fine = self.to_fine(torch.cat([interpolate(fine, coarse, of_coarse), of_fine], dim=2))
        return self.to_points(torch.cat([interpolate(points, fine, of_fine), points], dim=2))


def maxima(network, radius, centers, points, features=None):
    """Maximum (B, C, F) of a network over the points (B, N, 3) within a radius of each center (B, C, 3).

    Its input is a point's offset from the centre as a share of the radius, and its feature (B, N, .) if there are any.
    """
    batch, center, point = (distances(centers, points) <= radius).nonzero(as_tuple=True)
    inputs = (points[batch, point] - centers[batch, center]) / radius
    if features is not None:
        inputs = torch.cat([inputs, features[batch, point]], dim=1)
    values = network(inputs)
    most = values.new_zeros(centers.shape[0] * centers.shape[1], values.shape[1])  # what a ReLU is at least
    index = (batch * centers.shape[1] + center).unsqueeze(1).expand_as(values)
    return most.scatter_reduce(0, index, values, "amax").unflatten(0, centers.shape[:2])


def interpolate(queries, centers, features):
    """Features (B, Q, F) at queries (B, Q, 3): the mean of those (B, C, F) of the three nearest centers (B, C, 3).

    The weights are 1 / squared distance.
    """
    distance, nearest = distances(queries, centers).topk(min(3, centers.shape[1]), dim=2, largest=False)
    weights = 1 / (distance.square() + 1e-8)
    weights = weights / weights.sum(dim=2, keepdim=True)
    rows = torch.arange(len(queries), device=queries.device)[:, None, None]
    return (weights.unsqueeze(3) * features[rows, nearest]).sum(dim=2)
