"""Clouds in tiles from Python, on one machine and on a local Ray cluster, have the keypoints of the whole cloud."""

import os
import pickle

import numpy as np
import pytest

import snake_rs

OPTIONS = {"voxel_size": 0.4, "mode_radius": 0.6, "saliency_threshold": 0.01, "nms_radius": 0.5, "min_confidence": None}
WHOLE = {**OPTIONS, "max_keypoints": 100_000}


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """A street with houses, far from zero, as an .xyz file."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(0, 40, (2500, 1)), rng.uniform(0, 16, (2500, 1)), np.zeros((2500, 1))])
    along, height = rng.uniform(0, 40, 2500), rng.uniform(0, 6, 2500)
    facade = np.column_stack([along, 5 + 0.3 * ((along // 3) % 2), height])
    path = tmp_path_factory.mktemp("city") / "city.xyz"
    np.savetxt(path, np.concatenate([ground, facade]) + [691_000.0, 5_336_000.0, 512.0], fmt="%.3f")
    return path


@pytest.fixture(scope="module")
def whole(city):
    keypoints = snake_rs.detect(city, model="scenes", **WHOLE)
    assert len(keypoints) > 50
    return keypoints


def assert_equal(found, whole):
    """The bits of all columns."""
    for name, column in whole.to_dict().items():
        assert np.array_equal(np.asarray(found[name]), column), name


def test_tiles_and_their_pickles_give_the_keypoints_of_the_whole_cloud(city, whole, tmp_path):
    tiles = snake_rs.tiles(city, tile=9, folder=tmp_path / "tiles", model="scenes", **OPTIONS)
    assert len(tiles) > 4 and not tiles.failures and tiles.max_keypoints is None
    copy = pickle.loads(pickle.dumps(tiles))
    for row in copy.rows():
        assert row["west"] < row["east"] and row["num_points"] > 0
        copy.detect(row["tile"])
        assert tiles.is_detected(row["tile"])
    assert sum(row["num_points"] for row in tiles.rows()) == 5000
    keypoints = tiles.finish()
    assert_equal(keypoints.to_dict(), whole)
    assert keypoints.counts == whole.counts


def test_a_folder_is_one_cloud(city, whole, tmp_path):
    (tmp_path / "parts").mkdir()
    lines = city.read_text().splitlines(keepends=True)
    for number, start in enumerate((0, 2000)):
        (tmp_path / f"parts/{number}.xyz").write_text("".join(lines[start : [2000, None][number]]))
    (tmp_path / "parts/notes.md").write_text("flown in May")
    tiles = snake_rs.tiles(tmp_path / "parts", tile=9, folder=tmp_path / "tiles", model="scenes", **OPTIONS)
    for tile in range(len(tiles)):
        tiles.detect(tile)
    assert_equal(tiles.finish().to_dict(), whole)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="no clouds"):
        snake_rs.tiles(tmp_path / "empty", tile=9, folder=tmp_path / "none", model="scenes", **OPTIONS)


def test_limits_lists_of_paths_and_missing_tiles(city, whole, tmp_path):
    broken = tmp_path / "broken.laz"
    broken.write_text("no scan")
    tiles = snake_rs.tiles(
        [city, broken], tile=20, folder=tmp_path / "tiles", model="scenes", **OPTIONS, max_keypoints=9
    )
    assert list(tiles.failures) == [broken]
    with pytest.raises(ValueError, match=f"{len(tiles)} of {len(tiles)} tiles are missing"):
        tiles.finish()
    assert tiles.detected().missing == list(range(len(tiles)))
    for tile in range(len(tiles)):
        tiles.detect(tile)
    assert tiles.detected().missing == []
    assert_equal(tiles.finish().to_dict(), whole[:9])
    with pytest.raises(IndexError):
        tiles.detect(len(tiles))


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        ({"tile": 0}, ValueError, "tile"),
        ({"model": "compact"}, ValueError, "scenes"),
        ({"paths": "missing.laz"}, FileNotFoundError, "missing.laz"),
        ({"colour": 1}, TypeError, "colour"),
    ],
)
def test_mistakes_are_errors(city, tmp_path, wrong, error, words):
    given = {"paths": city, "tile": 9, "folder": tmp_path / "tiles", "model": "scenes", **wrong}
    with pytest.raises(error, match=words):
        snake_rs.tiles(**given)


@pytest.fixture(scope="module")
def cluster():
    """A local Ray cluster of two CPUs."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'ray[data]'")
    pytest.importorskip("snake_rs.ray", reason="Ray Data is not installed: pip install 'ray[data]'")
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    try:
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=200 << 20)
    except (ray.exceptions.RayError, OSError, RuntimeError) as error:  # such as a sandbox without shared memory
        pytest.skip(f"Ray cannot start here: {error}")
    ray.data.DataContext.get_current().enable_progress_bars = False
    yield ray
    ray.shutdown()


def test_a_cluster_registers_pairs_as_one_machine(cluster, tmp_path):
    from snake_rs.ray import RegisterPairs

    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (4000, 3)) * [1, 0.7, 0.4]
    points[:, 2] += 0.3 * np.sin(3 * points[:, 0]) * (points[:, 1] > 0)
    points[np.arange(4000), rng.integers(0, 3, 4000)] *= 0.05
    source, target, missing = (tmp_path / f"{name}.npy" for name in ("source", "target", "missing"))
    np.save(source, points[::2])
    np.save(target, points[1::2] + [3, 0, 1])
    rows = [{"source": source.as_uri(), "target": str(target)}, {"source": str(missing), "target": str(target)}]
    steps = {"batch_format": "pyarrow", "concurrency": 1, "num_cpus": 1}
    found = (
        cluster.data.from_items(rows).map_batches(RegisterPairs, fn_constructor_kwargs={"seed": 3}, **steps).take_all()
    )
    good, bad = sorted(found, key=lambda row: row["error"] is not None)
    here = snake_rs.register(source, target, seed=3)
    assert np.array_equal(np.reshape(good["t_target_source"], (4, 4)), here.t_target_source)
    assert (good["confidence"], good["is_reliable"]) == (here.verdict.confidence, here.verdict.is_reliable)
    assert "FileNotFoundError" in bad["error"] and bad["t_target_source"] is None and bad["is_reliable"] is None


def test_a_cluster_has_the_bits_of_one_machine(cluster, city, whole, tmp_path):
    from snake_rs.ray import keypoints_of_tiles

    tiles = snake_rs.tiles(city, tile=16, folder=tmp_path / "tiles", model="scenes", **OPTIONS)
    table = keypoints_of_tiles(tiles, concurrency=2)
    assert len(tiles) > 2
    assert_equal({name: table[name].to_numpy() for name in table.column_names}, whole)
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "tiles/candidates").glob("*.safetensors")}
    assert keypoints_of_tiles(pickle.loads(pickle.dumps(tiles))).equals(table)
    assert {path: path.stat().st_mtime_ns for path in written} == written and len(written) == len(tiles)


def test_a_cluster_names_tiles_that_fail(cluster, city, tmp_path):
    from snake_rs.ray import keypoints_of_tiles

    tiles = snake_rs.tiles(city, tile=40, folder=tmp_path / "tiles", model="scenes", **OPTIONS)
    for path in (tmp_path / "tiles" / "points").iterdir():
        path.write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"2 of 2 tiles failed: the tile from x 69.*damaged"):
        keypoints_of_tiles(tiles)
