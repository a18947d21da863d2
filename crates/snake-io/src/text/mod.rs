//! Reads points from columns of text.

pub(crate) mod columns;
pub(crate) mod commas;
pub(crate) mod doubts;
pub(crate) mod header;
pub(crate) mod lines;
pub(crate) mod number;
pub(crate) mod separator;

use std::io::{self, Write};

use crate::table::Table;
use crate::table::shape::Shape;
use crate::text::columns::{Columns, Indices};
use crate::text::commas::COMMAS;
use crate::text::doubts::{DecimalCommas, count};
use crate::text::header::{Header, is_comment, is_units};
use crate::text::lines::{Lines, no_position, text};
use crate::text::number::{cell, number};
use crate::text::separator::{Separator, without_brackets};
use snake_geometry::{RigidTransform, excerpt};

/// Maximum number of title lines above a header.
const MAX_TITLE_LINES: usize = 20;

/// Reads one point per line: x, y, z from the chosen columns, else from the columns that a header names, else from the
/// first three. A first line with a single integer is the number of points.
///
/// The separator is chosen line by line: semicolons, else commas, else bars, else white space; below a header with tabs
/// it is the tab. Separators within double quotes and brackets around a row are ignored. Blank lines and comments are
/// ignored too, except that a comment can be the header. `nan` and `inf` are numbers; an empty cell and `NA` are `nan`.
///
/// Rows that can be read in two ways are refused, unless the columns are chosen by numbers.
pub(crate) fn read(bytes: &[u8], columns: Option<&Columns>) -> Result<Shape, String> {
    Text::open(bytes, columns, false)?.positions(columns)
}

/// Reads the same columns from a file that may hold several scans, each below a line with its number of points.
pub(crate) fn read_counted(bytes: &[u8], columns: Option<&Columns>) -> Result<Shape, String> {
    Text::open(bytes, columns, true)?.positions(columns)
}

/// The columns that a header names, with their names in lower case and without units.
pub(crate) fn table(bytes: &[u8]) -> Result<Table<'_>, String> {
    let text = Text::open(bytes, None, false)?;
    let header = text.layout.as_ref().and_then(|layout| layout.header.as_ref()).or(text.header.as_ref());
    let names = header.iter().flat_map(|header| &header.names).map(|name| columns::plain(name)).collect();
    Ok(Table::parsed(names, move |columns, found| text.rows(columns, found)))
}

/// Four rows of four numbers, if a text consists of them.
pub(crate) fn matrix(bytes: &[u8]) -> Option<[[f64; 4]; 4]> {
    let row = |(_, line): (usize, &[u8])| -> Option<[f64; 4]> {
        let numbers: Option<Vec<f64>> = text(line).split_whitespace().map(number).collect();
        numbers?.try_into().ok()
    };
    let rows: Option<Vec<_>> = Lines::from_text(bytes).ok()?.take(5).map(row).collect();
    rows?.try_into().ok()
}

/// Writes the four rows of a transform's matrix.
pub(crate) fn write_rows(out: &mut dyn Write, transform: &RigidTransform) -> io::Result<()> {
    for [a, b, c, d] in transform.to_matrix() {
        writeln!(out, "{a} {b} {c} {d}")?;
    }
    Ok(())
}

/// A text whose lines above the points have been read.
struct Text<'a> {
    bytes: &'a [u8],
    /// The lines from the first row on; `first_line` is the number of that line.
    lines: Lines<'a>,
    first_line: usize,
    blocks: Blocks,
    /// The layout of the rows, if there are rows; `header` is set otherwise.
    layout: Option<Layout>,
    header: Option<Header>,
}

