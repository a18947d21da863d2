"""Whole evaluations of tiny data, and refusals. `test_reproduce` runs each of the paper's layouts."""

import json
import subprocess
import sys

import numpy as np
import pytest

from snake_training.data import write_corpus
from snake_training.data.shapes import Procedural
from snake_training.evaluation.__main__ import evaluate, main
from snake_training.evaluation.datasets import annotated_shapes, apart_note, fragment, open_scenes, open_views
from snake_training.evaluation.methods import methods_of
from snake_training.evaluation.tables import pivot
from snake_training.export import write_weights
from test_official import SMPL, described, fragments, keypointnet, pairs, shape

QUICK = ["--downsample", "1", "8", "--noise", "0", "0.06", "--num-points", "300", "--limit", "2"]
SHIFT = np.eye(4)
SHIFT[:3, 3] = 5e5, 5e6, 100


@pytest.fixture
def rooms(tmp_path):
    """A pair of georeferenced clouds, one of which has moved, with keypoints that another program found: the same points of both."""
    points = shape(1).astype(np.float64)
    t = np.eye(4)
    t[1, 3] = -1
    for name, shift in (("a", 0), ("b", 1)):
        cloud = points + SHIFT[:3, 3] + (0, shift, 0)
        np.save(tmp_path / f"{name}.npy", cloud)
        (tmp_path / "found").mkdir(exist_ok=True)
        np.savez(tmp_path / f"found/{name}.npz", keypoints=cloud[:60], scores=-np.arange(60.0))
    write_pairs(tmp_path, [("b.npy", "a.npy", t)])
    return tmp_path


def write_pairs(folder, rows):
    rows = [{"source": source, "target": target, "T": np.asarray(t).tolist()} for source, target, t in rows]
    (folder / "pairs.json").write_text(json.dumps(rows))


def figure(table, metric, method, condition):
    """The mean of a figure."""
    return pivot(table, {"": (metric, condition)}).loc[method, ""]


def test_objects_from_detection_to_curves_and_a_method_that_is_there_is_not_run_again(tmp_path, capsys, monkeypatch):
    write_corpus(tmp_path / "objects", [Procedural()[row] for row in range(3)], 500)
    words = ["repeatability", str(tmp_path / "objects"), *QUICK, "-o", str(tmp_path / "out"), "--methods"]
    main([*words, "compact:query_resolution=12", "iss", "--paper"])
    printed = capsys.readouterr().out
    assert "| snake (paper) | 0.763 | 0.864 |" in printed
    names = {path.name for path in (tmp_path / "out").iterdir()}
    files = {"repeatability.csv", "repeatability.md", "repeatability.svg", "repeatability-iss.csv"}
    assert names == {*files, "repeatability-compact_query_resolution=12.csv"}
    assert (tmp_path / "out/repeatability.md").read_text() == printed.rstrip("\n") + "\n"
    table = evaluate([*words, "compact:query_resolution=12"])
    assert set(table.columns) == {"metric", "method", "condition", "unit", "value"}
    clean = table[(table["metric"] == "repeatability") & (table["condition"] == "ε 0.04")]
    assert len(clean) == 2
    for condition in ("ε 0.04, 1 in 1", "ε 0.04, σ 0"):
        again = table[(table["metric"] == "repeatability") & (table["condition"] == condition)]
        assert again["value"].tolist() == clean["value"].tolist()
    monkeypatch.setattr("snake_training.evaluation.methods.Method.find", None)
    assert evaluate([*words, "compact:query_resolution=12", "iss"])["value"].notna().any()
    with pytest.raises(ValueError, match="was written with other settings"):
        evaluate([*words, "iss", "--seed", "1"])


def test_a_file_detects_by_the_options_that_it_recommends(tmp_path, network):
    np.save(tmp_path / "cloud.npy", np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32))
    counts = {}
    for radius in ("0.2", "2.0"):
        thresholds = '"occupancy_threshold":0,"surface_threshold":0,"saliency_threshold":0,"refine_steps":0'
        options = f'{{"detect":{{{thresholds},"query_resolution":8,"nms_radius":{radius}}}}}'
        path = tmp_path / f"{radius}.safetensors"
        write_weights(path, network.config, network.state_dict(), extra={"recommended_options": options})
        words = ["repeatability", str(tmp_path), "--methods", str(path), "--downsample", "1", "--noise", "0"]
        counts[radius] = figure(evaluate(words), "keypoints", str(path), "clean")
    assert counts["0.2"] > counts["2.0"] >= 1


