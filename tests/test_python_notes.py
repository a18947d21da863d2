"""The module says what the program says: the notes of a result are those of the program, and each is a UserWarning."""

import json
import pickle
import struct
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest

import snake_rs

REPOSITORY = Path(__file__).parents[1]
CLI = REPOSITORY / "target" / "release" / "snake-cli"


def surface(number, *boxes):
    """Points on boxes, each of a centre and a size."""
    rng = np.random.default_rng(0)
    points = []
    for center, size in boxes:
        unit = rng.random((number, 3)) - 0.5
        axis = rng.integers(3, size=number)
        unit[np.arange(number), axis] = rng.choice([-0.5, 0.5], number)
        points.append(unit * size + center)
    return np.concatenate(points)


def thing(number=2000):
    return surface(number, ([0, 0, 0], [0.3, 0.2, 0.05]), ([0.1, 0, 0.1], [0.05, 0.05, 0.2]))


def room(number=4000):
    table = ([1.5, 1, 0.4], [1.2, 0.8, 0.8])
    return surface(number, ([3, 2.5, 1.4], [6, 5, 2.8]), table, ([4, 3.5, 0.9], [0.6, 0.4, 1.8]))


def las(path, points, classes):
    """A LAS file of points with a byte of classification each."""
    records = np.zeros(
        len(points), [("xyz", "<i4", 3), ("intensity", "<u2"), ("flags", "u1"), ("class", "u1"), ("rest", "u1", 4)]
    )
    records["xyz"], records["class"] = np.round(points / 0.001), classes
    head = b"LASF" + struct.pack("<HHIHH8sBB", 0, 0, 0, 0, 0, b"", 1, 2) + bytes(64)
    counts = struct.pack("<HHHIIBHI5I", 1, 2026, 227, 227, 0, 0, 20, len(points), len(points), 0, 0, 0, 0)
    bounds = np.c_[points.max(0), points.min(0)].ravel()
    path.write_bytes(head + counts + struct.pack("<12d", *[0.001] * 3, *[0] * 3, *bounds) + records.tobytes())


def mesh(path):
    """A box of triangles."""
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [face for a, b, c, d in quads for face in ([a, b, c], [a, c, d])]
    lines = ["OFF", f"{len(corners)} {len(faces)} 0", *(" ".join(map(str, row)) for row in corners)]
    path.write_text("\n".join([*lines, *(f"3 {a} {b} {c}" for a, b, c in faces)]) + "\n")


def case(name, folder):
    """The file of a cloud of this name, and the options of its detection."""
    path, options = folder / "cloud.npy", {}
    if name == "withheld":
        path = folder / "cloud.las"
        las(path, thing(), np.where(np.arange(4000) % 10 == 0, 128 + 2, 2))
    elif name == "mesh":
        path = folder / "cloud.off"
        mesh(path)
    else:
        clouds = {
            "plain": lambda: thing(),
            "outliers": lambda: np.r_[thing(), [[500.0, 0, 0], [0, 500, 0]]],
            "missing": lambda: np.r_[room(), np.zeros((3000, 3))],
            "housing": lambda: np.r_[room() - [3, 2, 1.2], 0.01 * np.random.default_rng(1).normal(size=(15_000, 3))],
            "thin": lambda: surface(30_000, ([0, 0, 0], [200, 0.3, 0.3])),
            "empty": lambda: thing(),
            "rotations": lambda: thing(3000),
        }
        options = {"empty": {"saliency_threshold": 0.9999}, "rotations": {"rotations": 2}}.get(name, {})
        np.save(path, clouds[name]())
    return path, options


