//! The file formats with their names, extensions and signatures.

use std::path::Path;

use serde::Deserialize;

use crate::arrays::npy;
use crate::{Error, Result};

/// The first bytes of a zip archive.
const NPZ_MAGIC: &[u8] = b"PK\x03\x04";

/// A format from which clouds are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PointFormat {
    /// Polygon file format, ascii or binary; faces define a surface.
    Ply,
    /// Point Cloud Library: ascii, binary or binary_compressed.
    Pcd,
    /// Columns of text: xyz, txt, csv.
    Text,
    /// Columns of text after a line with the number of points: pts.
    Pts,
    /// One NumPy array.
    Npy,
    /// A zip archive of NumPy arrays.
    Npz,
    /// Wavefront mesh.
    Obj,
    /// Object file format, a mesh.
    Off,
    /// Stereolithography mesh, ascii or binary.
    Stl,
    /// ASPRS laser scans, plain (las) or compressed (laz).
    Las,
    /// Laser scans of E57.
    E57,
    /// glTF scenes, as JSON (gltf) or binary (glb).
    Gltf,
    /// A sweep of KITTI: x, y, z and intensity as float32 (bin).
    Kitti,
    /// A sweep of nuScenes: x, y, z, intensity and ring as float32 (pcd.bin).
    Nuscenes,
    /// A sweep of points with this number of float32 values, the first three of them x, y and z (bin).
    Sweep(u8),
}

/// The most float32 values that a point of a sweep can have.
const MAX_SWEEP_VALUES: u8 = 64;

/// The extensions that [`PointFormat::from_path`] accepts.
pub const POINT_EXTENSIONS: &[&str] = &[
    "ply", "pcd", "xyz", "txt", "csv", "pts", "asc", "xyzn", "xyzrgb", "xyzi", "npy", "npz", "obj", "off", "stl",
    "las", "laz", "e57", "gltf", "glb",
];

impl PointFormat {
    /// The format of a file by its extension, in upper or lower case. A `.bin` file is a sweep of nuScenes if its name ends
    /// in `.pcd.bin` or a folder of its path is `LIDAR_TOP`, and one of KITTI if a folder is `velodyne` or
    /// `velodyne_points`.
    ///
    /// # Errors
    /// [`Error::Format`] when the extension is not among [`POINT_EXTENSIONS`] and the file is no such sweep.
    pub fn from_path(path: &Path) -> Result<Self> {
        if extension(path) == "bin" {
            return sweep_format(path);
        }
        Self::from_extension(&extension(path)).ok_or_else(|| match conversion(&extension(path)) {
            Some(command) => Error::Format { path: path.into(), reason: format!("this format is not read; {command}") },
            None => unknown_extension(path, "read", POINT_EXTENSIONS),
        })
    }

    /// The format of an extension in lower case without a dot, or of the name `kitti`, `nuscenes` or `kitti:5`, which are
    /// sweeps of 4, 5 and the stated number of float32 values a point. The stated number is not checked with the content.
    pub fn from_extension(extension: &str) -> Option<Self> {
        Some(match extension {
            "ply" => Self::Ply,
            "pcd" => Self::Pcd,
            "xyz" | "txt" | "csv" | "asc" | "xyzn" | "xyzrgb" | "xyzi" => Self::Text,
            "pts" => Self::Pts,
            "npy" => Self::Npy,
            "npz" => Self::Npz,
            "obj" => Self::Obj,
            "off" => Self::Off,
            "stl" => Self::Stl,
            "las" | "laz" => Self::Las,
            "e57" => Self::E57,
            "gltf" | "glb" => Self::Gltf,
            "kitti" => Self::Kitti,
            "nuscenes" => Self::Nuscenes,
            _ => {
                let values = extension.strip_prefix("kitti:")?.parse().ok()?;
                return (3..=MAX_SWEEP_VALUES).contains(&values).then_some(Self::Sweep(values));
            }
        })
    }

