//! Writes `.npy` files.

use std::path::Path;

use crate::arrays::npy;
use crate::{Error, Result, write_atomically};

/// Writes a volume `[z][y][x]` as an `.npy` array of `<f4` in C order. The file is written whole or not at all, as by
/// [`write_keypoints`](crate::write_keypoints).
///
/// # Errors
/// [`Error::Input`] when the shape does not match the number of values; [`Error::Io`] when the file cannot be written.
pub fn write_volume(path: &Path, shape: [usize; 3], values: &[f32]) -> Result<()> {
    if shape.iter().try_fold(1_usize, |product, length| product.checked_mul(*length)) != Some(values.len()) {
        let reason = format!("{} values do not have the shape {shape:?}", values.len());
        return Err(Error::Input { what: "volume", reason });
    }
    write_atomically(path, |file| npy::write_volume(file, shape, values))
        .map_err(|source| Error::Io { path: path.into(), source })
}
