//! The model that suits a cloud, with options by name: `cargo run --release --example choose -- cloud.f32 '{"rotations": 4}'`.
//! The file has x, y and z of each point as float32; without one the cloud is made here. The result is one JSON object.

use std::error::Error;

use serde_json::{Map, Value, json};
use snake_core::{Chooser, Control, Point};

/// The floor and two walls of a room.
fn room() -> Vec<Point> {
    let at = |i: u16, step: f32| (f32::from(i) * step).fract();
    let point = |i: u16| match i % 3 {
        0 => [4.0 * at(i, 0.618_034), 3.0 * at(i, 0.754_878), 0.0],
        1 => [4.0 * at(i, 0.618_034), 0.0, 2.4 * at(i, 0.569_84)],
        _ => [0.0, 3.0 * at(i, 0.754_878), 2.4 * at(i, 0.569_84)],
    };
    (0..9000).map(point).collect()
}

fn read(path: &str) -> std::io::Result<Vec<Point>> {
    let bytes = std::fs::read(path)?;
    let values: Vec<f32> = bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    Ok(values.as_chunks().0.to_vec())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let points = arguments.next().map_or_else(|| Ok(room()), |path| read(&path))?;
    let values: Map<String, Value> = arguments.next().map_or(Ok(Map::new()), |text| serde_json::from_str(&text))?;

    let chooser = Chooser::default().with_values(&values)?;
    let chosen = chooser.for_points(&points)?;
    let detection = chosen.detect(&Control::default())?;
    let note = detection.note(&chosen.options.detect);
    let notes: Vec<String> = chosen.notes().into_iter().chain(note).collect();

    let (keypoints, voxel_size) = (&detection.keypoints, detection.voxel_size);
    println!("{}", json!({ "model": chosen.name, "voxel_size": voxel_size, "notes": notes, "keypoints": keypoints }));
    Ok(())
}