impl<'a> Text<'a> {
    fn open(bytes: &'a [u8], columns: Option<&Columns>, in_blocks: bool) -> Result<Self, String> {
        let tells = |header: &Header| header.tells(columns);
        let mut lines = Lines::from_text(bytes)?;
        let mut blocks = Blocks { in_blocks, ..Blocks::default() };
        let (mut header, mut comments, mut words) = (None, Vec::new(), Vec::new());
        // The first row with three numbers, or the first row below a header that tells where they are.
        let mut first = loop {
            let from_here = lines.clone();
            let Some((number, line)) = lines.next() else { break None };
            if is_comment(line) {
                comments.push(line);
                continue;
            }
            let line = text(line);
            let row = without_brackets(&line);
            let (is_headed, blocks_above) = (header.is_some(), blocks);
            let is_count = blocks.begins(row, number, 0, !is_headed);
            if row.is_empty() || is_headed && is_units(row) || is_count && (is_headed || words.is_empty()) {
                continue;
            }
            if is_headed {
                break Some(from_here);
            }
            match Header::of(row) {
                Some(named) if tells(&named) => header = Some(named),
                _ if has_three_numbers(row) || words.len() == MAX_TITLE_LINES => break Some(from_here),
                named => words.push((from_here, named, blocks_above)),
            }
        };
        // Words above a header that tells the columns are titles. Without such a header, they are at most one line of names.
        if header.is_none() {
            let mut words = words.into_iter().peekable();
            header = words.next_if(|(_, named, _)| named.is_some()).and_then(|(_, named, _)| named);
            if let Some((from_here, _, blocks_above)) = words.next() {
                (first, blocks) = (Some(from_here), blocks_above);
            }
        }
        let row = first.and_then(|lines| lines.clone().next().map(|(number, line)| (lines, number, text(line))));
        if let Some((lines, first_line, line)) = row {
            let layout = Layout::of(without_brackets(&line), header, &comments, columns);
            let layout = layout.map_err(|reason| format!("line {first_line}: {reason}"))?;
            return Ok(Self { bytes, lines, first_line, blocks, layout: Some(layout), header: None });
        }
        blocks.check(0)?;
        match header {
            Some(header) if !tells(&header) => {
                Err(format!("no points below `{}`", excerpt(&header.names.join(" "), 60)))
            }
            header => Ok(Self { bytes, lines, first_line: 0, blocks, layout: None, header }),
        }
    }

    /// The points in the chosen columns, or in the known ones.
    fn positions(&self, columns: Option<&Columns>) -> Result<Shape, String> {
        let mut points = Vec::new();
        let Some(layout) = &self.layout else { return Ok(points.into()) };
        let indices = layout.positions(columns).map_err(|reason| format!("line {}: {reason}", self.first_line))?;
        self.rows(&indices, &mut |row| points.push([row[0], row[1], row[2]]))?;
        if layout.is_guessed() {
            if layout.width > 3 {
                doubts::check_first_column(&points, self.first_line)?;
            }
            if points.len() == 4 && matrix(self.bytes).is_some_and(|rows| rows[3] == [0.0, 0.0, 0.0, 1.0]) {
                return Err(
                    "the 4 x 4 matrix of a transform and no cloud; a registration takes it as the option `initial`"
                        .into(),
                );
            }
        }
        Ok(points.into())
    }

    /// Calls `found` with the numbers of each row in these columns.
    fn rows(&self, columns: &[usize], found: &mut dyn FnMut(&[f64])) -> Result<(), String> {
        let Some(layout) = &self.layout else { return Ok(()) };
        let (mut separator, mut blocks) = (layout.separator, self.blocks);
        let (mut values, mut num_rows, mut decimal_commas) =
            (vec![f64::NAN; columns.len()], 0, DecimalCommas::default());
        for (number, line) in self.lines.clone().filter(|(_, line)| !is_comment(line)) {
            let line = text(line);
            let row = without_brackets(&line);
            // The last bracket of an array stands alone.
            if row.is_empty() || blocks.begins(row, number, num_rows, false) {
                continue;
            }
            layout.read(number, row, &mut separator, columns, &mut values)?;
            found(&values);
            num_rows += 1;
            if layout.is_guessed() && separator == Separator::Char(b',') && !decimal_commas.is_excluded() {
                decimal_commas.add(separator.fields(row));
            }
        }
        blocks.check(num_rows)?;
        decimal_commas.check()
    }
}

