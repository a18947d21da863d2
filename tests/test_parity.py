"""snake_rs against snake_training: random networks, exported and loaded (`pytest tests/test_parity.py`).

Both run in float32 and sum in different orders, so values agree to about 1e-5; wider tolerances say why.
"""

from pathlib import Path

import numpy as np
import pytest

import snake_rs

torch = pytest.importorskip("torch")
pytest.importorskip("snake_training")


from safetensors.torch import load_file

from snake_training import detection
from snake_training import model as reference
from snake_training.augment import normalize
from snake_training.detection import DetectOptions, detect
from snake_training.export import load_network, write_weights
from snake_training.model import NetworkConfig, SnakeNetwork

torch.set_num_threads(1)

# Odd and unequal sizes, z bounds, one level to four, channels below and above the number of groups.
CONFIGS = [
    NetworkConfig((16, 16, 16), c_dim=16, hidden_dim=16, decoder_hidden_dim=16, unet_levels=2, unet_base_channels=8),
    NetworkConfig(
        (13, 13, 13),
        c_dim=8,
        hidden_dim=24,
        decoder_hidden_dim=12,
        unet_levels=3,
        unet_base_channels=4,
        group_norm_groups=4,
    ),  # fmt: skip
    NetworkConfig((20, 14, 9), 0.05, -0.3, 0.4, 24, 12, 20, 3, 2, 16, 4),
    NetworkConfig((9, 17, 12), 0.25, -0.5, 0.2, 5, 7, 9, 1, 1, 12, 8),
    NetworkConfig((24, 24, 24), 0.1, -0.5, 0.5, 32, 32, 32, 5, 4, 8, 8),
    NetworkConfig((31, 8, 22), 0.125, -0.2, 0.3, 15, 9, 33, 4, 3, 6, 3),
    NetworkConfig((17, 12, 20), 0.125, -0.5, 0.4, 16, 16, 16, 3, 3, 8, 8, scatter="soft"),
]


def random_points(rng, number):
    """A bumpy torus, (number, 3) float32, in the network's frame: the cube +-0.5."""
    u, v = rng.uniform(0, 2 * np.pi, (2, number))
    ring = 1 + (0.35 + 0.1 * np.sin(3 * u)) * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), 0.5 * np.sin(v) + 0.2 * np.cos(2 * u)], axis=1)
    return (points / 3 + rng.uniform(-0.02, 0.02, 3)).astype(np.float32)


@torch.no_grad()
def random_network(config, seed, points):
    """A network of random weights, none of them zero, whose two fields vary over the cube.

    Volumes get a deviation of about 0.5. Logits get one of 2.5 and a shift by which a quarter of the cube is
    occupied and half of it salient: thresholds then mean something.
    """
    generator = torch.Generator().manual_seed(seed)
    network = SnakeNetwork(config).eval()
    for name, tensor in network.named_parameters():
        noise = torch.randn(tensor.shape, generator=generator)
        if "groupnorm" in name:
            tensor.copy_(0.2 * noise + (1 if name.endswith("weight") else 0))
        elif name.endswith("bias"):
            tensor.copy_(0.1 * noise)
        else:
            tensor.copy_(noise * (1.5 / tensor[0].numel()) ** 0.5)
    for tensor in network.encoder.unet3d.final_conv.parameters():
        tensor *= 0.4
    volume = network.encode(torch.from_numpy(points)[None])
    queries = torch.rand(1, 4000, 3, generator=generator) - 0.5
    for decoder, share in ((network.decoder_occup, 0.75), (network.decoder_keypoint, 0.5)):
        quantity = network.occupancy if decoder is network.decoder_occup else network.saliency
        logits = []
        hook = decoder.register_forward_hook(lambda module, inputs, output: logits.append(output))
        quantity(volume, queries)
        hook.remove()
        factor = 2.5 / logits[0].std()
        decoder.fc_out.weight *= factor
        decoder.fc_out.bias.copy_(factor * (decoder.fc_out.bias - logits[0].quantile(share)))
    return network


