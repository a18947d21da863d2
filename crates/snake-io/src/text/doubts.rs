//! Reasons to refuse rows of text that can be read in two ways, and explanations for rows that cannot be read at all.

use crate::table::shape::Position;
use crate::text::commas::{COMMAS, commas};
use crate::text::header::Header;
use crate::text::number::number;
use crate::text::separator::Separator;
use snake_geometry::excerpt;

/// Minimum number of rows whose first column can be recognised as an index or a time.
const MIN_ROWS: usize = 5;

/// First columns that only rise and begin above this are times: seconds since 1970 exceed 1e9, coordinates are below 1e8.
const MIN_TIME: f64 = 1e8;

/// Refuses rows of four or more columns, without a header, whose first column rises in equal steps or holds times.
pub(crate) fn check_first_column(points: &[Position], line: usize) -> Result<(), String> {
    let steps = || points.windows(2).map(|pair| pair[1][0] - pair[0][0]);
    let [first, .., last] = points else { return Ok(()) };
    let mean = (last[0] - first[0]) / (points.len() - 1) as f64;
    let is_index = mean > 0.0 && steps().all(|step| (step - mean).abs() <= 0.05 * mean);
    let is_time = first[0] >= MIN_TIME && mean > 0.0 && steps().all(|step| step >= 0.0);
    if points.len() < MIN_ROWS || !(is_index || is_time) {
        return Ok(());
    }
    let what = if is_time { "holds times" } else { "rises in equal steps like an index or a time" };
    Err(format!(
        "line {line}: the first column {what}, and there is no header; choose the columns: `columns` 2,3,4 without it, or \
         `columns` 1,2,3 if it is x"
    ))
}

/// Watches rows of integers between commas, which can be numbers with decimal commas: `1,087,0,054,0,312`.
#[derive(Default)]
pub(crate) struct DecimalCommas {
    is_excluded: bool,
    /// Whether a second, fourth or sixth column begins with 0, as no integer does.
    has_leading_zero: bool,
    /// The number of digits in the second, fourth and sixth columns, as long as it is the same.
    digits: Option<Option<usize>>,
}

impl DecimalCommas {
    pub(crate) fn add<'a>(&mut self, mut fields: impl Iterator<Item = &'a str>) {
        for _ in 0..3 {
            let (whole, decimals) = (fields.next().unwrap_or_default(), fields.next().unwrap_or_default());
            let is_digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
            if self.is_excluded || !is_digits(whole.trim_start_matches(['+', '-'])) || !is_digits(decimals) {
                self.is_excluded = true;
                return;
            }
            self.has_leading_zero |= decimals.len() > 1 && decimals.starts_with('0');
            let digits = self.digits.get_or_insert(Some(decimals.len()));
            *digits = digits.filter(|&digits| digits == decimals.len());
        }
    }

    pub(crate) fn is_excluded(&self) -> bool {
        self.is_excluded
    }

    pub(crate) fn check(&self) -> Result<(), String> {
        match self.digits {
            Some(digits) if !self.is_excluded && (self.has_leading_zero || digits.is_some()) => Err(format!(
                "integers between commas that look like numbers with decimal commas: {COMMAS}; `columns` 1,2,3 reads \
                 integers"
            )),
            _ => Ok(()),
        }
    }
}

/// What is wrong with a row without three coordinates, and what to do. `names` are the header's names.
pub(crate) fn explain(row: &str, names: &[String], separator: Separator) -> String {
    let fields: Vec<&str> = separator.fields(row).collect();
    let first = fields.first().copied().unwrap_or_default();
    if ["ncols", "nrows", "DSAA"].iter().any(|word| first.eq_ignore_ascii_case(word)) {
        return ": a raster and no cloud; convert it: gdal_translate -of XYZ FILE FILE.xyz".into();
    }
    if commas(row).is_some() {
        return String::new();
    }
    if !names.is_empty() && Header::of(row).is_some_and(|header| header.names == names) {
        return ": the header once more, as in files that were joined; remove this line".into();
    }
    if row.trim().parse::<u64>().is_ok() {
        return ": a number of points? Several scans in one file are read as .pts (`format` pts)".into();
    }
    match first_numbers(&fields) {
        Some(start @ 1..) => {
            let shown = excerpt(fields[start - 1], 20);
            format!(": column {start} is `{shown}`; choose the columns of x, y and z, as in {}", choice(start))
        }
        _ if fields.len() < names.len().max(3) => {
            format!(": {} where {} are needed", count(fields.len(), "column"), names.len().max(3))
        }
        _ => String::new(),
    }
}

/// The error for words above the first row if they are too few to name its columns.
pub(crate) fn no_header(words: &[String], row: &str) -> String {
    let fields: Vec<&str> = Separator::of(row, b";,|").fields(row).collect();
    let shown = excerpt(&words.join(" "), 40);
    match first_numbers(&fields) {
        Some(start) => format!(
            "`{shown}` above this row does not name its {}; choose those of x, y and z by numbers, as in {}",
            count(fields.len(), "column"),
            choice(start)
        ),
        None => format!("`{shown}` and no three coordinates in `{}` below", excerpt(row, 60)),
    }
}

/// The index of the first three consecutive columns of a row that hold numbers.
fn first_numbers(fields: &[&str]) -> Option<usize> {
    fields.windows(3).position(|three| three.iter().all(|field| number(field).is_some()))
}

/// The option that chooses three columns from this index, counted from 0.
fn choice(start: usize) -> String {
    format!("`columns` {},{},{}", start + 1, start + 2, start + 3)
}

/// A number with its noun.
pub(crate) fn count(number: usize, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}
