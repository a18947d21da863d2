//! The lines above the rows of a table: headers, comments with names, units.

use crate::text::columns::{self, Columns, Indices};
use crate::text::lines::text;
use crate::text::number::{is_spreadsheet_error, number};
use crate::text::separator::Separator;

/// Characters that begin a comment.
const COMMENT_MARKS: [char; 4] = ['#', '/', '%', '!'];

/// Units of length below a header, without brackets.
const LENGTHS: [&str; 14] =
    ["m", "mm", "cm", "dm", "km", "um", "\u{b5}m", "ft", "usft", "in", "meter", "meters", "metre", "metres"];

/// Whether a line is a comment: it starts with `#`, `//`, `%` or `!`, but not with an error of a spreadsheet such as
/// `#N/A`. The line `sep=;` tells Excel the separator.
pub(crate) fn is_comment(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    match line.first() {
        Some(b'#') => {
            let cell = line.split(|byte| b",;|\t ".contains(byte)).next().unwrap_or_default();
            !str::from_utf8(cell).is_ok_and(is_spreadsheet_error)
        }
        Some(b'/') => line.starts_with(b"//"),
        Some(b's') => line.starts_with(b"sep=") && line.len() <= 6,
        first => matches!(first, Some(b'%' | b'!')),
    }
}

/// A line with the names of columns.
pub(crate) struct Header {
    pub(crate) names: Vec<String>,
    pub(crate) separator: Separator,
    /// Whether any number of unnamed columns may follow, as after `TRACK[]` of COLMAP.
    pub(crate) is_open: bool,
    /// Whether white space precedes the first name.
    is_indented: bool,
}

impl Header {
    /// The names in a line that consists of names only.
    pub(crate) fn of(line: &str) -> Option<Self> {
        let separator = Separator::of(line, b";,|\t");
        let is_indented = line.starts_with(char::is_whitespace);
        let mut names: Vec<String> = match separator {
            // The unit in `X (m)` is not a column of its own.
            Separator::WhiteSpace => separator.fields(&without_units(line)).map(String::from).collect(),
            Separator::Char(_) => separator.fields(line).map(String::from).collect(),
        };
        let list = names.iter().position(|name| name.contains("[]"));
        names.truncate(list.unwrap_or(names.len()));
        let is_name = |name: &String| name.contains(char::is_alphabetic) && number(name).is_none();
        let has_names = names.iter().all(|name| name.is_empty() || is_name(name)) || columns::is_numbered(&names);
        (has_names && !names.is_empty()).then_some(Self { names, separator, is_open: list.is_some(), is_indented })
    }

    /// Whether the names tell where the coordinates are.
    pub(crate) fn tells(&self, columns: Option<&Columns>) -> bool {
        columns::known(&self.names).is_some() || columns.is_some_and(|columns| columns.are_named_in(&self.names))
    }

    /// Whether the names fit a row with this number of columns.
    pub(crate) fn fits(&self, width: usize) -> bool {
        self.names.len() == width || self.is_open && self.names.len() < width
    }

    /// The last comment that names the columns of the first row. It must have as many names as the row has columns. It
    /// must also contain three chosen or known names, or use the row's semicolons or commas as separators.
    ///
    /// A comment with known names beyond the first three columns is refused if their number does not fit.
    pub(crate) fn among(comments: &[&[u8]], row: &str, columns: Option<&Columns>) -> Result<Option<Self>, String> {
        let separator = Separator::of(row, b";,|");
        let width = separator.fields(row).count();
        let headers = || comments.iter().rev().filter_map(|comment| Self::from_comment(&text(comment)));
        let is_of_row = |header: &Self| {
            let is_told = match columns {
                Some(columns) => columns.in_header(&header.names).is_ok(),
                None => header.tells(None),
            };
            let is_table = header.separator == separator && separator != Separator::WhiteSpace;
            header.fits(width) && width >= 3 && (is_told || is_table)
        };
        let contradicts = |header: &Self| {
            let beyond = |indices: Indices| indices != [0, 1, 2] && indices.iter().all(|&index| index < width);
            columns.is_none() && columns::known(&header.names).is_some_and(beyond)
        };
        if let Some(header) = headers().find(is_of_row) {
            return Ok(Some(header));
        }
        match headers().find(contradicts) {
            Some(header) => Err(format!(
                "a comment names {} columns, the first row has {width}; {}",
                header.names.len(),
                columns::cannot_tell(&header.names)
            )),
            None => Ok(None),
        }
    }

    /// The names in a comment, after its marks and after the colon of `columns: x y z`.
    fn from_comment(comment: &str) -> Option<Self> {
        let text = comment.trim_start_matches(COMMENT_MARKS).trim();
        Self::of(text.rsplit_once(": ").map_or(text, |(_, names)| names))
    }

    /// Adds a name for an index column that the header does not name: pandas indents the header of its text output, and
    /// R quotes the index.
    pub(crate) fn name_index(&mut self, row: &str) {
        let is_indexed = self.is_indented && !row.starts_with(char::is_whitespace) || row.trim_start().starts_with('"');
        let is_one_short = self.separator.fields(row).count() == self.names.len() + 1;
        if self.separator == Separator::WhiteSpace && is_indexed && is_one_short {
            self.names.insert(0, String::new());
        }
    }
}

/// Whether a line below a header holds units: at least three lengths, all the same, and no numbers.
pub(crate) fn is_units(line: &str) -> bool {
    let fields = Separator::of(line, b";,|\t").fields(line);
    let units: Vec<String> = fields.map(|field| field.trim_matches(['(', ')', '[', ']', '"']).to_lowercase()).collect();
    let lengths: Vec<&String> = units.iter().filter(|unit| LENGTHS.contains(&unit.as_str())).collect();
    let are_equal = lengths.windows(2).all(|pair| pair[0] == pair[1]);
    lengths.len() >= 3 && are_equal && units.iter().all(|unit| number(unit).is_none())
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
