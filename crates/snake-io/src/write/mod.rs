//! Converts keypoints and clouds to the columns of a file.

pub(crate) mod json;
pub(crate) mod keypoint_source;
mod laz;
pub(crate) mod mesh;
mod ply;
mod rows;

use std::io::{self, Write};
use std::path::Path;

use crate::formats::{CloudFormat, KeypointFormat, extension};
use crate::table::scalar::{Column, Scalar};
use crate::write::keypoint_source::KeypointSource;
use crate::write::rows::Rows;
use crate::{Attributes, Error, Result, write_atomically};
use snake_geometry::{Keypoint, Point, add_origin};

impl KeypointFormat {
    /// Writes keypoints and adds the origin, except in PCD, whose coordinates have four bytes.
    ///
    /// # Errors
    /// The errors of `out`; for PLY and PCD, also an index that does not fit into their integers.
    pub fn write(self, out: &mut dyn Write, keypoints: &[Keypoint], source: &KeypointSource) -> io::Result<()> {
        let (origin, colors) = match self {
            Self::Ply => (Some(source.origin), &COLORS[..]),
            Self::Pcd => (None, &PACKED[..]),
            _ => (Some(source.origin), &[][..]),
        };
        let row = |keypoint: &Keypoint| {
            let &Keypoint { position, saliency, occupancy, nearest_index, confidence, covariance } = keypoint;
            let mut row = with_origin(position, origin).to_vec();
            row.extend(color_values(colors, color(saliency)));
            row.extend([
                saliency.into(),
                occupancy.into(),
                nearest_index as f64,
                confidence.unwrap_or(f32::NAN).into(),
                covariance.deviation().into(),
            ]);
            row
        };
        let columns = [&axes(origin.unwrap_or_default())[..], colors, &VALUES].concat();
        let rows = Rows { columns, num_rows: keypoints.len(), rows: keypoints.iter().map(row) };
        match self {
            Self::Ply => rows.write_ply(out),
            Self::Pcd => rows.write_pcd(out, source.origin, None),
            Self::Npy => rows.write_npy(out),
            Self::Csv => rows.write_csv(out),
            Self::Json => json::write(out, keypoints, source.origin),
            Self::KeypointNet => json::write_keypointnet(out, keypoints, source),
            Self::Laz => laz::write(out, keypoints, source),
        }
    }
}

impl CloudFormat {
    /// Writes points `(N, 3)` with their attributes and adds the origin, except in PCD, whose coordinates have four bytes. NPY
    /// and text without a header hold only coordinates.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn write(
        self,
        out: &mut dyn Write,
        points: &[Point],
        attributes: &Attributes,
        origin: [f64; 3],
    ) -> io::Result<()> {
        let Attributes { colors, intensity, normals, viewpoint } = match self {
            Self::Npy | Self::Xyz => &Attributes::default(),
            Self::Ply | Self::Pcd | Self::Csv => attributes,
        };
        let (added, normal_names, all_colors) = match self {
            Self::Pcd => (None, ["normal_x", "normal_y", "normal_z"], &PACKED[..]),
            _ => (Some(origin), ["nx", "ny", "nz"], &COLORS[..]),
        };
        let mut columns = axes(added.unwrap_or_default()).to_vec();
        columns.extend(normals.iter().flat_map(|_| normal_names.map(|name| (name, Scalar::FLOAT))));
        columns.extend(colors.iter().flat_map(|_| all_colors));
        columns.extend(intensity.iter().map(|_| ("intensity", Scalar::FLOAT)));
        let row = |(index, &point): (usize, &Point)| {
            let mut row = with_origin(point, added).to_vec();
            row.extend(normals.iter().flat_map(|normals| normals[index].map(f64::from)));
            row.extend(colors.iter().flat_map(|colors| color_values(all_colors, colors[index])));
            row.extend(intensity.iter().map(|intensity| f64::from(intensity[index])));
            row
        };
        let rows = Rows { columns, num_rows: points.len(), rows: points.iter().enumerate().map(row) };
        match self {
            Self::Ply => rows.write_ply(out),
            Self::Pcd => rows.write_pcd(out, origin, *viewpoint),
            Self::Npy => rows.write_npy(out),
            Self::Xyz => rows.write_lines(out, " "),
            Self::Csv => rows.write_csv(out),
        }
    }
}

/// The columns of a keypoint after its position and colour.
const VALUES: [Column; 5] = [
    ("saliency", Scalar::FLOAT),
    ("occupancy", Scalar::FLOAT),
    ("nearest_index", Scalar::INT),
    ("confidence", Scalar::FLOAT),
    ("deviation", Scalar::FLOAT),
];
const COLORS: [Column; 3] = [("red", Scalar::BYTE), ("green", Scalar::BYTE), ("blue", Scalar::BYTE)];
/// A colour in the bits of a float.
const PACKED: [Column; 1] = [("rgb", Scalar::FLOAT)];

/// The values of a colour in these columns: [`COLORS`], [`PACKED`] or none.
fn color_values(columns: &[Column], color: [u8; 3]) -> Vec<f64> {
    match columns.len() {
        0 => Vec::new(),
        1 => vec![packed(color)],
        _ => color.map(f64::from).into(),
    }
}

/// The position in the file's frame.
fn with_origin(point: Point, origin: Option<[f64; 3]>) -> [f64; 3] {
    origin.map_or(point.map(f64::from), |origin| add_origin(point, origin))
}

/// A colour as PCL stores it: its bytes are the bits of a float.
fn packed([red, green, blue]: [u8; 3]) -> f64 {
    f32::from_bits(u32::from_be_bytes([0, red, green, blue])).into()
}

