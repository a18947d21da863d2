//! The file formats with their names, extensions and signatures. The reader of each format is a file here, or is in the folder of
//! arrays, text or laser scans.

pub(crate) mod e57;
pub(crate) mod gltf;
pub(crate) mod lzf;
pub(crate) mod obj;
pub(crate) mod off;
pub(crate) mod pcd;
pub(crate) mod ply;
pub(crate) mod ply_header;
pub(crate) mod quaternion;
pub(crate) mod stl;
pub(crate) mod sweep;

use std::path::Path;
use std::sync::LazyLock;

use serde::Deserialize;

use crate::arrays::npy;
use crate::arrays::npz;
use crate::las;
use crate::table::shape::Shape;
use crate::{Error, ReadOptions, Result, text};

/// How files of a format are named, recognised and read.
struct Format {
    format: PointFormat,
    /// The name in messages. Formats without extensions are selected by it.
    name: &'static str,
    extensions: &'static [&'static str],
    /// The first bytes of a file.
    signatures: &'static [&'static [u8]],
    read: Read,
}

/// Reads the points, from the columns in the options, and the faces if they are to be sampled.
type Read = fn(&[u8], &ReadOptions) -> std::result::Result<Shape, String>;

const fn row(
    format: PointFormat,
    name: &'static str,
    extensions: &'static [&'static str],
    signatures: &'static [&'static [u8]],
    read: Read,
) -> Format {
    Format { format, name, extensions, signatures, read }
}

/// All formats from which clouds are read, except [`PointFormat::Sweep`].
#[rustfmt::skip]
const FORMATS: &[Format] = &[
    // Faces are read only for sampling: most callers do not need them, and some files have broken faces.
    row(PointFormat::Ply, "PLY", &["ply"], &[b"ply\n", b"ply\r"], |bytes, options| ply::read(bytes, options.sample.is_some())),
    row(PointFormat::Pcd, "PCD", &["pcd"], &[b"# .PCD", b"VERSION", b"FIELDS"], |bytes, _| pcd::read(bytes)),
    row(PointFormat::Text, "text", &["xyz", "txt", "csv", "asc", "xyzn", "xyzrgb", "xyzi"], &[],
        |bytes, options| text::read(bytes, options.columns.as_ref())),
    row(PointFormat::Pts, "PTS", &["pts"], &[], |bytes, options| text::read_counted(bytes, options.columns.as_ref())),
    row(PointFormat::Npy, "NPY", &["npy"], &[npy::MAGIC], |bytes, options| npy::read(bytes, options.columns.as_ref())),
    row(PointFormat::Npz, "NPZ", &["npz"], &[b"PK\x03\x04"],
        |bytes, options| npz::read(bytes, options.columns.as_ref())),
    row(PointFormat::Obj, "OBJ", &["obj"], &[], |bytes, _| obj::read(bytes)),
    row(PointFormat::Off, "OFF", &["off"], &[b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF"],
        |bytes, _| off::read(bytes)),
    row(PointFormat::Stl, "STL", &["stl"], &[b"solid "], |bytes, _| stl::read(bytes)),
    row(PointFormat::Las, "LAS", &["las", "laz"], &[b"LASF"], |bytes, options| las::read(bytes, options.keep_withheld)),
    row(PointFormat::E57, "E57", &["e57"], &[b"ASTM-E57"], |bytes, _| e57::read(bytes)),
    row(PointFormat::Gltf, "glTF", &["gltf", "glb"], &[b"glTF"],
        |bytes, _| gltf::read(bytes)),
    row(PointFormat::Kitti, "KITTI", &[], &[], |bytes, _| sweep::read_checked(bytes, 4)),
    row(PointFormat::Nuscenes, "nuScenes", &[], &[], |bytes, _| sweep::read_checked(bytes, 5)),
];

/// The extensions of the formats that are written, and their content: clouds or keypoints.
const WRITTEN: &[Written] = &[
    ("ply", Some(CloudFormat::Ply), Some(KeypointFormat::Ply)),
    ("pcd", Some(CloudFormat::Pcd), Some(KeypointFormat::Pcd)),
    ("npy", Some(CloudFormat::Npy), Some(KeypointFormat::Npy)),
    ("xyz", Some(CloudFormat::Xyz), None),
    ("csv", Some(CloudFormat::Csv), Some(KeypointFormat::Csv)),
    ("keypointnet.json", None, Some(KeypointFormat::KeypointNet)),
    ("json", None, Some(KeypointFormat::Json)),
    ("laz", None, Some(KeypointFormat::Laz)),
];

/// The extensions that [`PointFormat::from_path`] accepts.
pub static POINT_EXTENSIONS: Extensions =
    LazyLock::new(|| FORMATS.iter().flat_map(|format| format.extensions).copied().collect());
/// The extensions that [`CloudFormat::from_path`] accepts.
pub static CLOUD_EXTENSIONS: Extensions = LazyLock::new(|| written(|(_, cloud, _)| cloud.is_some()));
/// The extensions that [`KeypointFormat::from_path`] accepts.
pub static KEYPOINT_EXTENSIONS: Extensions = LazyLock::new(|| written(|(.., keypoints)| keypoints.is_some()));

type Extensions = LazyLock<Vec<&'static str>>;
type Written = (&'static str, Option<CloudFormat>, Option<KeypointFormat>);

fn written(is_wanted: impl Fn(&&Written) -> bool) -> Vec<&'static str> {
    WRITTEN.iter().filter(is_wanted).map(|(extension, ..)| *extension).collect()
}

/// The format of a file to write, by the first extension with which its name ends.
fn written_format<F>(path: &Path, extensions: &[&str], format: impl Fn(&Written) -> Option<F>) -> Result<F> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let is_own = |extension: &str| {
        name.strip_suffix(extension).and_then(|stem| stem.strip_suffix('.')).is_some_and(|stem| !stem.is_empty())
    };
    let mut formats = WRITTEN.iter().filter(|(extension, ..)| is_own(extension)).filter_map(format);
    formats.next().ok_or_else(|| unknown_extension(path, "written", extensions))
}

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

