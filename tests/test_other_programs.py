"""LASzip reads the keypoints of a city."""

import json
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

CITY = Path(__file__).parent / "data/tiles/city.copc.laz"
OPTIONS = shlex.split("--model scenes --voxel-size 0.4 --nms-radius 0.5 --max-keypoints 5000 --quiet --tile 20")


def test_laszip_reads_laz(compiled, tmp_path):
    laspy = pytest.importorskip("laspy", reason="LASzip is not tested: pip install laspy laszip")
    pytest.importorskip("laszip", reason="LASzip is not tested: pip install laspy laszip")
    for name in ("keypoints.json", "keypoints.laz"):
        command = [compiled / "snake-cli", "detect", CITY, *OPTIONS, "--tile-folder", tmp_path / "tiles"]
        subprocess.run([*command, "-o", tmp_path / name], check=True)
    rows = json.loads((tmp_path / "keypoints.json").read_text())["keypoints"]
    assert len(rows) > 50
    found = {column: np.array([row[column] for row in rows]) for column in rows[0]}
    cloud = laspy.read(tmp_path / "keypoints.laz", laz_backend=laspy.LazBackend.Laszip)
    assert cloud.header.parse_crs().to_epsg() == 25832
    assert str(cloud.header.version) == "1.4"  # PDAL reads extra dimensions of no other
    assert np.abs(cloud.xyz - np.column_stack([found[axis] for axis in "xyz"])).max() < 1e-6
    for name in ("saliency", "occupancy", "nearest_index"):
        assert np.array_equal(cloud[name], found[name].astype(cloud[name].dtype)), name