/// The columns of the coordinates. They have eight bytes if there is an origin.
pub(crate) fn axes(origin: [f64; 3]) -> [Column; 3] {
    let scalar = if origin == [0.0; 3] { Scalar::FLOAT } else { Scalar::DOUBLE };
    ["x", "y", "z"].map(|axis| (axis, scalar))
}

/// The colour of a saliency, from violet at 0 through green to yellow at 1 (five colours of viridis).
fn color(saliency: f32) -> [u8; 3] {
    const COLORS: [[u8; 3]; 5] = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
    let place = saliency.clamp(0.0, 1.0) * (COLORS.len() - 1) as f32;
    let low = (place as usize).min(COLORS.len() - 2);
    let share = place - low as f32;
    let mixed =
        |channel: usize| f32::from(COLORS[low][channel]) * (1.0 - share) + f32::from(COLORS[low + 1][channel]) * share;
    std::array::from_fn(|channel| mixed(channel).round() as u8)
}

/// Writes keypoints; the extension selects the format.
///
/// The file appears under its name once it is complete and replaces an earlier file of that name. Links and special
/// files are treated as by [`write_atomically`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`KEYPOINT_EXTENSIONS`](crate::KEYPOINT_EXTENSIONS); [`Error::Io`] when the file cannot be
/// written.
pub fn write_keypoints(path: &Path, keypoints: &[Keypoint], source: &KeypointSource) -> Result<()> {
    let format = KeypointFormat::from_path(path)?;
    write_atomically(path, |file| format.write(file, keypoints, source))
        .map_err(|source| Error::Io { path: path.into(), source })
}

/// Whether the writers add the origin to the coordinates in this file. Otherwise, these stay relative to the origin.
pub fn adds_origin(path: &Path) -> bool {
    !matches!(extension(path).as_str(), "pcd" | "stl")
}

/// A sentence for the user if coordinates are written relative to an origin.
pub fn origin_note(adds_origin: bool, [x, y, z]: [f64; 3]) -> Option<String> {
    (!adds_origin && [x, y, z] != [0.0; 3]).then(|| {
        format!(
            "the coordinates are relative to the origin {x} {y} {z}, because this format holds about seven digits; add the \
             origin to them, or write another format"
        )
    })
}

/// Writes points `(N, 3)` and adds the origin if [`adds_origin`]. The file is written whole or not at all, as by
/// [`write_keypoints`].
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`CLOUD_EXTENSIONS`](crate::CLOUD_EXTENSIONS); [`Error::Io`] when the file cannot be
/// written.
pub fn write_points(path: &Path, points: &[Point], origin: [f64; 3]) -> Result<()> {
    write_cloud(path, points, &Attributes::default(), origin)
}

/// [`write_points`] with the attributes of the points. PLY, PCD and CSV hold them; other formats hold only coordinates.
///
/// # Errors
/// The errors of [`write_points`]; [`Error::Input`] when the number of an attribute's values is not the number of points.
pub fn write_cloud(path: &Path, points: &[Point], attributes: &Attributes, origin: [f64; 3]) -> Result<()> {
    let format = CloudFormat::from_path(path)?;
    if let Some(number) = attributes.numbers().find(|number| *number != points.len()) {
        let reason = format!("{number} values for {} points", points.len());
        return Err(Error::Input { what: "attributes", reason });
    }
    write_atomically(path, |file| format.write(file, points, attributes, origin))
        .map_err(|source| Error::Io { path: path.into(), source })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::KEYPOINTS;

    fn written(format: KeypointFormat, origin: [f64; 3]) -> Vec<u8> {
        let mut bytes = Vec::new();
        format.write(&mut bytes, &KEYPOINTS, &KeypointSource { origin, ..Default::default() }).unwrap();
        bytes
    }

    #[test]
    fn text_is_short_and_exact() {
        let text = String::from_utf8(written(KeypointFormat::Csv, [0.0; 3])).unwrap();
        let expected = "x,y,z,saliency,occupancy,nearest_index,confidence,deviation\n0.1,-2.5,0.0000003,0.75,0.5,7,0.5,inf\n4,5,10000000,0.3,1,16777217,0.25,inf\n";
        assert_eq!(text, expected);
        let far = String::from_utf8(written(KeypointFormat::Csv, [5e6, 0.0, 0.0])).unwrap();
        assert!(far.contains("\n5000004,5,10000000,0.3,1,16777217,0.25,inf\n") && far.contains("\n5000000.1"), "{far}");
    }

    #[test]
    fn arrays_are_exact_and_aligned() {
        let bytes = written(KeypointFormat::Npy, [0.0; 3]);
        let data = &bytes[bytes.len() - 128..];
        assert_eq!((bytes.len() - data.len()) % 64, 0);
        assert_eq!(data[..8], f64::from(0.1_f32).to_le_bytes());
        assert_eq!(data[104..112], 16_777_217_f64.to_le_bytes());
    }

    #[test]
    fn colors_follow_saliency() {
        assert_eq!(
            [0.0, 0.5, 1.0, f32::NAN, 7.0].map(color),
            [[68, 1, 84], [33, 145, 140], [253, 231, 37], [0; 3], [253, 231, 37]]
        );
        assert_eq!(color(0.75), [94, 201, 98]);
        let bytes = written(KeypointFormat::Pcd, [0.0; 3]);
        let text = String::from_utf8_lossy(&bytes);
        assert!(
            text.contains(
                "FIELDS x y z rgb saliency occupancy nearest_index confidence deviation\nSIZE 4 4 4 4 4 4 4 4 4\nTYPE F F F F F F I F F\n"
            ),
            "{text}"
        );
        // In little-endian order blue comes first.
        assert_eq!(bytes[bytes.len() - 72..][12..16], [98, 201, 94, 0]);
    }
}
