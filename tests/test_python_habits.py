"""The module as users of numpy, pandas and notebooks expect it."""

import contextlib
import html
import importlib
import json
import pickle
import re
import types
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import snake_rs


def torus(n: int = 4000) -> np.ndarray:
    u, v = np.arange(n) * 0.1, np.arange(n) * 0.7
    ring = 1 + 0.3 * np.cos(v)
    return np.stack([ring * np.cos(u), ring * np.sin(u), 0.3 * np.sin(v)], axis=1)


@pytest.fixture(scope="module")
def keypoints() -> snake_rs.Keypoints:
    found = snake_rs.detect(torus())
    assert len(found) > 5
    return found


def same(a: snake_rs.Keypoints, b: snake_rs.Keypoints) -> bool:
    return np.array_equal(a.points, b.points) and np.array_equal(a.saliency, b.saliency)


def test_a_model_is_also_a_name_or_a_path(tmp_path):
    points = torus()
    assert same(snake_rs.detect(points, "standard"), snake_rs.detect(points, snake_rs.Model.builtin("standard")))
    with pytest.raises(ValueError, match="no built-in model large; known are compact, standard"):
        snake_rs.detect(points, model="large")
    with pytest.raises(FileNotFoundError):
        snake_rs.detect(points, model=tmp_path / "none.safetensors")
    with pytest.raises(TypeError, match="expected a Model, a name or a path"):
        snake_rs.detect(points, model=3)


def test_clouds_in_every_form_give_the_same_keypoints(keypoints, tmp_path):
    points = torus()
    np.save(tmp_path / "torus.npy", points)
    named = np.zeros(len(points), dtype=[("intensity", "f4"), ("z", "f8"), ("y", "f8"), ("x", "f8")])
    named["x"], named["y"], named["z"] = points.T

    class Tensor:
        """A tensor that gives DLPack alone."""

        def __dlpack__(self, **options):
            return points.__dlpack__(**options)

        def __dlpack_device__(self):
            return points.__dlpack_device__()

    forms = {
        "path": tmp_path / "torus.npy",
        "text": str(tmp_path / "torus.npy"),
        "more columns": np.hstack([points, np.ones((len(points), 2))]),
        "structured": named,
        "structured rows": named.reshape(40, 100),
        "dlpack": Tensor(),
        "open3d.t": types.SimpleNamespace(point={"positions": Tensor()}),
        "laspy": types.SimpleNamespace(xyz=points, points="records"),
        "open3d": types.SimpleNamespace(points=points),
    }
    for name, form in forms.items():
        assert same(snake_rs.detect(form), keypoints), name
    with pytest.raises(FileNotFoundError):
        snake_rs.detect("none.ply")


class Frame:
    """A frame as those of pandas: columns have names, and a list of names chooses columns."""

    def __init__(self, names, points):
        self.columns, self.points = names, points

    def __getitem__(self, names):
        return self.points[:, [self.columns.index(name) for name in names]]

    def __array__(self, dtype=None, copy=None):
        return self.points


def frames(points):
    """The same cloud in frames of several kinds, with a column before the coordinates or in another order."""
    time = np.arange(len(points)) * 1e-4
    yield "fake", Frame(["t", "z", "y", "x"], np.column_stack([time, points[:, ::-1]]))
    yield "numbers", Frame([0, 1, 2], points)
    columns = {"t": time, "x": points[:, 0], "z": points[:, 2], "y": points[:, 1]}
    for module, make in (("pandas", "DataFrame"), ("polars", "DataFrame"), ("pyarrow", "table")):
        with contextlib.suppress(ImportError):
            yield module, getattr(importlib.import_module(module), make)(columns)


def test_frames_are_taken_by_the_names_of_their_columns(keypoints):
    points = torus()
    for name, frame in frames(points):
        assert same(snake_rs.detect(frame), keypoints), name
    for names in (["a", "b", "c"], ["x", "y", "y"], ["X", "Y", "Z"]):
        with pytest.raises(
            ValueError, match=f"^points: the columns of the frame are {', '.join(names)}: expected x, y and z"
        ):
            snake_rs.detect(Frame(names, points))


def test_meshes_are_taken_and_no_positions_are_refused(keypoints):
    assert same(snake_rs.detect(types.SimpleNamespace(vertex={"positions": torus()})), keypoints)
    with pytest.raises(ValueError, match="^points: no points: it has no `positions`$"):
        snake_rs.detect(types.SimpleNamespace(point={}))


def test_keypoints_are_a_sequence(keypoints):
    first = keypoints[0]
    assert isinstance(first, snake_rs.Keypoint)
    assert np.array_equal(first.position, keypoints.points[0]) and first.saliency == keypoints.saliency[0]
    assert first.nearest_index == keypoints.nearest_index[0] and first.occupancy == keypoints.occupancy[0]
    assert [k.saliency for k in keypoints] == keypoints.saliency.tolist()
    assert np.array_equal(keypoints[-1].position, keypoints.points[-1])
    some = keypoints[1:4]
    assert isinstance(some, snake_rs.Keypoints) and np.array_equal(some.points, keypoints.points[1:4])
    salient = keypoints[keypoints.saliency > keypoints.saliency[3]]
    assert len(salient) == 3 and same(salient, keypoints[[0, 1, 2]])
    assert same(pickle.loads(pickle.dumps(some)), some) and len(keypoints[:0]) == 0
    with pytest.raises(IndexError):
        keypoints[len(keypoints)]


