//! Motions under which a cloud is self-similar: a step of spiral stairs, the pitch of a row, a
//! storey, a half turn of a room.

use super::constants::{ELSEWHERE, FEW_PLACES, MAX_SLIDE_TURN, REPEAT_PARALLEL};
use nalgebra::{DVectorView, IsometryMatrix3};
use ndarray::{ArrayView1, ArrayView2, Axis};

use crate::steps::consensus::consensus;
use crate::steps::describe::{Rows, describe_cloud};
use crate::steps::matches::inliers;
use crate::steps::pair::Pair;
use crate::steps::prepare::{PreparedCloud, SelfMotion};
use snake_core::{Control, Result};
use snake_geometry::{Vector, vector};

/// Number of motions under which a cloud is self-similar, at most. Set for time.
const SELF_MOTIONS: usize = 10;

/// Number of places that are compared with all others at once: a map has many.
const CHUNK: usize = 64;

/// The motions under which a cloud is self-similar, each with the share of its self-matches that
/// agree, the best supported first. A self-match is one of descriptors at different places of the
/// cloud; `signed` is as in [`describe_cloud`]. The cloud keeps the motions.
pub(super) fn self_motions(cloud: &PreparedCloud, signed: bool) -> Result<&[SelfMotion]> {
    let slot = &cloud.self_motions[usize::from(signed)];
    if slot.get().is_none() {
        let (pair, control) = (Pair::new(cloud, cloud, None), Control::default());
        let pair = if signed { pair } else { pair.without_signs() };
        let indices = matches_elsewhere(cloud, &describe_cloud(cloud, signed, &control)?);
        let matches = pair.matches(&indices)?;
        let motions = consensus(&matches, pair.criteria(), SELF_MOTIONS, &control)?;
        let support = |motion| inliers(&matches, motion, pair.criteria()).0 as f64 / matches.len().max(1) as f64;
        slot.get_or_init(|| motions.iter().map(|motion| (*motion.isometry(), support(motion.isometry()))).collect());
    }
    Ok(slot.get().map(Vec::as_slice).unwrap_or_default())
}

/// The total support of all motions that rotate about the axis of a given one, or slide along its direction.
/// A ring of equal columns is self-similar after so many rotations that few matches agree with each of them.
pub(super) fn shared_support(motions: &[SelfMotion], motion: &IsometryMatrix3<f64>) -> f64 {
    let turns = |motion: &IsometryMatrix3<f64>| motion.rotation.angle() > MAX_SLIDE_TURN.to_radians();
    let direction = |motion: &IsometryMatrix3<f64>| match motion.rotation.axis() {
        Some(axis) if turns(motion) => axis.into_inner(),
        _ => motion.translation.vector.normalize(),
    };
    let is_like = |(other, _): &&SelfMotion| {
        turns(other) == turns(motion) && direction(other).dot(&direction(motion)).abs() > REPEAT_PARALLEL
    };
    motions.iter().filter(is_like).map(|(_, support)| support).sum()
}

/// Matches a sample of the keypoints, each with the keypoint of the nearest descriptor that is not near it.
fn matches_elsewhere(cloud: &PreparedCloud, rows: &Rows) -> Vec<[usize; 2]> {
    let points: Vec<Vector> = cloud.keypoints().into_iter().map(vector).collect();
    let squared_distance = (ELSEWHERE * cloud.lengths.inlier_distance).powi(2);
    let all = ArrayView2::from_shape((rows.len(), rows.dimension()), rows.values()).expect("the rows are whole");
    // The row b nearest to a has the greatest a·b - |b|²/2.
    let norm = |row: &[f32]| 0.5 * DVectorView::from_slice(row, row.len()).norm_squared();
    let half_norms: Vec<f32> = rows.values().chunks_exact(rows.dimension()).map(norm).collect();
    let chosen: Vec<usize> = (0..points.len()).step_by(points.len().div_ceil(FEW_PLACES).max(1)).collect();
    let nearest = |from: usize, products: ArrayView1<f32>| {
        let mut best = (f32::NEG_INFINITY, None);
        for (to, (product, half_norm)) in products.iter().zip(&half_norms).enumerate() {
            let score = product - half_norm;
            if score > best.0 && (points[to] - points[from]).norm_squared() > squared_distance {
                best = (score, Some(to));
            }
        }
        best.1.map(|to| [from, to])
    };
    let matches = |chosen: &[usize]| {
        let products = all.select(Axis(0), chosen).dot(&all.t());
        chosen.iter().zip(products.rows()).filter_map(|(&from, row)| nearest(from, row)).collect::<Vec<_>>()
    };
    chosen.chunks(CHUNK).flat_map(matches).collect()
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use nalgebra::Vector3;
    use rand::SeedableRng;

    use super::*;
    use crate::options::RegisterOptions;
    use crate::rigid::{displacement, moved, tests::random_points};
    use crate::steps::prepare;
    use snake_core::Point;

    #[test]
    fn motions_about_one_axis_share_their_support() {
        let turn = |axis: Vector3<f64>, degrees: f64| {
            (IsometryMatrix3::new(Vector3::new(1.0, 2.0, 0.0), axis * degrees.to_radians()), 0.02)
        };
        let slide = |by: Vector3<f64>| (IsometryMatrix3::new(by, Vector3::zeros()), 0.05);
        let mut motions: Vec<SelfMotion> = [18.0, 36.0, -54.0].map(|degrees| turn(Vector3::z(), degrees)).to_vec();
        motions.extend([turn(Vector3::x(), 90.0), slide(Vector3::z()), slide(-2.0 * Vector3::z())]);
        let support = |at: usize| shared_support(&motions, &motions[at].0);
        for (at, expected) in [(0, 0.06), (3, 0.02), (4, 0.1)] {
            assert!((support(at) - expected).abs() < 1e-12, "{at}: {}", support(at));
        }
    }

    #[test]
    fn a_cloud_that_has_a_part_twice_looks_like_itself_under_the_motion_between_them() {
        let motion = IsometryMatrix3::new(Vector3::new(6.0, 1.0, 0.5), Vector3::new(0.0, 0.0, 0.7));
        // Six boxes, sampled on their faces.
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (centers, sizes) = (random_points(&mut rng, 6), random_points(&mut rng, 6));
        let surface = |(at, mut point): (usize, Point)| {
            let part = at % centers.len();
            point[at % 3] = point[at % 3].signum();
            Vector::from_fn(|axis, _| {
                f64::from(1.5 * centers[part][axis] + (0.2 + 0.4 * sizes[part][axis].abs()) * point[axis])
            })
        };
        let part: Vec<Vector> = random_points(&mut rng, 12_000).into_iter().enumerate().map(surface).collect();
        let both = part.iter().copied().chain(part.iter().map(|point| moved(&motion, point)));
        let cloud: Vec<Point> = both.map(|point| point.map(|v| v as f32).into()).collect();
        let prepared =
            prepare(&[&cloud, &cloud], &[None, None], None, &RegisterOptions::default(), &Control::default());
        let cloud = &prepared.unwrap().clouds[0];
        let motions = self_motions(cloud, false).unwrap();
        let is_found = |wanted: &IsometryMatrix3<f64>, points: &[Vector]| {
            let error = |found| displacement(found, wanted, points);
            motions.iter().map(|(motion, _)| error(motion)).fold(f64::INFINITY, f64::min)
                < cloud.lengths.inlier_distance
        };
        let there: Vec<Vector> = part.iter().map(|point| moved(&motion, point)).collect();
        assert!(is_found(&motion, &part) || is_found(&motion.inverse(), &there), "{motions:?}");
    }
}
