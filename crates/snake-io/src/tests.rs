//! Tests across the formats.

use std::path::{Path, PathBuf};

use snake_geometry::{Covariance, Keypoint, Point};

use super::*;
use crate::table::shape::Shape;

pub(crate) const KEYPOINTS: [Keypoint; 2] = [
    Keypoint {
        position: [0.1, -2.5, 3e-7],
        saliency: 0.75,
        occupancy: 0.5,
        nearest_index: 7,
        confidence: Some(0.5),
        covariance: Covariance::UNKNOWN,
    },
    Keypoint {
        position: [4.0, 5.0, 1.0e7],
        saliency: 0.3,
        occupancy: 1.0,
        nearest_index: 16_777_217,
        confidence: Some(0.25),
        covariance: Covariance::UNKNOWN,
    },
];

/// The four points that every file in `good` and `velodyne` holds.
const CLOUD: [Point; 4] = [[0.0, 0.0, 0.0], [1.0, -2.0, 0.5], [-0.25, 3.0, 100.0], [0.125, 1e-3, -7.0]];

/// The points of a shape as `read_points` returns them.
pub(crate) fn points(shape: std::result::Result<Shape, String>) -> std::result::Result<Vec<Point>, String> {
    Ok(shape?.into_cloud().into_points())
}

fn good_files() -> Vec<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/io"));
    let files = |name| folder.join(name).read_dir().unwrap().map(|entry| entry.unwrap().path());
    let mut paths: Vec<_> = files("good").chain(files("velodyne")).collect();
    paths.sort();
    paths
}

#[test]
fn good_files_hold_the_cloud() {
    let paths = good_files();
    for extension in POINT_EXTENSIONS.iter() {
        assert!(paths.iter().any(|path| super::formats::extension(path) == *extension), "no sample of .{extension}");
    }
    for path in paths {
        assert_eq!(read_points(&path).unwrap(), CLOUD, "{}", path.display());
        let mut positions = Vec::new();
        for_each_position(&path, &ReadOptions::default(), &mut |position| positions.push(position)).unwrap();
        assert_eq!(positions.iter().map(|p| p.map(|v| v as f32)).collect::<Vec<_>>(), CLOUD, "{}", path.display());
    }
}

#[test]
fn meshes_can_be_sampled_and_contents_are_recognised() {
    for path in good_files() {
        let (format, bytes) = (PointFormat::from_path(&path).unwrap(), std::fs::read(&path).unwrap());
        let options = ReadOptions { sample: Some(50), seed: 1, ..ReadOptions::default() };
        // This is the only one of the PLY files that has faces.
        let is_mesh = matches!(format, PointFormat::Obj | PointFormat::Off | PointFormat::Stl | PointFormat::Gltf)
            || path.file_name().unwrap() == "ascii.ply";
        match parse_cloud(&bytes, format, &options) {
            Ok(cloud) => assert!(is_mesh && cloud.points.len() == 50, "{}", path.display()),
            Err(error) => assert!(!is_mesh && error.to_string().contains("no faces"), "{error}"),
        }
        let contents = parse_contents(&bytes, format, &ReadOptions::default()).unwrap();
        assert_eq!(contents.notes.iter().any(|note| note.starts_with("a mesh of")), is_mesh, "{}", path.display());
        let has_signature = path.extension().unwrap() != "gltf"
            && path.file_name().unwrap() != "binary.stl"
            && !matches!(
                format,
                PointFormat::Text | PointFormat::Pts | PointFormat::Obj | PointFormat::Kitti | PointFormat::Nuscenes
            );
        // PCD and OFF files can begin with comments; these files have none.
        assert_eq!(PointFormat::from_content(&bytes), has_signature.then_some(format), "{}", path.display());
    }
}

#[test]
fn clouds_far_away_read_back_to_the_last_digit() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = Cloud { points: CLOUD.to_vec(), origin: [524_288.0, 5_400_000.0, 128.0] };
    for extension in CLOUD_EXTENSIONS.iter() {
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
    }
}

