//! Other answers that are tried on purpose: the winner after a turn that lays planes on planes, after the motions under
//! which one of the clouds looks like itself, after a shift under which details repeat, and after a reflection.

use super::constants::{DETAIL, ELSEWHERE, MAX_SLIDE_TURN, MIN_SHIFT, PLACES};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3};
use rayon::prelude::*;

use super::alike::{self_motions, shared_support};
use super::open_motions::axis_name;
use super::repeats::axes;
use super::shifts::{Shift, shifts};
use super::turns::{after_turns, reflections, turns};
use crate::cloud::depth_image::{DepthImage, Sight};
use crate::cloud::patches::{self, FineCloud, Place, overlap};
use crate::cloud::surface::{Surface, coarse_step};
use crate::rigid::displacement;
use crate::steps::pair::Pair;
use crate::steps::refine::icp::one_way_icp;
use crate::steps::refine::patches::refine_on_patches;
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// Number of places whose details are compared. Set for time.
const SHIFT_PLACES: usize = 1200;
/// Number of ICP steps after a motion. Set for time.
const RIVAL_STEPS: usize = 8;
/// A cloud looks like itself after a motion on which this share of these matches agrees. Unit: share of the matches.
/// Stairs have 0.10 to 0.31, stairwells 0.07 to 0.25, ramps 0.07 to 0.09; beside right answers real and made rooms 0.01
/// to 0.06.
const MIN_SELF_SUPPORT: f64 = 0.06;
/// Such a motion is longer where the sensors are not known: objects have details alike side by side. Unit: inlier
/// distances. An object in a map has 7 to 11.
const MIN_UNSIGNED_MOTION: f64 = 12.0;
/// A rival contradicts at most this. Unit: share of the places that the winner explains and that tell the two apart. Stairs,
/// ramps and stairwells have up to 0.05, right answers in real rooms 0.09 and more.
const MAX_CONTRADICTED: f64 = 0.08;
/// With sensors at one place, where one pattern of rays coincides point by point: traffic has up to 0.25, rooms at rest 0.33
/// and more.
const STANDING_CONTRADICTED: f64 = 0.28;
/// Of all places, after a shift there or one with which details fit better: pillars have up to 0.38.
const SHIFT_CONTRADICTED: f64 = 0.43;
/// Every so many of them tell where exactly a shift fits. Unit: places. Set for time.
const SHIFT_THINNING: usize = 6;
/// Number of steps to either side in which a shift is made exact. Half and twice change no outcome.
const SHIFT_STEPS: i32 = 6;
/// A rival's surfaces fit by this: usually, and after a slide with sensors at one place. Unit: shares of the winner's
/// fit. Stairs have 0.9, ramps 0.89, an aeroplane of 4096 points after a half turn 0.69 to 0.77; traffic that keeps
/// pace 0.44 to 0.54.
const RIVAL_FIT_SHARES: [f64; 2] = [0.75, 0.43];
/// A shift is not made exact if fewer of the places lie on the target there, less those that contradict it. Unit: share
/// of the places. Set for time.
const MIN_SHIFT_SCORE: f64 = 0.3;
/// A rival that contradicts more, and explains less, is not refined. Unit: share of the places that the winner
/// explains. Set for time.
const HOPELESS: f64 = 0.5;
/// A mirror image fits better if it leads by this. Unit: share of the places that the winner explains. Mirrored boxes
/// have 0.1 and more.
const MIRROR_LEAD: f64 = 0.06;

/// Of two transforms one explains more places, and absence contradicts the other, by so many standard deviations. Half turns of
/// rooms that are the answer have -5 to 2 beside the truth, the other way round 4 and more.
const MIN_DEVIATIONS: f64 = 3.0;

/// What leads from the winner to its rival.
#[derive(Debug, Clone, Copy)]
enum Motion {
    Mirror,
    Shift(Shift),
    /// A turn, or a motion under which one of the clouds looks like itself.
    Alike,
}

/// Another answer, compared with the winner place by place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rival {
    pub(super) transform: IsometryMatrix3<f64>,
    motion: Motion,
    counts: Counts,
    /// Whether the winner puts the sensors of both clouds at one place.
    is_standing: bool,
    /// The root mean square distance by which it moves the source from where the winner puts it.
    moved: f64,
}

