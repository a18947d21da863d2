//! Files of the snake-rs crates: reads point clouds, meshes, arrays and transforms, and writes keypoints, clouds,
//! meshes, volumes and transforms. A reader accepts any bytes: it returns a cloud or an error and never panics. A
//! writer writes a whole file or none.
//!
//! ```text
//! file → read_cloud → Cloud {points (N, 3) f32, origin f64} → snake_core::Model → Keypoint, Mesh
//!                       │                                                            │
//!                       └→ write_points                    write_keypoints, write_mesh ←┘
//! ```
//!
//! ```
//! use snake_core::add_origin;
//! use snake_io::{ReadOptions, read_cloud, write_points};
//! # let folder = tempfile::tempdir()?;
//! # let [scan, copy] = ["scan.xyz", "copy.ply"].map(|name| folder.path().join(name));
//! std::fs::write(&scan, "691000.25 5336000.5 512\n691001 5336003 514.125\n")?;
//! let cloud = read_cloud(&scan, &ReadOptions::default())?;
//! assert_eq!(add_origin(cloud.points[0], cloud.origin), [691_000.25, 5_336_000.5, 512.0]);
//! write_points(&copy, &cloud.points, cloud.origin)?;
//! assert_eq!(read_cloud(&copy, &ReadOptions::default())?, cloud);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The extension of the file name selects the format, in upper or lower case:
//!
//! | extension | clouds are read | clouds are written | keypoints are written |
//! |---|---|---|---|
//! | `ply` | ascii or binary, any scalar type | binary `x y z` | binary, with colour by saliency |
//! | `pcd` | ascii, binary, binary_compressed | binary `x y z` | binary, with colour by saliency |
//! | `npy` | `(N, C)`, `C >= 3`, floats or integers | `(N, 3)` of `<f8` | `(K, 6)` of `<f8`, columns as in csv |
//! | `npz` | the array `points`, `xyz`, `pc`, `pos` or `arr_0`; else the only array with the shape of a cloud | | |
//! | `csv` | as `xyz` | `x,y,z` | `x,y,z,saliency,occupancy,nearest_index` |
//! | `xyz`, `txt`, `pts` | columns of text | only `xyz` | |
//! | `obj`, `off`, `stl` | vertices, or points sampled on the surface (also of a `ply` with faces) | | |
//! | `las`, `laz` | coordinates | | |
//! | `json` | | | `{"keypoints": [{"x": .., ..}, ..]}` |
//! | `keypointnet.json` | | | annotations in the format of KeypointNet |
//!
//! Meshes are written as binary `ply`, as binary `stl` or as `obj`. Registrations are written as `json`, or as `txt`
//! with the four rows of the matrix. The readers ignore colours, normals and other fields.
//!
//! Coordinates are read as `f64` and stored as `f32`. Georeferenced scans lie far from zero and would lose digits (at
//! 5e6 m one `f32` step is 0.5 m). Their points are therefore stored relative to a [`Cloud::origin`]. The writers add
//! the origin and then use columns of eight bytes.
//!
//! PCD and STL files are the exception ([`adds_origin`]): PCL, Open3D and others read only coordinates of four bytes,
//! so these files contain points relative to the origin. A PCD file states the origin in a comment `# snake-rs origin X
//! Y Z`; the PCD reader of this crate adds it again.
//!
//! Time and memory of a reader are limited to a small multiple of the file's size, for compressed files to 50 times.

#![forbid(unsafe_code)]

mod array;
mod atomic;
mod columns;
mod dtype;
mod error;
mod format;
#[cfg(feature = "laz")]
mod gps_time;
mod json;
mod keypoint_source;
#[cfg(feature = "laz")]
mod las;
mod lzf;
mod mesh;
mod npy;
#[cfg(feature = "npz")]
mod npz;
mod obj;
mod off;
mod pcd;
mod ply;
mod shape;
mod stl;
mod table;
mod text;
mod transform;
mod write;

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;
use snake_core::{Keypoint, Mesh, Point, RigidTransform};

use format::{extension, unknown_extension};
use shape::Shape;

pub use array::Array;
pub use atomic::{hold_writes, write_atomically};
pub use columns::{Column, Columns};
pub use error::{Error, Result};
pub use format::{CLOUD_EXTENSIONS, CloudFormat, KEYPOINT_EXTENSIONS, KeypointFormat, POINT_EXTENSIONS, PointFormat};
pub use json::keypoint_json;
pub use keypoint_source::KeypointSource;
pub use snake_core::Cloud;

/// The extensions that [`write_mesh`] accepts.
pub const MESH_EXTENSIONS: &[&str] = &["ply", "obj", "stl"];

/// The extensions that [`write_registration`] accepts.
pub const REGISTRATION_EXTENSIONS: &[&str] = &["json", "txt"];

