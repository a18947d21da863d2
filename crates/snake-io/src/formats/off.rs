//! Object file format (OFF): vertices and faces.

use crate::table::shape::{Shape, add_polygon};
use crate::text::lines::{Lines, no_position, position, text, without_comment};
use snake_geometry::excerpt;

/// Keywords at the beginning of a file. The letters before OFF announce fields after a vertex's coordinates.
const KEYWORDS: [&str; 6] = ["STOFF", "CNOFF", "STCOFF", "COFF", "NOFF", "OFF"];

/// Reads vertices and faces; colours, normals and texture coordinates are ignored.
///
/// The counts may follow the keyword on the same line, even without a space, as in some files of ModelNet40.
pub(crate) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let lines = Lines::from_text(bytes)?.map(|(number, line)| (number, without_comment(&text(line)).to_string()));
    let mut lines = lines.filter(|(_, line)| !line.is_empty());
    let (number, first) = lines.next().ok_or("not an OFF file: it is empty")?;
    let keyword = KEYWORDS.iter().find_map(|keyword| {
        let (start, counts) = first.split_at_checked(keyword.len())?;
        start.eq_ignore_ascii_case(keyword).then_some(counts)
    });
    let counts = keyword.ok_or_else(|| format!("not an OFF file: it begins with `{}`", excerpt(&first, 40)))?.trim();
    let (number, counts) = if counts.is_empty() {
        lines.next().ok_or("cut short: no counts after OFF")?
    } else {
        (number, counts.to_string())
    };
    let mut words = counts.split_whitespace().map(|word| word.parse::<u64>().ok());
    let (Some(Some(num_points)), Some(Some(num_faces))) = (words.next(), words.next()) else {
        return Err(format!("line {number}: no numbers of vertices and faces in `{}`", excerpt(&counts, 40)));
    };

    let mut shape = Shape::default();
    let mut next = |what: &str, index: u64, count: u64| {
        lines.next().ok_or_else(|| format!("cut short: {index} of {count} {what}"))
    };
    for index in 0..num_points {
        let (number, line) = next("vertices", index, num_points)?;
        shape.points.push(position(line.split_ascii_whitespace()).ok_or_else(|| no_position(number, &line))?);
    }
    for index in 0..num_faces {
        let (number, line) = next("faces", index, num_faces)?;
        let corners = polygon(&line);
        let corners = corners
            .ok_or_else(|| format!("line {number}: no face (a number and indices) in `{}`", excerpt(&line, 60)))?;
        add_polygon(&mut shape.triangles, &corners);
    }
    shape.check_triangles()?;
    Ok(shape)
}

/// Parses the number of corners and their indices; a colour may follow.
fn polygon(line: &str) -> Option<Vec<u32>> {
    let mut words = line.split_whitespace();
    let count: usize = words.next()?.parse().ok()?;
    let corners: Vec<u32> = words.take(count).map(|word| word.parse().ok()).collect::<Option<_>>()?;
    (corners.len() == count).then_some(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keywords_comments_and_counts_in_every_place() {
        let rest = "0 0 0\n1 0 0 # corner\r\n\n1 1 0 255 0 0\n0 1e0 0\n# faces\n4 0 1 2 3 0.5 0.5 0.5\n3 0 2 1\n";
        for head in ["OFF\n4 2 0\n", "OFF 4 2 0\n", "OFF4 2 0\n", "COFF\n# made by hand\n\n4 2 5\n", "NOFF\r\n4 2\r\n"]
        {
            let shape = read(format!("{head}{rest}").as_bytes()).unwrap();
            assert_eq!(shape.points, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], "{head}");
            assert_eq!(shape.triangles, [[0, 1, 2], [0, 2, 3], [0, 2, 1]]);
        }
        assert!(read(b"OFF\n0 0 0\n").unwrap().points.is_empty());
    }

    #[test]
    fn bad_files_are_named() {
        for (text, expected) in [
            ("", "it is empty"),
            ("ply\n", "not an OFF file: it begins with `ply`"),
            ("4OFF\n1 0 0\n", "not an OFF file"),
            ("OFF", "no counts"),
            ("OFF BINARY\n1 0 0\n", "line 1: no numbers of vertices and faces"),
            ("OFF\n-1 0 0\n", "line 2: no numbers"),
            ("OFF\n1000000000000 0 0\n1 2 3\n", "cut short: 1 of 1000000000000 vertices"),
            ("OFF\n1 1000000000000 0\n1 2 3\n1 0\n", "cut short: 1 of 1000000000000 faces"),
            ("OFF\n1 0 0\n1 2\n", "line 3: no three coordinates in `1 2`"),
            ("OFF\n1 1 0\n1 2 3\n3 0 0\n", "line 4: no face"),
            ("OFF\n1 1 0\n1 2 3\n99999999999 0 0\n", "line 4: no face"),
            ("OFF\n1 1 0\n1 2 3\n3 0 0 1\n", "names vertex 1"),
        ] {
            let reason = read(text.as_bytes()).unwrap_err();
            assert!(reason.contains(expected), "{reason}");
        }
    }
}
