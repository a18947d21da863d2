"""Learning from objects: by the four losses from two views of a cloud, or as a student of a teacher's saliency."""

from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from ..augment import degraded, normalize, student_views, two_views
from ..data import Mixture, Procedural, open_all
from ..data.landmarks import landmarks
from ..detection import DetectOptions, candidates, suppress, why_none
from ..evaluation.repeatability import relative_repeatability
from ..evaluation.views import view_pairs
from ..export import build_network, load_network
from ..losses import LOSSES, loss_options, losses_of
from ..model import Decoder, SnakeNetwork
from ..teacher import Targets


class Objects:
    """Whole shapes, one a sample, in the cube +-0.5. What cannot be read is an OSError or a ValueError."""

    def __init__(self, config):
        self.settings, self.network_config = config, config.network
        clouds = open_all(config.data, config.split)
        self.shapes = Targets(*config.targets) if config.targets else Mixture(clouds, config.procedural_share)
        self.held_out = Mixture(open_all(config.validation_data, config.validation_split) or [Procedural()], 0.0)

    def network(self):
        """The network of the settings, with the weights of `init` if there is one, whatever its resolution."""
        config = self.settings
        if not config.init:
            return SnakeNetwork(config.network)
        try:
            network = build_network(config.network, load_network(config.init).state_dict())
        except ValueError as error:
            raise ValueError(f"init {config.init}: {error}") from error
        if config.fresh_saliency:
            start_saliency(network)
        return network

    def batch(self, first, number):
        """Samples of the training shapes."""
        return make_batch(self.shapes, self.settings, first, number)

    def ready(self, batch):
        """The batch as it is: what a teacher says of a shape is in its file."""
        return batch

    def answer(self, model, batch, autocast):
        """The two fields at the queries of both views."""
        size = len(batch["points"])
        fields = model(batch["points"].flatten(0, 1), batch["queries"].flatten(0, 1), autocast)
        return tuple(field.unflatten(0, (size, 2)) for field in fields)

    def validate(self, network, device, autocast):
        """The four losses, the share of saturated queries, and relative repeatability on unseen shapes.

        Repeatability is at epsilon 0.04 of clouds of radius 1, with suppression at 0.01 and at 0.05.
        """
        config = self.settings
        normalization = "unit-sphere" if config.normalization == "mixed" else config.normalization
        options = DetectOptions(normalization=normalization, query_resolution=config.validation_resolution)
        if not config.occupancy_decoder:
            options = replace(options, occupancy_threshold=0.0, surface_threshold=0.0)
        network.eval()
        figures = self.validation_losses(network, device, autocast)

        shares, counts, radii = [], [], (0.01, 0.05)
        for views in view_pairs(self.held_out, config.validation_objects, 5000, 0):
            found = [candidates(network, view, options)[:, :3] for view in (views.view_1, views.view_2)]
            kept = [[points[suppress(points, radius, limit=64)].numpy() for points in found] for radius in radii]
            shares.append([relative_repeatability(*both, views.t_1_2, [0.04])[0] for both in kept])
            counts.append([len(first) for first, _ in kept])
        for radius, share, count in zip(radii, np.mean(shares, axis=0), np.mean(counts, axis=0)):
            figures |= {f"repeatability_nms_{radius}": float(share), f"keypoints_nms_{radius}": float(count)}
        if figures["keypoints_nms_0.01"] == 0:
            cloud = next(view_pairs(self.held_out, 1, 5000, 0)).view_1
            tqdm.write(f"warning: no keypoint in the validation: {why_none(network, cloud, options)}")
        return figures

    def validation_losses(self, network, device, autocast):
        """The means of the four losses and of the share of saturated queries, over random samples or over each shape once."""
        config, results, sizes = self.settings, [], []
        number = config.validation_samples or len(self.held_out)
        for first in range(0, number, 4):
            sizes.append(min(4, number - first))
            batch = make_batch(
                self.held_out, config, first, sizes[-1], stream=1, in_order=config.validation_samples == 0
            )
            batch = {name: tensor.to(device) for name, tensor in batch.items()}
            with torch.no_grad():
                results.append(losses_of(*self.answer(network, batch, autocast), batch, **loss_options(config)))
        losses = {name: [losses[name].item() for losses, _ in results] for name in LOSSES}
        losses["saturated"] = [share.item() for _, share in results]
        return {name: float(np.average(values, weights=sizes)) for name, values in losses.items()}

    def score(self, figures):
        """How good a validation is, by which the best is chosen."""
        if self.settings.best_by == "loss":
            return -sum(getattr(self.settings, f"weight_{name}") * figures[name] for name in LOSSES)
        return figures["repeatability_nms_0.01"] + figures["repeatability_nms_0.05"]


def start_saliency(network, shapes=6, steps=400):
    """A new saliency decoder that knows the corners and tips of so many made boxes, nuts and animals, also of noisy and thin views.

    The losses do not say where the peaks are to lie, only that both views agree and that there are some everywhere. They keep
    the positions that they find, if the encoder has learnt by all of them before; a decoder drawn at random ends some voxels from
    every edge. SuperPoint (DeTone et al. 2018) begins at the corners of made shapes as well.
    """
    device = next(network.parameters()).device
    network.decoder_keypoint = Decoder(network.config).to(device)
    volumes, clouds, near = [], [], []
    for row in range(shapes):
        for name in ("box", "nut", "animal"):
            rng = np.random.default_rng(row)
            points, at = landmarks(name, rng)
            points = normalize(points)[0]
            cloud = torch.from_numpy(points).to(device)
            for seen in (points, degraded(points, rng)):
                with torch.no_grad():
                    volumes.append(network.encode(torch.from_numpy(seen).to(device)[None]))
                clouds.append(cloud)
                near.append(torch.cdist(cloud, cloud[at]).amin(dim=1) / 0.025)
    volumes, clouds, near = torch.cat(volumes), torch.stack(clouds), torch.stack(near)
    wanted, weight = 0.02 + 0.9 * torch.exp(-(near**2)), torch.where(near < 2, 4.0, 1.0)
    adam = torch.optim.Adam(network.decoder_keypoint.parameters(), lr=2e-3)
    for _ in range(steps):
        row, column = torch.randint(len(clouds), (8,)), torch.randint(clouds.shape[1], (256,))
        of = [part[row][:, column] for part in (clouds, wanted, weight)]
        loss = F.binary_cross_entropy(network.saliency(volumes[row], of[0]), *of[1:])
        adam.zero_grad()
        loss.backward()
        adam.step()


def make_batch(shapes, config, first, number, stream=0, in_order=False):
    """Samples first .. first + number - 1 of shapes or targets, each from its own seed, as tensors by name.

    Their shapes are random ones, or `in_order` the shapes of these numbers.
    """
    samples = []
    for index in range(first, first + number):
        rng = np.random.default_rng([config.seed, stream, index])
        is_taught = isinstance(shapes, Targets)
        if is_taught:
            samples.append(student_views(shapes.sample(rng), config, rng))
        else:
            samples.append(two_views(shapes[index] if in_order else shapes.cloud(rng), config, rng))
    batch = {name: torch.from_numpy(np.stack([sample[name] for sample in samples])) for name in samples[0]}
    return batch | {"label": label(config.num_occupancy)}


def label(number):
    """Occupancy (2 K,) of the occupancy queries: the first K lie on the surface."""
    return (torch.arange(2 * number) < number).float()