/// Maximum number of float32 values per point of a sweep.
const MAX_SWEEP_VALUES: u8 = 64;

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
            None => unknown_extension(path, "read", &POINT_EXTENSIONS),
        })
    }

    /// The format for an extension in lower case without a dot, or for one of the names `kitti`, `nuscenes` and `kitti:5`. The names are
    /// sweeps of 4, 5 and the stated number of float32 values per point. A stated number is not checked against the content.
    pub fn from_extension(extension: &str) -> Option<Self> {
        let is_own = |format: &&Format| match format.extensions {
            [] => format.name.eq_ignore_ascii_case(extension),
            extensions => extensions.contains(&extension),
        };
        FORMATS.iter().find(is_own).map(|format| format.format).or_else(|| {
            let values = extension.strip_prefix("kitti:")?.parse().ok()?;
            (3..=MAX_SWEEP_VALUES).contains(&values).then_some(Self::Sweep(values))
        })
    }

    /// The format of a file by its signature. Columns of text, OBJ and binary STL have no signature.
    pub fn from_content(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let is_own = |format: &&Format| format.signatures.iter().any(|signature| bytes.starts_with(signature));
        FORMATS.iter().find(is_own).map(|format| format.format)
    }

    /// The name of the format in messages.
    pub fn name(self) -> &'static str {
        self.row().map_or("sweep", |format| format.name)
    }

    /// Reads the points of a file, from the columns in the options, and the faces if they are to be sampled.
    pub(crate) fn read(self, bytes: &[u8], options: &ReadOptions) -> std::result::Result<Shape, String> {
        if options.columns.is_some() && !matches!(self, Self::Text | Self::Pts | Self::Npy | Self::Npz) {
            return Err(
                "columns can be chosen in text and in arrays of NumPy; this format names its coordinates".into()
            );
        }
        match (self.row(), self) {
            (Some(format), _) => (format.read)(bytes, options),
            (None, Self::Sweep(values)) => sweep::read(bytes, values.into()),
            _ => Err("not a format of the table".into()),
        }
    }

    fn row(self) -> Option<&'static Format> {
        FORMATS.iter().find(|format| format.format == self)
    }
}

