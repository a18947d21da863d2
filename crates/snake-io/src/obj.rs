//! Wavefront OBJ: vertices and faces.

use super::shape::{Position, Shape, add_polygon};
use snake_core::excerpt;

/// Reads the lines `v` and `f`; normals, textures, groups, materials, points and lines are ignored. A face may refer to
/// a vertex that comes after it.
pub(super) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let mut shape = Shape::default();
    let mut corners = Vec::new();
    for (number, line) in (1..).zip(bytes.split(|&byte| byte == b'\n')) {
        let Some((key, rest)) = line.trim_ascii().split_at_checked(2) else { continue };
        let text = || String::from_utf8_lossy(rest);
        let bad = |what: &str| format!("line {number}: no {what} in `{}`", excerpt(&text(), 60));
        match key {
            b"v " | b"v\t" => shape.points.push(position(&text()).ok_or_else(|| bad("three coordinates"))?),
            b"f " | b"f\t" => {
                corners.clear();
                for word in text().split_whitespace() {
                    let corner = corner(word, shape.points.len());
                    corners.push(corner.ok_or_else(|| bad("indices of vertices"))?);
                }
                add_polygon(&mut shape.triangles, &corners);
            }
            _ => {}
        }
    }
    if shape.points.is_empty() && !bytes.trim_ascii().is_empty() {
        return Err("no vertices: no line begins with `v`".into());
    }
    shape.check_triangles()?;
    Ok(shape)
}

fn position(text: &str) -> Option<Position> {
    let mut values = text.split_whitespace().map(|word| word.parse().ok());
    Some([values.next()??, values.next()??, values.next()??])
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
