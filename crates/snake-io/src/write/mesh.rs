//! Writes triangle meshes as PLY, OBJ and STL.

use std::io::{self, Write};
use std::path::Path;

use crate::formats::{extension, unknown_extension};
use crate::table::scalar::Scalar;
use crate::write::axes;
use crate::write::ply::{self, Row};
use crate::{Error, Result, write_atomically};
use snake_geometry::{Mesh, add_origin};

/// The extensions that [`write_mesh`] accepts.
pub const MESH_EXTENSIONS: &[&str] = &["ply", "obj", "stl"];

/// Writes binary little-endian PLY: vertices `x y z` (eight bytes each with an origin) and `float nx ny nz`, and faces
/// as lists of three `int`.
pub(crate) fn write_ply(out: &mut dyn Write, mesh: &Mesh, origin: [f64; 3]) -> io::Result<()> {
    let columns = [&axes(origin)[..], &["nx", "ny", "nz"].map(|name| (name, Scalar::FLOAT))].concat();
    let vertex = ply::element("vertex", mesh.vertices.len(), &columns);
    let face = ply::face(mesh.triangles.len());
    ply::write_header(out, [&vertex, &face])?;
    for (&position, normal) in mesh.vertices.iter().zip(&mesh.normals) {
        let [[x, y, z], [nx, ny, nz]] = [add_origin(position, origin), normal.map(f64::from)];
        Row { columns: &columns, values: &[x, y, z, nx, ny, nz], ..Row::default() }.write(out, &vertex)?;
    }
    mesh.triangles.iter().try_for_each(|triangle| {
        Row { corners: &triangle.map(|corner| corner as i32), ..Row::default() }.write(out, &face)
    })
}

/// Writes OBJ: vertices, normals, and faces that refer to both.
pub(crate) fn write_obj(out: &mut dyn Write, mesh: &Mesh, origin: [f64; 3]) -> io::Result<()> {
    if origin == [0.0; 3] {
        // An f32 is written with the fewest digits that identify it.
        mesh.vertices.iter().try_for_each(|[x, y, z]| writeln!(out, "v {x} {y} {z}"))?;
    } else {
        let positions = mesh.vertices.iter().map(|&vertex| add_origin(vertex, origin));
        positions.into_iter().try_for_each(|[x, y, z]| writeln!(out, "v {x} {y} {z}"))?;
    }
    mesh.normals.iter().try_for_each(|[x, y, z]| writeln!(out, "vn {x} {y} {z}"))?;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| u64::from(vertex) + 1);
        writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
    }
    Ok(())
}

/// Writes binary STL: a normal and three corners for each triangle. The format has no shared vertices and no vertex
/// normals. Coordinates have four bytes and therefore stay relative to the origin.
pub(crate) fn write_stl(out: &mut dyn Write, mesh: &Mesh, _origin: [f64; 3]) -> io::Result<()> {
    let number = u32::try_from(mesh.triangles.len()).map_err(|_| io::Error::other("too many triangles for STL"))?;
    // Readers treat a file whose header begins with "solid" as text.
    out.write_all(format!("{:80}", "binary STL").as_bytes())?;
    out.write_all(&number.to_le_bytes())?;
    for &triangle in &mesh.triangles {
        write_floats(out, &mesh.triangle_normal(triangle))?;
        triangle.iter().try_for_each(|&vertex| write_floats(out, &mesh.vertices[vertex as usize]))?;
        out.write_all(&[0; 2])?;
    }
    Ok(())
}

