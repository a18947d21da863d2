//! Types of numbers in binary files.

use std::io::{self, Write};

/// The type of the numbers in a column, in an array or in a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Scalar {
    /// `f`, `i` or `u`, as in NumPy.
    pub(crate) kind: u8,
    /// Size in bytes.
    pub(crate) size: usize,
    big_endian: bool,
}

/// The name of a written column and its type: `FLOAT`, `DOUBLE`, `BYTE` or `INT`.
pub(crate) type Column = (&'static str, Scalar);

impl Scalar {
    pub(crate) const FLOAT: Self = Self { kind: b'f', size: 4, big_endian: false };
    pub(crate) const DOUBLE: Self = Self { kind: b'f', size: 8, big_endian: false };
    pub(crate) const BYTE: Self = Self { kind: b'u', size: 1, big_endian: false };
    pub(crate) const INT: Self = Self { kind: b'i', size: 4, big_endian: false };

    /// Parses byte order, kind and size, for example `<f4`.
    pub(crate) fn parse(descr: &str) -> Option<Self> {
        let &[order, kind, size] = descr.as_bytes() else { return None };
        let size = usize::from(size.wrapping_sub(b'0'));
        let is_known = matches!((kind, size), (b'f', 2 | 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8))
            && matches!((order, size), (b'<' | b'>', _) | (b'|', 1));
        is_known.then_some(Self { kind, size, big_endian: order == b'>' })
    }

    /// Refuses an index that is too large for an `INT`.
    pub(crate) fn check(self, value: f64) -> io::Result<()> {
        if self == Self::INT && value > f64::from(i32::MAX) {
            return Err(io::Error::other(format!("{value} exceeds the four bytes of an index")));
        }
        Ok(())
    }

    /// Writes a number as one of the four types that the writers use.
    ///
    /// # Errors
    /// The errors of `out`, and a number that is too large for an `INT`.
    pub(crate) fn write(self, out: &mut dyn Write, value: f64) -> io::Result<()> {
        self.check(value)?;
        match self {
            Self::FLOAT => out.write_all(&(value as f32).to_le_bytes()),
            Self::BYTE => out.write_all(&[value as u8]),
            Self::INT => out.write_all(&(value as i32).to_le_bytes()),
            _ => out.write_all(&value.to_le_bytes()),
        }
    }

    /// Decodes an item of `size` bytes.
    pub(crate) fn decode(&self, item: &[u8]) -> f64 {
        let mut bytes = [0; 8];
        bytes[..self.size].copy_from_slice(item);
        if self.big_endian {
            bytes[..self.size].reverse();
        }
        let bits = u64::from_le_bytes(bytes);
        match (self.kind, self.size) {
            (b'f', 2) => half(bits as u16),
            (b'f', 4) => f32::from_bits(bits as u32).into(),
            (b'f', _) => f64::from_bits(bits),
            (b'u', _) => bits as f64,
            _ => {
                // The shift to the left and back extends the sign bit over the unused bytes.
                let unused = 64 - 8 * self.size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
        }
    }
}

/// The value of the bits of a `float16`: a sign, 5 bits of exponent, 10 bits of fraction.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff) / 1024.0);
    let magnitude = match exponent {
        0 => fraction * 2.0_f64.powi(-14),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + fraction) * 2.0_f64.powi(exponent - 15),
    };
    if bits >> 15 == 1 { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_exact() {
        // NumPy: numpy.array([..], "<f2").tobytes()
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333251953125),
            (0x7bff, 65504.0),
            (0x0001, 5.960464477539063e-8),
            (0x0400, 6.103515625e-5),
            (0x7c00, f64::INFINITY),
            (0xfc00, f64::NEG_INFINITY),
            (0x8000, -0.0),
        ] {
            assert_eq!(
                Scalar::parse("<f2").unwrap().decode(&u16::to_le_bytes(bits)).to_bits(),
                f64::to_bits(value),
                "{bits:x}"
            );
        }
        assert!(Scalar::parse(">f2").unwrap().decode(&[0x7e, 0]).is_nan());
    }
}
