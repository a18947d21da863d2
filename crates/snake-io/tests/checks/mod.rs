//! What must hold of every input, whatever its bytes: no panic, no more memory and no more results than the input's size
//! accounts for, and what was read can be used.
//!
//! `cargo test` runs the same over the stored corpus and over damaged files (`tests/any_input.rs`).

use std::sync::{Mutex, MutexGuard, PoisonError};

use peak_alloc::PeakAlloc;
use snake_core::{EncodeOptions, Model, NormalizationMethod, Point};
use snake_io::{Cloud, PointFormat, ReadOptions, parse_cloud};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Reads a cloud, and draws points from the surface where the format can have one.
pub fn read_cloud(bytes: &[u8], format: PointFormat) {
    let most = expansion(format) * bytes.len();
    let read = |sample, columns: Option<&str>| {
        let columns = columns.map(|columns| columns.parse().expect("names of columns"));
        in_proportion(most, || {
            parse_cloud(bytes, format, &ReadOptions::default().with_sample(sample).with_columns(columns))
        })
    };
    if let Ok(Cloud { points, origin }) = read(None, None) {
        assert!(points.len() <= most && origin.iter().all(|v| v.is_finite()));
    }
    for columns in ["x,y,z", "2,x,9"] {
        if let Ok(Cloud { points, .. }) = read(None, Some(columns)) {
            assert!(points.len() <= most);
        }
    }
    let is_mesh =
        matches!(format, PointFormat::Ply | PointFormat::Obj | PointFormat::Off | PointFormat::Stl | PointFormat::Gltf);
    if let Some(Ok(Cloud { points, .. })) = is_mesh.then(|| read(Some(5), None)) {
        assert_eq!(points.len(), 5);
    }
}

/// Loads a network, and if it is a small one detects keypoints with it.
pub fn load_model(bytes: &[u8]) {
    let Ok(model) = in_proportion(64 * bytes.len(), || Model::from_bytes(bytes)) else { return };
    if model.config().frame().is_some_and(|frame| frame.resolution.iter().product::<usize>() > 4096) {
        return;
    }
    let _alone = alone();
    let points: Vec<Point> = (0..40).map(|i| [i, i * i % 7, i % 5].map(|v| v as f32 * 0.02 - 0.4)).collect();
    let encode = EncodeOptions::default().with_normalization(NormalizationMethod::None);
    let Ok(field) = model.encode(&points, &encode) else { return };
    let options = model.recommended().detect.with_query_resolution(4).with_nms_radius(Some(0.1.into()));
    let options = options.with_refine_steps(options.refine_steps.min(3));
    let detection = field.detect(&options).expect("the options were checked when the model was loaded");
    assert!(detection.keypoints.iter().all(|k| k.position.iter().chain([&k.saliency]).all(|v| v.is_finite())));
}

/// Bytes of memory that a byte of a file may take. A point takes some 60 while it is read, and at least 3 of its file.
fn expansion(format: PointFormat) -> usize {
    match format {
        // Packed bytes stand for up to 50 (zip, LAZ) or 88 (LZF).
        PointFormat::Npz | PointFormat::Las | PointFormat::Pcd | PointFormat::E57 => 2000,
        // The JSON of a scene takes some hundreds of bytes for an entry of a few.
        PointFormat::Gltf => 1000,
        _ => 64,
    }
}

/// No other memory is measured while this is held. Whoever takes much of it holds it.
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs what may take `most` bytes at a time, and some for the tables of a decoder.
fn in_proportion<T>(most: usize, run: impl FnOnce() -> T) -> T {
    let _alone = alone();
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    let result = run();
    let peak = MEMORY.peak_usage().saturating_sub(before);
    assert!(peak <= most + (4 << 20), "{peak} bytes where {most} are in proportion");
    result
}
