//! The comparison that every rival must pass: place by place, what the winner explains and what the rival does.

use nalgebra::{IsometryMatrix3, Translation3};

use super::constants::{DETAIL, MIN_SHIFT, PLACES};
use super::fitting::Fitting;
use super::rival::{Counts, Measure, Motion, Rival};
use super::shifts::Shift;
use crate::cloud::depth_image::{DepthImage, Sight};
use crate::cloud::patches::{self, FineCloud, Place};
use crate::cloud::surface::Surface;
use crate::rigid::displacement;
use crate::steps::refine::patches::refine_on_patches;
use snake_core::{Counter, Result};

/// Step between the places that determine where exactly a shift fits. Unit: places. Set for time.
const SHIFT_THINNING: usize = 6;
/// Number of steps to either side of a shift in the search for its exact length. Half and twice change no outcome.
const SHIFT_STEPS: i32 = 6;
/// A shift is dropped if its score is below this: places that lie on the target there, less those
/// that contradict it. Unit: share of the places. Set for time.
const MIN_SHIFT_SCORE: f64 = 0.3;
/// A rival that misses more places, or contradicts half as many of the telling ones, and explains fewer in all, is not
/// refined. Unit: share of the places that the winner explains. Set for time.
const HOPELESS: f64 = 0.5;