def test_keypoints_of_files_are_found_again_in_far_clouds_too(rooms):
    words = ["repeatability", str(rooms), "--methods", "random", "--external", f"other={rooms / 'found'}"]
    table = evaluate([*words, "--downsample", "1", "--noise", "0", "--num-points", "1000"])
    assert figure(table, "repeatability", "other", "ε 0.1") == 1 and figure(table, "coverage", "other", "clean") < 1
    few = evaluate([*words, "--downsample", "1", "--noise", "0", "--max-keypoints", "20", "--coverage", "0.2"])
    assert figure(few, "coverage", "other", "clean") <= 0.2 < figure(table, "coverage", "other", "clean") + 0.2


def test_annotations_of_keypoints_from_files(tmp_path):
    """Of both shapes, one annotated point of two is a keypoint; another keypoint is false."""
    data, _ = keypointnet(tmp_path / "data")
    for one in annotated_shapes(data):
        points = np.loadtxt(one.path, skiprows=11)[:, :3]
        np.savez(tmp_path / f"{one.name}.npz", keypoints=points[[3, 90]])
    table = evaluate(
        ["semantic", str(data), "--methods", "random", "--external", f"other={tmp_path}", "--threshold", "0"]
    )
    assert figure(table, "mIoU, strict", "other", "threshold 0") == pytest.approx(1 / 3)
    assert figure(table, "found", "other", "threshold 0") == 0.5


def test_bodies_of_a_model_and_of_arrays(tmp_path):
    table = evaluate(["semantic", str(SMPL / "model.npz"), "--methods", "fps", "--limit", "2", "--paper"])
    assert figure(table, "mIoU, strict", "fps", "threshold 0.1") > 0
    assert figure(table, "mIoU, as released", "snake (paper)", "threshold 0.1") == 0.704
    bodies = np.stack([shape(1), shape(2)])
    for name in ("body_1.npy", "body_2.npy"):
        np.save(tmp_path / name, bodies)
    table = evaluate(["semantic", str(tmp_path), "--methods", "fps", "--threshold", "0"])
    assert figure(table, "mIoU, strict", "fps", "threshold 0") == 1  # the same points of the same body


def test_a_scene_is_registered_by_descriptors_of_files_and_by_snake_rs(tmp_path):
    scene = fragments(tmp_path / "data") / "scene"
    described(scene, tmp_path / "found/scene")
    words = ["--external", f"d3={tmp_path / 'found'}", "--descriptors", "d3", "fpfh", "--max-keypoints", "50"]
    table = evaluate(["registration", str(tmp_path / "data"), "--methods", "fps", "register", *words])
    for method, condition in (("fps d3", "best 50"), ("d3 d3", "best 50"), ("register", "all voxels")):
        assert figure(table, "registration recall", method, condition) == 1, method
    assert (
        figure(table, "inlier ratio", "fps d3", "best 50") == 1 == figure(table, "keypoints", "d3 d3", "best 50") / 50
    )
    write_pairs(scene, [("cloud_bin_2.ply", "cloud_bin_0", np.eye(4)), ("cloud_bin_1", "cloud_bin_0", np.eye(4))])
    listed = open_scenes(scene)
    assert [pair.scene for pair in listed] == ["cloud_bin"] * 2 and listed[0].fragments == (2, 0)
    assert fragment("kitchen_07.ply") == ("kitchen", 7) and fragment("b.npy") == ("b", None)


def test_pairs_that_do_not_meet_are_named(tmp_path):
    points, t = shape(1), np.eye(4)
    t[0, 3] = 1.5
    moved = points + t[:3, 3].astype(np.float32)
    note = lambda transform: apart_note(["a to b"], lambda row: (moved, points, transform), [0])
    assert note(t) is None
    assert "1 of 1 pairs" in note(np.linalg.inv(t)) and "wrong way" in note(np.linalg.inv(t))
    far = np.eye(4)
    far[1, 3] = 99
    assert "in the clouds' unit" in note(far)


