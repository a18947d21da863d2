//! Registration step by step, to replace a step:
//! `cargo run --release -p snake-registration --example steps`.

use snake_core::{Control, RigidTransform};
use snake_registration::steps::{Pair, consensus, describe, judge, match_rows, prepare, refine};
use snake_registration::{RegisterOptions, transform_points};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Two samplings of a surface with a known transform: a quarter turn about z and a shift of 3
    // along x.
    let points = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
    let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let truth = RigidTransform::from_matrix(rows)?;
    let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));

    let (options, control) = (RegisterOptions::default(), Control::default());
    // Once for a cloud. `PreparedCloud::new` prepares a scan for a map that is kept;
    // `with_keypoints` takes yours.
    let prepared = prepare(&[source, &target], &[None, None], None, &options, &control)?;
    let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], options.gravity);
    // A row for each keypoint. Yours: `Rows::new(values, dimension)`.
    let [source_rows, target_rows] = describe(&pair, &control)?;
    // Indices of keypoints. Yours: any list of `[source, target]`.
    let indices = match_rows(&source_rows, &target_rows, options.max_matches, &control)?;
    let matches = pair.matches(&indices)?;
    // Transforms, best first. Yours: any list of `RigidTransform`.
    let guesses = consensus(&matches, pair.criteria(), 20, &control)?;
    // Candidates, best first. Yours: `Candidate::measure` of a transform that your ICP refined.
    let candidates = refine(&pair, &matches, &guesses, options.icp_steps, 3, &control)?;
    let registration = judge(&pair, &matches, &candidates)?;

    let (angle, distance) = registration.t_target_source.angle_and_distance_to(&truth);
    println!(
        "{}, {} of {} matches agree",
        registration.verdict.word(),
        registration.matches.num_agreeing,
        matches.len()
    );
    println!("the transform is off by {angle:.4} rad and {distance:.4}");
    Ok(())
}