/// Numbers of places of both clouds.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    /// Places that both transforms bring onto the other cloud.
    both: usize,
    /// Those of them that the two bring to different places: a floor agrees with all slides along it.
    telling: usize,
    /// Places that the winner brings onto the other cloud and the rival contradicts.
    winner: usize,
    /// The reverse.
    rival: usize,
    /// Places that the winner brings onto a cloud whose sensor is not known, and the rival to where it has nothing.
    absent: usize,
    /// The reverse.
    gained: usize,
}

impl Counts {
    /// How many more places the rival explains than the winner does.
    fn gain(&self) -> i64 {
        (self.rival + self.gained) as i64 - (self.winner + self.absent) as i64
    }

    /// By how much the winner leads, as a share of the places that it explains.
    fn lead(&self) -> f64 {
        -self.gain() as f64 / self.explained()
    }

    /// The share of the places that the winner explains and the rival does not.
    fn contradicted(&self) -> f64 {
        (self.winner + self.absent) as f64 / self.explained()
    }

    /// The share of the places that tell the two apart which the rival contradicts.
    fn contradicted_of_telling(&self) -> f64 {
        let contradicted = self.winner + if self.absence_tells() { self.absent } else { 0 };
        contradicted as f64 / (self.telling + contradicted).max(1) as f64
    }

    /// Whether absence contradicts the rival: nobody knows where an unknown sensor looked, and a rival that explains as
    /// many other places instead is as good.
    fn absence_tells(&self) -> bool {
        is_significant(self.absent as i64 - self.gained as i64, self.absent + self.gained)
    }

    fn explained(&self) -> f64 {
        (self.both + self.winner + self.absent).max(1) as f64
    }
}

impl Rival {
    /// Whether the rival is a mirror image of the source, which no rigid motion gives.
    pub(super) fn is_mirrored(&self) -> bool {
        matches!(self.motion, Motion::Mirror)
    }

    /// What must be small for a rival to be equal, and its limit. A mirror image must explain more, whatever it contradicts.
    /// What the winner alone explains does not count beyond that: clouds of one pattern of rays coincide point by point
    /// wherever they are a period apart.
    fn limit(&self) -> (f64, f64) {
        let (of_all, of_telling) = (self.counts.contradicted(), self.counts.contradicted_of_telling());
        match self.motion {
            Motion::Mirror => (self.counts.lead(), -MIRROR_LEAD),
            Motion::Shift(Shift { is_better, .. }) if is_better || self.is_standing => (of_all, SHIFT_CONTRADICTED),
            _ if self.is_standing => (of_telling, STANDING_CONTRADICTED),
            _ => (of_telling, MAX_CONTRADICTED),
        }
    }

    /// How many more places it explains than the winner does.
    pub(super) fn gain(&self) -> i64 {
        self.counts.gain()
    }

    /// Whether it explains significantly more places than the winner. A mirror image is no answer.
    pub(super) fn is_better(&self) -> bool {
        let Counts { winner, absent, rival, gained, .. } = self.counts;
        !self.is_mirrored() && is_significant(self.gain(), winner + absent + rival + gained)
    }

    /// Whether the rival contradicts little of what tells it from the winner.
    pub(super) fn is_equal(&self) -> bool {
        let (measure, limit) = self.limit();
        measure <= limit
    }

    /// Of the places that the winner explains, the share that this shift of it, or motion under which
    /// a cloud looks like itself, explains too; 0 for a mirror image.
    pub(super) fn repeat_fit(&self) -> f64 {
        match self.motion {
            Motion::Shift(_) => self.counts.both as f64 / self.counts.explained(),
            Motion::Alike => 1.0 - self.counts.contradicted_of_telling(),
            Motion::Mirror => 0.0,
        }
    }

    /// What is ambiguous beside a winner, in a sentence.
    pub(super) fn note(&self, winner: &IsometryMatrix3<f64>) -> String {
        match self.motion {
            Motion::Mirror => {
                "a mirror image of the source fits better: one of the clouds may have a flipped axis".into()
            }
            Motion::Alike => {
                let angle = (self.transform.rotation * winner.rotation.inverse()).angle().to_degrees().round();
                let by = self.transform.translation.vector - winner.translation.vector;
                if angle == 0.0 {
                    return repeat_note("scene", &by);
                }
                format!(
                    "ambiguous: the scene looks like itself after a turn by {angle:.0} degrees that moves the source by {:.3}, \
                     and the source fits there about as well",
                    self.moved
                )
            }
            Motion::Shift(Shift { by, .. }) => repeat_note("target", &by),
        }
    }
}

