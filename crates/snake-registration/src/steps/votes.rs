//! Poses of a source that is a small part of a cluttered target, by votes of point pairs.
//!
//! Two points with normals have a length and three angles that no motion changes. Each pair of the
//! target looks up the pairs of the source that are alike, and votes for the pose that lays one on
//! the other: for the source's first point and the turn about its normal (Drost et al. 2010). One
//! right point is enough, where descriptors need three, and equal parts have a peak each.

use std::collections::HashSet;
use std::f64::consts::{PI, TAU};

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::cloud::near_grid::NearGrid;
use crate::rigid::displacement;
use crate::steps::oriented::Oriented;
use crate::steps::pair::Pair;
use snake_core::{Control, Counter, Result};
use snake_geometry::Vector;

/// Distance between the points that vote, and the step of the lengths of pairs. Unit: diameters of the source. Drost et
/// al. 2010.
const SPACING: f64 = 0.05;
/// Number of steps of an angle between normals and lines, over 90 degrees. Steps of about 12 degrees: Drost et al.
/// 2010.
const ANGLE_STEPS: usize = 7;
/// Number of steps of a turn about a normal. Drost et al. 2010.
const TURN_STEPS: usize = 30;
/// Every so many of the target's points collect votes. Set by hand: parts that show little need them.
const REFERENCE_STEP: usize = 2;
/// Poses that move the source by less than this are one. Unit: diameters of the source. Drost et al. 2010.
const SAME_POSE: f64 = 0.1;
/// Number of points of the source that tell whether two poses are one. Set for time.
const PROBES: usize = 12;

/// What no motion changes of a pair of points, and where the second point lies about the normal of
/// the first.
struct Feature {
    /// The length and three angles, in steps.
    key: usize,
    /// Whether the second point lies on the side to which the normal points; `None` on neither.
    side: Option<bool>,
    /// The azimuth of the second point about the normal, in turns.
    azimuth: f32,
}

/// The pairs of the source by their features.
struct PairTable {
    points: Vec<Oriented>,
    step: f64,
    /// By key: the first point of a pair, and what tells the pose.
    entries: Vec<Vec<(u32, Option<bool>, f32)>>,
}

/// The pose for which most pairs of a point of the target vote.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Vote {
    pub(crate) transform: IsometryMatrix3<f64>,
    /// The point of the source that the pose lays on the target's point.
    pub(crate) source: Vector,
    pub(crate) target: Vector,
    num_pairs: f64,
}

/// The votes of the target's points, most pairs first.
pub(crate) struct Votes {
    pub(crate) all: Vec<Vote>,
    /// Some points of the source.
    probes: Vec<Vector>,
    /// Poses that move the probes less far apart are one.
    distance: f64,
}

/// Poses of the source in the target for which point pairs vote.
///
/// # Errors
/// [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub(crate) fn votes(pair: &Pair, control: &Control) -> Result<Votes> {
    let [source, target] = pair.clouds();
    let spacing = SPACING * source.diameter;
    let [source_points, target_points] =
        [source, target].map(|cloud| thinned(&cloud.voxels.voxels.points, &cloud.voxels.normals, spacing));
    let table = PairTable::new(source_points, spacing);
    let places: Vec<Vector> = target_points.iter().map(|place| place.point).collect();
    let probes = table.points.iter().step_by(table.points.len().div_ceil(PROBES).max(1));
    let probes: Vec<Vector> = probes.map(|place| place.point).collect();
    let distance = SAME_POSE * source.diameter;
    if places.is_empty() || table.points.is_empty() {
        return Ok(Votes { all: Vec::new(), probes, distance });
    }
    let grid = NearGrid::new(&places, source.diameter);
    let references: Vec<&Oriented> = target_points.iter().step_by(REFERENCE_STEP).collect();
    let counter = control.begin("votes", references.len());
    let votes =
        references.into_par_iter().map(|reference| table.best_poses(reference, &target_points, &grid, &counter));
    let mut all: Vec<Vote> = votes.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    all.retain(|vote| pair.criteria().is_level(&vote.transform.rotation));
    // The order of the points decides between equals.
    all.sort_by(|a, b| b.num_pairs.total_cmp(&a.num_pairs));
    Ok(Votes { all, probes, distance })
}

impl Votes {
    /// At most `count` distinct poses, each with the pairs of all votes that are near it, most pairs
    /// first.
    pub(crate) fn poses(&self, count: usize) -> Vec<IsometryMatrix3<f64>> {
        let mut distinct: Vec<Vote> = Vec::new();
        for vote in &self.all {
            match distinct.iter_mut().find(|other| self.is_near(vote, &other.transform)) {
                Some(other) => other.num_pairs += vote.num_pairs,
                None => distinct.push(*vote),
            }
        }
        distinct.sort_by(|a, b| b.num_pairs.total_cmp(&a.num_pairs));
        distinct.iter().take(count).map(|vote| vote.transform).collect()
    }

    /// The votes for about this pose.
    pub(crate) fn agreeing<'a>(&'a self, transform: &'a IsometryMatrix3<f64>) -> impl Iterator<Item = &'a Vote> {
        self.all.iter().filter(|vote| self.is_near(vote, transform))
    }

    fn is_near(&self, vote: &Vote, transform: &IsometryMatrix3<f64>) -> bool {
        displacement(&vote.transform, transform, &self.probes) < self.distance
    }
}

