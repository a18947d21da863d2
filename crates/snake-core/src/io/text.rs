//! Points as columns of text.

use std::io::{self, Write};

use super::shape::{Position, Shape};
use crate::excerpt::excerpt;
use crate::registration::Registration;

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Which columns hold x, y and z.
type Columns = [usize; 3];

/// Reads one point a line: x, y, z in the first three columns, or in those that a header line names so.
///
/// Columns are separated by semicolons, else by commas, else by white space, line by line. Blank lines and lines that
/// start with `#` or `//` do not count. `nan` and `inf` are numbers.
pub(super) fn read(bytes: &[u8]) -> Result<Shape, String> {
    Ok(read_rows(&mut rows(bytes).peekable())?.into())
}

/// Reads the same from a file whose first line may be the number of points.
pub(super) fn read_counted(bytes: &[u8]) -> Result<Shape, String> {
    let mut rows = rows(bytes).peekable();
    let promised = rows.peek().and_then(|row| row.as_ref().ok()).and_then(|(_, line)| line.parse::<u64>().ok());
    if promised.is_some() {
        rows.next();
    }
    let points = read_rows(&mut rows)?;
    match promised {
        Some(count) if count != points.len() as u64 => {
            Err(format!("the first line promises {count} points, {} follow", points.len()))
        }
        _ => Ok(points.into()),
    }
}

/// Writes the four rows of a registration's matrix.
pub(super) fn write_transform(out: &mut dyn Write, registration: &Registration) -> io::Result<()> {
    for [a, b, c, d] in registration.t_target_source {
        writeln!(out, "{a} {b} {c} {d}")?;
    }
    Ok(())
}

/// The lines that count, trimmed, with their numbers from 1.
fn rows(bytes: &[u8]) -> impl Iterator<Item = Result<(usize, &str), String>> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    // A file from an old Macintosh would otherwise be one line, that is one point.
    let line_end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let lines = bytes.split(move |&byte| byte == line_end).map(<[u8]>::trim_ascii);
    lines.zip(1..).filter(|(line, _)| !(line.is_empty() || line.starts_with(b"#") || line.starts_with(b"//"))).map(
        |(line, number)| match std::str::from_utf8(line) {
            Ok(line) => Ok((number, line)),
            Err(_) => Err(format!("line {number}: not UTF-8 text: `{}`", excerpt(&String::from_utf8_lossy(line), 40))),
        },
    )
}

fn read_rows(rows: &mut dyn Iterator<Item = Result<(usize, &str), String>>) -> Result<Vec<Position>, String> {
    let mut columns = [0, 1, 2];
    let mut points = Vec::new();
    for (index, row) in rows.enumerate() {
        let (number, line) = row?;
        if index == 0 && is_header(line) {
            columns = named_columns(line).unwrap_or(columns);
            continue;
        }
        let point = parse_point(line, columns);
        points.push(point.ok_or_else(|| format!("line {number}: no three coordinates in `{}`", excerpt(line, 60)))?);
    }
    Ok(points)
}

/// One separator a line, so that the decimal commas of `1,5;2,5;3,5` are refused rather than taken for separators.
fn fields(line: &str) -> impl Iterator<Item = &str> {
    let separator = [';', ','].into_iter().find(|&separator| line.contains(separator));
    line.split(move |c: char| separator.map_or(c.is_whitespace(), |separator| c == separator))
        .map(str::trim)
        .filter(move |field| separator.is_some() || !field.is_empty())
}

fn parse_point(line: &str, columns: Columns) -> Option<Position> {
    let mut point = [None; 3];
    for (column, field) in fields(line).enumerate() {
        if let Some(axis) = columns.iter().position(|&c| c == column) {
            point[axis] = Some(field.parse().ok()?);
            if let [Some(x), Some(y), Some(z)] = point {
                return Some([x, y, z]);
            }
        }
    }
    None
}

