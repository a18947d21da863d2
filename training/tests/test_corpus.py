"""The list of the corpus, and the folder that is made of clones."""

import numpy as np
import pytest
import trimesh

from conftest import FOLDER
from snake_training.data import Corpus, corpus
from snake_training.data.assemblies import MeshError, triangles_of
from snake_training.data.corpus import Entry, build, check_points, read_list, spread, summary
from snake_training.make import main

SHARED = FOLDER.parent / "shared/data/objects"


def box(*size):
    """A mesh file's box."""
    return trimesh.creation.box(size)


@pytest.fixture
def clones(tmp_path):
    """Clones of two repositories: a box, a file that is no mesh, and a stool of SDF; another has no clone."""
    folder = tmp_path / "clones"
    (folder / "us/boxes").mkdir(parents=True)
    box(1, 2, 4).export(folder / "us/boxes/crate.obj")
    (folder / "us/boxes/broken.stl").write_text("solid nothing")
    stool = folder / "models/stool"
    (stool / "meshes").mkdir(parents=True)
    box(1, 1, 0.2).export(stool / "meshes/seat.stl")
    (stool / "model.sdf").write_text(
        """<sdf version="1.6"><model name="stool"><link name="a"><pose>0 0 1 0 0 0</pose><visual name="v"><geometry><mesh>
        <uri>model://stool/meshes/seat.stl</uri><scale>2 2 1</scale></mesh></geometry></visual>
        <visual name="leg"><pose>0 0 -0.5 0 1.5707963267948966 0</pose><geometry><box><size>1 0.2 0.1</size></box></geometry></visual>
        </link></model></sdf>"""
    )
    return folder


def entry(source, path, faces=12, spread="0.5,0.3,0.2", split="train", digest="00ff"):
    """An entry of a list."""
    return Entry(split, source, "", path, "name", "box", "group", "family", "CC0-1.0", str(faces), digest, spread)


def listed():
    """Entries that the clones hold, and entries that they lack."""
    return [
        entry("us/boxes", "crate.obj"),
        entry("us/boxes", "broken.stl"),
        entry("us/boxes", "absent.obj"),
        entry("other/models", "stool/model.sdf", 24, split="val"),
        entry("no/clone", "a.obj"),
        entry("generated", "superquadric e1=1 e2=1 a=0.5,0.5,0.5", 57600, "0.577,0.577,0.577"),
    ]


def test_a_folder_is_made_of_what_the_clones_hold_and_the_rest_is_said(clones, tmp_path):
    report = build(listed(), clones, tmp_path / "made")
    train, val = Corpus(tmp_path / "made/train"), Corpus(tmp_path / "made/val")
    assert train.points.shape == (2, 4096, 3) and val.points.shape == (1, 8192, 3)
    assert [row["path"] for row in train.index] == ["crate.obj", "superquadric e1=1 e2=1 a=0.5,0.5,0.5"]
    assert train.index[0]["faces"] == 12 and train.index[0]["licence"] == "CC0-1.0"
    assert [row["source"] for row in val.index] == ["other/models"]
    for points in (*train.points, *val.points):
        assert np.linalg.norm(points.astype(float), axis=1).max() == pytest.approx(32767, abs=1)
        assert np.abs(points.mean(axis=0)).max() < 2
    lines = "\n".join(summary(report))
    assert lines.startswith("3 of 6 objects, 1 with the surface of the list\nno clone of no/clone: 1 objects")
    for said in (
        "absent.obj: the clone of us/boxes lacks the file",
        "broken.stl: ",
        "another surface: spread off by 0.",
    ):
        assert said in lines
    assert len((tmp_path / "made/report.tsv").read_text().splitlines()) == 6


def test_the_points_are_seeded_and_their_spread_tells_surfaces_apart(clones, tmp_path):
    build(listed(), clones, tmp_path / "one")
    build(listed(), clones, tmp_path / "two")
    one, two = (Corpus(tmp_path / name / "train").points for name in ("one", "two"))
    assert (one == two).all()
    known = ",".join(f"{value:.3f}" for value in spread(one[0]))
    same = entry("us/boxes", "crate.obj", spread=known, digest="1234")
    ((_, fault, other),) = build([same], clones, tmp_path / "three")
    assert (fault, other) == ("", "")
    assert (Corpus(tmp_path / "three/train").points[0] != one[0]).any()
    ((_, _, other),) = build([entry("us/boxes", "crate.obj", 14, known)], clones, tmp_path / "three")
    assert other == "12 triangles, listed 14"


