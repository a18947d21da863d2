//! Wavefront OBJ: vertices and faces.

use crate::table::shape::{Shape, add_polygon};
use crate::text::lines::{Lines, no_position, position, text, without_comment};
use snake_geometry::excerpt;

/// Reads the lines `v` and `f`; normals, textures, groups, materials, points and lines are ignored. A face may refer to
/// a vertex that comes after it. A line continues after `\` at its end, and `#` begins a comment anywhere.
pub(crate) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let mut shape = Shape::default();
    let mut begun = String::new();
    for (number, line) in Lines::from_text(bytes)? {
        let line = text(line);
        let line = without_comment(&line);
        match line.strip_suffix('\\') {
            Some(part) => begun = begun + part + " ",
            None if begun.is_empty() => add(&mut shape, number, line)?,
            None => add(&mut shape, number, &(std::mem::take(&mut begun) + line))?,
        }
    }
    add(&mut shape, 0, &begun)?;
    if shape.points.is_empty() && !bytes.trim_ascii().is_empty() {
        return Err("no vertices: no line begins with `v`".into());
    }
    shape.check_triangles()?;
    Ok(shape)
}

fn add(shape: &mut Shape, number: usize, line: &str) -> Result<(), String> {
    match line.split_once(|c: char| c.is_ascii_whitespace()) {
        Some(("v", rest)) => {
            let point = position(rest.split_ascii_whitespace());
            shape.points.push(point.ok_or_else(|| no_position(number, rest))?);
        }
        Some(("f", rest)) => {
            let corners = rest.split_ascii_whitespace().map(|word| corner(word, shape.points.len()));
            let corners: Option<Vec<u32>> = corners.collect();
            let bad = || format!("line {number}: no indices of vertices in `{}`", excerpt(rest, 60));
            add_polygon(&mut shape.triangles, &corners.ok_or_else(bad)?);
        }
        _ => {}
    }
    Ok(())
}

/// The index of a corner `vertex/texture/normal`. The file counts from 1, or backwards from the last vertex so far.
fn corner(word: &str, num_points: usize) -> Option<u32> {
    let index: i64 = word.split('/').next()?.parse().ok()?;
    let from_start = if index < 0 { index.checked_add_unsigned(num_points as u64)? } else { index.checked_sub(1)? };
    from_start.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_and_faces_in_every_notation() {
        let text = b"# \xff comment\r\nmtllib a.mtl\r\no thing\r\nv 0 0 0\r\n  v 1 0 0 0.5 0.5 0.5\nv\t0 1 0 1\nvn 0 0 1\nvt 0 0\n\
            usemtl x\ns off\nf 1/1/1 2//1 3\nf -3 -2 -1 4/2\nl 1 2\np 1\nv 0 0 -1e-1\n";
        let shape = read(text).unwrap();
        assert_eq!(shape.points, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -0.1]]);
        assert_eq!(shape.triangles, [[0, 1, 2], [0, 1, 2], [0, 2, 3]]);
        assert!(read(b" \n").unwrap().points.is_empty());
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, expected) in [
            ("v 1 2\n", "line 1: no three coordinates in `1 2`"),
            ("v 1 2 3\n\nv 1 two 3\n", "line 3: no three coordinates"),
            ("v 1 2 3\nf 1 x 1\n", "line 2: no indices of vertices"),
            ("v 1 2 3\nf 0 1 1\n", "line 2: no indices"),
            ("v 1 2 3\nf -2 1 1\n", "line 2: no indices"),
            ("v 1 2 3\nf 1 1 99999999999999999999\n", "line 2: no indices"),
            ("v 1 2 3\nf 1 1 -9223372036854775808\n", "line 2: no indices"),
            ("v 1 2 3\nf 1 1 5\n", "a face names vertex 4 (counted from 0), but there are 1"),
            ("solid cube\n", "no vertices"),
        ] {
            let reason = read(text.as_bytes()).unwrap_err();
            assert!(reason.contains(expected), "{reason}");
        }
    }
}