/// The pair and what the comparison of two transforms needs.
pub(super) struct Comparison<'a, 'b> {
    fitting: Fitting<'a, 'b>,
    fine: [&'a FineCloud; 2],
    /// Places of the source on the target, in the target's frame.
    places: &'a [Place],
    /// Places of both clouds, each with the vote of the winner: whether it explains the place.
    sample: [Vec<(Place, Option<bool>)>; 2],
    images: [Option<DepthImage>; 2],
}

impl<'a, 'b> Comparison<'a, 'b> {
    pub(super) fn new(fitting: Fitting<'a, 'b>, fine: [&'a FineCloud; 2], places: &'a [Place]) -> Self {
        let (winner, distance) = (*fitting.winner, fitting.pair.criteria().inlier_distance);
        let images = fitting.pair.surfaces().each_ref().map(Surface::fine_image);
        let mut comparison = Self { fitting, fine, places, sample: Default::default(), images };
        comparison.sample = std::array::from_fn(|from| {
            let transform = if from == 0 { winner } else { winner.inverse() };
            let with_vote = |place: Place| (place, comparison.explains(&place.moved(&transform), 1 - from));
            fine[from].thinned(distance, PLACES).into_iter().map(with_vote).collect()
        });
        comparison
    }

    /// The rival near a transform from a rotation, a reflection or a motion; `None` if it contradicts too much.
    pub(super) fn moved(&self, motion: Motion, rough: IsometryMatrix3<f64>) -> Result<Option<Rival>> {
        let counts = self.compare(&rough);
        let may_contradict = self.fitting.is_standing || matches!(motion, Motion::Repetition);
        let contradicts = !may_contradict && counts.measure(Measure::OfTelling) > HOPELESS / 2.0;
        let misses = contradicts || counts.measure(Measure::OfAll) > HOPELESS;
        let is_hopeless = misses && counts.measure(Measure::Lead) > 0.0;
        if is_hopeless { Ok(None) } else { self.rival(motion, rough) }
    }

    /// The rival near a shift; `None` if it does not fit.
    pub(super) fn shifted(&self, Shift { by: shift, is_better }: Shift) -> Result<Option<Rival>> {
        let distance = self.fitting.pair.criteria().inlier_distance;
        let places: Vec<&Place> = self.places.iter().step_by(SHIFT_THINNING).collect();
        let unit = 1.5 * DETAIL * distance / shift.norm() / f64::from(SHIFT_STEPS);
        let near = |offset: i32| (1.0 + unit * f64::from(offset)) * shift;
        let fit = |offset: i32| {
            let lies = |place: &&Place| {
                let place = Place { point: place.point + near(offset), ..**place };
                self.fine[1].lies_on(&place, distance).map_or(0, |is_on| if is_on { 1 } else { -1 })
            };
            places.iter().map(lies).sum::<i32>()
        };
        if !self.fitting.is_standing && f64::from(fit(0)) < MIN_SHIFT_SCORE * places.len() as f64 {
            return Ok(None);
        }
        let shift = near(best_offset(fit, SHIFT_STEPS));
        let rough = Translation3::from(shift) * self.fitting.winner;
        if self.compare(&rough).measure(Measure::OfAll) > HOPELESS {
            return Ok(None);
        }
        let rival = self.rival(Motion::Shift(Shift { by: shift, is_better }), rough)?;
        let refined = |rival: &Rival| rival.transform.translation.vector - self.fitting.winner.translation.vector;
        Ok(rival.map(|rival| Rival { motion: Motion::Shift(Shift { by: refined(&rival), is_better }), ..rival }))
    }

    /// The rival near a transform, refined as the winner was; `None` if it is the winner.
    fn rival(&self, motion: Motion, rough: IsometryMatrix3<f64>) -> Result<Option<Rival>> {
        let distance = self.fitting.pair.criteria().inlier_distance;
        let gravity = self.fitting.pair.criteria().gravity;
        let refined = refine_on_patches(self.fine, rough, gravity, &Counter::default())?;
        let is_near = displacement(&refined, &rough, &self.fitting.coarse) < 0.5 * distance;
        let transform = if is_near { refined } else { rough };
        let moved = displacement(&transform, self.fitting.winner, &self.fitting.coarse);
        if moved < MIN_SHIFT * distance {
            return Ok(None);
        }
        let turn = transform.rotation * self.fitting.winner.rotation.inverse();
        let is_standing = self.fitting.is_slide_of_one_place(&turn);
        Ok(Some(Rival { transform, motion, counts: self.compare(&transform), is_standing, moved }))
    }

    /// Compares the winner with another transform, place by place.
    fn compare(&self, transform: &IsometryMatrix3<f64>) -> Counts {
        let mut counts = Counts::default();
        let transforms = [(*transform, *self.fitting.winner), (transform.inverse(), self.fitting.winner.inverse())];
        for (from, (transform, winner)) in transforms.into_iter().enumerate() {
            for (place, by_winner) in &self.sample[from] {
                let moved = place.moved(&transform);
                match (by_winner, self.explains(&moved, 1 - from)) {
                    (Some(true), Some(true)) => {
                        counts.both += 1;
                        counts.telling += usize::from(self.tells(&place.moved(&winner), &moved));
                    }
                    (Some(true), Some(false)) => counts.winner += 1,
                    (Some(false), Some(true)) => counts.rival += 1,
                    (Some(true), None) if self.images[1 - from].is_none() => counts.absent += 1,
                    (None, Some(true)) if self.images[1 - from].is_none() => counts.gained += 1,
                    _ => (),
                }
            }
        }
        counts
    }

    /// Whether two transforms bring a place to different places. A place that stays on its plane
    /// does not tell them apart.
    fn tells(&self, by_winner: &Place, by_rival: &Place) -> bool {
        let Some((normal, other)) = by_winner.normal.zip(by_rival.normal) else { return true };
        let offset = normal.dot(&(by_rival.point - by_winner.point)).abs();
        offset > patches::MAX_OFFSET * self.fitting.pair.criteria().inlier_distance
            || normal.dot(&other).abs() < patches::AGREEING_COSINE
    }

    /// Whether a place lies on a cloud (1 is the target) or contradicts it; `None` where the cloud
    /// does not tell. The view of a model or of merged scans is not known.
    fn explains(&self, place: &Place, cloud: usize) -> Option<bool> {
        let is_free = || self.images[cloud].as_ref().is_some_and(|image| image.sight(&place.point) == Sight::Free);
        self.fine[cloud]
            .lies_on(place, self.fitting.pair.criteria().inlier_distance)
            .or_else(|| is_free().then_some(false))
    }
}

/// The offset that fits best, up to `steps` to either side of 0; the middle one of equally good offsets.
fn best_offset(fit: impl Fn(i32) -> i32, steps: i32) -> i32 {
    let fits: Vec<(i32, i32)> = (-steps..=steps).map(|offset| (fit(offset), offset)).collect();
    let best = fits.iter().map(|(fit, _)| *fit).max();
    let equal: Vec<i32> = fits.iter().filter(|(fit, _)| Some(*fit) == best).map(|(_, offset)| *offset).collect();
    equal[equal.len() / 2]
}