/// Whether one of two transforms explains so many more of the places that only one explains (McNemar's test).
fn is_significant(more: i64, differing: usize) -> bool {
    more as f64 > MIN_DEVIATIONS * (differing as f64).sqrt()
}

/// What repeats itself after a shift, in a sentence.
fn repeat_note(what: &str, by: &Vector) -> String {
    format!(
        "ambiguous: the {what} repeats itself every {:.3} along {}, and the source fits there about as well",
        by.norm(),
        axis_name(&by.normalize())
    )
}

/// The turns, motions, shifts and reflections of the winner under which the clouds fit, with what tells them
/// from the winner.
pub(super) fn rivals(pair: &Pair, winner: &IsometryMatrix3<f64>, is_standing: bool) -> Result<Vec<Rival>> {
    let (surfaces, fine) = (pair.surfaces(), pair.fine()?);
    let distance = pair.criteria().inlier_distance;
    let patches = overlap(fine, winner, patches::NEAR * distance).patches;
    let [Some(first), Some(second), Some(third)] = axes(&patches) else { return Ok(Vec::new()) };
    let frame = [first, second, third];
    let rotated = |turns: Vec<_>| turns.into_iter().map(|turn| (Motion::Alike, turn));
    let mirrored = |frame| reflections(frame).into_iter().map(|turn| (Motion::Mirror, turn));
    let tried: Vec<_> = match pair.criteria().gravity {
        // No cloud is mirrored.
        Some(axis) => rotated(turns(&[axis])).collect(),
        None => rotated(turns(&frame)).chain(mirrored(&frame)).collect(),
    };
    let by_turn = after_turns(surfaces, winner, tried.into_iter(), &frame);
    let places = fine[0].places(winner, fine[1], distance, SHIFT_PLACES);
    let by_shift = shifts(&places, fine[1], &frame, distance, is_standing);
    let fitting = Fitting::new(pair, winner, is_standing);
    let guesses: Vec<_> = by_turn.into_iter().chain(fitting.alike()?).collect();
    let fit = |(motion, guess)| fitting.fitted(motion, guess);
    let fitted: Vec<_> = guesses.into_par_iter().map(fit).collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    if fitted.is_empty() && by_shift.is_empty() {
        return Ok(Vec::new());
    }
    let scene = Scene::new(fitting, fine, &places);
    let moved = fitted.into_par_iter().map(|(motion, rough)| scene.moved(motion, rough)).collect::<Result<Vec<_>>>()?;
    let shifted = by_shift.into_par_iter().map(|shift| scene.shifted(shift)).collect::<Result<Vec<_>>>()?;
    Ok(moved.into_iter().chain(shifted).flatten().collect())
}

/// The pair with what shows whether another transform fits the surfaces.
struct Fitting<'a, 'b> {
    pair: &'a Pair<'b>,
    winner: &'a IsometryMatrix3<f64>,
    /// Some voxels of the source.
    coarse: Vec<Vector>,
    /// How well they fit with the winner.
    best_fit: f64,
    is_standing: bool,
}

impl<'a, 'b> Fitting<'a, 'b> {
    fn new(pair: &'a Pair<'b>, winner: &'a IsometryMatrix3<f64>, is_standing: bool) -> Self {
        let surfaces = pair.surfaces();
        let step = coarse_step(surfaces[0].points.len());
        let coarse = surfaces[0].points.iter().step_by(step).copied().collect();
        let best_fit = Surface::agreement(&surfaces[0], &surfaces[1], winner, step).fit();
        Self { pair, winner, coarse, best_fit, is_standing }
    }

