//! Readers and writers with any input: the stored corpus of the fuzz targets, arbitrary bytes, damaged files, and files
//! that were written and read back.

use std::io::Read;
use std::path::{Path, PathBuf};

use proptest::collection::vec;
use proptest::num::f32::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
use proptest::prelude::*;
use proptest::sample::{Index, select};
use serde_json::Value;
use snake_core::{Covariance, Keypoint, Point, RigidTransform};
use snake_io::{self as io, Cloud, KeypointSource, PointFormat, ReadOptions};

/// An allocator that also counts the memory in use.
mod checks;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = folder.read_dir().unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn the_stored_corpus_is_read_or_refused() {
    let archive = std::fs::File::open(root().join("fuzz/corpus.zip")).unwrap();
    let mut archive = zip::ZipArchive::new(archive).unwrap();
    assert!(archive.len() > 1000);
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        match entry.name().unwrap().split_once('/').unwrap().0 {
            "weights" => checks::load_model(&bytes),
            "text" => checks::read_cloud(&bytes, PointFormat::Text),
            target => checks::read_cloud(&bytes, PointFormat::from_extension(target).unwrap()),
        }
    }
}

/// A kind of damage to a file.
#[derive(Debug, Clone)]
enum Edit {
    Insert(Index, Vec<u8>),
    Overwrite(Index, Vec<u8>),
    Remove(Index, Index),
    Repeat(Index, Index),
    Cut(Index),
}

impl Edit {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let place = |index: &Index| index.index(bytes.len() + 1);
        let range = |a: &Index, b: &Index| place(a).min(place(b))..place(a).max(place(b));
        match self {
            Self::Insert(at, piece) => drop(bytes.splice(place(at)..place(at), piece.iter().copied())),
            Self::Overwrite(at, piece) => {
                let end = (place(at) + piece.len()).min(bytes.len());
                drop(bytes.splice(place(at)..end, piece.iter().copied()));
            }
            Self::Remove(a, b) => drop(bytes.drain(range(a, b))),
            Self::Repeat(a, b) => bytes.extend_from_within(range(a, b)),
            Self::Cut(at) => bytes.truncate(place(at)),
        }
    }
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    const WORDS: &[&str] =
        &["nan", "-1", "0", "1e999", "1000000000000", "4294967295", "\r\n", " ", "x", "\u{fc}", "\0\0\0\0"];
    let word = select(WORDS).prop_map(|word| word.as_bytes().to_vec());
    let piece = prop_oneof![word, Just(vec![0xff; 4]), vec(any::<u8>(), 1..9)].boxed();
    let two = || (any::<Index>(), any::<Index>());
    let edit = prop_oneof![
        2 => (any::<Index>(), piece.clone()).prop_map(|(at, piece)| Edit::Insert(at, piece)),
        4 => (any::<Index>(), piece).prop_map(|(at, piece)| Edit::Overwrite(at, piece)),
        1 => two().prop_map(|(a, b)| Edit::Remove(a, b)),
        1 => two().prop_map(|(a, b)| Edit::Repeat(a, b)),
        1 => any::<Index>().prop_map(Edit::Cut),
    ];
    vec(edit, 1..6)
}

/// Coordinates that a file can hold: all finite numbers.
fn coordinate() -> impl Strategy<Value = f32> {
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
}

fn points() -> impl Strategy<Value = Vec<Point>> {
    let places = [coordinate().boxed(), (-100_i16..100).prop_map(f32::from).boxed()];
    places
        .map(|axis| vec([axis.clone(), axis.clone(), axis], 0..30))
        .into_iter()
        .fold(Just(vec![]).boxed(), |all, one| prop_oneof![all, one].boxed())
}

/// Whether two clouds are equal up to the digits that an origin costs.
fn assert_same(expected: &[Point], cloud: Cloud) {
    let exact = cloud.origin == [0.0; 3];
    let read = cloud.into_points();
    assert_eq!(read.len(), expected.len());
    let largest = |points: &[Point]| points.as_flattened().iter().fold(0.0, |m: f32, v| m.max(v.abs()));
    for (a, b) in expected.as_flattened().iter().zip(read.as_flattened()) {
        assert!(a == b || !exact && (a - b).abs() <= 1e-6 * largest(expected), "{a} {b}");
    }
}