@pytest.fixture(scope="module", params=range(len(CONFIGS)), ids=lambda seed: f"seed{seed}")
def pair(request, tmp_path_factory):
    """(network, model, points): the same weights in PyTorch and in snake_rs."""
    seed, config = request.param, CONFIGS[request.param]
    points = random_points(np.random.default_rng(seed), 600 + 137 * seed)
    network = random_network(config, seed, points)
    path = tmp_path_factory.mktemp("weights") / "network.safetensors"
    write_weights(path, config, network.state_dict())
    return network, snake_rs.Model.load(path), points


def both_fields(pair):
    """(network, its volume, field of snake_rs) of the cloud."""
    network, model, points = pair
    with torch.no_grad():
        volume = network.encode(torch.from_numpy(points)[None])
    return network, volume, model.encode(points, normalization="none")


def random_queries(seed, number=2000):
    """Queries in the cube and beyond it, where coordinates are clamped."""
    return np.random.default_rng(seed).uniform(-0.7, 0.7, (number, 3)).astype(np.float32)


def test_the_configuration_travels(pair):
    network, model, _ = pair
    expected = vars(network.config)
    assert {name: pytest.approx(value) for name, value in model.config.items()} == expected
    assert model.num_parameters == sum(tensor.numel() for tensor in network.parameters())


def test_volume_and_values(pair):
    network, volume, field = both_fields(pair)
    assert volume.std() > 0.1  # else the comparison would say nothing
    assert np.abs(field.volume - volume[0].numpy()).max() < 1e-4
    queries = random_queries(1)
    with torch.no_grad():
        occupancy, saliency = network.occupancy_and_saliency(volume, torch.from_numpy(queries)[None])
    assert occupancy.std() > 0.05 and saliency.std() > 0.05
    assert np.abs(field.occupancy(queries) - occupancy[0].numpy()).max() < 1e-4
    assert np.abs(field.saliency(queries) - saliency[0].numpy()).max() < 1e-4


def test_the_built_in_weights_have_the_fields_of_pytorch():
    network = load_network(Path(__file__).parents[1] / "crates/snake-core/models/compact.safetensors")
    test_volume_and_values((network, snake_rs.Model.builtin("compact"), random_points(np.random.default_rng(7), 900)))


def test_float16_exports_have_the_volume_of_pytorch(pair, tmp_path):
    network, _, points = pair
    path = tmp_path / "half.safetensors"
    write_weights(path, network.config, network.state_dict(), torch.float16)
    assert all(tensor.dtype == torch.float16 for tensor in load_file(path).values())
    _, volume, full = both_fields(pair)
    _, rounded, half = both_fields((load_network(path), snake_rs.Model.load(path), points))
    assert np.abs(half.volume - rounded[0].numpy()).max() < 1e-4
    assert 1e-5 < np.abs(half.volume - full.volume).max() < 0.1  # rounded, and not by much


@pytest.mark.parametrize("quantity", ["occupancy", "saliency"])
def test_gradients_are_those_of_autograd(pair, quantity):
    network, volume, field = both_fields(pair)
    queries = random_queries(2)
    variable = torch.from_numpy(queries)[None].requires_grad_()
    values = getattr(network, quantity)(volume, variable)
    (expected,) = torch.autograd.grad(values.sum(), variable)
    expected = expected[0].numpy()
    found_values, found = getattr(field, f"{quantity}_and_gradient")(queries)
    assert np.abs(found_values - values[0].detach().numpy()).max() < 1e-4
    # Where a ReLU's input is zero to within rounding, or a query lies on a voxel's face, either side may be taken: both
    # are derivatives there, so a few queries in a thousand may differ and the 99th percentile is compared.
    size = np.linalg.norm(expected, axis=1)
    error = np.linalg.norm(found - expected, axis=1) / (size + np.median(size))
    assert np.percentile(error, 99) < 1e-3
    assert (np.abs(queries[:, :2]) > 0.5 * (1 + network.config.padding)).any()  # clamped ones are among them


