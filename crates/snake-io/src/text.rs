//! Reads points from columns of text.

use std::io::{self, Write};

use super::columns::{self, Columns, Indices};
use super::shape::{Position, Shape};
use snake_core::{RigidTransform, excerpt};

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Reads one point per line: x, y, z in the chosen columns, else in the columns that a header names, else in the first
/// three.
///
/// The separator is chosen line by line: semicolons, else commas, else white space; below a header with tabs it is the
/// tab. Separators within double quotes are ignored. Blank lines and lines that start with `#` or `//` are ignored too,
/// except that one of them can be the header. `nan` and `inf` are numbers.
pub(super) fn read(bytes: &[u8], columns: Option<&Columns>) -> Result<Shape, String> {
    Ok(read_rows(bytes, columns, false)?.into())
}

/// Reads the same columns from a file whose first line may be the number of points.
pub(super) fn read_counted(bytes: &[u8], columns: Option<&Columns>) -> Result<Shape, String> {
    Ok(read_rows(bytes, columns, true)?.into())
}

/// Writes the four rows of a transform's matrix.
pub(super) fn write_rows(out: &mut dyn Write, transform: &RigidTransform) -> io::Result<()> {
    for [a, b, c, d] in transform.to_matrix() {
        writeln!(out, "{a} {b} {c} {d}")?;
    }
    Ok(())
}

/// The lines that are not blank, trimmed, with their numbers counted from 1.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    // A file of the classic Mac OS would otherwise be one line and so one point.
    let line_end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    (1..)
        .zip(bytes.split(move |&byte| byte == line_end).map(<[u8]>::trim_ascii_end))
        .filter(|(_, line)| !line.is_empty())
}

fn read_rows(bytes: &[u8], columns: Option<&Columns>, may_be_counted: bool) -> Result<Vec<Position>, String> {
    let (mut comments, mut header, mut promised) = (Vec::new(), None, None);
    let mut layout: Option<Layout> = None;
    let mut points = Vec::new();
    for (number, line) in lines(bytes) {
        let start = line.trim_ascii_start();
        if start.starts_with(b"#") || start.starts_with(b"//") {
            // Any comment above the points can be the header.
            if layout.is_none() {
                comments.push(start);
            }
            continue;
        }
        let Ok(line) = str::from_utf8(line) else {
            return Err(format!("line {number}: not UTF-8 text: `{}`", excerpt(&String::from_utf8_lossy(line), 40)));
        };
        if layout.is_none() && header.is_none() {
            // CloudCompare writes the number of points below a header that starts with `//`.
            let is_below_header = comments.last().is_some_and(|comment| comment.starts_with(b"//"));
            let count = line.trim().parse::<u64>().ok().filter(|_| may_be_counted || is_below_header);
            if count.is_some() && promised.is_none() {
                promised = count;
                continue;
            }
            header = Header::of(line);
            if header.is_some() {
                continue;
            }
        }
        let layout = match &mut layout {
            Some(layout) => layout,
            none => none.insert(Layout::of(header.take(), &comments, line, columns)?),
        };
        let point = layout.point(line);
        points.push(point.ok_or_else(|| format!("line {number}: no three coordinates in `{}`", excerpt(line, 60)))?);
    }
    match promised {
        Some(count) if count != points.len() as u64 => {
            Err(format!("the first line promises {count} points, {} follow", points.len()))
        }
        _ => Ok(points),
    }
}

/// The separator between the columns of a line.
#[derive(Clone, Copy, PartialEq)]
enum Separator {
    Char(char),
    WhiteSpace,
}

impl Separator {
    /// The first of these separators that a line contains. Only one is used per line, so that the decimal commas of
    /// `1,5;2,5;3,5` are refused and not read as separators.
    fn of(line: &str, known: &[char]) -> Self {
        let separates = |separator| line.contains(separator) && split(line, |c| c == separator).nth(1).is_some();
        let found = known.iter().find(|&&separator| separates(separator));
        found.map_or(Self::WhiteSpace, |&separator| Self::Char(separator))
    }

    /// The columns of a line, without quotes.
    fn fields(self, line: &str) -> impl Iterator<Item = &str> {
        split(line, move |c| match self {
            Self::Char(separator) => c == separator,
            Self::WhiteSpace => c.is_whitespace(),
        })
        .map(str::trim)
        .filter(move |field| self != Self::WhiteSpace || !field.is_empty())
        .map(|field| field.strip_prefix('"').and_then(|field| field.strip_suffix('"')).unwrap_or(field).trim())
    }
}

/// The pieces of a line between separators outside double quotes.
fn split(line: &str, is_separator: impl Fn(char) -> bool) -> impl Iterator<Item = &str> {
    let mut within_quotes = false;
    line.split(move |c| {
        within_quotes ^= c == '"';
        !within_quotes && is_separator(c)
    })
}

