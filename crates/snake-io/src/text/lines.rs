//! Splits text into lines. Every text format, and every text header of a binary format, is read through [`Lines`].

use std::borrow::Cow;

use crate::table::shape::Position;
use crate::text::commas::commas;
use crate::text::number::number;
use snake_geometry::excerpt;

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// The lines that are not blank, with their numbers counted from 1.
///
/// A line ends with LF, CR LF, CR or LF CR. A byte order mark is skipped.
#[derive(Clone)]
pub(crate) struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
    ends: Ends,
}

/// The line ends of a text. The first line end decides, because binary data after a header may begin with any byte.
#[derive(Clone, Copy, PartialEq)]
enum Ends {
    /// LF, CR LF or CR.
    Any,
    /// CR of classic Mac OS.
    Cr,
    /// LF CR.
    LfCr,
}

impl<'a> Lines<'a> {
    /// The lines of a text. Zeros and the end mark of DOS after the last line are dropped.
    pub(crate) fn from_text(bytes: &'a [u8]) -> Result<Self, String> {
        if is_utf_16(bytes) {
            return Err("UTF-16 text; convert it to UTF-8: iconv -f UTF-16 -t UTF-8 FILE > NEW".into());
        }
        let is_text = |byte: &u8| !matches!(byte, 0 | 0x1a | b'\n' | b'\r' | b' ');
        let length = bytes.iter().rposition(is_text).map_or(0, |last| last + 1);
        Ok(Self::from_header(&bytes[..length]))
    }

    /// The lines of a header, before [`Lines::rest`].
    pub(crate) fn from_header(bytes: &'a [u8]) -> Self {
        let rest = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
        let first = rest.iter().position(is_end).map_or(&[][..], |end| &rest[end..]);
        let ends = match first {
            [b'\n', b'\r', ..] => Ends::LfCr,
            [b'\r', b'\n', ..] | [b'\n', ..] | [] => Ends::Any,
            _ => Ends::Cr,
        };
        Self { rest, number: 0, ends }
    }

    /// The bytes after the last line that was returned.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The next line, which can be blank.
    #[inline]
    fn next_line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let length = self.rest.iter().position(is_end).unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(length);
        let end = match (rest, self.ends) {
            ([b'\r', b'\n', ..], Ends::Any) | ([b'\n', b'\r', ..], Ends::LfCr) => 2,
            _ => rest.len().min(1),
        };
        self.rest = &rest[end..];
        Some(line)
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, &'a [u8]);

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let line = self.next_line()?;
            if !line.trim_ascii().is_empty() {
                return Some((self.number, line));
            }
        }
    }
}

fn is_end(byte: &u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

/// Whether a text has a byte order mark of UTF-16, or a zero in one of the bytes of its first two characters.
fn is_utf_16(bytes: &[u8]) -> bool {
    let is_character = |pair: &[u8; 2]| (pair[0] == 0) != (pair[1] == 0);
    let first = bytes.as_chunks::<2>().0.get(..2);
    matches!(bytes, [0xff, 0xfe, ..] | [0xfe, 0xff, ..]) || first.is_some_and(|pairs| pairs.iter().all(is_character))
}

/// A line as text. Bytes that are not UTF-8 are read as Latin-1. Spaces and minus signs outside ASCII become their
/// ASCII forms.
#[inline]
pub(crate) fn text(line: &[u8]) -> Cow<'_, str> {
    let plain = |c: char| match c {
        '\u{2212}' | '\u{2012}' | '\u{2013}' => '-',
        '\u{feff}' => ' ',
        c if c.is_whitespace() && !c.is_ascii() => ' ',
        c => c,
    };
    match str::from_utf8(line) {
        Ok(text) if text.is_ascii() => text.into(),
        Ok(text) => text.chars().map(plain).collect(),
        Err(_) => line.iter().map(|&byte| plain(byte.into())).collect(),
    }
}

/// A line of a mesh without the comment after `#`. The `#` of `1.#IND` does not begin a comment.
pub(crate) fn without_comment(line: &str) -> &str {
    let begins = |&(place, _): &(usize, &str)| !line[..place].ends_with('.');
    line.match_indices('#').find(begins).map_or(line, |(place, _)| &line[..place]).trim()
}

/// The first three numbers of a line of words.
pub(crate) fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Position> {
    let mut next = || number(words.next()?);
    Some([next()?, next()?, next()?])
}

/// The error for a line without three coordinates, with [`advice`].
pub(crate) fn no_position(number: usize, line: &str) -> String {
    format!("line {number}: no three coordinates in `{}`{}", excerpt(line, 60), advice(line))
}

/// The advice for a line that cannot be read because of commas in its numbers.
pub(crate) fn advice(line: &str) -> String {
    commas(line).map(|advice| format!(": {advice}")).unwrap_or_default()
}