@pytest.mark.parametrize("method", ["unit-sphere", "unit-cube", "none"])
def test_clouds_of_any_place_and_size(pair, method):
    _, model, points = pair
    cloud = points * np.float32(7.3) + np.float32([30, -4, 1])
    _, center, scale = normalize(cloud, method)
    field = model.encode(cloud, normalization=method)
    assert field.normalization[0] == pytest.approx(center, rel=1e-6) and field.normalization[1] == pytest.approx(scale)
    if method == "none":
        return
    # The same arithmetic in numpy's float32, so the same bits. (With PyTorch's center, a unit in the last place may
    # move a point into the next voxel, and all values with it: the other tests give both sides network coordinates.)
    center, scale = field.normalization
    unit = model.encode((cloud - center) / np.float32(scale), normalization="none")
    assert np.array_equal(field.volume, unit.volume)
    queries = random_queries(4, 200) * np.float32(scale) + center
    values, gradients = field.saliency_and_gradient(queries)
    unit_values, unit_gradients = unit.saliency_and_gradient((queries - center) / np.float32(scale))
    assert np.array_equal(values, unit_values) and np.allclose(gradients * scale, unit_gradients, rtol=1e-5)
    options = OPTIONS | {"nms_radius": 0.0, "max_keypoints": 100}
    found, expected = field.detect(**options), unit.detect(**options)
    assert len(found) > 50 and np.array_equal(found.saliency, expected.saliency)
    assert np.allclose(found.points, expected.points * np.float32(scale) + center, atol=1e-6 * scale)


def nearest(a, b):
    """For each row of a (K, 4: position and score), distance to the nearest row of b and difference of their scores."""
    distance = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=2)
    row = distance.argmin(axis=1)
    return distance[np.arange(len(a)), row], np.abs(a[:, 3] - b[row, 3])


def rows(keypoints):
    """Keypoints as (K, 4)."""
    return np.column_stack([keypoints.points, keypoints.saliency])


OPTIONS = {"query_resolution": 13, "refine_step_size": 2e-3, "surface_threshold": 0.6, "saliency_threshold": 0.45}


@pytest.mark.parametrize(("method", "band"), [("adam", 0), ("gradient-descent", 0), ("adam", 1)])
def test_detected_keypoints(pair, method, band):
    network, model, points = pair
    options = OPTIONS | {"normalization": "none", "refine_method": method, "nms_radius": 0.08, "max_keypoints": 40}
    options["query_band"] = band
    expected = detect(network, points, DetectOptions(**options))
    found = rows(snake_rs.detect(points, model, **options))
    assert 5 < len(found) <= 40 and abs(len(found) - len(expected)) <= 1
    for a, b in ((found, expected), (expected, found)):
        distance, score = nearest(a, b)
        # Suppression is all or nothing: two equal scores in the other order may change one keypoint and its neighbours.
        assert np.median(distance) < 1e-5 and np.median(score) < 1e-5
        assert np.mean((distance < 1e-3) & (score < 1e-3)) >= 0.9


# The steps one by one. Both sides have the same input, so nothing but rounding differs, and each value is compared.


def near(found, expected, tolerance):
    """Whether two arrays differ by at most a part `tolerance` of the second's largest value."""
    expected = expected.detach().numpy()
    assert found.shape == expected.shape and np.abs(expected).max() > 0
    return np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


def slopes(function, *inputs):
    """The value of a function at tensors, and the derivatives of its sum with respect to each of them."""
    variables = [tensor.requires_grad_() for tensor in inputs]
    value = function(*variables)
    return value, torch.autograd.grad(value.sum(), variables)


def normal(seed, *shape):
    """Normal numbers, float32."""
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def aggregation(pair):
    """Voxel aggregation of given features, of points within and beyond the volume."""
    network, model, _ = pair
    points, encoder = torch.from_numpy(random_queries(7))[None], network.encoder
    features = normal(7, 1, points.shape[1], 6)
    soft = network.config.scatter == "soft"
    voxels = reference.voxel_index(points, network.config)
    expected = encoder.scatter_soft(features, points) if soft else encoder.scatter_mean(features, voxels)
    # Sums of at most some hundred features of one voxel.
    assert near(snake_rs.steps.aggregate(model, points[0], features[0]), expected[0], 5e-7)


