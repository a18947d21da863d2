//! Files of the snake-rs crates: reads point clouds, meshes, arrays and transforms, and writes keypoints, clouds,
//! meshes, volumes and transforms. A reader accepts any bytes: it returns a cloud or an error and never panics. A
//! writer writes a whole file or none.
//!
//! ```text
//! file → read_cloud → Cloud {points (N, 3) f32, origin f64} → Model of snake-core → Keypoint, Mesh
//!                       │                                                            │
//!                       └→ write_points                    write_keypoints, write_mesh ←┘
//! ```
//!
//! ```
//! use snake_geometry::add_origin;
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
//! | `npy` | `(N, C)`, `C >= 3`, floats or integers | `(N, 3)` of `<f8` | `(K, 8)` of `<f8`, columns as in csv |
//! | `npz` | the array `points`, `xyz`, `pc`, `pos` or `arr_0`; else the only array with the shape of a cloud | | |
//! | `csv` | as `xyz` | `x,y,z` | `x,y,z,saliency,occupancy,nearest_index,confidence,deviation` |
//! | `xyz`, `txt`, `pts`, `asc`, `xyzn`, `xyzrgb`, `xyzi` | columns of text | only `xyz` | |
//! | `pcd.bin`, and `bin` in folders of KITTI or nuScenes | x, y and z of float32 values, 5 or 4 per point; [`PointFormat::Sweep`] for others | | |
//! | `obj`, `off`, `stl` | vertices, or points sampled on the surface (also of a `ply` with faces) | | |
//! | `gltf`, `glb` | vertices of all meshes in the scene's frame, or points sampled on them | | |
//! | `las`, `laz`, `e57` | coordinates | | only `laz`, with extra dimensions |
//! | `json` | | | `{"keypoints": [{"x": .., ..}, ..]}` |
//! | `keypointnet.json` | | | annotations in the format of KeypointNet |
//!
//! Meshes are written as binary `ply`, as binary `stl` or as `obj`. Registrations are written as `json`, or as `txt` with the four
//! rows of the matrix; [`read_poses`] reads the poses of many clouds. The readers ignore colours, normals and other fields.
//!
//! Coordinates are read as `f64` and stored as `f32`. Georeferenced scans lie far from zero and would lose digits (at
//! 5e6 m one `f32` step is 0.5 m). Their points are therefore stored relative to a [`Cloud::origin`]. The writers add
//! the origin and then use columns of eight bytes.
//!
//! PCD and STL files are the exception ([`adds_origin`]): PCL, Open3D and others read only coordinates of four bytes,
//! so these files contain points relative to the origin. A PCD file states the origin in a comment `# snake-rs origin X
//! Y Z`; the PCD reader of this crate adds it again.
//!
//! The time and memory of a reader are limited to a small multiple of the file's size, for compressed files 50 times.

#![forbid(unsafe_code)]

mod arrays;
mod atomic;
mod attributes;
mod clouds;
mod crs;
mod formats;
mod las;
mod logs;
mod poses;
mod table;
#[cfg(test)]
mod tests;
mod text;
mod transform;
mod write;

pub use arrays::array_files::write_volume;
pub use atomic::{TEMPORARY, hold_writes, sync_folder, write_atomically};
pub use attributes::{Attributes, read_attributes};
pub use clouds::{
    Contents, ReadOptions, for_each_position, parse_cloud, parse_contents, read_cloud, read_contents, read_points,
};
pub use crs::Crs;
pub use formats::{CLOUD_EXTENSIONS, CloudFormat, KEYPOINT_EXTENSIONS, KeypointFormat, POINT_EXTENSIONS, PointFormat};
pub use las::copc::{Copc, LocalFile, Ranges};
pub use logs::recording::{RecordedCloud, Recording, is_recording, read_recording};
pub use poses::{POSE_EXTENSIONS, Poses, read_poses};
pub use snake_geometry::Cloud;
pub use snake_geometry::{Error, Result};
pub use text::columns::{Column, Columns};
pub use transform::{REGISTRATION_EXTENSIONS, check_registration_path, read_transform, write_registration};
pub use write::json::keypoint_json;
pub use write::keypoint_source::KeypointSource;
pub use write::mesh::{MESH_EXTENSIONS, check_mesh_path, write_mesh};
pub use write::{adds_origin, origin_note, write_cloud, write_keypoints, write_points};

#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;

/// The limit of the unpacked size, as a multiple of the packed size. No scan exceeds it; a malicious file could otherwise
/// take all memory.
const MAX_EXPANSION: usize = 50;