/// Whether every field is a name.
fn is_header(line: &str) -> bool {
    let is_name = |field: &str| field.contains(char::is_alphabetic) && field.parse::<f32>().is_err();
    fields(line).all(|field| field.is_empty() || is_name(field))
}

fn named_columns(line: &str) -> Option<Columns> {
    let column = |axis| fields(line).position(|field| field.trim_matches(['"', '\'']).eq_ignore_ascii_case(axis));
    Some([column("x")?, column("y")?, column("z")?])
}

#[cfg(test)]
mod tests {
    use super::super::tests::points;
    use crate::points::Point;

    fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read(bytes))
    }

    fn read_counted(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read_counted(bytes))
    }

    const TWO: [Point; 2] = [[1.0, 2.0, 3.0], [-0.5, 1e-3, 7.0]];

    #[test]
    fn separators_comments_headers_and_line_ends() {
        for text in [
            "1 2 3\n-.5 1e-3 7.",
            "1,2,3\r\n-0.5,0.001,7\r\n",
            "x y z\r1 2 3\r-0.5 0.001 7\r",
            "1; 2; 3; 255\n-0.5; 0.001; 7; 255\n\n",
            "# x y z\n\n// more\n  1\t2   3\n  # between\n-0.5 +0.001 7",
            "\u{feff}X Y Z red\n1 2 3 9\n-0.5 0.001 7 9\n",
            "id,\"z\",\"y\",\"x\"\na,3,2,1\nb,7,0.001,-0.5\n",
            "east,north,up,\n1,2,3,\n-0.5,0.001,7,\n",
        ] {
            assert_eq!(read(text.as_bytes()).unwrap(), TWO, "{text:?}");
        }
        for text in ["", "\n\r\n", "# nothing", "x,y,z\n"] {
            assert!(read(text.as_bytes()).unwrap().is_empty(), "{text:?}");
        }
    }

    #[test]
    fn numbers_that_are_not_finite_come_through() {
        let points = read(b"nan -nan NaN\ninf -Infinity 1e99\n").unwrap();
        assert!(points[0].iter().all(|v| v.is_nan()) && points[1].iter().all(|v| v.is_infinite()));
    }

    #[test]
    fn bad_lines_are_named_and_shown() {
        for (text, line, shown) in [
            (&b"1 2 3\n1 2\n"[..], "line 2:", "`1 2`"),
            (b"x y z\n\n1 two 3", "line 3:", "`1 two 3`"),
            (b"x y z\nx y z\n", "line 2:", "`x y z`"),
            (b"1,5;2,5;3,5", "line 1:", "`1,5;2,5;3,5`"),
            (b"1,,3", "line 1:", "`1,,3`"),
            (b"2\n1 2 3\n1 2 3", "line 1:", "`2`"),
            (b"1 2 3\n1 \xff 3", "line 2:", "not UTF-8"),
            (b"\xff\xfe1\0 \x002\0", "line 1:", "not UTF-8"),
            (b"1 2\0 3", "line 1:", "`1 2  3`"),
        ] {
            let reason = read(text).unwrap_err();
            assert!(reason.starts_with(line) && reason.contains(shown), "{reason}");
        }
        assert!(read("9".repeat(1 << 20).as_bytes()).unwrap_err().len() < 200);
    }

    #[test]
    fn count_lines_are_checked() {
        assert_eq!(read_counted(b"2\n1 2 3 0 255 0 0\n-0.5 1e-3 7 0 0 0 0\n").unwrap(), TWO);
        assert_eq!(read_counted(b"# pts\n1 2 3\n-0.5 1e-3 7\n").unwrap(), TWO);
        assert!(read_counted(b"0\n").unwrap().is_empty() && read_counted(b"").unwrap().is_empty());
        for text in [&b"3\n1 2 3\n"[..], b"1000000000000\n1 2 3\n", b"1\n1 2 3\n1 2 3\n", b"2.5\n1 2 3"] {
            read_counted(text).unwrap_err();
        }
    }
}
