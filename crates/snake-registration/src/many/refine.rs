//! Poses that fit the points of all clouds at once.

use snake_core::{Counter, Result};
use snake_geometry::{Vector, some_in_parallel};

use super::graph::Part;
use super::pose_graph::{Link, least_squares};
use crate::cloud::surface::{Surface, coarse_step};
use crate::rigid::displacement;
use crate::steps::refine::icp::remeasure;

/// Number of rounds of the last refinement, at most; each measures every pair of clouds again. Set by hand.
const REFINE_ROUNDS: usize = 30;
/// The last refinement ends when no cloud moves by more than this. Unit: inlier distances. Set by hand.
const REFINE_TOLERANCE: f64 = 0.01;

/// Refines the poses of a part on the points of its overlapping clouds. `pairs` are pairs of places
/// in the part, and `surfaces` are in the same order as its clouds.
///
/// Each round pairs some of the points by the poses, takes one step of ICP for every pair of clouds
/// and fits the poses to these steps. A transform that is measured from two clouds alone fits their
/// own distortions; here each cloud is balanced between all clouds that it overlaps.
pub(super) fn refine(
    part: &mut Part,
    pairs: &[[usize; 2]],
    surfaces: &[Surface],
    probes: &[Vec<Vector>],
    counter: &Counter,
) -> Result<()> {
    let Part { clouds, poses, .. } = part;
    for _ in 0..REFINE_ROUNDS {
        counter.check()?;
        let measure = |&[source, target]: &[usize; 2]| {
            let pair = [source, target].map(|at| &surfaces[at]);
            let step = coarse_step(pair.map(|surface| surface.points.len()).into_iter().max()?);
            let by_poses = poses[target].inverse() * poses[source];
            let (t_target_source, information) = remeasure(pair, &by_poses, step)?;
            Some(Link { source, target, t_target_source, information })
        };
        let links: Vec<Link> = some_in_parallel(pairs.iter(), measure);
        if links.is_empty() {
            break;
        }
        let before = poses.clone();
        let distance = surfaces[0].grid.distance();
        least_squares(poses, &links, &vec![1.0; links.len()], distance, counter)?;
        let moved = clouds.iter().zip(before.iter().zip(&*poses));
        let moved = moved.map(|(&cloud, (before, after))| displacement(before, after, &probes[cloud]));
        if moved.fold(0.0, f64::max) < REFINE_TOLERANCE * distance {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use nalgebra::IsometryMatrix3;
    use rand::SeedableRng;

    use super::*;
    use crate::rigid::moved;
    use crate::rigid::tests::{random_points, random_transform};
    use snake_geometry::vector;

    #[test]
    fn all_points_together_correct_the_poses() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let truth: Vec<_> = (0..4).map(|_| random_transform(&mut rng)).collect();
        // Each cloud samples three faces of the cube ±1 in its own frame.
        let mut cloud = |pose: &IsometryMatrix3<f64>| -> (Vec<Vector>, Vec<Vector>) {
            let on_face = |(i, mut point): (usize, [f32; 3])| {
                point[i % 3] = 1.0;
                (moved(&pose.inverse(), &vector(point)), pose.inverse().rotation * Vector::ith(i % 3, 1.0))
            };
            random_points(&mut rng, 3000).into_iter().enumerate().map(on_face).unzip()
        };
        let clouds: Vec<_> = truth.iter().map(&mut cloud).collect();
        let surfaces: Vec<_> =
            clouds.iter().map(|(points, normals)| Surface::new(points, normals, None, 0.15)).collect();
        let probes: Vec<Vec<Vector>> = clouds.iter().map(|(points, _)| points[..50].to_vec()).collect();
        let poses: Vec<_> = truth.iter().map(|pose| truth[0].inverse() * pose).collect();
        let off = |i: usize| IsometryMatrix3::new(Vector::repeat(0.01 * i as f64), Vector::repeat(0.004 * i as f64));
        let rough = (0..4).map(|i| poses[i] * off(i)).collect();
        let mut part = Part { clouds: (0..4).collect(), poses: rough, links: Vec::new() };
        let pairs: Vec<[usize; 2]> = (1..4).flat_map(|at| (0..at).map(move |before| [at, before])).collect();
        let error =
            |part: &Part| (0..4).map(|i| displacement(&part.poses[i], &poses[i], &probes[i])).fold(0.0, f64::max);
        assert!(error(&part) > 0.03);
        refine(&mut part, &pairs, &surfaces, &probes, &Counter::default()).unwrap();
        assert!(error(&part) < 0.005 && part.poses[0] == poses[0], "{}", error(&part));
    }
}