    /// The format of a file by its signature. Columns of text, OBJ and binary STL have no signature.
    pub fn from_content(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let starts = |signatures: &[&[u8]]| signatures.iter().any(|signature| bytes.starts_with(signature));
        if starts(&[b"ply\n", b"ply\r"]) {
            Some(Self::Ply)
        } else if starts(&[b"# .PCD", b"VERSION", b"FIELDS"]) {
            Some(Self::Pcd)
        } else if starts(&[npy::MAGIC]) {
            Some(Self::Npy)
        } else if starts(&[NPZ_MAGIC]) {
            Some(Self::Npz)
        } else if starts(&[b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF"]) {
            Some(Self::Off)
        } else if starts(&[b"solid "]) {
            Some(Self::Stl)
        } else if starts(&[b"LASF"]) {
            Some(Self::Las)
        } else if starts(&[b"ASTM-E57"]) {
            Some(Self::E57)
        } else if starts(&[b"glTF"]) {
            Some(Self::Gltf)
        } else {
            None
        }
    }

    /// The name of the format in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ply => "PLY",
            Self::Pcd => "PCD",
            Self::Text => "text",
            Self::Pts => "PTS",
            Self::Npy => "NPY",
            Self::Npz => "NPZ",
            Self::Obj => "OBJ",
            Self::Off => "OFF",
            Self::Stl => "STL",
            Self::Las => "LAS",
            Self::E57 => "E57",
            Self::Gltf => "glTF",
            Self::Kitti => "KITTI",
            Self::Nuscenes => "nuScenes",
            Self::Sweep(_) => "sweep",
        }
    }
}

/// A format in which keypoints are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum KeypointFormat {
    /// Binary PLY vertices with colour (by saliency), saliency, occupancy and nearest index.
    Ply,
    /// Binary PCD points with the same fields.
    Pcd,
    /// An array `(K, 7)` of `<f8`: x, y, z, saliency, occupancy, nearest_index, confidence, which is not a number where it is not known.
    Npy,
    /// The same columns as text.
    Csv,
    /// The JSON object `{"keypoints": [{"x": .., ..}, ..]}`.
    Json,
    /// KeypointNet annotations: a list with one shape and its keypoints.
    KeypointNet,
    /// LAZ with saliency, occupancy and nearest index as extra dimensions; with the feature `laz`.
    #[cfg(feature = "laz")]
    Laz,
    /// Parquet with the metadata of GeoParquet; with the feature `parquet`.
    #[cfg(feature = "parquet")]
    Parquet,
}

/// The extensions that [`KeypointFormat::from_path`] accepts.
pub const KEYPOINT_EXTENSIONS: &[&str] = &[
    "ply",
    "pcd",
    "npy",
    "csv",
    "keypointnet.json",
    "json",
    #[cfg(feature = "laz")]
    "laz",
    #[cfg(feature = "parquet")]
    "parquet",
];

impl KeypointFormat {
    /// The format of a file by its extension, in upper or lower case.
    ///
    /// # Errors
    /// [`Error::Format`] when the extension is not among [`KEYPOINT_EXTENSIONS`]; [`Error::Feature`] when it is that of a format
    /// that this build does not write.
    pub fn from_path(path: &Path) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        Ok(match extension(path).as_str() {
            "ply" => Self::Ply,
            "pcd" => Self::Pcd,
            "npy" => Self::Npy,
            "csv" => Self::Csv,
            "json" if name.ends_with(".keypointnet.json") => Self::KeypointNet,
            "json" => Self::Json,
            #[cfg(feature = "laz")]
            "laz" => Self::Laz,
            #[cfg(not(feature = "laz"))]
            "laz" => return Err(Error::Feature { path: path.into(), feature: "laz" }),
            #[cfg(feature = "parquet")]
            "parquet" => Self::Parquet,
            #[cfg(not(feature = "parquet"))]
            "parquet" => return Err(Error::Feature { path: path.into(), feature: "parquet" }),
            _ => return Err(unknown_extension(path, "written", KEYPOINT_EXTENSIONS)),
        })
    }

    /// The extension of files in this format.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Pcd => "pcd",
            Self::Npy => "npy",
            Self::Csv => "csv",
            Self::Json => "json",
            Self::KeypointNet => "keypointnet.json",
            #[cfg(feature = "laz")]
            Self::Laz => "laz",
            #[cfg(feature = "parquet")]
            Self::Parquet => "parquet",
        }
    }
}

/// A format in which clouds are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CloudFormat {
    /// Binary PLY vertices.
    Ply,
    /// Binary PCD points.
    Pcd,
    /// An array `(N, 3)` of `<f8`.
    Npy,
    /// Columns of text.
    Xyz,
    /// Columns of text below a line with the column names.
    Csv,
}