def test_keypoints_are_an_array_and_columns(keypoints):
    points = np.asarray(keypoints)
    assert points.shape == (len(keypoints), 3) and np.array_equal(points, keypoints.points)
    assert np.asarray(keypoints, dtype=np.float32).dtype == np.float32
    assert not np.shares_memory(np.array(keypoints), keypoints.points)
    columns = keypoints.to_dict()
    assert list(columns) == ["x", "y", "z", "saliency", "occupancy", "nearest_index", "confidence"]
    assert np.array_equal(columns["y"], keypoints.points[:, 1])


def test_a_notebook_shows_a_picture(keypoints):
    shown = keypoints._repr_html_()
    svg = ElementTree.fromstring(shown[: shown.index("</svg>") + len("</svg>")])
    circles = svg.findall("{http://www.w3.org/2000/svg}circle")
    assert len(circles) == len(keypoints)
    for circle in circles:
        assert 0 < float(circle.get("cx")) < 240 and 0 < float(circle.get("cy")) < 160
    assert "svg" not in keypoints[:0]._repr_html_()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_fields_are_pickled(dtype):
    points = torus().astype(dtype)
    points[5] = np.nan
    if dtype == np.float64:
        points += [691_000.0, 5_336_000.0, 500.0]
    field = snake_rs.Model.builtin().encode(points, max_points=2000, seed=3)
    again = pickle.loads(pickle.dumps(field))
    queries = points[10:60]
    assert np.array_equal(again.saliency(queries), field.saliency(queries))
    found, expected = again.detect(), field.detect()
    assert same(found, expected) and found.points.dtype == dtype
    assert found.num_skipped == 1 and np.array_equal(found.nearest_index, expected.nearest_index)


def test_a_view_opens_in_the_browser_and_is_embedded_in_a_notebook(points, monkeypatch, tmp_path):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    view = snake_rs.view(points, name='my <"cloud">', max_keypoints=3)
    (address,) = opened
    page = Path(address.removeprefix("file://")).read_text()
    assert page == view.html and page.startswith("<!doctype html>") and '<"cloud">' not in page
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page)[1])
    expected = snake_rs.detect(points, max_keypoints=3)
    found = [[keypoint[axis] for axis in "xyz"] for keypoint in data["clouds"][0]["keypoints"]]
    assert np.allclose(found, expected.points, atol=1e-6) and data["model"] == "compact, built-in"
    view.save(tmp_path / "view.html")
    assert (tmp_path / "view.html").read_text() == page
    embedded = re.fullmatch(r'<iframe srcdoc="([^"]*)" [^<>]*></iframe>', view._repr_html_())
    assert html.unescape(embedded[1]) == page
    with pytest.raises(TypeError, match="view"):
        snake_rs.view(points, radius=1)


def test_a_list_of_clouds_gives_a_list_of_keypoints(tmp_path):
    clouds = [torus(2000), torus(3000).astype(np.float32), torus(2500) + [5e5, 5.4e6, 0]]
    expected = [snake_rs.detect(cloud) for cloud in clouds]
    for given in (clouds, tuple(clouds)):
        found = snake_rs.detect(given)
        assert len(found) == 3 and all(map(same, found, expected))
        assert [k.points.dtype for k in found] == [np.float64, np.float32, np.float64]
    np.save(tmp_path / "cloud.npy", clouds[0])
    paths = snake_rs.detect([tmp_path / "cloud.npy", str(tmp_path / "cloud.npy")])
    assert len(paths) == 2 and same(paths[0], paths[1])
    # Rows are one cloud.
    assert same(snake_rs.detect(clouds[0].tolist()), expected[0])
    assert same(snake_rs.detect(list(clouds[0])), expected[0])
    with pytest.raises(ValueError, match=r"\[1\]: .*at least two different points"):
        snake_rs.detect([clouds[0], np.ones((9, 3))])
    with pytest.raises(ValueError, match=r"^points\[1\]: expected real numbers"):
        snake_rs.detect([clouds[0], np.ones((9, 2))])


def test_keypoints_have_descriptors_that_match(keypoints):
    rows = keypoints.descriptors
    assert rows.shape == (len(keypoints), 33) and rows.dtype == np.float32
    assert np.array_equal(keypoints[2:5].descriptors, rows[2:5])
    assert np.array_equal(pickle.loads(pickle.dumps(keypoints)).descriptors, rows)
    pairs = snake_rs.match(keypoints, keypoints)
    # Keypoints in one voxel have one descriptor, and the first of them matches.
    different = np.sort(np.unique(rows, axis=0, return_index=True)[1])
    assert len(different) > 40 and pairs.dtype == np.int64
    assert np.array_equal(pairs, np.stack([different, different], axis=1))
    field = snake_rs.Model.builtin().encode(torus())
    assert np.array_equal(field.detect().descriptors, rows)


def test_a_page_shows_a_pair_or_takes_a_model():
    from snake_rs._core import page

    points = torus(2000)
    turned = points @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).T + [1, 2, 3]
    for t_first_second in (None, np.eye(4)):
        assert "keypoint that repeats" in page(points, turned, epsilon="3r", t_first_second=t_first_second)
    assert '"pair":null' in page(points, "standard") and '"pair":null' in page(points, snake_rs.Model.builtin())
    with pytest.raises(ValueError, match="need two clouds"):
        page(points, epsilon=0.1)
    with pytest.raises(ValueError, match="b.ply is neither a built-in model nor a weight file"):
        snake_rs.detect(points, "b.ply")
