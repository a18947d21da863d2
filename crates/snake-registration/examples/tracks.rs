//! Keypoints of a drive through a room as tracks, beside the nearest neighbours of ISS keypoints from frame to frame:
//! `cargo run --release -p snake-registration --example tracks`.

use snake_core::{Builtin, Model, NormalizationMethod, Point, Result, Tracker, TrackerOptions};
use snake_registration::detectors::{IssOptions, iss};

const NUM_FRAMES: u16 = 11;
/// Way of the sensor along x from frame to frame, in metres.
const STEP: f32 = 0.1;
/// Maximum distance between a keypoint and its track, in metres.
const MAX_DISTANCE: f32 = 0.4;

/// A keypoint's id and its position in the room.
type Tracked = (u64, Point);

fn main() -> Result<()> {
    let model = Model::builtin(Builtin::Compact);
    // Frames lie alike, so they are encoded as they lie: principal axes may change places from frame to frame.
    let encode = model.recommended().encode.with_normalization(NormalizationMethod::UnitSphere);
    let mut tracker = Tracker::new(TrackerOptions::default().with_max_distance(f64::from(MAX_DISTANCE)))?;
    let mut frames: Vec<Vec<Tracked>> = Vec::new();
    for frame in 0..NUM_FRAMES {
        let field = model.encode(&view(frame), &encode)?;
        let keypoints = field.detect(&model.recommended().detect)?.keypoints;
        let positions: Vec<Point> = keypoints.iter().map(|keypoint| keypoint.position).collect();
        // The motion is not given: it is less than the maximum distance.
        let ids = tracker.update(&keypoints, &field.descriptors(&positions)?, None)?;
        frames.push(ids.into_iter().zip(in_room(&positions, frame)).collect());
    }
    report("Tracker", &frames);

    let count = frames[0].len();
    let mut frames: Vec<Vec<Tracked>> = Vec::new();
    let (mut last, mut next_id): (Vec<Tracked>, u64) = (Vec::new(), 0);
    for frame in 0..NUM_FRAMES {
        let points = view(frame);
        let best = iss(&points, &IssOptions::default())?;
        let positions: Vec<Point> = best.iter().take(count).map(|response| points[response.index]).collect();
        last = continued(&last, &positions, &mut next_id);
        frames.push(last.iter().map(|&(id, position)| (id, in_room(&[position], frame)[0])).collect());
    }
    report("ISS and nearest neighbours", &frames);
    Ok(())
}

/// How many ids of the first frame are also in the last, at the same place.
fn report(name: &str, frames: &[Vec<Tracked>]) {
    let (first, last) = (&frames[0], &frames[frames.len() - 1]);
    let is_kept = |(id, place): &&Tracked| {
        last.iter().any(|(other, position)| other == id && distance(place, position) < MAX_DISTANCE)
    };
    let kept = first.iter().filter(is_kept).count();
    let share = 100.0 * kept as f64 / first.len() as f64;
    println!("{name}: {kept} of {} ids ({share:.0} %) are kept over {} frames", first.len(), frames.len() - 1);
}

/// The ids of positions by their nearest neighbours in the last frame, the nearest pairs first.
fn continued(last: &[Tracked], positions: &[Point], next_id: &mut u64) -> Vec<Tracked> {
    let mut pairs: Vec<(f32, usize, usize)> = Vec::new();
    for (new, position) in positions.iter().enumerate() {
        pairs.extend(last.iter().enumerate().map(|(old, (_, place))| (distance(position, place), new, old)));
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut ids, mut is_taken) = (vec![None; positions.len()], vec![false; last.len()]);
    for (_, new, old) in pairs.into_iter().take_while(|pair| pair.0 < MAX_DISTANCE) {
        if ids[new].is_none() && !is_taken[old] {
            (ids[new], is_taken[old]) = (Some(last[old].0), true);
        }
    }
    let mut id = |known: Option<u64>| {
        known.unwrap_or_else(|| {
            *next_id += 1;
            *next_id
        })
    };
    ids.into_iter().map(&mut id).zip(positions.iter().copied()).collect()
}

fn distance(a: &Point, b: &Point) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
}

/// Positions of the sensor's frame in the frame of the room.
fn in_room(positions: &[Point], frame: u16) -> Vec<Point> {
    positions.iter().map(|&[x, y, z]| [x + f32::from(frame) * STEP, y, z]).collect()
}

/// A room with boxes, seen from a sensor that moves along x. Each frame has other points.
fn view(frame: u16) -> Vec<Point> {
    let at = f32::from(frame) * STEP;
    let point = |i: usize| {
        let [u, v, w] = [0.754_877_7, 0.569_840_3, 0.438_579]
            .map(|step: f64| ((i + 977 * usize::from(frame)) as f64 * step).fract() as f32);
        let [x, y, z] = match i % 5 {
            0 => [6.0 * u, 6.0 * v, 0.0],
            1 => [6.0 * u, 0.0, 2.5 * v],
            2 => [0.0, 6.0 * u, 2.5 * v],
            3 if w < 0.5 => [1.0 + 1.5 * u, 4.0 * w + 2.0, 1.0],
            3 => [1.0 + 1.5 * u, 2.0, v],
            _ => [4.0, 3.0 + u, 1.8 * v],
        };
        [x - at, y, z]
    };
    (0..6000).map(point).collect()
}
