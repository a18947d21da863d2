//! Rotations and reflections of the source under which the large planes of the overlap lie on
//! planes again: the walls of a room fit at two or four headings.

use super::constants::TRIES;
use std::f64::consts::PI;

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3};

use crate::cloud::patches;
use crate::cloud::surface::{Surface, coarse_step};
use crate::rigid::moved;
use snake_geometry::Vector;

/// Number of offsets along each axis at which planes of a rotated source are aligned with planes.
/// Half and twice change no outcome.
const TURN_OFFSETS: usize = 3;
/// The quarter and half turns about the axes.
pub(super) fn turns(axes: &[Vector]) -> Vec<Rotation3<f64>> {
    let about = |&axis: &Vector| [0.5, 1.0, 1.5].map(|half_turns| Rotation3::from_scaled_axis(axis * half_turns * PI));
    axes.iter().flat_map(about).collect()
}

/// The reflections across each axis, and the point reflection. Their matrices are no rotations.
pub(super) fn reflections(axes: &[Vector; 3]) -> Vec<Rotation3<f64>> {
    let across = axes.iter().map(|axis| Matrix3::identity() - 2.0 * axis * axis.transpose());
    across.chain([-Matrix3::identity()]).map(Rotation3::from_matrix_unchecked).collect()
}

/// Number of bins over which a plane spreads. Together they are two inlier distances wide.
const BINS: usize = 4;

/// How many voxels of a cloud lie on planes at each offset along three axes.
struct Offsets {
    /// For each axis, the counts of voxels that face along it and against it, starting at the bin `first`.
    counts: [[Vec<f64>; 2]; 3],
    first: [i64; 3],
}

impl Offsets {
    /// `places` are points with normals. If normals are unsigned, all face along the axis.
    fn new(places: &[(Vector, Vector)], frame: &[Vector; 3], is_signed: bool, side: f64) -> Self {
        let bin = |point: &Vector, axis: &Vector| (point.dot(axis) / side).floor() as i64;
        let mut first = [0; 3];
        let counts = std::array::from_fn(|at| {
            let axis = &frame[at];
            let bins = || places.iter().map(|(point, _)| bin(point, axis));
            first[at] = bins().min().unwrap_or_default();
            let length = bins().max().map_or(0, |last| (last - first[at] + 1) as usize);
            let mut counts = [vec![0.0; length], vec![0.0; length]];
            for (point, normal) in places {
                let cosine = normal.dot(axis);
                if cosine.abs() > patches::AGREEING_COSINE {
                    counts[usize::from(is_signed && cosine < 0.0)][(bin(point, axis) - first[at]) as usize] += 1.0;
                }
            }
            counts
        });
        Self { counts, first }
    }

    /// The best shifts along an axis, in bins, each with the number of voxels whose planes meet; 0 if none meet.
    fn shifts(&self, target: &Self, axis: usize) -> Vec<(f64, f64)> {
        let [own, other] = [&self.counts[axis], &target.counts[axis]];
        let mut sums = vec![0.0; own[0].len() + other[0].len() + 1];
        for (own, other) in own.iter().zip(other) {
            for (from, count) in own.iter().enumerate().filter(|(_, count)| **count > 0.0) {
                for (to, limit) in other.iter().enumerate() {
                    sums[to + own.len() - from] += f64::min(*count, *limit);
                }
            }
        }
        let zero = (own[0].len() as i64 + self.first[axis] - target.first[axis]) as f64;
        // A plane can lie across the borders of bins: neighbouring bins are summed, and their mean is the shift.
        let mean = |(first, sums): (usize, &[f64])| {
            let sum: f64 = sums.iter().sum();
            let moment: f64 = sums.iter().enumerate().map(|(at, count)| (first + at) as f64 * count).sum();
            (moment / sum - zero, sum)
        };
        let mut shifts: Vec<_> = sums.windows(BINS).enumerate().map(mean).filter(|(_, sum)| *sum > 0.0).collect();
        shifts.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.total_cmp(&b.0)));
        let mut best: Vec<(f64, f64)> = Vec::new();
        for (shift, sum) in shifts {
            if best.len() < TURN_OFFSETS && best.iter().all(|(other, _)| (other - shift).abs() >= BINS as f64) {
                best.push((shift, sum));
            }
        }
        if best.is_empty() { vec![(0.0, 0.0)] } else { best }
    }
}