type MeshWriter = fn(&mut dyn Write, &Mesh, [f64; 3]) -> io::Result<()>;

/// Options of [`read_cloud`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReadOptions {
    /// The number of points to sample on the surface of a mesh, uniformly by area; `None` reads its vertices.
    pub sample: Option<usize>,
    /// Seed of the samples.
    pub seed: u64,
    /// The columns of text and NumPy arrays that hold x, y and z. `None` uses the columns that a header names, and the
    /// first three columns without a header.
    pub columns: Option<Columns>,
}

/// The content of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contents {
    /// The points.
    pub cloud: Cloud,
    /// The number of faces that were ignored because the vertices were read and not samples of the surface.
    pub unsampled_faces: usize,
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
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not among [`POINT_EXTENSIONS`],
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
    let format = PointFormat::from_path(path)?;
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    parse(&bytes, format, options).map_err(|reason| Error::Format { path: path.into(), reason })
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

fn parse(bytes: &[u8], format: PointFormat, options: &ReadOptions) -> std::result::Result<Contents, String> {
    if let (PointFormat::Npy, None) = (format, options.sample) {
        let cloud = Cloud::from_positions(npy::positions(bytes, options.columns.as_ref())?);
        return Ok(Contents { cloud, unsampled_faces: 0 });
    }
    let shape = read_shape(bytes, format, options)?;
    Ok(match options.sample {
        Some(number) => Contents { cloud: shape.sample(number, options.seed)?.into_cloud(), unsampled_faces: 0 },
        None => Contents { unsampled_faces: shape.num_faces(), cloud: shape.into_cloud() },
    })
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

/// Reads rigid transforms from an `.npy` array `(S, 3, 4)` or `(S, 4, 4)` of floats or integers. A missing fourth row
/// is 0 0 0 1.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it does not hold such an array.
pub fn read_transforms(path: &Path) -> Result<Vec<RigidTransform>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npy::read_transforms(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Reads a rigid transform.
///
/// A `json` file holds an object with the key `t_target_source`, as [`write_registration`] writes it, or the four rows
/// alone. A `txt` file holds four rows of four numbers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not among
/// [`REGISTRATION_EXTENSIONS`] or the content is not a rigid transform.
pub fn read_transform(path: &Path) -> Result<RigidTransform> {
    let read = match extension(path).as_str() {
        "json" => transform::read_json,
        "txt" => transform::read_text,
        _ => return Err(unknown_extension(path, "read", REGISTRATION_EXTENSIONS)),
    };
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    read(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Writes a volume `[z][y][x]` as an `.npy` array of `<f4` in C order. The file is written whole or not at all, as by
/// [`write_keypoints`].
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
#[cfg(feature = "npz")]
pub fn read_arrays(path: &Path, names: &[&str]) -> Result<Vec<Array>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npz::read_named(&bytes, names).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Writes keypoints; the extension selects the format.
///
/// The file appears under its name once it is complete and replaces an earlier file of that name. Links and special
/// files are treated as by [`write_atomically`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`KEYPOINT_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_keypoints(path: &Path, keypoints: &[Keypoint], source: &KeypointSource) -> Result<()> {
    let format = KeypointFormat::from_path(path)?;
    write_atomically(path, |file| format.write(file, keypoints, source))
        .map_err(|source| Error::Io { path: path.into(), source })
}

/// Whether the writers add the origin to the coordinates in this file; otherwise these stay relative to the origin.
pub fn adds_origin(path: &Path) -> bool {
    !matches!(extension(path).as_str(), "pcd" | "stl")
}

/// Writes points `(N, 3)` and adds the origin if [`adds_origin`]. The file is written whole or not at all, as by
/// [`write_keypoints`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`CLOUD_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_points(path: &Path, points: &[Point], origin: [f64; 3]) -> Result<()> {
    let format = CloudFormat::from_path(path)?;
    write_atomically(path, |file| format.write(file, points, origin))
        .map_err(|source| Error::Io { path: path.into(), source })
}

/// Writes a mesh and adds the origin to its vertices if [`adds_origin`].
///
/// `ply` and `obj` hold vertices, normals and triangles; `stl` holds triangles alone. The file is written whole or not
/// at all, as by [`write_keypoints`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`MESH_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_mesh(path: &Path, mesh: &Mesh, origin: [f64; 3]) -> Result<()> {
    let write = mesh_writer(path)?;
    write_atomically(path, |file| write(file, mesh, origin)).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path whose extension [`write_mesh`] would refuse, so that a caller can check it before any work is done.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`MESH_EXTENSIONS`].
pub fn check_mesh_path(path: &Path) -> Result<()> {
    mesh_writer(path).map(drop)
}

/// Writes a registration. A `json` file holds the record, an object that should have the key `t_target_source`. A `txt`
/// file holds the four rows of the matrix.
///
/// # Errors
/// As [`write_keypoints`].
pub fn write_registration(path: &Path, t_target_source: &RigidTransform, record: &impl Serialize) -> Result<()> {
    check_registration_path(path)?;
    let is_json = extension(path) == "json";
    let write = |file: &mut dyn Write| match is_json {
        true => {
            serde_json::to_writer(&mut *file, record)?;
            writeln!(file)
        }
        false => text::write_rows(file, t_target_source),
    };
    write_atomically(path, write).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path whose extension [`write_registration`] would refuse, so that a caller can check it before any work.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`REGISTRATION_EXTENSIONS`].
pub fn check_registration_path(path: &Path) -> Result<()> {
    match REGISTRATION_EXTENSIONS.contains(&extension(path).as_str()) {
        true => Ok(()),
        false => Err(unknown_extension(path, "written", REGISTRATION_EXTENSIONS)),
    }
}

fn mesh_writer(path: &Path) -> Result<MeshWriter> {
    Ok(match extension(path).as_str() {
        "ply" => mesh::write_ply,
        "obj" => mesh::write_obj,
        "stl" => mesh::write_stl,
        _ => return Err(unknown_extension(path, "written", MESH_EXTENSIONS)),
    })
}

/// The limit of the unpacked size, in sizes of the packed file. No scan exceeds it; a file made to exceed it would take
/// all memory.
#[cfg(any(feature = "laz", feature = "npz"))]
const MAX_EXPANSION: usize = 50;

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    pub(super) const KEYPOINTS: [Keypoint; 2] = [
        Keypoint { position: [0.1, -2.5, 3e-7], saliency: 0.75, occupancy: 0.5, nearest_index: 7 },
        Keypoint { position: [4.0, 5.0, 1.0e7], saliency: 0.3, occupancy: 1.0, nearest_index: 16_777_217 },
    ];

    /// The four points that every file in `good` holds.
    const CLOUD: [Point; 4] = [[0.0, 0.0, 0.0], [1.0, -2.0, 0.5], [-0.25, 3.0, 100.0], [0.125, 1e-3, -7.0]];

    /// The points of a shape as `read_points` returns them.
    pub(super) fn points(shape: std::result::Result<Shape, String>) -> std::result::Result<Vec<Point>, String> {
        Ok(shape?.into_cloud().into_points())
    }

    fn good_files() -> Vec<PathBuf> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/io/good"));
        let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths
    }

    #[test]
    fn good_files_hold_the_cloud() {
        let paths = good_files();
        for extension in POINT_EXTENSIONS {
            assert!(paths.iter().any(|path| super::extension(path) == *extension), "no sample of .{extension}");
        }
        for path in paths {
            assert_eq!(read_points(&path).unwrap(), CLOUD, "{}", path.display());
        }
    }

    #[test]
    fn meshes_can_be_sampled_and_contents_are_recognised() {
        for path in good_files() {
            let (format, bytes) = (PointFormat::from_path(&path).unwrap(), std::fs::read(&path).unwrap());
            let options = ReadOptions { sample: Some(50), seed: 1, columns: None };
            // This is the only one of the PLY files that has faces.
            let is_mesh = matches!(format, PointFormat::Obj | PointFormat::Off | PointFormat::Stl)
                || path.file_name().unwrap() == "ascii.ply";
            match parse_cloud(&bytes, format, &options) {
                Ok(cloud) => assert!(is_mesh && cloud.points.len() == 50, "{}", path.display()),
                Err(error) => assert!(!is_mesh && error.to_string().contains("no faces"), "{error}"),
            }
            let contents = parse_contents(&bytes, format, &ReadOptions::default()).unwrap();
            assert_eq!(contents.unsampled_faces > 0, is_mesh, "{}", path.display());
            let has_signature = !matches!(format, PointFormat::Text | PointFormat::Pts | PointFormat::Obj)
                && path.file_name().unwrap() != "binary.stl";
            // PCD and OFF files can begin with comments; these files have none.
            assert_eq!(PointFormat::from_content(&bytes), has_signature.then_some(format), "{}", path.display());
        }
    }

    #[test]
    fn keypoints_read_back_as_points() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.ply", "b.NPY", "c.csv", "d.pcd"] {
            let path = folder.path().join(name);
            for keypoints in [&KEYPOINTS[..], &[]] {
                write_keypoints(&path, keypoints, &KeypointSource::default()).unwrap();
                let positions: Vec<_> = keypoints.iter().map(|keypoint| keypoint.position).collect();
                assert_eq!(read_points(&path).unwrap(), positions, "{name}");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4, "temporary files remain");
    }

    #[test]
    fn clouds_far_away_read_back_to_the_last_digit() {
        let folder = tempfile::tempdir().unwrap();
        let cloud = Cloud { points: CLOUD.to_vec(), origin: [524_288.0, 5_400_000.0, 128.0] };
        for extension in CLOUD_EXTENSIONS {
            let path = folder.path().join("a").with_extension(extension);
            write_points(&path, &cloud.points, cloud.origin).unwrap();
            let read = read_cloud(&path, &ReadOptions::default()).unwrap();
            for (point, expected) in read.points.iter().zip(CLOUD) {
                for axis in 0..3 {
                    let (found, expected) =
                        (f64::from(point[axis]) + read.origin[axis], f64::from(expected[axis]) + cloud.origin[axis]);
                    assert!((found - expected).abs() < 1e-5, "{extension}: {found} {expected}");
                }
            }
            assert!(read.origin[1] > 5e6 && read.points.len() == 4);
            write_points(&path, &CLOUD, [0.0; 3]).unwrap();
            assert_eq!(
                read_cloud(&path, &ReadOptions::default()).unwrap(),
                Cloud { points: CLOUD.to_vec(), origin: [0.0; 3] }
            );
        }
    }

    #[test]
    fn clouds_and_registrations_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let (cloud, json, text) =
            (folder.path().join("a.ply"), folder.path().join("b.json"), folder.path().join("c.TXT"));
        write_points(&cloud, &CLOUD, [0.0; 3]).unwrap();
        assert_eq!(read_points(&cloud).unwrap(), CLOUD);
        let rows = [[0.6, -0.8, 1e-17, 3.5], [0.8, 0.6, 0.0, 1e7], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]];
        let t_target_source = RigidTransform::from_matrix(rows).unwrap();
        let record = serde_json::json!({ "t_target_source": t_target_source, "num_inliers": 3, "rmse": 0.1 });
        write_registration(&json, &t_target_source, &record).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        assert_eq!(value, record);
        write_registration(&text, &t_target_source, &record).unwrap();
        assert_eq!(read_transform(&text).unwrap(), t_target_source);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "temporary files remain");
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        write_keypoints(&path, &KEYPOINTS, &KeypointSource::default()).unwrap();
        let before = std::fs::read(&path).unwrap();
        let beyond_int = Keypoint { nearest_index: usize::MAX, ..KEYPOINTS[0] };
        assert!(
            matches!(write_keypoints(&path, &[beyond_int], &KeypointSource::default()), Err(Error::Io { path: p, .. }) if p == path)
        );
        assert_eq!(std::fs::read(&path).unwrap(), before);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files remain");
    }

    #[cfg(unix)]
    #[test]
    fn written_files_have_ordinary_permissions() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, ordinary) = (folder.path().join("a.csv"), folder.path().join("b"));
        write_keypoints(&ours, &KEYPOINTS, &KeypointSource::default()).unwrap();
        std::fs::write(&ordinary, "").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&ordinary));
    }

    #[test]
    fn columns_are_chosen_only_where_there_are_columns() {
        let options = ReadOptions { columns: Some("2,1,3".parse().unwrap()), ..Default::default() };
        for path in good_files() {
            let format = PointFormat::from_path(&path).unwrap();
            let has_columns =
                matches!(format, PointFormat::Text | PointFormat::Pts | PointFormat::Npy | PointFormat::Npz);
            match read_cloud(&path, &options) {
                Ok(cloud) => assert!(has_columns && cloud.points.len() == 4, "{}", path.display()),
                Err(error) => assert!(!has_columns && error.to_string().contains("columns can be chosen"), "{error}"),
            }
        }
    }

    #[test]
    fn unknown_extensions_are_refused_with_the_list() {
        for name in ["a.doc", "a", "", ".ply"] {
            let error = read_points(Path::new(name)).unwrap_err().to_string();
            assert!(error.contains(".ply, .pcd"), "{error}");
            assert!(KeypointFormat::from_path(Path::new(name)).unwrap_err().to_string().contains(".json"));
            assert!(check_registration_path(Path::new(name)).unwrap_err().to_string().contains(".txt"));
            assert!(check_mesh_path(Path::new(name)).unwrap_err().to_string().contains(".ply, .obj, .stl"));
            assert!(CloudFormat::from_path(Path::new(name)).unwrap_err().to_string().contains(".ply"));
        }
        for extension in KEYPOINT_EXTENSIONS {
            let format = KeypointFormat::from_path(&Path::new("a").with_extension(extension)).unwrap();
            assert_eq!(format.extension(), *extension);
        }
        assert!(matches!(read_points(Path::new("/nowhere/a.PLY")), Err(Error::Io { .. })));
    }
}