#[test]
fn columns_are_chosen_only_where_there_are_columns() {
    let options = ReadOptions { columns: Some("2,1,3".parse().unwrap()), ..Default::default() };
    for path in good_files() {
        let format = PointFormat::from_path(&path).unwrap();
        let has_columns = matches!(format, PointFormat::Text | PointFormat::Pts | PointFormat::Npy | PointFormat::Npz);
        match read_cloud(&path, &options) {
            Ok(cloud) => assert!(has_columns && cloud.points.len() == 4, "{}", path.display()),
            Err(error) => assert!(!has_columns && error.to_string().contains("columns can be chosen"), "{error}"),
        }
    }
}

#[test]
fn unknown_extensions_are_refused_with_the_list() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.doc", "a", ".ply"] {
        let path = folder.path().join(name);
        std::fs::write(&path, "").unwrap();
        let error = read_points(&path).unwrap_err().to_string();
        assert!(error.contains(".ply, .pcd"), "{error}");
        assert!(KeypointFormat::from_path(Path::new(name)).unwrap_err().to_string().contains(".json"));
        assert!(check_registration_path(Path::new(name)).unwrap_err().to_string().contains(".txt"));
        assert!(check_mesh_path(Path::new(name)).unwrap_err().to_string().contains(".ply, .obj, .stl"));
        assert!(CloudFormat::from_path(Path::new(name)).unwrap_err().to_string().contains(".ply"));
    }
    for extension in KEYPOINT_EXTENSIONS.iter() {
        let format = KeypointFormat::from_path(&Path::new("a").with_extension(extension)).unwrap();
        assert_eq!(format.extension(), *extension);
    }
    assert!(matches!(read_points(Path::new("/nowhere/a.PLY")), Err(Error::Io { .. })));
}

/// A LAS file with a further record of the user `LASF_Projection`.
fn with_record(number: u16, data: &[u8]) -> Vec<u8> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/io/good/format_2.las");
    let mut bytes = std::fs::read(path).unwrap();
    let mut record = [0; 54].to_vec();
    record[2..17].copy_from_slice(b"LASF_Projection");
    record[18..20].copy_from_slice(&number.to_le_bytes());
    record[20..22].copy_from_slice(&(data.len() as u16).to_le_bytes());
    record.extend(data);
    let header = u16::from_le_bytes([bytes[94], bytes[95]]) as usize;
    let begins = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) + record.len() as u32;
    bytes[96..100].copy_from_slice(&begins.to_le_bytes());
    bytes[100] += 1;
    bytes.splice(header..header, record);
    bytes
}

#[test]
fn laser_scans_in_degrees_are_refused_with_what_to_do() {
    let keys = |kind: u16, key: u16, code: u16| -> Vec<u8> {
        [1, 1, 0, 2, 1024, 0, 1, kind, key, 0, 1, code].iter().flat_map(|n: &u16| n.to_le_bytes()).collect()
    };
    let read = |bytes: Vec<u8>| parse_cloud(&bytes, PointFormat::Las, &ReadOptions::default());
    for degrees in [with_record(34735, &keys(2, 2048, 4326)), with_record(2112, b"GEOGCS[\"WGS 84\"]")] {
        let error = read(degrees).unwrap_err().to_string();
        assert!(error.contains("degrees are no lengths; project it to metres"), "{error}");
    }
    assert_eq!(read(with_record(34735, &keys(1, 3072, 25832))).unwrap().points, CLOUD);
}

#[cfg(unix)]
#[test]
fn pipes_and_files_without_an_extension_are_read_by_their_content() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(good_files().into_iter().find(|path| path.ends_with("ascii.ply")).unwrap()).unwrap();
    let [plain, pipe, text] = ["plain", "pipe.data", "text"].map(|name| folder.path().join(name));
    std::fs::write(&plain, &bytes).unwrap();
    std::fs::write(&text, "1 2 3\n").unwrap();
    assert_eq!(read_points(&plain).unwrap(), CLOUD);
    let reason = read_points(&text).unwrap_err().to_string();
    assert!(reason.contains("`format` is not given; files that can be read: .ply"), "{reason}");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::thread::scope(|scope| {
        scope.spawn(|| std::fs::write(&pipe, &bytes).unwrap());
        assert_eq!(read_points(&pipe).unwrap(), CLOUD);
        // It can be read only once, so that its attributes are not known.
        assert_eq!(read_attributes(&pipe, None, 4).unwrap(), Attributes::default());
    });
}
