"""The official layouts in miniature. `test_reproduce` trains on them and evaluates."""

import json
import shutil

import numpy as np
import pytest

from conftest import FOLDER
from snake_training.data import ShapeError, open_all, open_shapes
from snake_training.data.official import Bodies, clouds_below

SMPL = FOLDER / "tests/data/smpl"


def shape(seed, points=300):
    """A cloud of an ellipsoid."""
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(points, 3))
    return (unit / np.linalg.norm(unit, axis=1, keepdims=True) * rng.uniform(0.3, 1, 3)).astype(np.float32)


def write_pcd(path, points):
    """A file like the authors': ASCII, with a colour."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = "".join(f"{x:.6f} {y:.6f} {z:.6f} 16711680\n" for x, y, z in points)
    number = len(points)
    path.write_text(
        "# .PCD v.7\nVERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
        f"WIDTH {number}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {number}\nDATA ascii\n{rows}"
    )


def keypointnet(folder):
    """Three shapes, of which the list of training names two, with annotations. (data, list)"""
    (folder / "annotations").mkdir(parents=True)
    marked = []
    for row in range(3):
        write_pcd(folder / f"02691156/{row}abc.pcd", shape(row))
        keypoints = [{"pcd_info": {"point_index": index}} for index in (3, 7)]
        marked.append({"class_id": "02691156", "model_id": f"{row}abc", "keypoints": keypoints})
    (folder / "annotations/airplane.json").write_text(json.dumps(marked))
    (folder / "train.txt").write_text("02691156-0abc\n02691156-2abc\n")
    return folder, folder / "train.txt"


def modelnet40(folder):
    """Two classes as USIP stores them, with normals; the test shapes turned."""
    data = folder / "modelnet40-normal_numpy"
    for name in ("airplane_0001", "night_stand_0002", "airplane_0627"):
        (data / name[:-5]).mkdir(parents=True, exist_ok=True)
        np.save(data / name[:-5] / f"{name}.npy", np.tile(shape(len(name)), 2))
    (folder / "modelnet40_train.txt").write_text("airplane_0001\nnight_stand_0002\n")
    pairs(folder / "modelnet40-test_rotated_numpy", "original", "rotated")
    return data, folder / "modelnet40_train.txt"


def pairs(folder, first, second):
    """Two turned objects in the layout of USIP."""
    turn = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]], float)
    for part in (first, second):
        (folder / part).mkdir(parents=True)
    for row in range(2):
        np.save(folder / first / f"{row}.npy", shape(row))
        np.save(folder / second / f"{row}.npy", shape(row) @ turn[:, :3])
    np.save(folder / "transform.npy", np.stack([turn, turn]))


def match3d(folder):
    """Two fragments of a scene, by their paths."""
    (folder / "3DMatch_npy/scene").mkdir(parents=True)
    for row in range(3):
        np.save(folder / f"3DMatch_npy/scene/{row}.npy", shape(row))
    (folder / "match3d_train.txt").write_text("scene/0.npy\nscene/1\n")
    redwood = folder / "redwood"
    (redwood / "room").mkdir(parents=True)
    for row in range(2):
        np.save(redwood / f"room/{row}.npy", shape(7))
    np.save(redwood / "transform.npy", np.eye(4)[None, :3])
    (redwood / "redwood_pair.txt").write_text("room 0 1\n")
    return folder / "3DMatch_npy", folder / "match3d_train.txt"


def smpl(folder):
    """The body model of the tests, converted, with parameters of two pairs."""
    folder.mkdir()
    shutil.copy(SMPL / "model.npz", folder)
    rng = np.random.default_rng(0)
    np.save(folder / "pose_test_100.npy", rng.random((2, 2, 3, 3)))
    np.save(folder / "beta_test_100.npy", rng.random((2, 2, 10)))
    return folder, None


def fragments(folder):
    """A scene of the registration benchmark: two fragments and what relates them."""
    scene = folder / "scene"
    scene.mkdir(parents=True)
    for row in (0, 1, 2):
        write_ply(scene / f"cloud_bin_{row}.ply", shape(9))
    identity = "\n".join(" ".join(map(str, row)) for row in np.eye(4))
    (scene / "gt.log").write_text(f"0 2 3\n{identity}\n")
    information = "\n".join(" ".join(map(str, row)) for row in np.eye(6))
    (scene / "gt.info").write_text(f"0 2 3\n{information}\n")
    return folder


def write_ply(path, points):
    """An ASCII PLY."""
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{properties}end_header\n{rows}")


def described(scene, folder):
    """Files as of D3Feat, of each cloud of a scene: its points, each with a score and a descriptor."""
    folder.mkdir(parents=True)
    for cloud in scene.glob("*.ply"):
        points = np.loadtxt(cloud, skiprows=7)
        np.savez(
            folder / f"{cloud.stem}.npz", keypoints=points, scores=points[:, 0], descriptors=points @ np.eye(3, 32)
        )


def annotate_figure_3(folder):
    """The aeroplane of figure 3, with annotations."""
    name, annotations = "1021a0914a7207aff927ed529ad90a11", folder / "annotations/airplane.json"
    write_pcd(folder / f"02691156/{name}.pcd", shape(0))
    marked = json.loads(annotations.read_text())
    annotations.write_text(json.dumps([*marked, marked[0] | {"model_id": name}]))


def official_folder(data):
    """The authors' folder with all data sets, and their lists in split/."""
    split = data / "split"
    split.mkdir(parents=True)
    _, names = keypointnet(data / "keypointnet_pcds")
    annotate_figure_3(data / "keypointnet_pcds")
    for name in ("keypointnet_train", "keypointnet_val"):
        shutil.copy(names, split / f"{name}.txt")
    names.unlink()
    (split / "keypointnet_test_full.txt").write_text("".join(f"02691156-{row}abc\n" for row in range(3)))
    shutil.copy(shutil.move(modelnet40(data / "modelnet40")[1], split), split / "modelnet40_val.txt")
    smpl(data / "smpl_model")
    (data / "smpl_model/model.npz").unlink()
    shutil.copy(SMPL / "model.pkl", data / "smpl_model")
    shutil.copy(shutil.move(match3d(data)[1], split / "match3d_train_new_40k.txt"), split / "match3d_val.txt")
    (data / "redwood/numpy_gt_normal").mkdir()
    for name in ("room", "transform.npy", "redwood_pair.txt"):
        shutil.move(data / "redwood" / name, data / "redwood/numpy_gt_normal" / name)
    fragments(data / "3DMatch_eval_downsample")
    described(data / "3DMatch_eval_downsample/scene", data / "d3feat/scene")
    return data


