//! Keypoints of an object move onto its surface.

use std::collections::{BTreeSet, HashMap};

use super::localize::{Patches, shows_surface};
use super::modes::{Modes, weighted_mean};
use crate::Result;
use crate::field::Field;
use snake_geometry::{Point, RadiusCells, by_falling_score, in_parallel, resolution};

/// A mode moves to the most salient point within this many voxels. In an object of radius 1, a voxel is about 0.07 wide.
const SEARCH: f32 = 2.0;
/// The mode then moves twice to the weighted mean of the points within this many voxels.
const MEAN: f32 = 1.4;
/// The weights of this mean are the saliency to this power.
const POWER: i32 = 4;
/// A mode lies on the surface if a point is within this many voxels.
const ON: f32 = 0.5;
/// Where points are sparse or noisy, a mode stands in the void if it is farther from all points than this. Unit: mean distances
/// between neighbours. On surfaces 0.99 of the modes are within 2.4; in the middle of a thin ring they have 3 and more.
const VOID: f32 = 2.7;

/// Moves modes onto the surface that the points show; returns the modes with their ranks. Modes of the two sides of a thin
/// body average to its middle. Where points are sparse or noisy, the field is more precise than they are, and only modes in the void move.
///
/// Moved modes can coincide, which leaves gaps in a list of keypoints that are `apart` from each other.
/// Modes that already lie on the surface fill the gaps: they are appended unmoved and rank after all others.
pub(super) fn on_surface(field: &Field, patches: &Patches, modes: Modes, apart: f32) -> Result<(Modes, Vec<f32>)> {
    let [search, mean, on] = [SEARCH, MEAN, ON].map(|voxels| voxels * field.voxel_size());
    let points = patches.points();
    let is_shown = shows_surface(patches);
    let void = if is_shown { 0.0 } else { VOID * resolution("points", points)? as f32 };
    let cells = RadiusCells::new(points, mean.max(void))?;
    let has_points_within = |position: &Point, radius: f32| {
        let mut has_points = false;
        cells.within(position, radius, |_| has_points = true);
        has_points
    };
    let moves = in_parallel(modes.positions.iter(), |mode| is_shown || !has_points_within(mode, void));
    if !moves.contains(&true) {
        let ranks = modes.scores.clone();
        return Ok((modes, ranks));
    }
    let saliency = field.saliency(points)?;
    let weights: Vec<f32> = saliency.iter().map(|saliency| saliency.powi(POWER)).collect();
    let by_saliency = by_falling_score(&saliency);
    let most_salient = |mode: &Point| {
        let squared = |point: &Point| (0..3).map(|axis| (point[axis] - mode[axis]).powi(2)).sum::<f32>();
        by_saliency.iter().copied().find(|&index| squared(&points[index]) <= search * search)
    };
    let bests = in_parallel(0..moves.len(), |mode| most_salient(&modes.positions[mode]).filter(|_| moves[mode]));
    let starts: BTreeSet<usize> = bests.iter().copied().flatten().collect();
    let moved = |&start: &usize| (start, (0..2).fold(points[start], |at, _| weighted_mean(&cells, &weights, at, mean)));
    let moved: HashMap<usize, Point> = in_parallel(starts.iter(), moved).into_iter().collect();
    let of_mode = |(mode, best): (&Point, Option<usize>)| best.map_or(*mode, |best| moved[&best]);
    let mut positions: Vec<Point> = modes.positions.iter().zip(bests).map(of_mode).collect();
    let mut ranks = modes.scores.clone();
    let mut scores = modes.scores;
    if apart > 0.0 && is_shown {
        let on_already = in_parallel(modes.positions.iter(), |position| has_points_within(position, on));
        for mode in (0..on_already.len()).filter(|&mode| on_already[mode]) {
            positions.push(modes.positions[mode]);
            ranks.push(scores[mode] - 1.0);
            scores.push(scores[mode]);
        }
    }
    Ok((Modes { positions, scores }, ranks))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::localize::Surroundings;
    use crate::options::Preference;

    fn placed(field: &Field, positions: &[Point], apart: f32) -> Vec<Point> {
        let modes = Modes { positions: positions.to_vec(), scores: vec![0.5; positions.len()] };
        on_surface(field, &Surroundings::of(field, Preference::Salient).unwrap().patches().unwrap(), modes, apart)
            .unwrap()
            .0
            .positions
    }

    /// A box of 0.3 by 1 by 0.4, thin enough that modes of both sides meet in its middle.
    fn plate(number: usize) -> Field {
        let golden = |i: usize, k: f64| (i as f64 * k).fract() as f32;
        let side = |i: usize| {
            [if i.is_multiple_of(2) { 0.0 } else { 0.3 }, golden(i, 0.754_877_67), 0.4 * golden(i, 0.569_840_29)]
        };
        let points: Vec<Point> = (0..number).map(side).collect();
        crate::Model::builtin(crate::Builtin::Compact).encode(&points, &crate::EncodeOptions::default()).unwrap()
    }

    #[test]
    fn modes_move_onto_the_surface_and_those_on_it_come_again() {
        let field = plate(8000);
        let voxel = field.voxel_size();
        let modes = [[0.3, 0.5, 0.2], [0.3 - 1.4 * voxel, 0.5, 0.2], [1.4 * voxel, 0.5, 0.2]];
        let moved = placed(&field, &modes, 0.0);
        assert_eq!(moved.len(), 3);
        for position in &moved {
            assert!(position[0].abs().min((position[0] - 0.3).abs()) < 1e-4, "{position:?}");
        }
        assert_eq!(placed(&field, &modes, 0.1), [&moved[..], &modes[..1]].concat());
    }

    #[test]
    fn sparse_points_move_only_what_stands_in_the_void() {
        let (inside, far) = ([[0.05, 0.5, 0.2]], [[0.07, 0.5, 0.2]]);
        assert_eq!(placed(&plate(300), &inside, 0.1), inside);
        let [[x, ..]] = placed(&plate(700), &far, 0.1)[..] else { panic!("one mode") };
        assert!(x.min(0.3 - x) < 1e-4, "{x}");
        assert_ne!(placed(&plate(8000), &inside, 0.1), inside);
    }
}