/// The first point of each cell of this side that has a normal.
fn thinned(points: &[Vector], normals: &[Vector], side: f64) -> Vec<Oriented> {
    let mut cells = HashSet::new();
    let mut is_first = |point: &Vector| cells.insert(point.map(|v| (v / side).floor() as i64));
    let oriented = points.iter().zip(normals).filter(|(_, normal)| normal.norm_squared() > 0.5);
    let oriented = oriented.map(|(&point, &normal)| Oriented { point, normal });
    oriented.filter(|place| is_first(&place.point)).collect()
}

impl PairTable {
    fn new(points: Vec<Oriented>, step: f64) -> Self {
        let lengths = (1.0 / SPACING) as usize + 1;
        let mut table = Self { points, step, entries: vec![Vec::new(); lengths * ANGLE_STEPS.pow(3)] };
        for (first, a) in table.points.iter().enumerate() {
            for b in &table.points {
                if let Some(feature) = feature(a, b, step)
                    && let Some(entries) = table.entries.get_mut(feature.key)
                {
                    entries.push((first as u32, feature.side, feature.azimuth));
                }
            }
        }
        table
    }

    /// The pose with most votes for each sign of the reference's normal.
    fn best_poses(
        &self,
        reference: &Oriented,
        places: &[Oriented],
        grid: &NearGrid,
        counter: &Counter,
    ) -> Result<Vec<Vote>> {
        counter.check()?;
        counter.add(1);
        let steps = TURN_STEPS;
        let mut votes = [(); 2].map(|()| vec![0_u32; self.points.len() * steps]);
        grid.within(&reference.point, |index, _, _| {
            let Some(feature) = feature(reference, &places[index], self.step) else { return };
            for &(first, side, azimuth) in self.entries.get(feature.key).into_iter().flatten() {
                for (sign, votes) in [1.0_f32, -1.0].into_iter().zip(&mut votes) {
                    // The normals' signs follow from the sides on which the second points lie.
                    if side.zip(feature.side).is_some_and(|(a, b)| (a == b) != (sign > 0.0)) {
                        continue;
                    }
                    let turns = sign * feature.azimuth - azimuth;
                    let step = ((turns - turns.floor()) * steps as f32) as usize;
                    let step = step.min(steps - 1);
                    votes[first as usize * steps + step] += 1;
                }
            }
        });
        let best = |(sign, votes): (f64, &Vec<u32>)| {
            let (cell, count) = votes.iter().enumerate().max_by_key(|(cell, count)| (**count, usize::MAX - cell))?;
            let turns = (0.5 + (cell % steps) as f64) / steps as f64;
            let place = &self.points[cell / steps];
            let onto = if sign > 0.0 { *reference } else { reference.flipped() };
            let (transform, num_pairs) = (place.laid_on(&onto, turns), f64::from(*count));
            (*count > 0).then_some(Vote { transform, source: place.point, target: reference.point, num_pairs })
        };
        Ok([1.0, -1.0].into_iter().zip(&votes).filter_map(best).collect())
    }
}

/// What is known of a pair; `None` for points of one plane, which fit everywhere, and where the
/// line between them is the normal, about which it says nothing.
fn feature(a: &Oriented, b: &Oriented, step: f64) -> Option<Feature> {
    let line = b.point - a.point;
    let length = line.norm();
    if length < step {
        return None;
    }
    let cosines = [a.normal.dot(&line) / length, b.normal.dot(&line) / length, a.normal.dot(&b.normal)];
    let angle = |cosine: f64| {
        let angle = cosine.abs().min(1.0).acos() / (PI / 2.0);
        ((angle * ANGLE_STEPS as f64) as usize).min(ANGLE_STEPS - 1)
    };
    let [first, second, between] = cosines.map(angle);
    let across = ANGLE_STEPS - 1;
    if (first, second, between) == (across, across, 0) || first == 0 {
        return None;
    }
    let [y, z] = a.across();
    Some(Feature {
        key: (((length / step) as usize * ANGLE_STEPS + first) * ANGLE_STEPS + second) * ANGLE_STEPS + between,
        side: (first != across).then_some(cosines[0] > 0.0),
        azimuth: (line.dot(&z).atan2(line.dot(&y)) / TAU) as f32,
    })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::rigid::moved;
    use crate::rigid::tests::random_transform;

    #[test]
    fn a_pair_gives_the_pose_back_whatever_the_signs_of_its_normals() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let [a, b] = [(Vector::zeros(), Vector::z()), (Vector::new(0.9, 0.2, 0.4), Vector::new(0.6, 0.0, 0.8))]
            .map(|(point, normal)| Oriented { point, normal });
        for case in 0..100 {
            let truth = random_transform(&mut rng);
            let sign = if case % 2 == 0 { 1.0 } else { -1.0 };
            let [c, d] = [&a, &b].map(|place| Oriented {
                point: moved(&truth, &place.point),
                normal: sign * (truth.rotation * place.normal),
            });
            let [before, after] = [(&a, &b), (&c, &d)].map(|(a, b)| feature(a, b, 0.1).unwrap());
            assert!(before.key == after.key && (before.side == after.side) == (sign > 0.0), "case {case}");
            let turns = sign * f64::from(after.azimuth) - f64::from(before.azimuth);
            let onto = if sign > 0.0 { c } else { c.flipped() };
            let pose = a.laid_on(&onto, turns);
            assert!(displacement(&pose, &truth, &[a.point, b.point, Vector::y()]) < 1e-6, "case {case}");
        }
    }
}