    /// The winner before or after each motion under which a cloud looks like itself, or its inverse. Where the
    /// sensors are at one place and one pattern of rays hides that the scene looks alike, any of its slides
    /// will do: a sensor that keeps pace with the scene does not turn.
    fn alike(&self) -> Result<Vec<(Motion, IsometryMatrix3<f64>)>> {
        let (distance, winner) = (self.pair.criteria().inlier_distance, self.winner);
        let least = match (self.is_standing, self.pair.is_signed()) {
            (true, _) => MIN_SHIFT,
            (false, true) => ELSEWHERE,
            (false, false) => MIN_UNSIGNED_MOTION,
        };
        let motions = |cloud: usize| {
            let motions = self_motions(self.pair.clouds()[cloud], self.pair.is_signed())?;
            let is_supported = |motion: &IsometryMatrix3<f64>| {
                self.is_slide_of_one_place(&motion.rotation) || shared_support(motions, motion) >= MIN_SELF_SUPPORT
            };
            let supported = motions.iter().map(|(motion, _)| *motion).filter(is_supported);
            Ok::<_, snake_core::Error>(supported.flat_map(|motion| [motion, motion.inverse()]).collect::<Vec<_>>())
        };
        let from_source = motions(0)?.into_iter().map(|motion| winner * motion);
        let from_target = motions(1)?.into_iter().map(|motion| motion * winner);
        let mut guesses: Vec<(Motion, IsometryMatrix3<f64>)> = Vec::new();
        for guess in from_target.chain(from_source) {
            let differs = |(_, other): &(Motion, _)| displacement(&guess, other, &self.coarse) > 2.0 * distance;
            if displacement(&guess, winner, &self.coarse) > least * distance && guesses.iter().all(differs) {
                guesses.push((Motion::Alike, guess));
            }
        }
        Ok(guesses)
    }

    /// Whether the sensors are at one place and hardly turn between two answers.
    fn is_slide_of_one_place(&self, turn: &Rotation3<f64>) -> bool {
        self.is_standing && turn.angle() < MAX_SLIDE_TURN.to_radians()
    }

    /// The transform near a guess that fits best; `None` if it does not fit the surfaces.
    fn fitted(&self, motion: Motion, guess: IsometryMatrix3<f64>) -> Result<Option<(Motion, IsometryMatrix3<f64>)>> {
        let (surfaces, gravity) = (self.pair.surfaces(), self.pair.criteria().gravity);
        let step = coarse_step(surfaces[0].points.len());
        let rough = one_way_icp(&self.coarse, &surfaces[1], guess, gravity, RIVAL_STEPS, &Counter::default())?;
        let fit = Surface::agreement(&surfaces[0], &surfaces[1], &rough, step).fit();
        let is_slide = self.is_slide_of_one_place(&(rough.rotation * self.winner.rotation.inverse()));
        let min_fit = RIVAL_FIT_SHARES[usize::from(is_slide)];
        Ok((fit >= min_fit * self.best_fit).then_some((motion, rough)))
    }
}

