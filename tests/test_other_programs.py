"""Other programs read the keypoints of a city: LASzip and PDAL the LAZ."""

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

CITY = Path(__file__).parent / "data/tiles/city.copc.laz"
OPTIONS = shlex.split("--model scenes --voxel-size 0.4 --nms-radius 0.5 --max-keypoints 5000 --quiet")


@pytest.fixture(scope="module")
def detect(compiled, tmp_path_factory):
    """Detects the city's keypoints in tiles and writes them to a file of a name."""
    folder = tmp_path_factory.mktemp("keypoints")

    def run(name, cloud=CITY):
        command = [compiled / "snake-cli", "detect", cloud, *OPTIONS, "--tile", "20"]
        command += ["--tile-folder", folder / cloud.parent.name]
        subprocess.run([*command, "-o", folder / name], check=True)
        return folder / name

    return run


@pytest.fixture(scope="module")
def found(detect):
    """The columns of the keypoints."""
    rows = json.loads(detect("keypoints.json").read_text())["keypoints"]
    assert len(rows) > 50
    return {column: np.array([row[column] for row in rows]) for column in rows[0]}


def test_laszip_reads_laz(detect, found):
    laspy = pytest.importorskip("laspy", reason="LASzip is not tested: pip install laspy laszip")
    pytest.importorskip("laszip", reason="LASzip is not tested: pip install laspy laszip")
    cloud = laspy.read(detect("keypoints.laz"), laz_backend=laspy.LazBackend.Laszip)
    assert cloud.header.parse_crs().to_epsg() == 25832
    assert str(cloud.header.version) == "1.4"  # PDAL reads extra dimensions of no other
    assert np.abs(cloud.xyz - np.column_stack([found[axis] for axis in "xyz"])).max() < 1e-6
    for name in ("saliency", "occupancy", "nearest_index"):
        assert np.array_equal(cloud[name], found[name].astype(cloud[name].dtype)), name


def test_pdal_reads_laz(detect, found, tmp_path):
    pdal = shutil.which("pdal")
    if not pdal:
        pytest.skip("PDAL is not tested: it is not installed")
    table = tmp_path / "keypoints.csv"
    subprocess.run([pdal, "translate", detect("keypoints.laz"), table, "--writers.text.precision=9"], check=True)
    read = np.genfromtxt(table, delimiter=",", names=True)
    assert np.abs(np.column_stack([read[axis] - found[axis.lower()] for axis in "XYZ"])).max() < 1e-6
    for name in ("saliency", "occupancy", "nearest_index"):
        assert np.allclose(read[name], found[name], rtol=1e-6), name