/// A line with the names of columns.
struct Header {
    names: Vec<String>,
    separator: Separator,
    /// Whether white space precedes the first name.
    is_indented: bool,
}

impl Header {
    /// The names in a line that consists of names only.
    fn of(line: &str) -> Option<Self> {
        let separator = Separator::of(line, &[';', ',', '\t']);
        let is_indented = line.starts_with(char::is_whitespace);
        let names: Vec<String> = match separator {
            // The unit in `X (m)` is not a column of its own.
            Separator::WhiteSpace => separator.fields(&without_units(line)).map(String::from).collect(),
            Separator::Char(_) => separator.fields(line).map(String::from).collect(),
        };
        let is_name = |name: &String| name.contains(char::is_alphabetic) && name.parse::<f32>().is_err();
        let has_names = names.iter().all(|name| name.is_empty() || is_name(name)) || columns::is_numbered(&names);
        has_names.then_some(Self { names, separator, is_indented })
    }

    /// The last comment that names the columns of the first row. It must have as many names as the row has columns. It
    /// must also contain three chosen or known names, or use the row's semicolons or commas as separators.
    fn among(comments: &[&[u8]], row: &str, columns: Option<&Columns>) -> Option<Self> {
        let separator = Separator::of(row, &[';', ',']);
        let number = separator.fields(row).count();
        let of_comment = |comment: &&[u8]| {
            let text = str::from_utf8(comment).ok()?.trim_start_matches(['#', '/']).trim();
            Self::of(text).filter(|header| {
                let is_told = match columns {
                    Some(columns) => columns.of_text(&header.names).is_ok(),
                    None => columns::known(&header.names).is_some(),
                };
                let is_table = header.separator == separator && separator != Separator::WhiteSpace;
                header.names.len() == number && number >= 3 && (is_told || is_table)
            })
        };
        comments.iter().rev().find_map(of_comment)
    }

    /// Adds a name for an index column that the header does not name: pandas indents the header of its text output, and
    /// R quotes the index.
    fn name_index(&mut self, row: &str) {
        let is_indexed = self.is_indented && !row.starts_with(char::is_whitespace) || row.trim_start().starts_with('"');
        let is_one_short = self.separator.fields(row).count() == self.names.len() + 1;
        if self.separator == Separator::WhiteSpace && is_indexed && is_one_short {
            self.names.insert(0, String::new());
        }
    }
}

/// A line without text in parentheses or brackets.
fn without_units(line: &str) -> String {
    let mut depth = 0_usize;
    let is_kept = |&c: &char| match c {
        '(' | '[' => {
            depth += 1;
            false
        }
        ')' | ']' => {
            depth = depth.saturating_sub(1);
            false
        }
        _ => depth == 0,
    };
    line.chars().filter(is_kept).collect()
}

/// The positions of the coordinates in a row.
struct Layout {
    columns: Indices,
    has_tabs: bool,
}

impl Layout {
    /// The layout by the header, the comments above the first row and the chosen columns.
    fn of(header: Option<Header>, comments: &[&[u8]], row: &str, columns: Option<&Columns>) -> Result<Self, String> {
        let mut header = header.or_else(|| Header::among(comments, row, columns));
        if let Some(header) = &mut header {
            header.name_index(row);
        }
        let names = header.as_ref().map_or(&[][..], |header| &header.names);
        let indices = match columns {
            Some(columns) => columns.of_text(names)?,
            None if header.is_none() => [0, 1, 2],
            None => columns::known(names).ok_or_else(|| columns::cannot_tell(names))?,
        };
        let has_tabs = header.is_some_and(|header| header.separator == Separator::Char('\t'));
        Ok(Self { columns: indices, has_tabs })
    }

