//! Reads point clouds from files and from bytes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use snake_geometry::{Cloud, Point, setters};

use crate::arrays::npy;
use crate::crs::Crs;
use crate::formats::{PointFormat, extension};
use crate::las;
use crate::text::columns::Columns;
use crate::{Error, Result};

/// The first bytes of a gzip file.
const GZIP_MAGIC: &[u8] = b"\x1f\x8b";

/// Options of [`read_cloud`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct ReadOptions {
    /// The number of points to sample on the surface of a mesh, uniformly by area; `None` reads its vertices.
    pub sample: Option<usize>,
    /// Seed of the samples.
    pub seed: u64,
    /// The columns of text and NumPy arrays that hold x, y and z. `None` uses the columns that a header names, and the
    /// first three columns without a header.
    pub columns: Option<Columns>,
    /// Whether to keep points of LAS and LAZ files that are withheld or classified as noise (7 and 18). Otherwise they are
    /// read as not finite.
    pub keep_withheld: bool,
}

setters!(ReadOptions {
    sample: Option<usize> => with_sample,
    seed: u64 => with_seed,
    columns: Option<Columns> => with_columns,
    keep_withheld: bool => with_keep_withheld,
});

/// The content of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contents {
    /// The points.
    pub cloud: Cloud,
    /// Sentences for the user about the points: points that were left out, faces that were not sampled.
    pub notes: Vec<String>,
    /// The position of the sensor, in the file's frame: the `VIEWPOINT` of a PCD file. A zero position does not count,
    /// because writers put it there when they do not know it.
    pub viewpoint: Option<[f64; 3]>,
    /// The coordinate reference system, of LAS and LAZ files.
    pub crs: Option<Crs>,
}

/// Reads the points `(N, 3)` of a file; the extension selects the format.
///
/// The points keep the file's order, units and frame. A file without points gives an empty vector. Coordinates that are
/// not finite are kept. Coordinates far from zero lose digits, which [`read_cloud`] keeps.
///
/// # Errors
/// The errors of [`read_cloud`].
pub fn read_points(path: &Path) -> Result<Vec<Point>> {
    read_cloud(path, &ReadOptions::default()).map(Cloud::into_points)
}

/// Reads a point cloud with its origin; the extension selects the format.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not among [`POINT_EXTENSIONS`](crate::POINT_EXTENSIONS),
/// the content does not follow the format, the columns of x, y and z are unknown, or samples are asked for and there is
/// no surface.
pub fn read_cloud(path: &Path, options: &ReadOptions) -> Result<Cloud> {
    read_contents(path, options).map(|contents| contents.cloud)
}

/// [`read_cloud`] with the other contents of the file.
///
/// # Errors
/// The errors of [`read_cloud`].
pub fn read_contents(path: &Path, options: &ReadOptions) -> Result<Contents> {
    let (format, bytes) = read_file(path)?;
    parse(&bytes, format, options).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// The format and the content of a file. The content determines the format of a pipe, and of a file without an extension
/// such as `/dev/stdin`.
pub(crate) fn read_file(path: &Path) -> Result<(PointFormat, Vec<u8>)> {
    let is_by_content = is_pipe(path) || (path.is_file() && extension(path).is_empty());
    let by_name = if is_by_content { PointFormat::from_path(path) } else { Ok(format_of(path)?) };
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    let format = by_name.or_else(|unknown| PointFormat::from_content(&bytes).ok_or(unknown))?;
    Ok((format, bytes))
}

/// Whether a file can be read only once.
#[cfg(unix)]
pub(crate) fn is_pipe(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    path.metadata().is_ok_and(|metadata| metadata.file_type().is_fifo())
}

/// Whether a file can be read only once.
#[cfg(not(unix))]
pub(crate) fn is_pipe(_path: &Path) -> bool {
    false
}

/// The format of a file by its name. If the name tells none, a file that cannot be read gives an I/O error instead.
fn format_of(path: &Path) -> Result<PointFormat> {
    PointFormat::from_path(path).map_err(|unknown| match File::open(path).and_then(|mut file| file.read(&mut [0])) {
        Ok(_) => unknown,
        Err(source) => Error::Io { path: path.into(), source },
    })
}

/// Calls `found` with each position of a file, in the file's order and units. Points that are left out are not finite.
/// Returns the coordinate reference system.
///
/// The memory for LAS and LAZ files does not grow with the number of points. Other formats are read whole.
///
/// # Errors
/// The errors of [`read_cloud`]. `found` has then been called for the positions before a damaged part.
pub fn for_each_position(path: &Path, options: &ReadOptions, found: &mut dyn FnMut([f64; 3])) -> Result<Option<Crs>> {
    let format = format_of(path)?;
    let io_error = |source| Error::Io { path: path.into(), source };
    let format_error = |reason| Error::Format { path: path.into(), reason };
    if (format, &options.columns, options.sample) == (PointFormat::Las, &None, None) {
        let file = std::io::BufReader::with_capacity(1 << 20, File::open(path).map_err(io_error)?);
        return las::for_each_position(file, options.keep_withheld, found).map_err(format_error);
    }
    let bytes = std::fs::read(path).map_err(io_error)?;
    let shape = format.read(&bytes, options).map_err(format_error)?;
    match options.sample {
        Some(number) => shape.sample(number, options.seed).map_err(format_error)?.points.into_iter().for_each(found),
        None => shape.points.into_iter().for_each(found),
    }
    Ok(None)
}

/// Reads a point cloud from the bytes of a file.
///
/// # Errors
/// [`Error::Input`] when the content does not follow the format, or samples are asked for and there is no surface.
pub fn parse_cloud(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> Result<Cloud> {
    parse_contents(bytes, format, options).map(|contents| contents.cloud)
}

/// [`parse_cloud`] with the other contents of the file.
///
/// # Errors
/// The errors of [`parse_cloud`].
pub fn parse_contents(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> Result<Contents> {
    parse(bytes, format, options).map_err(|reason| Error::Input { what: format.name(), reason })
}

/// [`parse_as`] with a hint if the content has the signature of another format.
fn parse(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> std::result::Result<Contents, String> {
    parse_as(bytes, format, options).map_err(|reason| match PointFormat::from_content(bytes) {
        Some(other) if other != format => {
            let name = other.name();
            format!("{reason}; the content is {name}: rename the file, or `format` {}", name.to_lowercase())
        }
        _ if bytes.starts_with(GZIP_MAGIC) => format!("{reason}; the content is compressed: gunzip FILE"),
        _ => reason,
    })
}

fn parse_as(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> std::result::Result<Contents, String> {
    if let (PointFormat::Npy, None) = (format, options.sample) {
        let cloud = Cloud::from_positions(npy::positions(bytes, options.columns.as_ref())?);
        return Ok(Contents { cloud, ..Contents::default() });
    }
    let crs = if format == PointFormat::Las { las::crs(bytes) } else { None };
    crs.iter().try_for_each(Crs::check_lengths)?;
    let mut shape = format.read(bytes, options)?;
    let viewpoint = shape.viewpoint;
    match (options.sample, shape.num_faces()) {
        (Some(number), _) => shape = shape.sample(number, options.seed)?,
        (None, 0) => {}
        (None, faces) => shape.notes.push(format!(
            "a mesh of {faces} faces: its {} vertices are used; `sample` draws points from its surface",
            shape.points.len()
        )),
    }
    let notes = std::mem::take(&mut shape.notes);
    Ok(Contents { cloud: shape.into_cloud(), notes, viewpoint, crs })
}
