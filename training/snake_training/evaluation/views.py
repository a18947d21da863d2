"""Views of objects and of pairs of clouds: thinned, noisy and rotated at random, by seeds (SNAKE section 4.2)."""

from dataclasses import dataclass

import numpy as np

from ..augment import choose, normalize, random_rotation


@dataclass(frozen=True)
class Condition:
    """A disturbance of both views, or of the second alone: one point in `downsample` is kept, with noise of a standard deviation."""

    downsample: int = 1
    noise: float = 0.0
    is_of_both: bool = True

    def __post_init__(self):
        if self.downsample < 1 or not 0 <= self.noise < np.inf:
            raise ValueError(f"{self}: allowed are 1 or more, and 0 or more")

    def __str__(self):
        noise = f"σ {self.noise:g}" if self.noise else ""
        words = (
            [f"1 in {self.downsample}"] * (self.downsample > 1)
            + [noise] * bool(noise)
            + ["of one"] * (not self.is_of_both)
        )
        return " ".join(words) or "clean"


CLEAN = Condition()


@dataclass(frozen=True)
class Views:
    """Two views of a pair."""

    view_1: np.ndarray  # (N, 3)
    view_2: np.ndarray  # (M, 3) in a frame of its own
    t_1_2: np.ndarray  # maps view 2 to view 1
    seeds: tuple  # of the random choices of a detector on each view


def unit_radius(points):
    """An object (N, 3), scaled so that its radius about its mean is 1. It is not centred."""
    return points / (normalize(points)[2] / 2)


def disturbed(points, condition, rng, number=10**9):
    """A cloud (N, 3) under a condition: one in `downsample` of at most `number` of its points, drawn at random, with noise."""
    chosen = choose(rng, points, max(min(number, len(points)) // condition.downsample, 1))
    noise = condition.noise * rng.standard_normal(chosen.shape) if condition.noise else np.zeros(3)
    return chosen + noise.astype(chosen.dtype)


def draw_views(clouds, condition=CLEAN, num_points=5000, seed=0, row=0):
    """Two views of at most `num_points` points, under a condition.

    clouds: an object (N, 3), whose second view has a random rotation and other points, or (cloud 1, cloud 2, t_1_2). A pair's `row`
    and the seed give the random choices; the rotation is the same under every condition.
    """
    rng, conditions = np.random.default_rng([seed, row]), [condition if condition.is_of_both else CLEAN, condition]
    if isinstance(clouds, tuple):
        *both, t_1_2 = clouds
        views = [disturbed(cloud, one, rng, num_points) for cloud, one in zip(both, conditions, strict=True)]
    else:
        rotation, t_1_2 = random_rotation(rng), np.eye(4)
        t_1_2[:3, :3] = rotation.T
        views = [disturbed(clouds, one, rng, num_points) for one in conditions]
        views[1] = views[1] @ rotation.T
    return Views(*views, t_1_2, tuple(int(number) for number in rng.integers(2**32, size=2)))


def spaced(length, limit=None):
    """`limit` rows of `length`, evenly spaced from the first to the last; all without a limit."""
    if limit is not None and limit < 1:
        raise ValueError(f"limit is {limit}: expected 1 or more")
    return np.linspace(0, length - 1, min(limit or length, length)).round().astype(int).tolist()


def view_pairs(shapes, number, num_points, seed):
    """The clean views of `number` objects of a collection, evenly spaced."""
    for row in spaced(len(shapes), number):
        yield draw_views(unit_radius(shapes[row]), CLEAN, num_points, seed, row)