/// A format in which keypoints are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum KeypointFormat {
    /// Binary PLY vertices with colour (by saliency), saliency, occupancy, nearest index, confidence and deviation.
    Ply,
    /// Binary PCD points with the same fields.
    Pcd,
    /// An array `(K, 8)` of `<f8`: x, y, z, saliency, occupancy, nearest_index, confidence and deviation. The confidence is NaN if it is
    /// unknown. The deviation is the largest standard deviation of the position, infinite if the points leave a direction open.
    Npy,
    /// The same columns as text.
    Csv,
    /// The JSON object `{"keypoints": [{"x": .., ..}, ..]}`.
    Json,
    /// KeypointNet annotations: a list with one shape and its keypoints.
    KeypointNet,
    /// LAZ with saliency, occupancy, nearest index and confidence as extra dimensions.
    Laz,
}

impl KeypointFormat {
    /// The format of a file by its extension, in upper or lower case.
    ///
    /// # Errors
    /// [`Error::Format`] when the extension is not among [`KEYPOINT_EXTENSIONS`].
    pub fn from_path(path: &Path) -> Result<Self> {
        if extension(path) == "parquet" {
            let reason = "Parquet is not written; write .csv, which GeoPandas converts: t = pandas.read_csv('FILE.csv'); \
                          geopandas.GeoDataFrame(t, geometry=geopandas.points_from_xy(t.x, t.y, t.z)).to_parquet('FILE')";
            return Err(Error::Format { path: path.into(), reason: reason.into() });
        }
        written_format(path, &KEYPOINT_EXTENSIONS, |(.., format)| *format)
    }

    /// The extension of files in this format.
    pub fn extension(self) -> &'static str {
        WRITTEN.iter().find(|(.., format)| *format == Some(self)).map_or("", |(extension, ..)| *extension)
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

impl CloudFormat {
    /// The format of a file by its extension, in upper or lower case.
    ///
    /// # Errors
    /// [`Error::Format`] when the extension is not among [`CLOUD_EXTENSIONS`].
    pub fn from_path(path: &Path) -> Result<Self> {
        written_format(path, &CLOUD_EXTENSIONS, |(_, format, _)| *format)
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
        let reason = "a .bin file does not say how many values a point has; give `format` kitti (4 values), \
                      nuscenes (5 values) or for example kitti:6 (6 values), or put it in a folder `velodyne` or `LIDAR_TOP`";
        Err(Error::Format { path: path.into(), reason: reason.into() })
    }
}

/// The command that converts a ROS 2 bag in SQLite files.
pub(crate) const CONVERT_BAG: &str =
    "ros2 bag convert -i FOLDER -o OPTIONS.yaml with output_bags: [{uri: drive, storage_id: mcap, all: true}]";

/// A command that converts a file whose format is not read.
fn conversion(extension: &str) -> Option<String> {
    let command = match extension {
        "bag" => "convert the ROS 1 bag: mcap convert FILE.bag FILE.mcap",
        "db3" => return Some(format!("convert the bag: {CONVERT_BAG}")),
        "zstd" | "zst" => "decompress it: zstd -d FILE",
        "gz" => "decompress it: gunzip --keep FILE",
        "bz2" => "decompress it: bunzip2 --keep FILE",
        "xz" => "decompress it: unxz --keep FILE",
        "zip" => "unpack it: unzip FILE",
        "mcap" => "it is a recording, which `read_recording` and `snake-cli detect` read",
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
    };
    Some(command.into())
}

pub(crate) fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

pub(crate) fn unknown_extension(path: &Path, verb: &str, extensions: &[&str]) -> Error {
    let reason = match verb {
        "read" => "unknown extension, and `format` is not given",
        _ => "unknown extension",
    };
    let reason = format!("{reason}; files that can be {verb}: .{}", extensions.join(", ."));
    Error::Format { path: path.into(), reason }
}
