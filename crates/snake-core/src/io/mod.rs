//! Reading point clouds, writing keypoints, clouds, meshes and transforms.
//!
//! The format follows from the file name's extension, in any case:
//!
//! | extension | clouds | keypoints |
//! |---|---|---|
//! | `ply` | ascii or binary, any scalar type | binary, `float x y z saliency occupancy`, `int nearest_index` |
//! | `pcd` | ascii or binary, any scalar type | |
//! | `npy` | `(N, C)`, `C >= 3`, floats or integers | `(K, 6)` of `<f8`, columns as in csv |
//! | `csv` | as `xyz` | `x,y,z,saliency,occupancy,nearest_index` |
//! | `xyz`, `txt`, `pts` | columns of text | |
//! | `json` | | `{"keypoints": [{"x": .., ..}, ..]}` |
//!
//! Clouds are written as binary `ply`, meshes as `ply` or `stl`, both binary, or as `obj`, registrations as `json` or as `txt`, the four rows of the matrix.
//!
//! Coordinates are held as `f32`. That loses digits of georeferenced clouds (at 5e6 m one step is 0.5 m): subtract an
//! offset from them first.
//!
//! The readers take bytes from anywhere: whatever the content, the answer is a cloud or an error, and neither time nor
//! memory exceeds a small multiple of the file's size.

mod array;
mod json;
mod mesh;
mod npy;
mod pcd;
mod ply;
mod text;

use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::{PoisonError, RwLock, RwLockWriteGuard};

use crate::detect::Keypoint;
use crate::points::{Point, Transform};
use crate::registration::Registration;
use crate::{Error, Mesh, Result};

pub use array::Array;
pub use json::keypoint_json;

/// The extensions that [`read_points`] knows.
pub const POINT_EXTENSIONS: &[&str] = &["ply", "pcd", "xyz", "txt", "csv", "pts", "npy"];

/// The extensions that [`write_keypoints`] knows.
pub const KEYPOINT_EXTENSIONS: &[&str] = &["ply", "npy", "csv", "json"];

/// The extensions that [`write_points`] knows.
pub const CLOUD_EXTENSIONS: &[&str] = &["ply"];

/// The extensions that [`write_mesh`] knows.
pub const MESH_EXTENSIONS: &[&str] = &["ply", "obj", "stl"];

/// The extensions that [`write_registration`] knows.
pub const REGISTRATION_EXTENSIONS: &[&str] = &["json", "txt"];

/// A file's bytes to points, or the reason why not.
type PointReader = fn(&[u8]) -> std::result::Result<Vec<Point>, String>;

type KeypointWriter = fn(&mut dyn Write, &[Keypoint]) -> io::Result<()>;

type MeshWriter = fn(&mut dyn Write, &Mesh) -> io::Result<()>;

type RegistrationWriter = fn(&mut dyn Write, &Registration) -> io::Result<()>;