/// The extensions that [`CloudFormat::from_path`] accepts.
pub const CLOUD_EXTENSIONS: &[&str] = &["ply", "pcd", "npy", "xyz", "csv"];

impl CloudFormat {
    /// The format of a file by its extension, in upper or lower case.
    ///
    /// # Errors
    /// [`Error::Format`] when the extension is not among [`CLOUD_EXTENSIONS`].
    pub fn from_path(path: &Path) -> Result<Self> {
        Ok(match extension(path).as_str() {
            "ply" => Self::Ply,
            "pcd" => Self::Pcd,
            "npy" => Self::Npy,
            "xyz" => Self::Xyz,
            "csv" => Self::Csv,
            _ => return Err(unknown_extension(path, "written", CLOUD_EXTENSIONS)),
        })
    }
}

/// The layout of a `.bin` file by its name and its folders.
fn sweep_format(path: &Path) -> Result<PointFormat> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let is_in = |folders: &[&str]| path.iter().any(|part| folders.iter().any(|folder| part == *folder));
    if name.ends_with(".pcd.bin") || is_in(&["LIDAR_TOP"]) {
        Ok(PointFormat::Nuscenes)
    } else if is_in(&["velodyne", "velodyne_points"]) {
        Ok(PointFormat::Kitti)
    } else {
        let reason = "a .bin file does not say how many values a point has; give --input-format kitti (4 values), \
                      nuscenes (5 values) or for example kitti:6 (6 values), or put it in a folder `velodyne` or `LIDAR_TOP`";
        Err(Error::Format { path: path.into(), reason: reason.into() })
    }
}

/// A command that converts a file of a format that is not read.
fn conversion(extension: &str) -> Option<&'static str> {
    Some(match extension {
        "bag" => "convert the ROS 1 bag: mcap convert FILE.bag FILE.mcap",
        "db3" => "it is a recording: snake-cli detect FILE.db3 --topic /TOPIC, or read_recording in Rust and Python",
        "zstd" | "zst" => "decompress it: zstd -d FILE",
        "gz" => "decompress it: gunzip --keep FILE",
        "bz2" => "decompress it: bunzip2 --keep FILE",
        "xz" => "decompress it: unxz --keep FILE",
        "zip" => "unpack it: unzip FILE",
        "mcap" => "it is a recording: snake-cli detect FILE.mcap --topic /TOPIC, or read_recording in Rust and Python",
        "pcap" | "pcapng" => "convert the recording to LAS files: ouster-cli source FILE.pcap save FILE.las",
        "ptx" | "fls" | "rcp" => "convert it with CloudCompare: CloudCompare -O FILE -C_EXPORT_FMT PLY -SAVE_CLOUDS",
        "parquet" => {
            "convert it: python -c \"import pandas; pandas.read_parquet('FILE')[['x', 'y', 'z']].to_csv('FILE.csv', index=False)\""
        }
        "arrow" | "feather" => {
            "convert it: python -c \"import pandas; pandas.read_feather('FILE')[['x', 'y', 'z']].to_csv('FILE.csv', index=False)\""
        }
        "drc" => "decode it: draco_decoder -i FILE.drc -o FILE.ply",
        "vtk" | "vtu" => "convert it: meshio convert FILE FILE.ply",
        "lvx" | "lvx2" => "export it with Livox Viewer as LAS or CSV",
        "splat" | "ksplat" | "spz" | "sog" => {
            "convert the Gaussian splats: npx @playcanvas/splat-transform FILE FILE.ply"
        }
        "usd" | "usda" | "usdc" | "usdz" => "convert it to a mesh: import it in Blender, and export it as PLY",
        "fbx" | "dae" | "3ds" | "3mf" | "blend" => "convert it to a mesh: assimp export FILE FILE.ply",
        "step" | "stp" | "iges" | "igs" => "convert it to a mesh: freecadcmd, then Mesh.export to FILE.stl",
        _ => return None,
    })
}

pub(crate) fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

pub(crate) fn unknown_extension(path: &Path, verb: &str, extensions: &[&str]) -> Error {
    let reason = format!("unknown extension; files that can be {verb}: .{}", extensions.join(", ."));
    Error::Format { path: path.into(), reason }
}