/// Lines with a number of points, above all points or above each scan.
#[derive(Clone, Copy, Default)]
struct Blocks {
    /// Whether each scan may have such a line.
    in_blocks: bool,
    /// The line number of the last such line, and the number of points that it promises.
    promised: Option<(usize, u64)>,
    /// The number of points above that line.
    above: usize,
}

impl Blocks {
    /// Whether a line is the number of the points that follow: the first line, or with `in_blocks` the line after the
    /// last point of a scan.
    fn begins(&mut self, row: &str, line: usize, num_points: usize, is_first: bool) -> bool {
        let is_next = match self.promised {
            None => is_first,
            Some((_, count)) => self.in_blocks && count == (num_points - self.above) as u64,
        };
        let count = is_next.then(|| row.trim().parse().ok()).flatten();
        if let Some(count) = count {
            (self.promised, self.above) = (Some((line, count)), num_points);
        }
        count.is_some()
    }

    fn check(&self, num_points: usize) -> Result<(), String> {
        match self.promised {
            Some((line, count)) if count != (num_points - self.above) as u64 => Err(format!(
                "line {line} promises {count} points, {} follow; to read them all, remove this line: sed {line}d FILE > NEW",
                num_points - self.above
            )),
            _ => Ok(()),
        }
    }
}

/// The columns of the rows.
struct Layout {
    first_row: String,
    /// Whether the columns are chosen by numbers.
    is_chosen: bool,
    header: Option<Header>,
    /// The separators that a row may have.
    known: &'static [u8],
    /// The separator of the first row.
    separator: Separator,
    /// The number of columns in the header, or without one in the first row.
    width: usize,
    /// The number of leading columns of the first row that are numbers.
    num_numbers: usize,
}

impl Layout {
    /// The layout of the first row, from the header or else from the comments above it.
    fn of(row: &str, header: Option<Header>, comments: &[&[u8]], columns: Option<&Columns>) -> Result<Self, String> {
        let mut header = match header {
            None => Header::among(comments, row, columns)?,
            header => header,
        };
        if let Some(header) = &mut header {
            header.name_index(row);
        }
        let has_tabs = header.as_ref().is_some_and(|header| header.separator == Separator::Char(b'\t'));
        let known: &[u8] = if has_tabs { b"\t" } else { b";,|" };
        let separator = Separator::of(row, known);
        let num_names = header.as_ref().map(|header| header.names.len()).filter(|&number| number > 0);
        Ok(Self {
            first_row: row.into(),
            is_chosen: columns.is_some_and(Columns::are_numbers),
            known,
            separator,
            width: num_names.unwrap_or_else(|| separator.fields(row).count()),
            num_numbers: leading_numbers(row, separator),
            header,
        })
    }

    /// Whether neither a header nor the caller says where the coordinates are.
    fn is_guessed(&self) -> bool {
        self.header.is_none() && !self.is_chosen
    }

    /// The columns of x, y and z.
    fn positions(&self, columns: Option<&Columns>) -> Result<Indices, String> {
        let names = self.names();
        match columns {
            Some(columns) => columns.in_text(names),
            None if self.header.is_none() => Ok([0, 1, 2]),
            None => columns::known(names).ok_or_else(|| {
                if names.len() < 3 { doubts::no_header(names, &self.first_row) } else { columns::cannot_tell(names) }
            }),
        }
    }