def test_a_list_gives_the_shapes_in_its_order(tmp_path):
    data, split = keypointnet(tmp_path / "data")
    shapes = open_shapes(data, split)
    assert [path.stem for path in shapes.files] == ["0abc", "2abc"]
    assert np.allclose(shapes[1], shape(2), atol=1e-5)
    assert len(open_shapes(data)) == 3  # without a list, all
    split.write_text("\ufeff" + split.read_text(), encoding="utf-8")  # as editors of Windows write it
    assert open_shapes(data, split).files == shapes.files


def test_arrays_of_evaluation_are_no_shapes(tmp_path):
    pairs(tmp_path / "rotated", "original", "rotated")
    assert {path.name for path in clouds_below(tmp_path)} == {"0.npy", "1.npy"}


@pytest.mark.parametrize(
    ("text", "message"),
    [("02691156-9xyz\n", "'02691156-9xyz' is no cloud below"), ("\n", "an empty list"), (None, "No such file")],
)
def test_a_list_that_does_not_fit_is_refused(tmp_path, text, message):
    data, _ = keypointnet(tmp_path / "data")
    if text is not None:
        (tmp_path / "list.txt").write_text(text)
    with pytest.raises(ShapeError, match=message):
        open_shapes(data, tmp_path / "list.txt")
    with pytest.raises(ShapeError, match="1 lists for 2 folders"):
        open_all([data, data], ["list.txt"])


@pytest.mark.parametrize("name", ["model.pkl", "model_py3.pkl", "model_py3_protocol5.pkl", "model.npz"])
def test_bodies_are_posed_as_by_the_definition(name):
    posed = np.load(SMPL / "posed.npz")
    found = Bodies(SMPL / name).vertices(posed["pose"], posed["betas"])
    assert np.abs(found - posed["vertices"]).max() < 1e-12


def test_bodies_lie_on_their_surface():
    bodies = Bodies(SMPL / "model.npz", number=3, points=100)
    assert len(bodies) == 3 and bodies[0].shape == (100, 3) and np.isfinite(bodies[1]).all()
    assert np.array_equal(bodies[2], bodies[2]) and not np.array_equal(bodies[0], bodies[1])
    assert bodies[0][:, 0].min() > -0.5 and bodies[0][:, 0].max() < 3.5  # an arm of length 3


@pytest.mark.parametrize("content", [b"cos\nsystem\n(S'touch harm'\ntR.", b"\x80\x02}.", b"text"])
def test_other_pickles_are_refused_and_not_run(tmp_path, content, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.pkl").write_bytes(content)
    with pytest.raises(ShapeError, match="not a body model"):
        open_shapes(tmp_path)
    assert not (tmp_path / "harm").exists()