/// `make test-full` tries more inputs.
fn num_cases() -> u32 {
    if std::env::var_os("SNAKE_FULL").is_some() { 2000 } else { 400 }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: num_cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_clouds_and_any_bytes_after_any_beginning_are_read_or_refused(
        file in any::<Index>(), edits in edits(), length in any::<Index>(), rest in vec(any::<u8>(), 0..300),
    ) {
        let paths = files(&root().join("tests/data/io/good"));
        let path = &paths[file.index(paths.len())];
        let (mut bytes, format) = (std::fs::read(path).unwrap(), PointFormat::from_path(path).unwrap());
        checks::read_cloud(&[&bytes[..length.index(bytes.len())], &rest].concat(), format);
        checks::read_cloud(&rest, format);
        edits.iter().for_each(|edit| edit.apply(&mut bytes));
        checks::read_cloud(&bytes, format);
    }

    #[test]
    fn any_shape_of_an_array_is_read_or_refused(
        lengths in vec(prop_oneof![0_u64..9, any::<u64>()], 0..5), item in "[<|>][fiu][0-9]", data in vec(any::<u8>(), 0..900),
    ) {
        let lengths: Vec<String> = lengths.iter().map(u64::to_string).collect();
        let header = format!("{{'descr': '{item}', 'fortran_order': False, 'shape': ({}), }}\n", lengths.join(", "));
        let bytes = [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &data].concat();
        checks::read_cloud(&bytes, PointFormat::Npy);
    }

    #[test]
    fn damaged_weights_are_loaded_or_refused(edits in edits()) {
        let mut bytes = std::fs::read(root().join("tests/data/hostile/good.safetensors")).unwrap();
        edits.iter().for_each(|edit| edit.apply(&mut bytes));
        checks::load_model(&bytes);
    }

    #[test]
    fn any_metadata_is_loaded_or_refused(key in any::<Index>(), value in prop_oneof![
        select(vec!["0", "1", "2", "3", "-1", "1e9", "nan", "inf", "[2, 3, 5]", "[512, 512, 512]", "[]", "{}", "\u{1b}"])
            .prop_map(String::from),
        any::<String>(),
    ]) {
        let good = std::fs::read(root().join("tests/data/hostile/good.safetensors")).unwrap();
        let (length, rest) = good.split_first_chunk().unwrap();
        let (header, data) = rest.split_at(u64::from_le_bytes(*length) as usize);
        let mut header: Value = serde_json::from_slice(header).unwrap();
        let metadata = header["__metadata__"].as_object_mut().unwrap();
        metadata.insert("recommended_options".into(), "{}".into());
        let key = metadata.keys().nth(key.index(metadata.len())).unwrap().clone();
        metadata.insert(key, value.into());
        let header = serde_json::to_vec(&header).unwrap();
        checks::load_model(&[&(header.len() as u64).to_le_bytes(), &header[..], data].concat());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn written_clouds_read_back(points in points()) {
        let _alone = checks::alone();
        let folder = tempfile::tempdir().unwrap();
        for extension in io::CLOUD_EXTENSIONS.iter() {
            let path = folder.path().join("cloud").with_extension(extension);
            io::write_points(&path, &points, [0.0; 3]).unwrap();
            assert_same(&points, io::read_cloud(&path, &ReadOptions::default()).unwrap());
        }
    }

    #[test]
    fn written_keypoints_read_back(
        points in points(), saliency in 0_f32..1.0, occupancy in 0_f32..1.0, nearest_index in 0..1_usize << 31,
    ) {
        let (confidence, covariance) = (None, Covariance::UNKNOWN);
        let keypoint =
            |&position: &Point| Keypoint { position, saliency, occupancy, nearest_index, confidence, covariance };
        let keypoints: Vec<Keypoint> = points.iter().map(keypoint).collect();
        let _alone = checks::alone();
        let folder = tempfile::tempdir().unwrap();
        // LAZ rounds, and has tests of its own.
        for extension in io::KEYPOINT_EXTENSIONS.iter().filter(|extension| **extension != "laz") {
            let path = folder.path().join(format!("keypoints.{extension}"));
            io::write_keypoints(&path, &keypoints, &KeypointSource::new(&path, [0.0; 3])).unwrap();
            if PointFormat::from_path(&path).is_ok() {
                assert_same(&points, io::read_cloud(&path, &ReadOptions::default()).unwrap());
                continue;
            }
            let value: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
            let listed = value.get("keypoints").or(value[0].get("keypoints")).unwrap().as_array().unwrap();
            prop_assert_eq!(listed.len(), points.len());
            for (object, position) in listed.iter().zip(&points).filter(|(object, _)| object.get("x").is_some()) {
                let read = ["x", "y", "z"].map(|axis| object[axis].as_f64().unwrap() as f32);
                prop_assert_eq!(&read, position);
                prop_assert_eq!(object["saliency"].as_f64().unwrap() as f32, saliency);
                prop_assert_eq!(object["nearest_index"].as_u64().unwrap() as usize, nearest_index);
            }
        }
    }

    #[test]
    fn written_registrations_read_back(angle in -4.0..4.0_f64, translation in prop::array::uniform3(-1e300..1e300)) {
        let ((sin, cos), [x, y, z]) = (angle.sin_cos(), translation);
        let rows = [[cos, -sin, 0.0, x], [sin, cos, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]];
        let t_target_source = RigidTransform::from_matrix(rows).unwrap();
        let record = serde_json::json!({ "t_target_source": t_target_source });
        let folder = tempfile::tempdir().unwrap();
        let (json, text) = (folder.path().join("a.json"), folder.path().join("a.txt"));
        io::write_registration(&json, &t_target_source, &record).unwrap();
        io::write_registration(&text, &t_target_source, &record).unwrap();
        prop_assert_eq!(io::read_transform(&json).unwrap(), t_target_source);
        prop_assert_eq!(io::read_transform(&text).unwrap(), t_target_source);
    }
}