/// The pair with what the comparison of two transforms needs.
struct Scene<'a, 'b> {
    fitting: Fitting<'a, 'b>,
    fine: [&'a FineCloud; 2],
    /// Places of the source on the target, in the target's frame.
    places: &'a [Place],
    /// Places of both clouds, each with what the winner makes of it.
    sample: [Vec<(Place, Option<bool>)>; 2],
    images: [Option<DepthImage>; 2],
}

impl<'a, 'b> Scene<'a, 'b> {
    fn new(fitting: Fitting<'a, 'b>, fine: [&'a FineCloud; 2], places: &'a [Place]) -> Self {
        let (winner, distance) = (*fitting.winner, fitting.pair.criteria().inlier_distance);
        let images = fitting.pair.surfaces().each_ref().map(Surface::fine_image);
        let mut scene = Self { fitting, fine, places, sample: Default::default(), images };
        scene.sample = std::array::from_fn(|from| {
            let transform = if from == 0 { winner } else { winner.inverse() };
            let with_vote = |place: Place| (place, scene.explains(&place.moved(&transform), 1 - from));
            fine[from].thinned(distance, PLACES).into_iter().map(with_vote).collect()
        });
        scene
    }

    /// The rival near a transform that a turn, a reflection or a motion led to; `None` if it contradicts too much.
    fn moved(&self, motion: Motion, rough: IsometryMatrix3<f64>) -> Result<Option<Rival>> {
        let counts = self.compare(&rough);
        let is_hopeless = counts.contradicted() > HOPELESS && counts.lead() > 0.0;
        if is_hopeless { Ok(None) } else { self.rival(motion, rough) }
    }

    /// The rival near a shift; `None` if it does not fit.
    fn shifted(&self, Shift { by: shift, is_better }: Shift) -> Result<Option<Rival>> {
        let distance = self.fitting.pair.criteria().inlier_distance;
        let places: Vec<&Place> = self.places.iter().step_by(SHIFT_THINNING).collect();
        let fit = |part: f64| {
            let lies = |place: &&Place| {
                let place = Place { point: place.point + part * shift, ..**place };
                self.fine[1].lies_on(&place, distance).map_or(0, |is_on| if is_on { 1 } else { -1 })
            };
            places.iter().map(lies).sum::<i32>()
        };
        if !self.fitting.is_standing && f64::from(fit(1.0)) < MIN_SHIFT_SCORE * places.len() as f64 {
            return Ok(None);
        }
        let unit = 1.5 * DETAIL * distance / shift.norm() / f64::from(SHIFT_STEPS);
        let shift = best_part(fit, unit) * shift;
        let rough = Translation3::from(shift) * self.fitting.winner;
        if self.compare(&rough).contradicted() > HOPELESS {
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
        if displacement(&transform, self.fitting.winner, &self.fitting.coarse) < MIN_SHIFT * distance {
            return Ok(None);
        }
        let turn = transform.rotation * self.fitting.winner.rotation.inverse();
        Ok(Some(Rival {
            transform,
            motion,
            counts: self.compare(&transform),
            is_standing: self.fitting.is_slide_of_one_place(&turn),
            moved: displacement(&transform, self.fitting.winner, &self.fitting.coarse),
        }))
    }

    /// The winner and another transform, place by place.
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

    /// Whether two transforms bring a place to different places: a place on a plane that stays on it
    /// does not tell.
    fn tells(&self, by_winner: &Place, by_rival: &Place) -> bool {
        let Some((normal, other)) = by_winner.normal.zip(by_rival.normal) else { return true };
        let offset = normal.dot(&(by_rival.point - by_winner.point)).abs();
        offset > patches::MAX_OFFSET * self.fitting.pair.criteria().inlier_distance
            || normal.dot(&other).abs() < patches::AGREEING_COSINE
    }

    /// Whether a place lies on a cloud (1 is the target) or contradicts it; `None` where the cloud
    /// does not tell: nobody knows where the sensor of a model or of merged scans did not look.
    fn explains(&self, place: &Place, cloud: usize) -> Option<bool> {
        let is_free = || self.images[cloud].as_ref().is_some_and(|image| image.sight(&place.point) == Sight::Free);
        self.fine[cloud]
            .lies_on(place, self.fitting.pair.criteria().inlier_distance)
            .or_else(|| is_free().then_some(false))
    }
}

/// The part of a shift, about 1, that fits best; of equals the middle one.
fn best_part(fit: impl Fn(f64) -> i32, unit: f64) -> f64 {
    let parts = (-SHIFT_STEPS..=SHIFT_STEPS).map(|at| 1.0 + unit * f64::from(at));
    let tries: Vec<(i32, f64)> = parts.map(|part| (fit(part), part)).collect();
    let best = tries.iter().map(|(fit, _)| *fit).max();
    let equal: Vec<f64> = tries.iter().filter(|(fit, _)| Some(*fit) == best).map(|(_, part)| *part).collect();
    equal[equal.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rival(motion: Motion, winner: usize, rival: usize) -> Rival {
        let counts = Counts { both: 200, telling: 200, winner, rival, absent: 0, gained: 0 };
        Rival { transform: IsometryMatrix3::identity(), motion, counts, is_standing: false, moved: 1.0 }
    }

    #[test]
    fn a_mirror_image_that_explains_more_is_a_rival_whatever_it_contradicts() {
        assert!(rival(Motion::Mirror, 180, 500).is_equal());
        assert!(!rival(Motion::Mirror, 180, 180).is_equal());
    }

    #[test]
    fn a_rival_that_explains_significantly_more_is_better_and_a_mirror_image_never() {
        assert!(rival(Motion::Alike, 20, 60).is_better());
        assert!(!rival(Motion::Alike, 20, 40).is_better());
        assert!(!rival(Motion::Mirror, 20, 60).is_better());
    }

    #[test]
    fn absence_before_an_unknown_sensor_contradicts_only_a_rival_that_explains_less() {
        let rival = |absent, gained| Counts { both: 900, telling: 700, winner: 5, rival: 5, absent, gained };
        assert!(rival(200, 190).contradicted_of_telling() < 0.01);
        assert!(rival(200, 100).contradicted_of_telling() > 0.2);
        assert!(rival(200, 300).contradicted_of_telling() < 0.01);
    }
}
