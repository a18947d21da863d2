//! Arrays: NumPy files and archives.

pub(crate) mod array_files;
pub(crate) mod npy;
pub(crate) mod npz;