/// Reads a point cloud; the extension says which format.
///
/// The points keep the file's order, units and frame. A file without points gives an empty vector, and coordinates that
/// are not finite come through: what to do about either is the caller's choice.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not among [`POINT_EXTENSIONS`]
/// or the content is not what it promises.
pub fn read_points(path: &Path) -> Result<Vec<Point>> {
    let read = point_reader(path)?;
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    read(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Reads clouds of equally many points from an `.npy` array of shape `(S, N, C)`, `C >= 3`, floats or integers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such array.
pub fn read_clouds(path: &Path) -> Result<Vec<Vec<Point>>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npy::read_clouds(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Reads rigid transforms from an `.npy` array of shape `(S, 3, 4)` or `(S, 4, 4)`, floats or integers; a missing fourth
/// row is 0 0 0 1.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such array.
pub fn read_transforms(path: &Path) -> Result<Vec<Transform>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npy::read_transforms(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Reads an `.npy` array of any shape, floats or integers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such array.
pub fn read_array(path: &Path) -> Result<Array> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    npy::read_array(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Reads arrays of the given names from an `.npz`, in their order.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such archive, or lacks one of them.
pub fn read_arrays(path: &Path, names: &[&str]) -> Result<Vec<Array>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    array::read_named(&bytes, names).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Writes keypoints; the extension says which format.
///
/// The file appears under its name once it is complete; an earlier file of that name is replaced.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`KEYPOINT_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_keypoints(path: &Path, keypoints: &[Keypoint]) -> Result<()> {
    let write = keypoint_writer(path)?;
    write_atomically(path, |file| write(file, keypoints)).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path that [`write_keypoints`] would refuse for its extension, before any work is done.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`KEYPOINT_EXTENSIONS`].
pub fn check_keypoint_path(path: &Path) -> Result<()> {
    keypoint_writer(path).map(drop)
}

/// Writes a point cloud as PLY, `float x y z`; like [`write_keypoints`] whole or not at all.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`CLOUD_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_points(path: &Path, points: &[Point]) -> Result<()> {
    check_cloud_path(path)?;
    write_atomically(path, |file| ply::write_points(file, points))
        .map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path that [`write_points`] would refuse for its extension, before any work is done.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`CLOUD_EXTENSIONS`].
pub fn check_cloud_path(path: &Path) -> Result<()> {
    match extension(path).as_str() {
        "ply" => Ok(()),
        _ => Err(unknown_extension(path, "written", CLOUD_EXTENSIONS)),
    }
}

/// Writes a mesh: vertices with normals and triangles as `ply` or `obj`, triangles alone as `stl`. Whole or not at all,
/// like [`write_keypoints`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`MESH_EXTENSIONS`]; [`Error::Io`] when the file cannot be written.
pub fn write_mesh(path: &Path, mesh: &Mesh) -> Result<()> {
    let write = mesh_writer(path)?;
    write_atomically(path, |file| write(file, mesh)).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path that [`write_mesh`] would refuse for its extension, before any work is done.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`MESH_EXTENSIONS`].
pub fn check_mesh_path(path: &Path) -> Result<()> {
    mesh_writer(path).map(drop)
}

/// Writes a registration: as `json` the object with the fields of [`Registration`], as `txt` the four rows of
/// `t_target_source`. Whole or not at all, like [`write_keypoints`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`REGISTRATION_EXTENSIONS`]; [`Error::Io`] when the file cannot be
/// written.
pub fn write_registration(path: &Path, registration: &Registration) -> Result<()> {
    let write = registration_writer(path)?;
    write_atomically(path, |file| write(file, registration)).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path that [`write_registration`] would refuse for its extension, before any work is done.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`REGISTRATION_EXTENSIONS`].
pub fn check_registration_path(path: &Path) -> Result<()> {
    registration_writer(path).map(drop)
}

fn point_reader(path: &Path) -> Result<PointReader> {
    Ok(match extension(path).as_str() {
        "ply" => ply::read,
        "pcd" => pcd::read,
        "npy" => npy::read,
        "pts" => text::read_counted,
        "xyz" | "txt" | "csv" => text::read,
        _ => return Err(unknown_extension(path, "read", POINT_EXTENSIONS)),
    })
}

fn keypoint_writer(path: &Path) -> Result<KeypointWriter> {
    Ok(match extension(path).as_str() {
        "ply" => ply::write,
        "npy" => npy::write,
        "csv" => text::write,
        "json" => json::write,
        _ => return Err(unknown_extension(path, "written", KEYPOINT_EXTENSIONS)),
    })
}

fn mesh_writer(path: &Path) -> Result<MeshWriter> {
    Ok(match extension(path).as_str() {
        "ply" => mesh::write_ply,
        "obj" => mesh::write_obj,
        "stl" => mesh::write_stl,
        _ => return Err(unknown_extension(path, "written", MESH_EXTENSIONS)),
    })
}

fn registration_writer(path: &Path) -> Result<RegistrationWriter> {
    Ok(match extension(path).as_str() {
        "json" => json::write_registration,
        "txt" => text::write_transform,
        _ => return Err(unknown_extension(path, "written", REGISTRATION_EXTENSIONS)),
    })
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

fn unknown_extension(path: &Path, verb: &str, extensions: &[&str]) -> Error {
    let reason = format!("unknown extension; files that can be {verb}: .{}", extensions.join(", ."));
    Error::Format { path: path.into(), reason }
}

/// Held to read by all that write a file.
static WRITING: RwLock<()> = RwLock::new(());

/// Waits until no file is being written, and holds up those that would begin. A program that ends itself on a signal
/// leaves no temporary file behind if it holds this.
pub fn hold_writes() -> RwLockWriteGuard<'static, ()> {
    WRITING.write().unwrap_or_else(PoisonError::into_inner)
}

/// Writes a file whole or not at all: fills a temporary file beside the target, on the same file system, and renames it.
///
/// # Errors
/// Those of the file system and of `fill`; what was at the target then stays.
pub fn write_atomically(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let _writing = WRITING.read().unwrap_or_else(PoisonError::into_inner);
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The usual permissions, less the umask; a temporary file would otherwise be its owner's alone.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = BufWriter::new(builder.tempfile_in(folder)?);
    fill(&mut file)?;
    file.into_inner()?.persist(path)?;
    Ok(())
}

/// A piece of a file's content that is safe to show: one line, short, without control characters.
fn excerpt(text: &str, max_chars: usize) -> String {
    let mut chars = text.trim().chars();
    let shown: String = chars.by_ref().take(max_chars).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if chars.next().is_some() { shown + "…" } else { shown }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    pub(super) const KEYPOINTS: [Keypoint; 2] = [
        Keypoint { position: [0.1, -2.5, 3e-7], saliency: 0.75, occupancy: 0.5, nearest_index: 7 },
        Keypoint { position: [4.0, 5.0, 1.0e7], saliency: 0.3, occupancy: 1.0, nearest_index: 16_777_217 },
    ];

    /// The four points that each of the good files holds.
    const CLOUD: [Point; 4] = [[0.0, 0.0, 0.0], [1.0, -2.0, 0.5], [-0.25, 3.0, 100.0], [0.125, 1e-3, -7.0]];

    fn sample_files(kind: &str) -> Vec<PathBuf> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/io")).join(kind);
        let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths
    }

    #[test]
    fn good_files_hold_the_cloud() {
        let paths = sample_files("good");
        for extension in POINT_EXTENSIONS {
            assert!(paths.iter().any(|path| super::extension(path) == *extension), "no sample of .{extension}");
        }
        for path in paths {
            assert_eq!(read_points(&path).unwrap(), CLOUD, "{}", path.display());
        }
    }

    #[test]
    fn hostile_files_are_refused() {
        for path in sample_files("hostile") {
            let error = read_points(&path).expect_err(&path.display().to_string()).to_string();
            assert!(error.len() < 500 && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn damaged_files_never_panic() {
        for path in sample_files("good") {
            let (read, good) = (point_reader(&path).unwrap(), std::fs::read(&path).unwrap());
            for index in 0..good.len() {
                let _ = read(&good[..index]);
                for byte in [0, 0xff, b'9', b'-', b'e', b' ', b'\n', b'(', good[index].wrapping_add(1)] {
                    let mut damaged = good.clone();
                    damaged[index] = byte;
                    let _ = read(&damaged);
                }
            }
        }
    }

    #[test]
    fn keypoints_read_back_as_points() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.ply", "b.NPY", "c.csv"] {
            let path = folder.path().join(name);
            for keypoints in [&KEYPOINTS[..], &[]] {
                write_keypoints(&path, keypoints).unwrap();
                let positions: Vec<_> = keypoints.iter().map(|keypoint| keypoint.position).collect();
                assert_eq!(read_points(&path).unwrap(), positions, "{name}");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "temporary files remain");
    }

    #[test]
    fn who_holds_writes_sees_no_file_half_written() {
        let folder = tempfile::tempdir().unwrap();
        let (begun, told) = std::sync::mpsc::channel();
        let path = folder.path().join("slow.txt");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let slowly = |file: &mut dyn Write| {
                    begun.send(()).unwrap();
                    std::thread::sleep(std::time::Duration::from_millis(300));
                    file.write_all(b"whole")
                };
                write_atomically(&path, slowly).unwrap();
            });
            told.recv().unwrap();
            let _writes = hold_writes();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), "whole");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files remain");
        });
    }

    #[test]
    fn clouds_and_registrations_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let (cloud, json, text) =
            (folder.path().join("a.ply"), folder.path().join("b.json"), folder.path().join("c.TXT"));
        write_points(&cloud, &CLOUD).unwrap();
        assert_eq!(read_points(&cloud).unwrap(), CLOUD);
        let t_target_source =
            [[0.1, -1.0, 1e-17, 3.5], [1.0, 0.1, 0.0, 1e7], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]];
        let registration =
            Registration { t_target_source, num_inliers: 3, num_correspondences: 9, rmse: 0.1, seconds: 2.5 };
        write_registration(&json, &registration).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        let expected = serde_json::json!({
            "t_target_source": t_target_source, "num_inliers": 3, "num_correspondences": 9, "rmse": 0.1, "seconds": 2.5
        });
        assert_eq!(value, expected);
        write_registration(&text, &registration).unwrap();
        let rows = std::fs::read_to_string(&text).unwrap();
        let rows = rows.lines().map(|row| row.split(' ').map(|v| v.parse::<f64>().unwrap()).collect::<Vec<_>>());
        assert_eq!(rows.collect::<Vec<_>>(), t_target_source);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "temporary files remain");
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        write_keypoints(&path, &KEYPOINTS).unwrap();
        let before = std::fs::read(&path).unwrap();
        let beyond_int = Keypoint { nearest_index: usize::MAX, ..KEYPOINTS[0] };
        assert!(matches!(write_keypoints(&path, &[beyond_int]), Err(Error::Io { path: p, .. }) if p == path));
        assert_eq!(std::fs::read(&path).unwrap(), before);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files remain");
    }

    #[cfg(unix)]
    #[test]
    fn written_files_have_ordinary_permissions() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, ordinary) = (folder.path().join("a.csv"), folder.path().join("b"));
        write_keypoints(&ours, &KEYPOINTS).unwrap();
        std::fs::write(&ordinary, "").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&ordinary));
    }

    #[test]
    fn unknown_extensions_are_refused_with_the_list() {
        for name in ["a.las", "a", "", ".ply"] {
            let error = read_points(Path::new(name)).unwrap_err().to_string();
            assert!(error.contains(".ply, .pcd"), "{error}");
            assert!(check_keypoint_path(Path::new(name)).unwrap_err().to_string().contains(".json"));
            assert!(check_registration_path(Path::new(name)).unwrap_err().to_string().contains(".txt"));
            assert!(check_mesh_path(Path::new(name)).unwrap_err().to_string().contains(".ply, .obj, .stl"));
            assert!(check_cloud_path(Path::new(name)).unwrap_err().to_string().contains(".ply"));
        }
        for extension in KEYPOINT_EXTENSIONS {
            check_keypoint_path(&Path::new("a").with_extension(extension)).unwrap();
        }
        assert!(matches!(read_points(Path::new("/nowhere/a.PLY")), Err(Error::Io { .. })));
    }
}
