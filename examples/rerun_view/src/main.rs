//! A cloud with its keypoints in the viewer of Rerun: `cargo run --release -- scan.ply keypoints.rrd`, then
//! `rerun keypoints.rrd`.

use std::error::Error;
use std::path::Path;

use rerun::{Points3D, RecordingStreamBuilder};
use snake_core::{Builtin, Model};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output] = &arguments[..] else { return Err("give the cloud to read and the recording to write".into()) };
    let points = snake_io::read_points(Path::new(input))?;
    let model = Model::builtin(Builtin::Compact);
    let detection = model.detect(&points, model.recommended())?;

    let recording = RecordingStreamBuilder::new("snake_rs").save(output)?;
    recording.log("points", &Points3D::new(points))?;
    let positions = detection.keypoints.iter().map(|keypoint| keypoint.position);
    let labels = detection.keypoints.iter().map(|keypoint| format!("{:.2}", keypoint.saliency));
    let red = rerun::Color::from_rgb(230, 40, 40);
    recording.log("points/keypoints", &Points3D::new(positions).with_labels(labels).with_colors([red]))?;
    recording.flush_blocking()?;
    Ok(())
}