    fn point(&self, line: &str) -> Option<Position> {
        let separator = Separator::of(line, if self.has_tabs { &['\t'] } else { &[';', ','] });
        let mut point = [None; 3];
        for (column, field) in separator.fields(line).enumerate() {
            if let Some(axis) = self.columns.iter().position(|&c| c == column) {
                point[axis] = Some(field.parse().ok()?);
                if let [Some(x), Some(y), Some(z)] = point {
                    return Some([x, y, z]);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::points;
    use snake_core::Point;

    fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read(bytes, None))
    }

    fn read_counted(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read_counted(bytes, None))
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
    fn headers_of_peoples_tools_say_where_the_coordinates_are() {
        for (program, text) in [
            ("ParaView", "\"ring\",\"range\",\"Points:0\",\"Points:1\",\"Points:2\"\n9,8,1,2,3\n9,8,-0.5,1e-3,7\n"),
            ("ParaView 5.13", "\"Points_0\",\"a:0\",\"Points_1\",\"Points_2\"\n1,9,2,3\n-0.5,9,1e-3,7\n"),
            (
                "VeloView",
                "\"intensity\",\"laser_id\",\"Points_m_XYZ:0\",\"Points_m_XYZ:1\",\"Points_m_XYZ:2\"\n9,8,1,2,3\n9,8,-0.5,1e-3,7\n",
            ),
            (
                "VeloView 3",
                "\"Points_m_XYZ:0\",\"Points_m_XYZ:1\",\"Points_m_XYZ:2\",\"X\",\"Y\",\"Z\"\n1,2,3,1,2,3\n-.5,1e-3,7,-.5,1e-3,7\n",
            ),
            (
                "Ouster",
                "TIMESTAMP (ns), RANGE (mm), SIGNAL (photons), X (m), Y (m), Z (m)\n5,6,7,1,2,3\n5,6,7,-.5,1e-3,7\n",
            ),
            ("Ouster by NumPy", "# TIMESTAMP (ns), RANGE (mm), X (m), Y (m), Z (m)\n5,6,1,2,3\n5,6,-.5,1e-3,7\n"),
            ("units between spaces", "Time [s] X (m) Y (m) Z (m)\n5 1 2 3\n5 -.5 1e-3 7\n"),
            ("CloudCompare", "//R G B X Y Z\n9 9 9 1 2 3\n9 9 9 -.5 1e-3 7\n"),
            ("CloudCompare with a count", "//X;Y;Z;Scalar_field\n2\n1;2;3;9\n-.5;1e-3;7;9\n"),
            ("pandas", ",x,y,z\n0,1,2,3\n1,-.5,1e-3,7\n"),
            ("pandas with tabs", "\tx\ty\tz\n0\t1\t2\t3\n1\t-.5\t1e-3\t7\n"),
            ("pandas of an array", ",0,1,2\n0,1,2,3\n1,-.5,1e-3,7\n"),
            ("pandas as text", "     x      y  z\n0  1.0  2.000  3\n1 -0.5  0.001  7\n"),
            ("R", "\"x\" \"y\" \"z\"\n\"1\" 1 2 3\n\"2 b\" -.5 1e-3 7\n"),
            (
                "TUM",
                "# ground truth\n# file: 'a b c.bag'\n# timestamp tx ty tz qx qy qz qw\n5 1 2 3 0 0 0 1\n6 -.5 1e-3 7 0 0 0 1\n",
            ),
            ("quoted text with commas", "name,x,y,z\n\"a, b\",\"1\",2,3\n\"c\",-.5,1e-3,7\n"),
            ("tabs and an empty column", "id\tlabel\tX\tY\tZ\n1\t\t1\t2\t3\n2\tb c\t-.5\t1e-3\t7\n"),
            ("byte order mark", "\u{feff}\"id\";\"X\";\"Y\";\"Z\"\n4;1;2;3\n5;-.5;1e-3;7\n"),
        ] {
            assert_eq!(read(text.as_bytes()).unwrap_or_else(|reason| panic!("{program}: {reason}")), TWO, "{program}");
        }
        // Prose is not a header.
        for text in ["# made by me today\n1 2 3 9\n-.5 1e-3 7 9", "# x is east\n1 2 3\n-.5 1e-3 7"] {
            assert_eq!(read(text.as_bytes()).unwrap(), TWO, "{text:?}");
        }
    }

    #[test]
    fn headers_that_tell_nothing_are_refused_with_their_columns() {
        for text in [
            "intensity,ring,range\n1,2,3\n",
            "# intensity, ring, range\n1,2,3\n",
            "time\tlat\tlon\talt\n1\t2\t3\t4\n",
            "x,y,x,z\n1,2,3,4\n",
            "Velocity:0,Velocity:1,Velocity:2\n1,2,3\n",
        ] {
            let reason = read(text.as_bytes()).unwrap_err();
            assert!(reason.contains("--columns x,y,z"), "{reason}");
        }
        let reason = read(b"intensity,ring,range (mm)\n1,2,3\n").unwrap_err();
        assert!(reason.ends_with("The columns are 1 `intensity`, 2 `ring`, 3 `range (mm)`"), "{reason}");
    }

    #[test]
    fn columns_can_be_chosen() {
        let read = |text: &str, columns: &str| points(super::read(text.as_bytes(), Some(&columns.parse().unwrap())));
        let table = "t,lat,lon,alt\n9,1,2,3\n9,-.5,1e-3,7\n";
        assert_eq!(read(table, "lat,lon,alt").unwrap(), TWO);
        assert_eq!(read(table, "2,3,4").unwrap(), TWO);
        assert_eq!(read("9 3 2 1\n9 7 1e-3 -.5\n", "4,3,2").unwrap(), TWO);
        assert_eq!(read("# t a b c\n9 1 2 3\n9 -.5 1e-3 7\n", "a,b,c").unwrap(), TWO);
        assert!(read(table, "x,y,z").unwrap_err().contains("no column `x`; the columns are 1 `t`, 2 `lat`"));
        assert!(read("1 2 3\n", "x,y,z").unwrap_err().contains("no header"));
        assert!(read("1 2 3\n", "2,3,4").unwrap_err().starts_with("line 1: no three coordinates"));
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
