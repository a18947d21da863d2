//! Rivals that are tried on purpose: the winner after turns that align planes, after motions under which a cloud is
//! self-similar, after slides, shifts and reflections. Searches propose the rivals, one comparison decides.

use nalgebra::{IsometryMatrix3, Translation3};

use super::comparison::Comparison;
use super::fitting::Fitting;
use super::repeats::{axes, slides};
use super::rival::{Motion, Rival};
use super::shifts::shifts;
use super::turns::{after_turns, reflections, turns};
use crate::cloud::patches::{self, overlap};
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::try_in_parallel;

/// Number of places whose details are compared. Set for time.
const SHIFT_PLACES: usize = 1200;

/// The rivals of the winner under which the clouds fit: rotations, self-similar motions, slides,
/// shifts and reflections, each compared with the winner.
pub(super) fn rivals(pair: &Pair, winner: &IsometryMatrix3<f64>, is_standing: bool) -> Result<Vec<Rival>> {
    let (surfaces, fine) = (pair.surfaces(), pair.fine()?);
    let distance = pair.criteria().inlier_distance;
    let patches = overlap(fine, winner, patches::NEAR * distance).patches;
    let Some(frame) = axes(&patches) else { return Ok(Vec::new()) };
    let rotated = |turns: Vec<_>| turns.into_iter().map(|turn| (Motion::Alike, turn));
    let mirrored = |frame| reflections(frame).into_iter().map(|turn| (Motion::Mirror, turn));
    let tried: Vec<_> = match pair.criteria().gravity {
        // With a known up axis, no cloud is taken to be mirrored.
        Some(axis) => rotated(turns(&[axis])).collect(),
        None => rotated(turns(&frame)).chain(mirrored(&frame)).collect(),
    };
    let by_turn = after_turns(surfaces, winner, tried.into_iter(), &frame);
    let places = fine[0].places(winner, fine[1], distance, SHIFT_PLACES);
    let by_shift = shifts(&places, fine[1], &frame, distance, is_standing);
    let fitting = Fitting::new(pair, winner, is_standing);
    let by_slide = slides(&patches, &frame, distance).into_iter().map(|slide| Translation3::from(slide) * winner);
    let by_turn = by_turn.into_iter().map(|(motion, guess)| (motion, (guess, 0.0)));
    let by_slide = by_slide.map(|guess| (guess, 0.0));
    let alike = fitting.alike()?.into_iter().chain(by_slide).map(|guess| (Motion::Alike, guess));
    let guesses: Vec<_> = by_turn.chain(alike).collect();
    let fitted = try_in_parallel(guesses.iter(), |&(motion, guess)| fitting.fitted(motion, guess))?;
    let fitted: Vec<_> = fitted.into_iter().flatten().collect();
    if fitted.is_empty() && by_shift.is_empty() {
        return Ok(Vec::new());
    }
    let comparison = Comparison::new(fitting, fine, &places);
    let moved = try_in_parallel(fitted.iter(), |&(motion, rough)| comparison.moved(motion, rough))?;
    let shifted = try_in_parallel(by_shift.iter(), |&shift| comparison.shifted(shift))?;
    Ok(moved.into_iter().chain(shifted).flatten().collect())
}
