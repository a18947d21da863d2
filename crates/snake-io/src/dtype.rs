//! Types of numbers in binary files.

/// The number type of a NumPy array's items or of a PCD field.
#[derive(Clone, Copy)]
pub(super) struct Dtype {
    kind: u8,
    /// Size in bytes.
    pub(super) size: usize,
    big_endian: bool,
}

impl Dtype {
    /// Parses byte order, kind and size, for example `<f4`.
    pub(super) fn parse(descr: &str) -> Option<Self> {
        let &[order, kind, size] = descr.as_bytes() else { return None };
        let size = usize::from(size.wrapping_sub(b'0'));
        let is_known = matches!((kind, size), (b'f', 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8))
            && matches!((order, size), (b'<' | b'>', _) | (b'|', 1));
        is_known.then_some(Self { kind, size, big_endian: order == b'>' })
    }

    /// Decodes an item of `size` bytes.
    pub(super) fn decode(&self, item: &[u8]) -> f64 {
        let mut bytes = [0; 8];
        bytes[..self.size].copy_from_slice(item);
        if self.big_endian {
            bytes[..self.size].reverse();
        }
        let bits = u64::from_le_bytes(bytes);
        match (self.kind, self.size) {
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
