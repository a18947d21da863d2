"""Learning from objects: by the four losses from two views of a cloud, or as a student of a teacher's saliency."""

import numpy as np
import torch
from tqdm import tqdm

from ..augment import normalize, student_views, two_views
from ..data import Mixture, Procedural, open_all
from ..data.landmarks import RECIPES, landmarks
from ..evaluate import DetectOptions, candidates, repeatability, suppress, view_pairs, why_none
from ..export import build_network, load_network
from ..losses import LOSSES, losses_of
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
            draw_saliency(network)
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
        network.eval()
        results = []
        for first in range(0, 32, 4):
            batch = make_batch(self.held_out, config, first, 4, stream=1)
            batch = {name: tensor.to(device) for name, tensor in batch.items()}
            with torch.no_grad():
                results.append(losses_of(*self.answer(network, batch, autocast), batch))
        figures = {name: float(np.mean([losses[name].item() for losses, _ in results])) for name in LOSSES}
        figures["saturated"] = float(np.mean([share.item() for _, share in results]))

        def detector(points):
            found = candidates(network, points, options)
            kept = {radius: suppress(found[:, :3], radius, limit=64) for radius in (0.01, 0.05)}
            return {f"nms_{radius}": found[kept[radius]].numpy() for radius in kept}

        for name, (measured, count) in repeatability(detector, self.held_out, config.validation_objects).items():
            figures |= {f"repeatability_{name}": float(measured[0]), f"keypoints_{name}": count}
        if figures["keypoints_nms_0.01"] == 0:
            cloud, _, _ = next(view_pairs(self.held_out, 1, 5000, 0))
            tqdm.write(f"warning: no keypoint in the validation: {why_none(network, cloud, options)}")
        return figures

    def score(self, figures):
        """How good a validation is, by which the best is chosen."""
        if self.settings.best_by == "loss":
            return -sum(getattr(self.settings, f"weight_{name}") * figures[name] for name in LOSSES)
        return figures["repeatability_nms_0.01"] + figures["repeatability_nms_0.05"]


@torch.no_grad()
def draw_saliency(network, draws=16):
    """A new saliency decoder: of so many draws the one whose saliency is highest at corners and tips of made shapes.

    The losses do not say where the peaks are to lie, only that both views agree and that there are some everywhere. Of three
    seeds the one that began clearly higher at corners ended there, the others away from every edge.
    """
    shapes = [landmarks(name, np.random.default_rng(row)) for row, name in enumerate(RECIPES)]
    clouds = [torch.from_numpy(normalize(cloud)[0])[None] for cloud, _ in shapes]
    volumes = [network.encode(cloud) for cloud in clouds]

    def preference(decoder):
        """By how many deviations the log-odds at landmarks exceed those of the surface, on average over the shapes."""
        network.decoder_keypoint = decoder
        values = [network.saliency(*of)[0].logit() for of in zip(volumes, clouds)]
        return float(np.mean([(v[at].mean() - v.mean()) / v.std() for v, (_, at) in zip(values, shapes)]))

    network.decoder_keypoint = max((Decoder(network.config) for _ in range(draws)), key=preference)


def make_batch(shapes, config, first, number, stream=0):
    """Samples first .. first + number - 1 of shapes or targets, each from its own seed, as tensors by name."""
    samples = []
    for index in range(first, first + number):
        rng = np.random.default_rng([config.seed, stream, index])
        is_taught = isinstance(shapes, Targets)
        samples.append(
            student_views(shapes.sample(rng), config, rng) if is_taught else two_views(shapes.cloud(rng), config, rng)
        )
    batch = {name: torch.from_numpy(np.stack([sample[name] for sample in samples])) for name in samples[0]}
    return batch | {"label": label(config.num_occupancy)}


def label(number):
    """Occupancy (2 K,) of the occupancy queries: the first K lie on the surface."""
    return (torch.arange(2 * number) < number).float()