fn write_floats(out: &mut dyn Write, values: &[f32; 3]) -> io::Result<()> {
    values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

type MeshWriter = fn(&mut dyn Write, &Mesh, [f64; 3]) -> io::Result<()>;

/// Writes a mesh and adds the origin to its vertices if [`adds_origin`](crate::adds_origin).
///
/// `ply` and `obj` hold vertices, normals and triangles; `stl` holds only triangles. The file is written whole or not
/// at all, as by [`write_keypoints`](crate::write_keypoints).
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`MESH_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_mesh(path: &Path, mesh: &Mesh, origin: [f64; 3]) -> Result<()> {
    let write = mesh_writer(path)?;
    write_atomically(path, |file| write(file, mesh, origin)).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path whose extension [`write_mesh`] would refuse, so that a caller can check it before any work.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`MESH_EXTENSIONS`].
pub fn check_mesh_path(path: &Path) -> Result<()> {
    mesh_writer(path).map(drop)
}

fn mesh_writer(path: &Path) -> Result<MeshWriter> {
    Ok(match extension(path).as_str() {
        "ply" => write_ply,
        "obj" => write_obj,
        "stl" => write_stl,
        _ => return Err(unknown_extension(path, "written", MESH_EXTENSIONS)),
    })
}

#[cfg(test)]
mod tests {
    use ply_rs::parser::Parser;
    use ply_rs::ply::{DefaultElement, Property};

    use super::*;

    fn tetrahedron() -> Mesh {
        Mesh {
            vertices: vec![[0.0; 3], [0.5, 0.0, 0.0], [0.0, -1e-7, 0.0], [0.0, 0.0, 3e7]],
            normals: vec![[0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]],
            num_removed: None,
        }
    }

    fn written(write: fn(&mut dyn Write, &Mesh, [f64; 3]) -> io::Result<()>, mesh: &Mesh) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&mut bytes, mesh, [0.0; 3]).unwrap();
        bytes
    }

    #[test]
    fn ply_reads_back() {
        let mesh = tetrahedron();
        let bytes = written(write_ply, &mesh);
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &bytes[..]).unwrap();
        for (index, vertex) in ply.payload["vertex"].iter().enumerate() {
            let row = |names: [&str; 3]| names.map(|name| vertex[name].clone());
            assert_eq!(row(["x", "y", "z"]), mesh.vertices[index].map(Property::Float));
            assert_eq!(row(["nx", "ny", "nz"]), mesh.normals[index].map(Property::Float));
        }
        let faces = ply.payload["face"].iter().map(|face| face["vertex_indices"].clone());
        let expected = mesh.triangles.iter().map(|t| Property::ListInt(t.map(|vertex| vertex as i32).to_vec()));
        assert!(faces.eq(expected) && ply.payload["vertex"].len() == 4);
    }

    #[test]
    fn obj_counts_from_one_and_keeps_every_digit() {
        let text = String::from_utf8(written(write_obj, &tetrahedron())).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4 + 4 + 4);
        assert_eq!(lines[1], "v 0.5 0 0");
        assert_eq!(lines[4], "vn 0 0.6 -0.8");
        assert_eq!(lines[9], "f 1//1 3//3 4//4");
        let third: Vec<f32> = lines[2].split(' ').skip(1).map(|v| v.parse().unwrap()).collect();
        assert_eq!(third, tetrahedron().vertices[2]);
    }

    #[test]
    fn stl_has_fifty_bytes_a_triangle() {
        let bytes = written(write_stl, &tetrahedron());
        assert_eq!(bytes.len(), 84 + 4 * 50);
        assert!(!bytes.starts_with(b"solid") && bytes[80..84] == [4, 0, 0, 0]);
        let floats: Vec<f32> =
            bytes[84 + 50..][..48].as_chunks().0.iter().map(|&value| f32::from_le_bytes(value)).collect();
        assert_eq!(floats[..3], [-1.0, 0.0, 0.0]);
        assert_eq!(floats[3..], [0.0, 0.0, 0.0, 0.0, -1e-7, 0.0, 0.0, 0.0, 3e7]);
        // A triangle without area has no normal.
        let flat = Mesh { triangles: vec![[0, 1, 1]], ..tetrahedron() };
        assert_eq!(written(write_stl, &flat)[84..96], [0; 12]);
    }
}
