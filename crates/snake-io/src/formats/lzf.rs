//! LZF, the compression of `binary_compressed` PCD files: Marc Lehmann's format of literals and back references.

/// Maximum number of output bytes per input byte: a back reference of 3 bytes copies up to 264.
const MAX_EXPANSION: usize = 88;

/// Decompresses to exactly `length` bytes.
pub(crate) fn decompress(data: &[u8], length: usize) -> Result<Vec<u8>, String> {
    if length > data.len().saturating_mul(MAX_EXPANSION) {
        return Err(format!("{} compressed bytes cannot hold {length}", data.len()));
    }
    let mut out = Vec::with_capacity(length);
    let mut rest = data;
    while !rest.is_empty() {
        rest = step(rest, &mut out).filter(|_| out.len() <= length).ok_or("the compressed data is damaged")?;
    }
    if out.len() == length { Ok(out) } else { Err(format!("{} bytes were unpacked, {length} promised", out.len())) }
}

/// Decompresses one run and returns the data after it.
fn step<'a>(data: &'a [u8], out: &mut Vec<u8>) -> Option<&'a [u8]> {
    let (&control, rest) = data.split_first()?;
    // The upper three bits are a length: 0 marks a run of literals, and 7 means that the next byte is added to it.
    let (literals, rest) = match control >> 5 {
        0 => rest.split_at_checked(usize::from(control) + 1)?,
        short => {
            let (&more, rest) = if short == 7 { rest.split_first()? } else { (&0, rest) };
            let (&low, rest) = rest.split_first()?;
            let distance = (usize::from(control & 0x1f) << 8 | usize::from(low)) + 1;
            let start = out.len().checked_sub(distance)?;
            // The copy goes byte by byte, because a back reference may overlap its own output.
            (start..start + usize::from(short) + usize::from(more) + 2).for_each(|index| out.push(out[index]));
            return Some(rest);
        }
    };
    out.extend_from_slice(literals);
    Some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_and_references_by_hand() {
        // `abc`; 4 bytes from 3 back; `x`; 7 + 1 + 2 bytes from 1 back.
        let packed = [2, b'a', b'b', b'c', 2 << 5, 2, 0, b'x', 7 << 5, 1, 0];
        assert_eq!(decompress(&packed, 18).unwrap(), b"abcabcaxxxxxxxxxxx");
        // The distance has 13 bits.
        let far = [vec![31; 1], vec![9; 32], [vec![31], vec![0; 32]].concat().repeat(8), vec![1 << 5 | 1, 31]].concat();
        let unpacked = decompress(&far, 9 * 32 + 3).unwrap();
        assert_eq!((unpacked[32], &unpacked[288..]), (0, &[9, 9, 9][..]));
        assert!(decompress(&[], 0).unwrap().is_empty());
    }

    #[test]
    fn damaged_data_is_refused() {
        let packed = [2, b'a', b'b', b'c', 2 << 5, 2];
        for length in [0, 3, 6, 8, 100] {
            decompress(&packed, length).unwrap_err();
        }
        for damaged in [&[2, b'a'][..], &[1 << 5], &[7 << 5, 1], &[0, b'a', 1 << 5, 1]] {
            assert!(decompress(damaged, 4).unwrap_err().contains("damaged"), "{damaged:?}");
        }
        assert!(decompress(&packed, 1 << 40).unwrap_err().contains("6 compressed bytes cannot hold"));
    }
}