/// The winner after each rotation in the target's frame, shifted so that planes lie on planes: of a few such shifts the one that
/// fits best. A tag names each rotation.
pub(super) fn after_turns<T: Copy>(
    surfaces: &[Surface; 2],
    winner: &IsometryMatrix3<f64>,
    turns: impl Iterator<Item = (T, Rotation3<f64>)>,
    frame: &[Vector; 3],
) -> Vec<(T, IsometryMatrix3<f64>)> {
    let [source, target] = surfaces;
    let (side, is_signed) = (2.0 / BINS as f64 * source.grid.distance(), source.is_signed());
    let some = |surface: &Surface| (0..surface.points.len()).step_by(2 * coarse_step(surface.points.len()));
    let offsets = |places: &[(Vector, Vector)]| Offsets::new(places, frame, is_signed, side);
    let at_rest = |i: usize| (moved(winner, &source.points[i]), winner.rotation * source.normals[i]);
    let at_rest: Vec<(Vector, Vector)> = some(source).map(at_rest).collect();
    let on_target = offsets(&some(target).map(|i| (target.points[i], target.normals[i])).collect::<Vec<_>>());
    let fit = |transform: &_| Surface::agreement(source, target, transform, 2 * coarse_step(source.points.len())).fit();
    let best = |(tag, turn): (T, Rotation3<f64>)| {
        let places: Vec<_> = at_rest.iter().map(|(point, normal)| (turn * point, turn * normal)).collect();
        let own = offsets(&places);
        let mut moves = vec![(Vector::zeros(), 0.0)];
        for (at, axis) in frame.iter().enumerate() {
            let shifts = own.shifts(&on_target, at);
            let with = |(to, sum): &(Vector, f64)| -> Vec<(Vector, f64)> {
                shifts.iter().map(|(shift, more)| (to + side * *shift * axis, sum + more)).collect()
            };
            moves = moves.iter().flat_map(with).collect();
        }
        moves.sort_by(|a, b| b.1.total_cmp(&a.1));
        let tries = moves.into_iter().take(TRIES).map(|(to, _)| {
            let translation = Translation3::from(turn * winner.translation.vector + to);
            let transform = IsometryMatrix3::from_parts(translation, turn * winner.rotation);
            (fit(&transform), transform)
        });
        tries.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, transform)| (tag, transform))
    };
    turns.filter_map(best).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_meet_after_the_shift_between_them() {
        let frame = [Vector::x(), Vector::y(), Vector::z()];
        let wall = |x: f64, normal: Vector| (0..50).map(move |i| (Vector::new(x, 0.1 * f64::from(i), 0.0), normal));
        let own: Vec<_> = wall(0.05, Vector::x()).chain(wall(2.05, -Vector::x())).collect();
        let other: Vec<_> = wall(1.05, Vector::x()).chain(wall(3.05, -Vector::x())).collect();
        let offsets = |places: &[_]| Offsets::new(places, &frame, true, 0.1);
        assert_eq!(offsets(&own).shifts(&offsets(&other), 0)[0], (10.0, 100.0));
        assert_eq!(offsets(&own).shifts(&offsets(&other), 1), [(0.0, 0.0)]);
        // A plane that lies across two bins is not moved by a whole one.
        let across: Vec<_> = wall(1.08, Vector::x()).chain(wall(1.12, Vector::x())).collect();
        let (shift, sum) = offsets(&wall(0.05, Vector::x()).collect::<Vec<_>>()).shifts(&offsets(&across), 0)[0];
        assert!((shift - 10.5).abs() < 1e-9 && sum == 100.0, "{shift} {sum}");
    }

    #[test]
    fn a_shift_that_the_sensor_saw_through_is_not_taken_though_it_overlaps_more() {
        let at = |i: i32, scale: f64| scale * (0.1 * f64::from(i) - 1.0);
        let wall = |x, scale, count| (0..count).map(move |i| Vector::new(x, at(i % 20, scale), at(i / 20, scale)));
        let own: Vec<_> = wall(3.0, 1.0, 400).chain(wall(2.0, 0.5, 320)).collect();
        let seen: Vec<_> = wall(4.0, 1.0, 400).collect();
        let normals = vec![-Vector::x(); own.len()];
        let target = Surface::new(&seen, &normals[..400], Some(Vector::zeros()), 0.2);
        let surfaces = [Surface::new(&own, &normals, None, 0.2), target];
        let frame = [Vector::x(), Vector::y(), Vector::z()];
        let turns = [((), Rotation3::identity())].into_iter();
        let found = after_turns(&surfaces, &IsometryMatrix3::identity(), turns, &frame);
        assert!((found[0].1.translation.x - 2.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn turns_are_rotations_and_reflections_are_not() {
        let frame = [Vector::x(), Vector::y(), Vector::z()];
        let determinants = |all: Vec<Rotation3<f64>>| all.iter().map(|r| r.matrix().determinant()).collect::<Vec<_>>();
        assert!(determinants(turns(&frame)).iter().all(|d| (d - 1.0).abs() < 1e-12));
        assert!(determinants(reflections(&frame)).iter().all(|d| (d + 1.0).abs() < 1e-12));
    }
}
