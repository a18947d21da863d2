"""Triangles of mesh files, and of models that are assembled of them: Gazebo's SDF and MuJoCo's XML."""

import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as xml
from pathlib import Path

import numpy as np
import trimesh

MAX_DEPTH = 8  # of models that include models


class MeshError(ValueError):
    """A file that gives no triangles; the message says why."""


def triangles_of(path, root):
    """The corners (F, 3, 3) of all triangles of a file below `root`, in the file's unit.

    SDF models are assembled of their visuals, MuJoCo's of their mesh geometries. What trimesh does not read, such as FBX, is
    converted by the program `assimp`, if it is installed.

    Raises MeshError.
    """
    try:
        if path.suffix == ".sdf":
            parts = sdf_parts(path, root)
        elif path.suffix == ".xml":
            parts = mujoco_parts(path)
        else:
            parts = [read_mesh(path)]
    except (xml.ParseError, OSError, KeyError, ValueError, TypeError) as error:
        raise MeshError(str(error) or type(error).__name__) from error
    parts = [part for part in parts if len(part)]
    if not parts or not np.isfinite(np.concatenate(parts)).all():
        raise MeshError("no triangles, or corners that are not finite")
    return np.concatenate(parts)


def read_mesh(path):
    """The triangles (F, 3, 3) of a mesh file, of all its nodes."""
    if not path.is_file():
        raise MeshError(f"no file {path.name}")
    try:
        return by_trimesh(path)
    except MeshError as error:
        if shutil.which("assimp") is None:
            raise MeshError(f"{error}; the program assimp, which may read it, is not installed") from error
    with tempfile.TemporaryDirectory() as folder:
        converted = Path(folder) / "mesh.ply"
        done = subprocess.run(["assimp", "export", path, converted], capture_output=True, text=True, check=False)
        if done.returncode or not converted.is_file():
            raise MeshError(f"{path.suffix}: assimp: {(done.stderr or done.stdout).strip()[-200:]}")
        return by_trimesh(converted)


def by_trimesh(path):
    """The triangles (F, 3, 3) of a file of a format that trimesh reads."""
    try:
        return np.asarray(trimesh.load_scene(path, process=False).to_mesh().triangles)
    except Exception as error:  # whatever its parsers trip over
        raise MeshError(f"{path.suffix}: {error}") from error


def numbers(text, count):
    """`count` numbers of a text."""
    values = np.array((text or "").split(), float)
    if len(values) != count:
        raise MeshError(f"{text!r}: expected {count} numbers")
    return values


def moved(corners, rotation, position):
    """Triangles (F, 3, 3) rotated by a matrix, then shifted."""
    return corners @ rotation.T + position


def pose(element):
    """The rotation and position of an SDF element: x y z roll pitch yaw."""
    x, y, z, *angles = numbers(element.findtext("pose", "0 0 0 0 0 0"), 6)
    return trimesh.transformations.euler_matrix(*angles, "sxyz")[:3, :3], np.array([x, y, z])


def sdf_parts(path, root, depth=0):
    """The triangles of each visual of an SDF model."""
    if depth > MAX_DEPTH:
        raise MeshError("models include each other")
    tree = xml.parse(path).getroot()
    model = tree if tree.tag == "model" else tree.find("model")
    if model is None:
        raise MeshError("no model")
    return model_parts(model, path, root, depth)


def model_parts(model, path, root, depth):
    """The triangles of each visual of a model element, in its frame."""
    parts = []
    for link in model.findall("link"):
        for visual in link.findall("visual"):
            corners = moved(sdf_geometry(visual.find("geometry"), path, root), *pose(visual))
            parts.append(moved(corners, *pose(link)))
    for inner in model.findall("model"):
        parts += [moved(part, *pose(inner)) for part in model_parts(inner, path, root, depth)]
    for include in model.findall("include"):
        found = resolve(include.findtext("uri", ""), path, root)
        found = found / "model.sdf" if found.is_dir() else found
        parts += [moved(part, *pose(include)) for part in sdf_parts(found, root, depth + 1)]
    return parts


def sdf_geometry(geometry, path, root):
    """The triangles (F, 3, 3) of a geometry element."""
    shape = None if geometry is None or len(geometry) == 0 else geometry[0]
    kind = "" if shape is None else shape.tag
    if kind == "mesh":
        scale = numbers(shape.findtext("scale", "1 1 1"), 3)
        return read_mesh(resolve(shape.findtext("uri", ""), path, root)) * scale
    if kind == "box":
        return trimesh.creation.box(numbers(shape.findtext("size"), 3)).triangles
    if kind == "sphere":
        return trimesh.creation.icosphere(radius=float(shape.findtext("radius", ""))).triangles
    if kind == "cylinder":
        radius, length = float(shape.findtext("radius", "")), float(shape.findtext("length", ""))
        return trimesh.creation.cylinder(radius, length).triangles
    return np.empty((0, 3, 3))


def resolve(uri, path, root):
    """The file of a URI in an SDF file: `model://NAME/..` is a folder beside one of those above the file, within `root`."""
    name = uri.strip().removeprefix("file://")
    if not name.startswith("model://"):
        return path.parent / name
    name = name.removeprefix("model://")
    for folder in path.parents:
        if (folder / name).exists():
            return folder / name
        if folder == root:
            break
    raise MeshError(f"no {name} of {uri}")


def mujoco_parts(path):
    """The triangles of each mesh geometry of a MuJoCo model, bodies at rest."""
    model = xml.parse(path).getroot()
    compiler = model.find("compiler")
    folder = path.parent / ("" if compiler is None else compiler.get("meshdir", ""))
    meshes = {}
    for mesh in model.iterfind("asset/mesh"):
        corners = read_mesh(folder / mesh.get("file", "")) * numbers(mesh.get("scale", "1 1 1"), 3)
        meshes[mesh.get("name", Path(mesh.get("file", "")).stem)] = corners
    world = model.find("worldbody")
    return [] if world is None else body_parts(world, meshes)


def body_parts(body, meshes):
    """The triangles of each mesh geometry of a body and of those in it, in its parent's frame."""
    parts = []
    for element in body:
        if element.tag == "body":
            parts += body_parts(element, meshes)
        elif element.tag == "geom" and element.get("type") == "mesh":
            parts.append(moved(meshes[element.get("mesh")], *body_pose(element)))
    return [moved(part, *body_pose(body)) for part in parts]


def body_pose(element):
    """The rotation and position of a MuJoCo element; its quaternion is w x y z."""
    quaternion = numbers(element.get("quat", "1 0 0 0"), 4)
    return trimesh.transformations.quaternion_matrix(quaternion)[:3, :3], numbers(element.get("pos", "0 0 0"), 3)