def test_an_sdf_model_is_assembled_of_its_visuals(clones):
    corners = triangles_of(clones / "models/stool/model.sdf", clones / "models")
    seat, leg = corners[:12], corners[12:]
    np.testing.assert_allclose([seat.min(axis=(0, 1)), seat.max(axis=(0, 1))], [[-1, -1, 0.9], [1, 1, 1.1]], atol=1e-6)
    # The leg's length, along x, is pitched to -z and back up by the link.
    np.testing.assert_allclose(
        [leg.min(axis=(0, 1)), leg.max(axis=(0, 1))], [[-0.05, -0.1, 0], [0.05, 0.1, 1]], atol=1e-6
    )


def test_a_mujoco_model_is_assembled_of_its_mesh_geometries(tmp_path):
    box(1, 1, 1).export(tmp_path / "part.stl")
    path = tmp_path / "model.xml"
    path.write_text(
        """<mujoco><asset><mesh file="part.stl" name="p" scale="2 1 1"/></asset><worldbody><body pos="0 0 3"><geom type="box"
        size="9 9 9"/><body quat="0.7071067811865476 0 0 0.7071067811865476" pos="5 0 0"><geom type="mesh" mesh="p"/></body></body>
        </worldbody></mujoco>"""
    )
    corners = triangles_of(path, tmp_path)
    np.testing.assert_allclose(
        [corners.min(axis=(0, 1)), corners.max(axis=(0, 1))], [[4.5, -1, 2.5], [5.5, 1, 3.5]], atol=1e-6
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<sdf", "unclosed token"),
        ("<sdf/>", "no model"),
        ("<sdf><model/></sdf>", "no triangles"),
        ("<sdf><model><include><uri>model://a</uri></include></model></sdf>", "include each other"),
        ("<sdf><model><include><uri>model://b</uri></include></model></sdf>", "no b of model://b"),
        ("<sdf><model><link><pose>1 2</pose><visual/></link></model></sdf>", "expected 6 numbers"),
    ],
)
def test_a_model_that_cannot_be_assembled_says_why(tmp_path, text, said):
    (tmp_path / "a").mkdir()
    (tmp_path / "a/model.sdf").write_text(text)
    with pytest.raises(MeshError, match=said):
        triangles_of(tmp_path / "a/model.sdf", tmp_path)


def test_the_list_of_the_repository_is_small_and_whole():
    entries = read_list()
    assert corpus.LIST.stat().st_size < 200_000
    assert [sum(entry.split == split for entry in entries) for split in ("train", "val")] == [2033, 174]
    assert all(entry.licence and entry.path and len(entry.digest) == 16 and int(entry.faces) for entry in entries)
    assert (
        all(len(entry.commit) in (0, 40) for entry in entries) and sum(bool(entry.commit) for entry in entries) > 1000
    )


def test_made_superquadrics_have_the_surface_of_the_list(tmp_path):
    made = [entry for entry in read_list() if entry.source == "generated"]
    report = build(made[:6], tmp_path, tmp_path / "made")
    assert [(fault, other) for _, fault, other in report] == [("", "")] * 6


@pytest.mark.skipif(not SHARED.is_dir(), reason="the corpus of objects is not public: its entries are not compared")
def test_the_list_is_that_of_the_corpus():
    entries = read_list()
    assert (
        next(check_points(entries, [SHARED / "train", SHARED / "val"]))
        == "2207 of 2207 listed objects have the same points here"
    )


def test_the_command_makes_prints_and_checks(clones, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(corpus, "read_list", listed)
    main(["corpus", str(clones), "-o", str(tmp_path / "made")])
    assert "3 of 6 objects" in capsys.readouterr().out
    main(["corpus"])
    assert "git clone https://github.com/us/boxes CLONES/us/boxes\n" in capsys.readouterr().out
    main(["corpus", "--check", str(tmp_path / "made/train")])
    assert capsys.readouterr().out.startswith("0 of 6 listed objects have the same points here\n")
    for wrong, said in (([str(clones)], "-o names"), ([str(tmp_path / "none"), "-o", "x"], "no such folder")):
        with pytest.raises(SystemExit):
            main(["corpus", *wrong])
        assert said in capsys.readouterr().err
