"""Outliers, repeated points, coordinates far from zero and numbers far too large (`pytest tests/test_python_robust.py`)."""

import subprocess
import sys

import numpy as np
import pytest

import snake_rs

baselines = snake_rs.baselines
UTM = np.array([500123.25, 5412345.75, 431.5])
OUTLIERS = {
    "one far away": [[1e4, 0, 0]],
    "one at 12 radii": [[0, 12, 0]],
    "several, everywhere": [[30, 0, 0], [0, -500, 7], [1e30, 0, 0], [-9, 9, 9]],
    "one per cent at a sentinel": [[65.535] * 3] * 50,
}


def bowl(number: int = 5000, seed: int = 0) -> np.ndarray:
    """An uneven bowl, 1 across."""
    x, y = np.random.default_rng(seed).uniform(-0.5, 0.5, (2, number))
    return np.stack([x, y, x**2 + 0.3 * np.sin(6 * y) * x], axis=1)


@pytest.fixture(params=OUTLIERS, ids=lambda name: name.replace(" ", "-"))
def outliers(request) -> np.ndarray:
    return np.array(OUTLIERS[request.param], float)


def mixed(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.insert(points, np.linspace(0, len(points), len(others)).astype(int), others, axis=0)


def test_outliers_are_named_and_change_no_keypoint(outliers):
    clean, dirty = bowl(), mixed(bowl(), outliers)
    expected = snake_rs.detect(clean)
    with pytest.warns(UserWarning, match=f"^{len(outliers)} of {len(dirty)} points .*left out"):
        found = snake_rs.detect(dirty)
    assert np.array_equal(found.points, expected.points)
    assert found.num_skipped == len(outliers)
    assert np.array_equal(dirty[found.nearest_index], clean[expected.nearest_index])


def sky(kind: str, seed: int = 0) -> np.ndarray:
    """Sky and floaters, as splats and photogrammetry have them about a scene of size 1."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    upper, corner = directions[directions[:, 2] > 0], directions[(directions > 0.1).all(axis=1)]
    jitter = rng.uniform(0.9, 1.1, (len(directions), 1))
    return {
        "dome": upper[:1250] * 100 * jitter[:1250],
        "large dome": upper[:7000] * 20 * jitter[:7000],
        "part of a dome": corner[:1500] * 50 * jitter[:1500],
        "shells": directions[:1500] * np.repeat([10, 30, 100], 500)[:, None] * jitter[:1500],
        "tails": directions[:1250] * np.exp(rng.uniform(0.5, 6, (1250, 1))),
        "power law": directions[:1250] * rng.uniform(0, 1, (1250, 1)) ** -2,
        "dome and tails": np.r_[upper[:1200] * 80, directions[:600] * np.exp(rng.uniform(0.5, 5, (600, 1)))],
    }[kind]


@pytest.mark.parametrize(
    "kind", ["dome", "large dome", "part of a dome", "shells", "tails", "power law", "dome and tails"]
)
def test_keypoints_are_on_the_scene_below_its_sky_and_floaters(kind):
    clean = bowl()
    dirty = np.random.default_rng(1).permutation(np.r_[clean, sky(kind)])
    with pytest.warns(UserWarning, match="sky, floaters or other outliers, left out"):
        found = snake_rs.detect(dirty, "compact")
    distances = np.linalg.norm(found.points[:, None] - clean[None], axis=2).min(axis=1)
    # Many floaters of a power law lie next to the scene, and stay: they draw most keypoints of `compact` (its card says so).
    assert len(found) > 10 and (distances < 0.05).mean() > (0.05 if kind == "power law" else 0.9)


def test_outliers_change_no_field_and_no_mesh(outliers):
    clean = snake_rs.Model.builtin().encode(bowl())
    with pytest.warns(UserWarning, match="left out"):
        dirty = snake_rs.Model.builtin().encode(mixed(bowl(), outliers))
    assert np.array_equal(dirty.saliency(bowl()), clean.saliency(bowl()))
    assert np.array_equal(dirty.mesh(resolution=32).vertices, clean.mesh(resolution=32).vertices)


@pytest.mark.parametrize("name", ["iss", "harris3d", "sift3d", "surface_variation", "farthest_points", "random_points"])
def test_outliers_change_no_classical_keypoint(name, outliers):
    arguments = {"count": 40} if name.endswith("points") else {}
    detector = getattr(baselines, name)
    clean, dirty = bowl(1500), mixed(bowl(1500), outliers[:20])
    with pytest.warns(UserWarning, match="left out"):
        found = detector(dirty, **arguments)[0]
    assert np.array_equal(dirty[found], clean[detector(clean, **arguments)[0]])


def test_outliers_in_either_cloud_change_no_transform(outliers):
    source, target = bowl(), bowl(seed=1) + [1, 2, 3]
    expected = snake_rs.register(source, target)
    found = snake_rs.register(mixed(source, outliers), target)
    assert np.array_equal(found.t_target_source, expected.t_target_source)
    assert any(note.startswith(f"source: {len(outliers)} of") for note in found.verdict.notes)
    both = snake_rs.register(mixed(source, outliers), mixed(target, outliers))
    assert np.array_equal(both.t_target_source, expected.t_target_source)


@pytest.mark.parametrize("kind", ["0 0 0", "one depth"])
def test_missing_returns_are_left_out_alike_by_detection_and_registration(kind):
    clean = bowl() + [6, 1, 0]
    rows = {"0 0 0": np.zeros((5000, 3)), "one depth": np.c_[bowl(seed=2)[:, :2] * 40, np.full(5000, 65.535)]}[kind]
    dirty = np.stack([clean, rows], axis=1).reshape(-1, 3)
    with pytest.warns(UserWarning, match="^5000 of 10000 points .*left out"):
        found = snake_rs.detect(dirty)
    expected = snake_rs.detect(clean)
    assert np.array_equal(found.points, expected.points) and found.num_skipped == 5000
    assert np.array_equal(dirty[found.nearest_index], clean[expected.nearest_index])
    registered = [snake_rs.register(source, bowl(seed=1)) for source in (clean, dirty)]
    assert np.array_equal(registered[0].t_target_source, registered[1].t_target_source)
    assert any(note.startswith("source: 5000 of 10000 points") for note in registered[1].verdict.notes)


@pytest.mark.parametrize("name", ["iss", "harris3d", "sift3d", "surface_variation"])
@pytest.mark.parametrize("repeated", [1, 0.6, 0.01])
def test_repeated_points_count_once(name, repeated):
    points = bowl(1500)
    twice = np.concatenate([points, points[: int(repeated * len(points))]])
    detector = getattr(baselines, name)
    assert np.array_equal(detector(twice)[0], detector(points)[0])


def test_a_georeferenced_cloud_with_missing_returns_at_zero_keeps_its_digits():
    points = bowl() + UTM
    expected = snake_rs.detect(points).points
    for missing in (1, 40):
        with pytest.warns(UserWarning, match=f"^{missing} of {5000 + missing} points"):
            found = snake_rs.detect(np.concatenate([np.zeros((missing, 3)), points])).points
        assert np.array_equal(found, expected)


def test_large_numbers_are_refused_or_work(tmp_path):
    """The call runs in a process of its own with 6 GB, which an abort would end."""
    code = """
import resource
import numpy as np
resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
import snake_rs
from snake_rs import baselines
snake_rs.set_num_threads(1)
few = np.random.default_rng(0).random((300, 3))
field = snake_rs.Model.builtin().encode(few)
def calls(n):
    yield lambda: snake_rs.set_num_threads(n)
    yield lambda: baselines.iss(few, min_neighbors=n)
    yield lambda: baselines.iss(few, count=n)
    yield lambda: baselines.sift3d(few, octaves=n)
    yield lambda: baselines.sift3d(few, scales_per_octave=n)
    yield lambda: baselines.farthest_points(few, n)
    yield lambda: baselines.random_points(few, n)
    for name in ("max_points", "rotations", "query_resolution", "query_band", "refine_steps", "max_keypoints"):
        yield lambda name=name: snake_rs.detect(few, **{name: n})
    yield lambda: field.mesh(resolution=n)
    for name in ("max_keypoints", "num_keypoints", "max_matches", "hypotheses"):
        yield lambda name=name: snake_rs.register(few, few, **{name: n})
    yield lambda: snake_rs.align([few, few], max_partners=n)
for n in (10**7, 2**64 - 1):
    for i, call in enumerate(calls(n)):
        print(n, i, flush=True)
        try:
            call()
        except (ValueError, OverflowError) as error:
            assert str(error)
        assert len(snake_rs.detect(few)) > 0
print("all")
"""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, timeout=900)
    assert done.stdout.endswith("all\n"), (done.stdout[-200:], done.stderr[-2000:])