def test_pairs_of_usip_are_those_of_their_lists(tmp_path):
    pairs(tmp_path / "data", "original", "rotated")
    views = open_views(tmp_path / "data")
    first, second, t = views.clouds(1)
    assert views.scale == "object" and views.files[1] == ("original/1", "rotated/1")
    assert np.abs(second @ t[:3, :3].T - first).max() < 1e-6


def test_evaluation_needs_no_pytorch():
    code = "import sys, snake_training.evaluation.__main__; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_options_stand_in_the_words_of_methods():
    method, classical = methods_of(["compact:rotations=4,prefer=corners,nms_radius=null", "sift3d"], paper=True)
    assert method.options == {"rotations": 4, "prefer": "corners", "nms_radius": None}
    assert classical.options == {"protocol": "paper", "field": "y"}


REFUSED = [
    (["repeatability", "{data}", "--methods", "isss"], "isss: neither a weight file nor one of"),
    (["repeatability", "{data}", "--methods", "iss", "iss"], "each method once"),
    (["repeatability", "{data}", "--methods", "compact:rotations"], "expected option=value"),
    (["repeatability", "{data}", "--methods", "compact:rotation=4"], "unexpected keyword argument"),
    (["repeatability", "{data}", "--methods", "iss:radius=1"], "have no options here"),
    (["repeatability", "{data}", "--external", "iss=found"], "of another name"),
    (["repeatability", "{data}", "--methods", "iss", "--limit", "0"], "limit is 0"),
    (["repeatability", "{data}", "--methods", "iss", "--noise", "-1"], "allowed are 1 or more"),
    (["repeatability", "{data}", "--methods", "iss", "--table-epsilon", "7"], "table_epsilon is 7"),
    (["repeatability", "{data}", "--methods", "iss", "--coverage", "1", "--nms-radius", "1"], "give one of them"),
    (["repeatability", "{data}", "--methods", "random", "--coverage", "-1"], "coverage is -1"),
    (["repeatability", "{data}", "--methods", "iss", "--external", "other={data}/absent"], "absent"),
    (["repeatability", "{data}", "--methods", "iss", "--external", "other={data}"], "no array keypoints"),
    (["repeatability", "{data}/absent"], "absent"),
    (["semantic", "{data}", "--methods", "iss"], "neither annotations/"),
    (["semantic", "{data}", "--methods", "iss", "--split", "list.txt"], "a split is for KeypointNet"),
    (["registration", "{data}", "--methods", "iss", "--descriptors", "d3feat"], "descriptors name d3feat"),
    (["registration", "{data}/found", "--methods", "iss"], "no pairs"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_arguments_that_cannot_be_used_are_refused(rooms, words, message, capsys):
    np.savez(rooms / "a.npz", other=np.zeros(3))
    with pytest.raises(SystemExit) as stop:
        main([word.format(data=rooms) for word in words])
    assert message in str(stop.value.code)


ARRAYS = [
    ({"keypoints": np.zeros((4, 2))}, "shape"), ({"keypoints": np.full((4, 3), np.nan)}, "finite"),
    ({"keypoints": np.zeros((4, 3)), "scores": np.zeros(3)}, "scores"),
    ({"keypoints": np.zeros((4, 3)), "descriptors": np.zeros(4)}, "descriptors"),
]  # fmt: skip


@pytest.mark.parametrize(("arrays", "message"), ARRAYS)
def test_files_of_keypoints_that_are_wrong_are_named(rooms, arrays, message):
    np.savez(rooms / "found/a.npz", **arrays)
    with pytest.raises(ValueError, match=f"a.npz.*{message}"):
        evaluate(["repeatability", str(rooms), "--methods", "random", "--external", f"other={rooms / 'found'}"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "pairs.json"), ("[]", "expected a list of pairs"), ('[{"source": "a.npy"}]', "expected a list of pairs"),
        ('[{"source": "a.npy", "target": "b.npy", "T": [[1, 0], [0, 1]]}]', "expected a rotation"),
        (json.dumps([{"source": "c.npy", "target": "a.npy", "T": np.eye(4).tolist()}]), "c.npy: no such cloud"),
    ],
)  # fmt: skip
def test_lists_that_are_wrong_are_named(rooms, text, message):
    (rooms / "pairs.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        evaluate(["repeatability", str(rooms), "--methods", "random"])
