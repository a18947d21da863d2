"""Tiles of clouds behind URLs have the keypoints of the file on disk, and read a part of a COPC file only."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from test_python_tiles import OPTIONS, assert_equal
from web_server import serving

import snake_rs

# 12 000 points on 40 by 40 m, see generate.py beside it.
CITY = Path(__file__).parent / "data/tiles/city.copc.laz"


@pytest.fixture(scope="module")
def whole():
    keypoints = snake_rs.detect(CITY, model="scenes", **OPTIONS, max_keypoints=100_000)
    assert len(keypoints) > 50
    return keypoints


@pytest.fixture
def server():
    with serving(CITY.parent, {}) as running:
        yield running


def test_a_tile_reads_a_part_of_a_copc_file_over_http(server, whole, tmp_path):
    url = f"{server.url}/city.copc.laz"
    tiles = snake_rs.tiles(url, tile=13, folder=tmp_path / "tiles", model="scenes", **OPTIONS)
    size = CITY.stat().st_size
    assert len(tiles) > 4
    assert server.served < 0.1 * size, "only the octree is read"
    # The margin of a tile is 80 voxels: of 0.4 it is most of the city.
    given = {"folder": tmp_path / "fine", "model": "scenes", **OPTIONS, "voxel_size": 0.1}
    fine = snake_rs.tiles(url, tile=5, **given)
    corner = min(range(len(fine)), key=lambda tile: fine.rows()[tile]["west"] + fine.rows()[tile]["south"])
    before = server.served
    fine.detect(corner)
    assert 0 < server.served - before < 0.8 * size
    copy = pickle.loads(pickle.dumps(tiles))
    for tile in range(len(tiles)):
        copy.detect(tile)
    assert_equal(tiles.finish().to_dict(), whole)
    again = snake_rs.tiles(url, tile=13, folder=tmp_path / "tiles", model="scenes", **OPTIONS)
    assert all(again.is_detected(tile) for tile in range(len(again)))


def test_a_reply_that_may_pass_is_tried_again(server, tmp_path, monkeypatch):
    from snake_rs import _remote

    monkeypatch.setattr(_remote, "_PAUSES", (0.01, 0.01, 0.01))
    given = {"tile": 40, "folder": tmp_path / "tiles", "model": "scenes", **OPTIONS}
    failures = server.failures["city.copc.laz"] = [503] * 2
    tiles = snake_rs.tiles(f"{server.url}/city.copc.laz", **given)
    failures += [503] * 3
    tiles.detect(0)
    assert failures == []
    failures += [503] * 99
    with pytest.raises(OSError, match="503"):
        snake_rs.tiles(f"{server.url}/city.copc.laz", **given)


def test_mistakes_of_servers_are_errors(server, tmp_path):
    url = server.url
    options = {"tile": 13, "folder": tmp_path / "tiles", "model": "scenes", **OPTIONS}
    with pytest.raises(FileNotFoundError):
        snake_rs.tiles(f"{url}/missing.copc.laz", **options)
    server.has_ranges = False
    with pytest.raises((OSError, ValueError), match="bytes were asked for|range"):
        snake_rs.tiles(f"{url}/city.copc.laz", **options)


def test_tiles_lie_in_object_storage(whole, object_storage, tmp_path):
    files, storage = object_storage
    plain = tmp_path / "city.npy"
    np.save(plain, whole.points)
    files.put_file(str(CITY), "clouds/city.copc.laz")
    files.put_file(str(plain), "clouds/city.npy")
    given = {"folder": tmp_path / "tiles", "model": "scenes", "storage_options": storage, **OPTIONS}
    tiles = snake_rs.tiles("s3://clouds/city.copc.laz", tile=25, **given)
    assert not (tmp_path / "tiles/.snake-rs.inputs.part").exists()
    for tile in range(len(tiles)):
        pickle.loads(pickle.dumps(tiles)).detect(tile)
    assert_equal(tiles.finish().to_dict(), whole)

    # A folder, here of one file beside a text.
    files.put_file(str(CITY), "clouds/city/part.copc.laz")
    files.pipe_file("clouds/city/notes.md", b"flown in May")
    folder = snake_rs.tiles("s3://clouds/city/", tile=25, **{**given, "folder": tmp_path / "listed"})
    assert [row | {"folder": None} for row in folder.rows()] == [row | {"folder": None} for row in tiles.rows()]
    with pytest.raises(FileNotFoundError, match="clouds/nothing"):
        snake_rs.tiles("s3://clouds/nothing/", tile=25, **given)

    # Files of other formats are copied once.
    given["folder"] = tmp_path / "copied"
    first = snake_rs.tiles("s3://clouds/city.npy", tile=25, **given)
    first.detect(0)
    (copy,) = (tmp_path / "copied/.snake-rs.inputs.part").glob("*/*")
    time = copy.stat().st_mtime_ns
    assert snake_rs.tiles("s3://clouds/city.npy", tile=25, **given).is_detected(0)
    assert copy.stat().st_mtime_ns == time
    # A file that was replaced by one of the same size is another cloud.
    content = plain.read_bytes()
    plain.write_bytes(content[:-8] + bytes([content[-8] ^ 1]) + content[-7:])
    files.put_file(str(plain), "clouds/city.npy")
    files.invalidate_cache()
    with pytest.raises(ValueError, match="other inputs"):
        snake_rs.tiles("s3://clouds/city.npy", tile=25, **given)