def sampling(pair):
    """Trilinear features of a given volume, and their gradient."""
    network, model, _ = pair
    config, queries = network.config, torch.from_numpy(random_queries(8))[None]
    volume = normal(8, 1, config.c_dim, *reversed(config.resolution))
    in_features = normal(9, 1, queries.shape[1], config.c_dim)
    expected, _ = slopes(lambda queries: reference.interpolate(volume, queries, config), queries)
    _, (gradient,) = slopes(lambda queries: reference.interpolate(volume, queries, config) * in_features, queries)
    queries = queries.detach()[0]
    # A position among 31 voxels has an error of 2e-6 of a voxel, by which the features of two voxels differ.
    assert near(snake_rs.steps.interpolate(model, volume[0], queries), expected[0], 5e-6)
    found = snake_rs.steps.interpolate_gradient(model, volume[0], queries, in_features[0])
    assert near(found, gradient[0], 5e-6)


def decoding(pair):
    """Both decoders at given features, with the derivatives by query and by feature."""
    network, model, _ = pair
    inputs = torch.from_numpy(random_queries(10))[None], normal(10, 1, 2000, network.config.c_dim)
    for quantity in ("occupancy", "saliency"):
        decoder = network.decoder_occup if quantity == "occupancy" else network.decoder_keypoint
        head = torch.sigmoid if quantity == "occupancy" else reference.saliency_head
        expected, gradients = slopes(lambda *inputs: head(decoder(*inputs)), *inputs)
        found, *found_gradients = snake_rs.steps.decode(model, quantity, *(tensor.detach()[0] for tensor in inputs))
        # Logits of up to 15, of 30 layers of sums.
        assert near(found, expected[0], 1e-5)
        for ours, theirs in zip(found_gradients, gradients):
            # Where a ReLU's input is zero to within rounding, either side may be taken.
            kept = np.abs(ours - theirs[0].numpy()).max(axis=1) < 1e-3 * np.abs(theirs.numpy()).max()
            assert kept.mean() > 0.995 and near(ours[kept], theirs[0][kept], 5e-5)


def refinement(pair, method, steps):
    """Steps up the gradients that PyTorch climbed."""
    network, _, points = pair
    with torch.no_grad():
        volume = network.encode(torch.from_numpy(points)[None])
    gradients = []

    class Recorded:
        """The network on the surface, which keeps the gradients of its saliency."""

        def occupancy_and_saliency(self, volume, queries):
            saliency = network.saliency(volume, queries)
            gradients.append(torch.autograd.grad(saliency.sum(), queries, retain_graph=True)[0][0])
            return torch.ones_like(saliency), saliency

    options = DetectOptions(
        refine_method=method, refine_steps=steps, refine_step_size=2e-3, selection="reference-final-position"
    )
    queries = torch.from_numpy(
        random_queries(11, 512)
    )  # a power of two: their mean has the gradients of their sum, to a bit
    expected, _ = detection.refine(Recorded(), volume, queries, options)
    found = snake_rs.steps.refine(queries, torch.stack(gradients), method, 2e-3)
    assert len(gradients) == steps
    # Positions of up to 0.7 have an error of 6e-8 in each of up to ten steps; none is shorter than 1e-5 on the whole.
    assert near(found - queries.numpy(), expected - queries, 1e-6 / (expected - queries).abs().max())


def suppression(pair):
    """Which of many candidates are kept, by rank: the same ones."""
    rng = np.random.default_rng(len(pair[2]))
    points = rng.uniform(-0.5, 0.5, (3000, 3)).astype(np.float32)
    scores = rng.integers(0, 500, 3000).astype(np.float32)  # many are equal
    order = torch.from_numpy(scores).argsort(descending=True, stable=True)
    for radius, limit in ((0.1, 3000), (0.1, 64), (0.03, 3000), (0.0, 40)):
        expected = order[detection.suppress(torch.from_numpy(points)[order], radius, limit)]
        assert snake_rs.steps.suppress(points, scores, radius, limit).tolist() == expected.tolist()


METHODS = ("adam", 1), ("adam", 10), ("gradient-descent", 1), ("gradient-descent", 10)
STEPS = {"aggregation": aggregation, "sampling": sampling, "decoding": decoding, "suppression": suppression} | {
    f"{method}-{steps}": lambda pair, method=method, steps=steps: refinement(pair, method, steps)
    for method, steps in METHODS
}


@pytest.mark.parametrize("step", STEPS)
def test_each_step_is_that_of_pytorch(pair, step):
    STEPS[step](pair)
