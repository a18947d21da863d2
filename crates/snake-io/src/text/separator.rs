//! The separators between the columns of a line.

/// The separator between the columns of a line.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Separator {
    /// One ASCII character.
    Char(u8),
    WhiteSpace,
}

impl Separator {
    /// The first of these separators that a line contains outside quotes, else white space. Only one is used per line,
    /// so that the decimal commas of `1,5;2,5;3,5` are refused and not read as separators.
    pub(crate) fn of(line: &str, known: &[u8]) -> Self {
        let separates = |&separator: &u8| {
            line.as_bytes().contains(&separator) && Self::Char(separator).fields(line).nth(1).is_some()
        };
        known.iter().copied().find(separates).map_or(Self::WhiteSpace, Self::Char)
    }

    /// The columns of a line, without quotes.
    pub(crate) fn fields(self, line: &str) -> Fields<'_> {
        Fields { rest: Some(line), separator: self }
    }

    fn separates(self, byte: u8) -> bool {
        match self {
            Self::Char(separator) => byte == separator,
            Self::WhiteSpace => byte.is_ascii_whitespace(),
        }
    }
}

/// The columns of a line. Separators within double quotes are ignored.
#[derive(Clone)]
pub(crate) struct Fields<'a> {
    rest: Option<&'a str>,
    separator: Separator,
}

impl<'a> Iterator for Fields<'a> {
    type Item = &'a str;

    #[inline]
    fn next(&mut self) -> Option<&'a str> {
        let text = match self.separator {
            Separator::Char(_) => self.rest?,
            Separator::WhiteSpace => self.rest.map(str::trim_ascii_start).filter(|text| !text.is_empty())?,
        };
        let mut within_quotes = false;
        let end = text.bytes().position(|byte| {
            within_quotes ^= byte == b'"';
            !within_quotes && self.separator.separates(byte)
        });
        let field;
        (field, self.rest) = match end {
            Some(end) => (&text[..end], Some(&text[end + 1..])),
            None => (text, None),
        };
        let field = field.trim_ascii();
        Some(field.strip_prefix('"').and_then(|field| field.strip_suffix('"')).map_or(field, str::trim_ascii))
    }
}

/// A row without the brackets or bars around it, as in `[1 2 3]`, `(1, 2, 3),` and `| 1 | 2 | 3 |`.
pub(crate) fn without_brackets(line: &str) -> &str {
    match line.trim_ascii_start() {
        row if row.starts_with(['[', '(', '{', '|', ']']) => {
            let row = row.trim_start_matches(|c: char| c.is_whitespace() || "[({|".contains(c));
            row.trim_end_matches(|c: char| c.is_whitespace() || "])}|,;".contains(c))
        }
        _ => line,
    }
}
