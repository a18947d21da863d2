//! Reads and writes the files of arrays, `.npy` and `.npz`.

use std::path::Path;

use crate::arrays::array::Array;
use crate::arrays::npy;
use crate::arrays::npz;
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

/// Reads an `.npy` array of any shape, of floats or integers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it does not hold such an array.
pub fn read_array(path: &Path) -> Result<Array> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npy::read_array(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Reads the named arrays of an `.npz` archive, in the order of `names`.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is not an archive or lacks one of the arrays.
pub fn read_arrays(path: &Path, names: &[&str]) -> Result<Vec<Array>> {
    let lacking = |name: &&str| Error::Format { path: path.into(), reason: format!("array `{name}`: not in the file") };
    let arrays = find_arrays(path, names)?.into_iter().zip(names);
    arrays.map(|(array, name)| array.ok_or_else(|| lacking(name))).collect()
}

/// [`read_arrays`] with `None` for an array that the archive does not have.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is not an archive or an array cannot be read.
pub fn find_arrays(path: &Path, names: &[&str]) -> Result<Vec<Option<Array>>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npz::read_named(&bytes, names).map_err(|reason| Error::Format { path: path.into(), reason })
}