    /// Reads the numbers of a row in these columns. `separator` is the separator of the previous row.
    fn read(
        &self,
        number: usize,
        row: &str,
        separator: &mut Separator,
        columns: &[usize],
        values: &mut [f64],
    ) -> Result<(), String> {
        if parse(row, *separator, columns, values) == Some(self.width) {
            return Ok(());
        }
        *separator = Separator::of(row, self.known);
        let explain = || no_position(number, row) + &doubts::explain(row, self.names(), *separator);
        let width = parse(row, *separator, columns, values).ok_or_else(explain)?;
        if width != self.width && !self.is_chosen {
            self.check_width(row, *separator, width).map_err(|reason| {
                let shown = excerpt(row, 60);
                format!(
                    "line {number}: {reason} in `{shown}`; are these decimal commas, or an index? Choose the columns by \
                     numbers, as in `columns` 1,2,3, or {COMMAS}"
                )
            })?;
        }
        Ok(())
    }

    /// Refuses a row whose number of columns shows that they are not the columns of the header or of the first row.
    fn check_width(&self, row: &str, separator: Separator, width: usize) -> Result<(), String> {
        let Some(header) = &self.header else {
            let numbers = leading_numbers(row, separator);
            return if numbers == self.num_numbers {
                Ok(())
            } else {
                Err(format!("{}, {} in the first row,", count(numbers, "number"), self.num_numbers))
            };
        };
        let is_number = |field: &str| number(field).is_some();
        let has_more = separator.fields(row).skip(self.width).any(is_number) && !header.is_open;
        let has_less = width < self.width && separator == Separator::WhiteSpace;
        if has_more || has_less {
            Err(format!("{} below {}", count(width, "column"), count(self.width, "name")))
        } else {
            Ok(())
        }
    }

    fn names(&self) -> &[String] {
        self.header.as_ref().map_or(&[], |header| &header.names)
    }
}

/// Reads the numbers in these columns of a row, and returns its number of columns.
fn parse(row: &str, separator: Separator, columns: &[usize], values: &mut [f64]) -> Option<usize> {
    let (mut width, mut num_values) = (0, 0);
    for (column, field) in separator.fields(row).enumerate() {
        if let Some(place) = columns.iter().position(|&c| c == column) {
            values[place] = cell(field)?;
            num_values += 1;
        }
        width = column + 1;
    }
    (num_values == columns.len()).then_some(width)
}

fn has_three_numbers(row: &str) -> bool {
    Separator::of(row, b";,|").fields(row).filter_map(number).nth(2).is_some()
}

/// The number of leading columns that are numbers.
fn leading_numbers(row: &str, separator: Separator) -> usize {
    separator.fields(row).take_while(|field| number(field).is_some()).count()
}

#[cfg(test)]
mod tests {
    use crate::tests::points;
    use snake_geometry::Point;

    fn read(bytes: &[u8]) -> Result<Vec<Point>, String> {
        points(super::read(bytes, None))
    }

    const TWO: [Point; 2] = [[1.0, 2.0, 3.0], [-0.5, 1e-3, 7.0]];

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
            assert!(reason.contains("`columns` x,y,z"), "{reason}");
        }
        let reason = read(b"intensity,ring,range (mm)\n1,2,3\n").unwrap_err();
        assert!(reason.ends_with("The columns are 1 `intensity`, 2 `ring`, 3 `range (mm)`"), "{reason}");
    }

    #[test]
    fn bad_lines_are_named_and_shown() {
        for (text, line, shown) in [
            (&b"1 2 3\n1 2\n"[..], "line 2:", "`1 2`"),
            (b"x y z\n\n1 two 3", "line 3:", "`1 two 3`"),
            (b"x y z\nx y z\n", "line 2:", "`x y z`"),
            (b"1,5;2,5;3,5", "line 1:", "`1,5;2,5;3,5`"),
            (b"2.5\n1 2 3\n1 2 3", "line 1:", "`2.5`"),
            (b"1 2 3\n1 \xff 3", "line 2:", "`1 \u{ff} 3`"),
            (b"1 2\0 3", "line 1:", "`1 2  3`"),
        ] {
            let reason = read(text).unwrap_err();
            assert!(reason.starts_with(line) && reason.contains(shown), "{reason}");
        }
        assert!(read("9".repeat(1 << 20).as_bytes()).unwrap_err().len() < 200);
    }
}