def warned(call):
    """The result of a call, and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call()
    assert all(warning.category is UserWarning for warning in caught)
    return result, [str(warning.message) for warning in caught]


def program(*arguments):
    run = subprocess.run([CLI, *map(str, arguments), "--json"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout), run.stderr


WORDS = {
    "plain": [],
    "outliers": ["far"],
    "missing": ["missing returns"],
    "housing": ["housing"],
    "thin": ["the cloud lies in"],
    "empty": ["no keypoints"],
    "rotations": ["`rotations` is for objects"],
    "withheld": ["withheld or as noise"],
    "mesh": ["vertices are used"],
}


@pytest.mark.skipif(not CLI.exists(), reason="snake-cli is not built: cargo build --release")
@pytest.mark.parametrize("name", WORDS)
def test_detection_has_the_notes_of_the_program(name, tmp_path):
    path, options = case(name, tmp_path)
    flags = [part for option, value in options.items() for part in ("--set", f"{option}={value}")]
    line, said = program("detect", path, *flags)
    found, texts = warned(lambda: snake_rs.detect(path, **options))
    assert found.notes == texts == line["notes"]
    assert all(word in " ".join(found.notes) for word in WORDS[name]) and bool(found.notes) == bool(WORDS[name])
    assert all(f"note: {path}: {note}" in said for note in found.notes)
    assert pickle.loads(pickle.dumps(found)).notes == found.notes


@pytest.mark.skipif(not CLI.exists(), reason="snake-cli is not built: cargo build --release")
def test_registration_and_alignment_have_the_notes_of_the_program(tmp_path):
    source, target = tmp_path / "source.las", tmp_path / "target.npy"
    las(source, thing(), np.where(np.arange(4000) % 10 == 0, 7, 2))
    np.save(target, thing(1500))
    line, said = program("register", source, target)
    found, texts = warned(lambda: snake_rs.register(source, target))
    assert found.verdict.notes == line["verdict"]["notes"] and found.verdict.notes[-1].startswith("source: 400 of")
    doubts = [text for text in texts if "not reliable" in text]
    assert all(f"warning: {text}" in said for text in doubts) and bool(doubts) != found.verdict.is_reliable
    assert {*texts} - {*doubts} == {note.removeprefix("source: ") for note in found.verdict.notes}
    np.save(target, np.random.default_rng(0).normal(size=(1500, 3)))
    line, said = program("align", source, target)
    poses, texts = warned(lambda: snake_rs.align([source, target]))
    assert poses.notes == line["notes"] and poses.notes[-1].startswith("cloud 0 (from 0): 400 of")
    assert len(poses.parts) == 2 and sum(f"warning: {text}" in said for text in texts) == 1


def test_points_that_are_withheld_are_kept_on_demand(tmp_path):
    las(tmp_path / "a.las", thing(100), np.where(np.arange(200) % 2 == 0, 18, 2))
    points, texts = warned(lambda: snake_rs.read_points(tmp_path / "a.las"))
    assert np.isnan(points[::2]).all() and np.isfinite(points[1::2]).all()
    assert len(texts) == 1 and texts[0].endswith("withheld or as noise; reading with `keep_withheld` keeps them")
    points, texts = warned(lambda: snake_rs.read_points(tmp_path / "a.las", keep_withheld=True))
    assert np.isfinite(points).all() and texts == []


def test_a_pcd_of_map_coordinates_names_its_origin(tmp_path):
    keypoints = snake_rs.detect(thing() + [500_000, 4_600_000, 100])
    _, texts = warned(lambda: keypoints.save(tmp_path / "k.pcd"))
    assert len(texts) == 1 and "relative to the origin" in texts[0]
    assert warned(lambda: keypoints.save(tmp_path / "k.ply"))[1] == []
    assert np.allclose(snake_rs.read_points(tmp_path / "k.pcd"), keypoints.points, atol=1e-3)


def test_meshes_and_fields_have_notes():
    model = snake_rs.Model.builtin()
    field, texts = warned(lambda: model.encode(np.r_[thing(), [[500.0, 0, 0]]]))
    assert field.notes == texts and len(texts) == 1
    _, shown = warned(lambda: snake_rs._core.page(np.r_[thing(), [[500.0, 0, 0]]], model="compact"))
    assert shown == texts
    mesh, texts = warned(lambda: field.mesh(level=0.999, resolution=32))
    assert mesh.notes == texts == ["no surface: a lower `level` may have one"]
    assert pickle.loads(pickle.dumps(mesh)).notes == mesh.notes


def test_keypoints_of_two_models_are_not_matched():
    a = snake_rs.detect(thing(), model="compact")
    for other in ("scenes", "standard"):  # `standard` has the weights of `compact`
        with pytest.raises(ValueError, match=f"two models, compact, built-in and {other}, built-in"):
            snake_rs.match(a, snake_rs.detect(thing(), model=other))
    files = (REPOSITORY / f"crates/snake-core/models/{name}.safetensors" for name in ("compact", "scenes"))
    a, b = (snake_rs.detect(thing(), model=snake_rs.Model.from_bytes(file.read_bytes())) for file in files)
    with pytest.raises(ValueError, match="two models, without a name and without a name"):
        snake_rs.match(a, b)
    assert len(snake_rs.match(a, a)) > 0
