//! Keypoints of a made drive as tracks, beside those of ISS. Make sweeps with
//! `python -m snake_training.make drives -o DRIVES --sweeps 11 --step 1`, then run
//! `cargo run --release -p snake-registration --example tracks -- DRIVES`.

use std::collections::BTreeMap;
use std::path::Path;

use snake_core::{Builtin, Covariance, Keypoint, Model, Point, RigidTransform, Tracker, TrackerOptions};
use snake_detectors::{IssOptions, iss};

/// Maximum distance between a keypoint and its track, in metres; a keypoint is at the same place
/// within half of it.
const MAX_DISTANCE: f64 = 1.0;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A keypoint's id and its position in the frame of the first sweep.
type Tracked = (u64, Point);

/// The sweeps of a drive, with the transforms from each sweep's frame to that of the first.
type Drive = Vec<(Vec<Point>, RigidTransform)>;

fn main() -> Result<()> {
    let folder =
        std::env::args().nth(1).ok_or("usage: tracks DRIVES, a folder that snake_training.make drives wrote")?;
    let (mut shares, drives) = ([0.0; 2], drives(Path::new(&folder))?);
    for (name, drive) in &drives {
        let field = field_tracks(drive)?;
        let count = field[0].len();
        for ((method, frames), sum) in
            [("scenes", field), ("ISS", iss_tracks(drive, count)?)].into_iter().zip(&mut shares)
        {
            let share = kept(&frames);
            println!("{name}: {:3.0} % of the ids of {method} are kept over {} sweeps", 100.0 * share, drive.len() - 1);
            *sum += share / drives.len() as f64;
        }
    }
    println!("mean: scenes {:.2}, ISS {:.2}", shares[0], shares[1]);
    Ok(())
}

/// The drives of a folder by name. Row i of `pairs.json` maps sweep i + 1 of its drive to sweep i.
fn drives(folder: &Path) -> Result<BTreeMap<String, Drive>> {
    #[derive(serde::Deserialize)]
    struct Pair {
        source: String,
        target: String,
        #[serde(rename = "T")]
        transform: [[f64; 4]; 4],
    }
    let pairs: Vec<Pair> = serde_json::from_slice(&std::fs::read(folder.join("pairs.json"))?)?;
    let read = |name: &str| -> Result<Vec<Point>> { Ok(snake_io::read_points(&folder.join(format!("{name}.npy")))?) };
    let mut drives: BTreeMap<String, Drive> = BTreeMap::new();
    for pair in pairs {
        let name = pair.target.split('_').next().unwrap_or_default().to_string();
        let drive = drives.entry(name).or_default();
        if drive.is_empty() {
            drive.push((read(&pair.target)?, RigidTransform::identity()));
        }
        let before = drive[drive.len() - 1].1;
        drive.push((read(&pair.source)?, before * RigidTransform::from_matrix(pair.transform)?));
    }
    Ok(drives)
}

/// Keypoints of `scenes` with their descriptors.
fn field_tracks(drive: &Drive) -> Result<Vec<Vec<Tracked>>> {
    let model = Model::builtin(Builtin::Scenes);
    tracks(drive, |points| {
        let field = model.encode(points, &model.recommended().encode)?;
        let keypoints = field.detect(&model.recommended().detect)?.keypoints;
        let positions: Vec<Point> = keypoints.iter().map(|keypoint| keypoint.position).collect();
        let descriptors = field.descriptors(&positions)?;
        Ok((keypoints, descriptors))
    })
}

/// The best `count` keypoints of ISS, whose tracks go on by position alone.
fn iss_tracks(drive: &Drive, count: usize) -> Result<Vec<Vec<Tracked>>> {
    tracks(drive, |points| {
        let best = iss(points, &IssOptions::default())?;
        let keypoint = |nearest_index: usize| Keypoint {
            position: points[nearest_index],
            saliency: 1.0,
            occupancy: 1.0,
            nearest_index,
            confidence: None,
            covariance: Covariance::UNKNOWN,
        };
        let keypoints: Vec<Keypoint> = best.iter().take(count).map(|response| keypoint(response.index)).collect();
        let alike = vec![1.0; keypoints.len()];
        Ok((keypoints, alike))
    })
}

/// The ids of keypoints and their positions, sweep by sweep. The motion is given, as odometry gives
/// it.
fn tracks(
    drive: &Drive,
    mut detect: impl FnMut(&[Point]) -> Result<(Vec<Keypoint>, Vec<f32>)>,
) -> Result<Vec<Vec<Tracked>>> {
    let mut tracker = Tracker::new(TrackerOptions::default().with_max_distance(MAX_DISTANCE))?;
    let mut frames = Vec::new();
    for (number, (points, to_first)) in drive.iter().enumerate() {
        let (keypoints, descriptors) = detect(points)?;
        let motion = number.checked_sub(1).map(|last| to_first.inverse() * drive[last].1);
        let ids = tracker.update(&keypoints, &descriptors, motion.as_ref())?;
        frames.push(ids.into_iter().zip(keypoints.iter().map(|keypoint| to_first.apply(keypoint.position))).collect());
    }
    Ok(frames)
}

/// The share of the ids of the first frame that are also in the last, at the same place.
fn kept(frames: &[Vec<Tracked>]) -> f64 {
    let (first, last) = (&frames[0], &frames[frames.len() - 1]);
    let is_kept = |(id, place): &&Tracked| {
        last.iter().any(|(other, position)| other == id && distance(place, position) < MAX_DISTANCE / 2.0)
    };
    first.iter().filter(is_kept).count() as f64 / first.len() as f64
}

fn distance(a: &Point, b: &Point) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}
