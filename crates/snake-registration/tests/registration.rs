//! Registration of the real scene pairs of `../shared/data/scenes` (3DMatch fragments, see the
//! README there), as `register` does it by default.

use std::path::{Path, PathBuf};

use serde_json::Value;
use snake_core::{Builtin, Control, Model, RigidTransform};
use snake_io as io;
use snake_registration::{PairOptions, RegisterOptions, Registration, register_with};

/// A registration is right up to this many degrees and metres.
const MAX_ERROR: (f64, f64) = (15.0, 0.3);

struct Pair {
    source: PathBuf,
    target: PathBuf,
    t_target_source: RigidTransform,
}

/// The pairs of a split with at least half of the points of each cloud in common, both ways round;
/// `None` without data.
fn pairs(split: &str) -> Option<Vec<Pair>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/scenes").join(split);
    let Ok(text) = std::fs::read(folder.join("pairs.json")) else {
        eprintln!("skipped: the real scene pairs are not public");
        return None;
    };
    let rows: Vec<Value> = serde_json::from_slice(&text).unwrap();
    let overlaps = |row: &&Value| ["overlap", "overlap_reverse"].iter().all(|key| row[key].as_f64().unwrap() >= 0.5);
    let both_ways = rows.iter().filter(overlaps).flat_map(|row| {
        let file = |key: &str| folder.join(format!("{}.npy", row[key].as_str().unwrap()));
        let forth: RigidTransform = serde_json::from_value(row["T"].clone()).unwrap();
        [
            Pair { source: file("source"), target: file("target"), t_target_source: forth },
            Pair { source: file("target"), target: file("source"), t_target_source: forth.inverse() },
        ]
    });
    Some(both_ways.collect())
}

/// The share of pairs that are put right, printed with the seconds that a pair takes.
fn recall(name: &str, pairs: &[Pair], options: &RegisterOptions) -> f64 {
    let model = options.needs_model().then(|| Model::builtin(Builtin::Compact));
    let mut errors = Vec::new();
    let mut seconds = Vec::new();
    for pair in pairs {
        let [source, target] = [&pair.source, &pair.target].map(|path| io::read_points(path).unwrap());
        let registration: Registration =
            register_with(&source, &target, model.as_ref(), options, &PairOptions::default(), &Control::default())
                .unwrap();
        let (angle, distance) = registration.t_target_source.angle_and_distance_to(&pair.t_target_source);
        errors.push((angle.to_degrees(), distance));
        seconds.push(registration.seconds);
    }
    let share = |degrees, distance| {
        errors.iter().filter(|(a, b)| *a <= degrees && *b <= distance).count() as f64 / errors.len() as f64
    };
    seconds.sort_by(f64::total_cmp);
    let (right, fine) = (share(MAX_ERROR.0, MAX_ERROR.1), share(5.0, 0.1));
    let (median, longest) = (seconds[seconds.len() / 2], seconds[seconds.len() - 1]);
    let count = pairs.len();
    println!(
        "{name}: {count} pairs, {right:.3} right, {fine:.3} within 5° and 0.1 m, {median:.2} s, at most {longest:.2} s"
    );
    right
}

#[test]
fn most_of_the_real_pairs_are_recovered() {
    let Some(pairs) = pairs("val") else { return };
    // A fourth of them, half of these the other way round.
    let some: Vec<Pair> =
        pairs.into_iter().enumerate().filter(|(i, _)| i % 8 == 0 || i % 8 == 5).map(|(_, p)| p).collect();
    assert!(recall("val, a fourth", &some, &RegisterOptions::default()) >= 0.85);
}

/// Recall under several options:
/// `cargo test --release --test registration -- --ignored --nocapture`.
#[test]
#[ignore = "takes minutes"]
fn table() {
    use snake_registration::Descriptor::Field;
    let Some(val) = pairs("val") else { return };
    let default = RegisterOptions::default();
    assert!(recall("val", &val, &default) >= 0.85);
    recall("val, seed 1", &val, &default.with_seed(1));
    recall("val, 1000 keypoints", &val, &default.with_max_keypoints(1000));
    recall("val, without ICP", &val, &default.with_icp_steps(0));
    recall("val, field descriptors", &val, &default.with_descriptor(Field));
    let train: Vec<Pair> = pairs("train").unwrap().into_iter().step_by(9).collect();
    recall("train, a ninth", &train, &default);
}
