//! Reads point clouds from files and from bytes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use snake_geometry::{Cloud, Point, setters};

use crate::arrays::npy;
#[cfg(feature = "npz")]
use crate::arrays::npz;
use crate::crs::Crs;
use crate::format::PointFormat;
#[cfg(feature = "e57")]
use crate::formats::e57;
#[cfg(feature = "gltf")]
use crate::formats::gltf;
use crate::formats::shape::Shape;
use crate::formats::{obj, off, pcd, ply, stl, sweep};
#[cfg(feature = "laz")]
use crate::las;
use crate::text::columns::Columns;
use crate::{Error, Result, text};

/// The first bytes of a file that gzip compressed.
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
}

setters!(ReadOptions {
    sample: Option<usize> => with_sample,
    seed: u64 => with_seed,
    columns: Option<Columns> => with_columns,
});

/// The content of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contents {
    /// The points.
    pub cloud: Cloud,
    /// The number of faces that were ignored because the vertices were read and not samples of the surface.
    pub unsampled_faces: usize,
    /// Where the sensor was, in the file's frame: the `VIEWPOINT` of a PCD file, unless it is zero, which writers put
    /// there when they do not know it.
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
/// As [`read_cloud`].
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

/// [`read_cloud`] with the number of ignored faces.
///
/// # Errors
/// As [`read_cloud`].
pub fn read_contents(path: &Path, options: &ReadOptions) -> Result<Contents> {
    let format = format_of(path)?;
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    parse(&bytes, format, options).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// The format of a file. What is missing or a folder has no format that could be wrong.
fn format_of(path: &Path) -> Result<PointFormat> {
    PointFormat::from_path(path).map_err(|unknown| match File::open(path).and_then(|mut file| file.read(&mut [0])) {
        Ok(_) => unknown,
        Err(source) => Error::Io { path: path.into(), source },
    })
}

/// Calls `found` with each position of a file, in the file's order and units. Returns its coordinate reference system.
///
/// The memory for LAS and LAZ files does not grow with the number of points. Other formats are read whole.
///
/// # Errors
/// As [`read_cloud`]. Positions before a damaged part are then found nevertheless.
pub fn for_each_position(path: &Path, options: &ReadOptions, found: &mut dyn FnMut([f64; 3])) -> Result<Option<Crs>> {
    let format = format_of(path)?;
    let io_error = |source| Error::Io { path: path.into(), source };
    let format_error = |reason| Error::Format { path: path.into(), reason };
    #[cfg(feature = "laz")]
    if (format, &options.columns, options.sample) == (PointFormat::Las, &None, None) {
        let file = std::io::BufReader::with_capacity(1 << 20, File::open(path).map_err(io_error)?);
        return las::for_each_position(file, found).map_err(format_error);
    }
    let bytes = std::fs::read(path).map_err(io_error)?;
    let shape = read_shape(&bytes, format, options).map_err(format_error)?;
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

/// [`parse_cloud`] with the number of ignored faces.
///
/// # Errors
/// As [`parse_cloud`].
pub fn parse_contents(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> Result<Contents> {
    parse(bytes, format, options).map_err(|reason| Error::Input { what: format.name(), reason })
}

/// [`parse_as`] with a hint if the content has the signature of another format.
fn parse(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> std::result::Result<Contents, String> {
    parse_as(bytes, format, options).map_err(|reason| match PointFormat::from_content(bytes) {
        Some(other) if other != format => {
            let name = other.name();
            format!("{reason}; the content is {name}: rename the file, or --input-format {}", name.to_lowercase())
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
    #[cfg(feature = "laz")]
    let crs = if format == PointFormat::Las { las::crs(bytes) } else { None };
    #[cfg(not(feature = "laz"))]
    let crs = None;
    crs.iter().try_for_each(Crs::check_lengths)?;
    let shape = read_shape(bytes, format, options)?;
    let viewpoint = if format == PointFormat::Pcd { pcd::viewpoint(bytes) } else { None };
    let (cloud, unsampled_faces) = match options.sample {
        Some(number) => (shape.sample(number, options.seed)?.into_cloud(), 0),
        None => {
            let num_faces = shape.num_faces();
            (shape.into_cloud(), num_faces)
        }
    };
    Ok(Contents { cloud, unsampled_faces, viewpoint, crs })
}

fn read_shape(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> std::result::Result<Shape, String> {
    let columns = options.columns.as_ref();
    match format {
        PointFormat::Text => text::read(bytes, columns),
        PointFormat::Pts => text::read_counted(bytes, columns),
        PointFormat::Npy => npy::read(bytes, columns),
        #[cfg(feature = "npz")]
        PointFormat::Npz => npz::read(bytes, columns),
        #[cfg(not(feature = "npz"))]
        PointFormat::Npz => Err("this build cannot read .npz: it lacks the feature `npz` of snake-io".into()),
        _ if columns.is_some() => {
            Err("columns can be chosen in text and in arrays of NumPy; this format names its coordinates".into())
        }
        // Faces are read only for samples: most readers of a cloud do not need them, and some files have broken faces.
        PointFormat::Ply => ply::read(bytes, options.sample.is_some()),
        PointFormat::Pcd => pcd::read(bytes),
        PointFormat::Obj => obj::read(bytes),
        PointFormat::Off => off::read(bytes),
        PointFormat::Stl => stl::read(bytes),
        #[cfg(feature = "e57")]
        PointFormat::E57 => e57::read(bytes),
        #[cfg(not(feature = "e57"))]
        PointFormat::E57 => Err("this build cannot read .e57: it lacks the feature `e57` of snake-io".into()),
        #[cfg(feature = "gltf")]
        PointFormat::Gltf => gltf::read(bytes),
        #[cfg(not(feature = "gltf"))]
        PointFormat::Gltf => {
            Err("this build cannot read .gltf and .glb: it lacks the feature `gltf` of snake-io".into())
        }
        PointFormat::Kitti => sweep::read_checked(bytes, 4),
        PointFormat::Nuscenes => sweep::read_checked(bytes, 5),
        PointFormat::Sweep(values) => sweep::read(bytes, values.into()),
        #[cfg(feature = "laz")]
        PointFormat::Las => las::read(bytes),
        #[cfg(not(feature = "laz"))]
        PointFormat::Las => Err("this build cannot read .las and .laz: it lacks the feature `laz` of snake-io".into()),
    }
}

/// Reads clouds with equal numbers of points from an `.npy` array `(S, N, C)`, `C >= 3`, of floats or integers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it does not hold such an array.
pub fn read_clouds(path: &Path) -> Result<Vec<Vec<Point>>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npy::read_clouds(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}
