//! Registration step by step, to replace a step: `cargo run --release -p snake-registration --example steps`.

use snake_core::{Point, RigidTransform};
use snake_registration::{Descriptor, KeypointDetector, RansacOptions, Scan, mutual_nearest, ransac, transform_points};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Two clouds with a known transform: a quarter turn about z and a shift of 3 along x.
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
    let source = snake_io::read_points(sample.as_ref())?;
    let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let truth = RigidTransform::from_matrix(rows)?;
    let target = transform_points(&truth, &source);

    // Keypoints (K, 3) and descriptors (K, 33) of each cloud. Your own keypoints or descriptors can take their place.
    let described = |points: &[Point]| {
        let scan = Scan::new(points, 0.02)?;
        let keypoints = scan.keypoints(KeypointDetector::Iss, 500, 0)?;
        let descriptors = scan.descriptors(&keypoints, Descriptor::Fpfh)?;
        Ok::<_, snake_core::Error>((keypoints, descriptors, scan.dimension(Descriptor::Fpfh)?))
    };
    let (source_keypoints, source_descriptors, dimension) = described(&source)?;
    let (target_keypoints, target_descriptors, _) = described(&target)?;

    // Row i of `from` corresponds to row i of `to`. Any matcher can make these pairs.
    let matches = mutual_nearest(&source_descriptors, &target_descriptors, dimension)?;
    let from: Vec<Point> = matches.iter().map(|&[row, _]| source_keypoints[row]).collect();
    let to: Vec<Point> = matches.iter().map(|&[_, row]| target_keypoints[row]).collect();
    let found = ransac(&from, &to, &RansacOptions::default())?.ok_or("no three correspondences agree")?;

    let (angle, distance) = found.t_target_source.angle_and_distance_to(&truth);
    println!("{} of {} correspondences agree", found.inliers.len(), matches.len());
    println!("the transform is off by {angle:.4} rad and {distance:.4}");
    Ok(())
}
