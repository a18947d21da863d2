//! Whether a transform fits the surfaces beside the winner, and motions under which a cloud is self-similar.

use nalgebra::{IsometryMatrix3, Rotation3};

use super::alike::{self_motions, shared_support};
use super::constants::{ELSEWHERE, MAX_SLIDE_TURN, MIN_SHIFT};
use super::rival::Motion;
use crate::cloud::surface::{Surface, coarse_step};
use crate::rigid::displacement;
use crate::steps::pair::Pair;
use crate::steps::prepare::SelfMotion;
use crate::steps::refine::icp::one_way_icp;
use snake_core::{Counter, Result};
use snake_geometry::Vector;

/// Number of ICP steps after a motion. Set for time.
const RIVAL_STEPS: usize = 8;
/// A cloud is self-similar under a motion if at least this share of its self-matches agrees. Stairs have 0.10 to 0.31,
/// stairwells 0.07 to 0.25, ramps 0.07 to 0.09, real and synthetic rooms with correct answers 0.01 to 0.06.
const MIN_SELF_SUPPORT: f64 = 0.06;
/// Smallest such motion if the sensors are not known, because objects have similar details side by
/// side. Unit: inlier distances. An object in a map has 7 to 11.
const MIN_UNSIGNED_MOTION: f64 = 12.0;
/// Smallest fit of a rival's surfaces: usually, of clouds with known sensors, which contradict wrong ones, and after a slide
/// with sensors at one place. Unit: shares of the winner's fit. Stairs have 0.9, an aeroplane of 4096 points after a
/// half turn 0.69 to 0.77, ramps 0.55 and more; traffic that keeps pace has 0.44 to 0.54.
const RIVAL_FIT_SHARES: [f64; 3] = [0.75, 0.55, 0.43];
/// A scene repeats itself, as storeys and tiers do, after a motion by which the surfaces fit by at least the first share of the
/// winner's fit. The motion is a slide with sensors at one place, or longer than [`MIN_UNSIGNED_MOTION`] with at least the
/// second share of the self-matches. Stairwells have 0.92 and 0.13 and more, stadiums 0.87 and more. Right answers in real rooms
/// have at most 0.87 with 0.09, or 0.84 with 0.12; for sensors at one place in streets 0.7.
const REPETITION: [f64; 2] = [0.87, 0.1];

/// The pair and the fit of the winner, which tell whether another transform fits the surfaces.
pub(super) struct Fitting<'a, 'b> {
    pub(super) pair: &'a Pair<'b>,
    pub(super) winner: &'a IsometryMatrix3<f64>,
    /// Some voxels of the source.
    pub(super) coarse: Vec<Vector>,
    /// The fit of these voxels under the winner.
    best_fit: f64,
    pub(super) is_standing: bool,
}

impl<'a, 'b> Fitting<'a, 'b> {
    pub(super) fn new(pair: &'a Pair<'b>, winner: &'a IsometryMatrix3<f64>, is_standing: bool) -> Self {
        let surfaces = pair.surfaces();
        let step = coarse_step(surfaces[0].points.len());
        let coarse = surfaces[0].points.iter().step_by(step).copied().collect();
        let best_fit = Surface::agreement(&surfaces[0], &surfaces[1], winner, step).fit();
        Self { pair, winner, coarse, best_fit, is_standing }
    }

    /// Combines the winner with each motion under which a cloud is self-similar, and with its inverse. Each keeps the share
    /// of the self-matches that agree. If the sensors are at one place, a slide needs no support by matches: the pattern of
    /// rays hides the self-similarity, and a sensor that keeps pace with the scene does not rotate.
    pub(super) fn alike(&self) -> Result<Vec<SelfMotion>> {
        let (distance, winner) = (self.pair.criteria().inlier_distance, self.winner);
        let least = match (self.is_standing, self.pair.is_signed()) {
            (true, _) => MIN_SHIFT,
            (false, true) => ELSEWHERE,
            (false, false) => MIN_UNSIGNED_MOTION,
        };
        let motions = |cloud: usize| {
            let motions = self_motions(self.pair.clouds()[cloud], self.pair.is_signed())?;
            let is_supported = |(motion, support): &SelfMotion| {
                self.is_slide_of_one_place(&motion.rotation) || *support >= MIN_SELF_SUPPORT
            };
            let shared = motions.iter().map(|(motion, _)| (*motion, shared_support(motions, motion)));
            let both = |(motion, support): SelfMotion| [(motion, support), (motion.inverse(), support)];
            Ok::<_, snake_core::Error>(shared.filter(is_supported).flat_map(both).collect::<Vec<_>>())
        };
        let from_source = motions(0)?.into_iter().map(|(motion, support)| (winner * motion, support));
        let from_target = motions(1)?.into_iter().map(|(motion, support)| (motion * winner, support));
        let mut guesses: Vec<SelfMotion> = Vec::new();
        for (guess, support) in from_target.chain(from_source) {
            let is_same = |(other, _): &&mut SelfMotion| displacement(&guess, other, &self.coarse) <= 2.0 * distance;
            if let Some((_, most)) = guesses.iter_mut().find(is_same) {
                *most = support.max(*most);
            } else if displacement(&guess, winner, &self.coarse) > least * distance {
                guesses.push((guess, support));
            }
        }
        Ok(guesses)
    }

    /// Whether the sensors are at one place and the rotation between two answers is small.
    pub(super) fn is_slide_of_one_place(&self, turn: &Rotation3<f64>) -> bool {
        self.is_standing && turn.angle() < MAX_SLIDE_TURN.to_radians()
    }

    /// The transform near a guess that fits best; `None` if it does not fit the surfaces. A guess comes with the share of the
    /// self-matches that agree, 0 without any.
    pub(super) fn fitted(
        &self,
        motion: Motion,
        (guess, support): SelfMotion,
    ) -> Result<Option<(Motion, IsometryMatrix3<f64>)>> {
        let (surfaces, criteria) = (self.pair.surfaces(), self.pair.criteria());
        let step = coarse_step(surfaces[0].points.len());
        let rough = one_way_icp(&self.coarse, &surfaces[1], guess, criteria.gravity, RIVAL_STEPS, &Counter::default())?;
        let fit = Surface::agreement(&surfaces[0], &surfaces[1], &rough, step).fit();
        let is_slide = self.is_slide_of_one_place(&(rough.rotation * self.winner.rotation.inverse()));
        let min_fit = RIVAL_FIT_SHARES[if is_slide { 2 } else { usize::from(self.pair.is_signed()) }];
        let is_long = displacement(&rough, self.winner, &self.coarse) > MIN_UNSIGNED_MOTION * criteria.inlier_distance;
        let repeats = fit >= REPETITION[0] * self.best_fit && (is_slide || is_long && support >= REPETITION[1]);
        Ok((fit >= min_fit * self.best_fit).then_some((if repeats { Motion::Repetition } else { motion }, rough)))
    }
}
