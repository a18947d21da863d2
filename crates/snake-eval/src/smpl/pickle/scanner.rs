//! Reads the bytes of a pickle: lengths, lines, numbers and strings.

use std::borrow::Cow;

use super::Node;

/// A result with the reason of a refusal.
pub(super) type Step<T> = Result<T, String>;

/// The bytes of a pickle and a position in them.
pub(super) struct Scanner<'a> {
    bytes: &'a [u8],
    pub(super) at: usize,
}

impl<'a> Scanner<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The number of an opcode.
    pub(super) fn number(&mut self, opcode: u8) -> Step<Node<'a>> {
        Ok(match opcode {
            b'I' => match self.line()? {
                b"00" => Node::Bool(false),
                b"01" => Node::Bool(true),
                line => Node::Int(parsed(line, "number")?),
            },
            b'L' => {
                let line = self.line()?;
                Node::Int(parsed(line.strip_suffix(b"L").unwrap_or(line), "number")?)
            }
            b'J' => Node::Int(i32::from_le_bytes(self.array()?).into()),
            b'K' => Node::Int(self.take(1)?[0].into()),
            b'M' => Node::Int(u16::from_le_bytes(self.array()?).into()),
            b'\x8a' | b'\x8b' => {
                let length = self.length(if opcode == b'\x8a' { 1 } else { 4 })?;
                Node::Int(little_endian(self.take(length)?)?)
            }
            b'F' => Node::Float(self.parsed_line("number")?),
            _ => Node::Float(f64::from_be_bytes(self.array()?)),
        })
    }

    /// The string or the bytes of an opcode.
    pub(super) fn string(&mut self, opcode: u8) -> Step<Node<'a>> {
        Ok(Node::Bytes(match opcode {
            b'S' => Cow::Owned(unquoted(self.line()?)?),
            b'V' => Cow::Borrowed(self.line()?),
            _ => {
                let width = match opcode {
                    b'U' | b'C' | b'\x8c' => 1,
                    b'T' | b'X' | b'B' => 4,
                    _ => 8,
                };
                let length = self.length(width)?;
                Cow::Borrowed(self.take(length)?)
            }
        }))
    }

    /// The next bytes. They are borrowed, so a length beyond the end of the file allocates nothing.
    pub(super) fn take(&mut self, length: usize) -> Step<&'a [u8]> {
        let end = self.at.checked_add(length);
        let taken = end.and_then(|end| self.bytes.get(self.at..end)).ok_or("cut short")?;
        self.at += length;
        Ok(taken)
    }

    pub(super) fn array<const N: usize>(&mut self) -> Step<[u8; N]> {
        let taken = self.take(N)?;
        Ok(std::array::from_fn(|i| taken[i]))
    }

    /// Reads a length that is stored in `width` bytes.
    pub(super) fn length(&mut self, width: usize) -> Step<usize> {
        let mut bytes = [0; 8];
        bytes[..width].copy_from_slice(self.take(width)?);
        usize::try_from(u64::from_le_bytes(bytes)).map_err(|_| "cut short".into())
    }

    /// The text up to the end of the line, without the line break.
    pub(super) fn line(&mut self) -> Step<&'a [u8]> {
        let length = self.bytes[self.at..].iter().position(|&byte| byte == b'\n').ok_or("cut short")?;
        let line = self.take(length + 1)?;
        Ok(line[..length].strip_suffix(b"\r").unwrap_or(&line[..length]))
    }

    pub(super) fn parsed_line<T: std::str::FromStr>(&mut self, what: &str) -> Step<T> {
        parsed(self.line()?, what)
    }
}

fn parsed<T: std::str::FromStr>(text: &[u8], what: &str) -> Step<T> {
    let text = String::from_utf8_lossy(text);
    text.parse().map_err(|_| format!("`{text:.20}` is not a {what}"))
}

/// A number in two's complement.
fn little_endian(bytes: &[u8]) -> Step<i64> {
    let sign = if bytes.last().is_some_and(|byte| byte & 0x80 != 0) { 0xff } else { 0 };
    let mut all = [sign; 8];
    all.get_mut(..bytes.len()).ok_or("a number of more than 8 bytes")?.copy_from_slice(bytes);
    Ok(i64::from_le_bytes(all))
}

/// The content of a quoted Python 2 string, with its escapes resolved.
fn unquoted(line: &[u8]) -> Step<Vec<u8>> {
    let inner = [b"'", b"\""].iter().find_map(|quote| line.strip_prefix(*quote)?.strip_suffix(*quote));
    let mut rest = inner.ok_or("a string without quotes")?;
    let mut bytes = Vec::with_capacity(rest.len());
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte != b'\\' {
            bytes.push(byte);
            continue;
        }
        let (&escape, after) = rest.split_first().ok_or("a string ends within an escape")?;
        rest = after;
        bytes.push(match escape {
            b'n' => b'\n',
            b'r' => b'\r',
            b't' => b'\t',
            b'\\' | b'\'' | b'"' => escape,
            b'x' => {
                let (digits, after) = rest.split_at_checked(2).ok_or("a string ends within an escape")?;
                rest = after;
                let digits = std::str::from_utf8(digits).unwrap_or_default();
                u8::from_str_radix(digits, 16).map_err(|_| format!("unknown escape `\\x{digits}`"))?
            }
            other => return Err(format!("unknown escape `\\{}`", char::from(other).escape_default())),
        });
    }
    Ok(bytes)
}
