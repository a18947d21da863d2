//! Initial poses of clouds: they start registrations of pairs, and check the results.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use nalgebra::IsometryMatrix3;

use snake_core::{Control, Error, Result};
use snake_geometry::{Length, RigidTransform, Vector, least_spread, resolution};

use super::Contradiction;
use super::solved::{Registered, probes};
use crate::options::{PairOptions, RegisterOptions};
use crate::register::tries::{Effort, Search};
use crate::result::Registration;
use crate::rigid::{displacement, moved};
use crate::steps::prepare::{Given, Pyramid};
use crate::steps::{Pair, approach, refine};

/// A transform contradicts initial poses if it moves the source farther from where they put it. An
/// object is at least twice as high as its standard deviation, so a storey exceeds the limit. Unit:
/// least standard deviations of a cloud. Set by hand.
const PRIOR_TOLERANCE: f64 = 1.5;

/// Smallest number of contradictions that give a note on the poses.
const MIN_CONTRADICTIONS: usize = 2;
/// Motions with angles that differ by less may be the same. Unit: degrees. Set by hand.
const SAME_ANGLE: f64 = 3.0;

/// The reliable registrations of pairs with poses, and those of them that contradict the poses.
#[derive(Default)]
pub(super) struct Checked {
    reliable: BTreeMap<[usize; 2], IsometryMatrix3<f64>>,
    pub(super) contradictions: HashMap<[usize; 2], Contradiction>,
}

/// The initial poses of clouds in one frame, with the tolerances within which a transform agrees with them.
pub(super) struct Priors {
    poses: Vec<Option<IsometryMatrix3<f64>>>,
    tolerances: Vec<f64>,
    probes: Vec<Vec<Vector>>,
    /// The means of the probes.
    centers: Vec<Vector>,
    /// Half of the clouds' diameters.
    radii: Vec<f64>,
}

impl Priors {
    /// Takes the given poses, at most one for each cloud, and one tolerance for all clouds. Without
    /// a tolerance, each cloud has its own.
    pub(super) fn new(
        poses: &[Option<RigidTransform>],
        tolerance: Option<Length>,
        given: &Given,
        pyramid: &Pyramid,
    ) -> Result<Self> {
        let poses = |cloud: usize| poses.get(cloud)?.as_ref().map(|pose| *pose.with_exact_rotation().isometry());
        let mut coarsest = 0.0_f64;
        if matches!(tolerance, Some(Length::Resolutions(_))) {
            for points in &given.points {
                coarsest = coarsest.max(resolution("points", points)?);
            }
        }
        let tolerance = tolerance.map(|length| length.resolve("pose_tolerance", || coarsest)).transpose()?;
        let clouds = || 0..pyramid.len();
        let by_cloud = |cloud: usize| {
            let least = refine::MIN_DIFFERENCE * pyramid.inlier_distance(pyramid.common(&[cloud]));
            least.max(PRIOR_TOLERANCE * least_spread(&pyramid.own(cloud).voxels.voxels.points))
        };
        let probes: Vec<_> = clouds().map(|cloud| probes(pyramid.own(cloud))).collect();
        Ok(Self {
            poses: clouds().map(poses).collect(),
            tolerances: clouds().map(|cloud| tolerance.unwrap_or_else(|| by_cloud(cloud))).collect(),
            centers: probes.iter().map(|points| points.iter().sum::<Vector>() / points.len().max(1) as f64).collect(),
            probes,
            radii: clouds().map(|cloud| pyramid.own(cloud).diameter / 2.0).collect(),
        })
    }

    /// The transform of a pair by the poses, if both have one.
    fn t_target_source(&self, [source, target]: [usize; 2]) -> Option<IsometryMatrix3<f64>> {
        Some(self.poses[target]?.inverse() * self.poses[source]?)
    }

    /// Whether both clouds of a pair have a pose.
    pub(super) fn has(&self, pair: [usize; 2]) -> bool {
        self.t_target_source(pair).is_some()
    }

    fn tolerance(&self, [source, target]: [usize; 2]) -> f64 {
        self.tolerances[source].min(self.tolerances[target])
    }

    /// The pairs that are worth a registration: `pairs` and the pairs of each cloud with the
    /// `count` nearest clouds, without those that are too far apart by the poses. A cloud that is too far from all others
    /// keeps its pairs, so that they can contradict its pose.
    pub(super) fn choose(&self, mut pairs: Vec<[usize; 2]>, count: usize) -> Vec<[usize; 2]> {
        for cloud in 0..self.poses.len() {
            let others = (0..self.poses.len()).filter(|&other| other != cloud);
            let mut near: Vec<(f64, usize)> =
                others.filter_map(|other| Some((self.distance([cloud, other])?, other))).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            pairs.extend(near.iter().take(count).map(|&(_, other)| [cloud.max(other), cloud.min(other)]));
        }
        pairs.sort_unstable();
        pairs.dedup();
        let met: BTreeSet<usize> = pairs.iter().filter(|pair| self.meets(**pair)).flatten().copied().collect();
        pairs.retain(|pair| self.meets(*pair) || !pair.iter().all(|cloud| met.contains(cloud)));
        pairs
    }

    /// The distance between the clouds' means where their poses put them.
    fn distance(&self, pair: [usize; 2]) -> Option<f64> {
        let [a, b] = pair.map(|cloud| Some(moved(self.poses[cloud].as_ref()?, &self.centers[cloud])));
        Some((a? - b?).norm())
    }

    /// Whether the clouds may overlap by their poses.
    fn meets(&self, pair: [usize; 2]) -> bool {
        let reach = self.radii[pair[0]] + self.radii[pair[1]] + self.tolerance(pair);
        self.distance(pair).is_none_or(|distance| distance <= reach)
    }

    /// Registers a pair by a search that also starts from its initial poses, if the clouds meet there. A result that
    /// contradicts the poses is replaced by that from the poses alone, if that is reliable and agrees with them.
    pub(super) fn register(
        &self,
        clouds: [usize; 2],
        pair: &Pair,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Registration> {
        let free = PairOptions::default();
        let search = Search::new(pair, options, &free, Effort::Usual, control);
        let prior = self.t_target_source(clouds).filter(|_| self.meets(clouds));
        let Some(prior) = prior.map(RigidTransform::from) else { return search.register() };
        let start = approach(pair, &prior, options.icp_steps, control)?;
        let searched = Search { guesses: &[start], ..search }.register();
        let contradicts = |found: &Registration| self.contradiction(clouds, found).is_some();
        if !searched.as_ref().is_ok_and(contradicts) {
            return searched;
        }
        let guessed = free.with_initial(Some(prior));
        match Search::new(pair, options, &guessed, Effort::Usual, control).register() {
            Ok(found) if found.verdict.is_reliable && !contradicts(&found) => Ok(found),
            Ok(_) | Err(Error::NoTransform { .. }) => searched,
            Err(error) => Err(error),
        }
    }

    /// How a registration contradicts the poses, if it does.
    fn contradiction(&self, pair: [usize; 2], registration: &Registration) -> Option<Contradiction> {
        let ([source, target], tolerance) = (pair, self.tolerance(pair));
        let prior = self.t_target_source(pair)?;
        let distance = displacement(registration.t_target_source.isometry(), &prior, &self.probes[source]);
        (distance > tolerance).then_some(Contradiction { source, target, distance, tolerance })
    }

    /// The registrations that do not contradict the poses. `checked` records the reliable ones and their contradictions.
    pub(super) fn filter(&self, registered: Vec<Registered>, checked: &mut Checked) -> Vec<Registered> {
        let agrees = |(pair, registration): &Registered| {
            let contradiction = self.contradiction(*pair, registration);
            if registration.verdict.is_reliable && self.has(*pair) {
                checked.reliable.entry(*pair).or_insert(*registration.t_target_source.isometry());
                checked.contradictions.extend(contradiction.map(|contradiction| (*pair, contradiction)));
            }
            contradiction.is_none()
        };
        registered.into_iter().filter(agrees).collect()
    }

    /// A note on what may be wrong with the poses, if reliable registrations contradict them: another interpretation
    /// that leaves less than half of the contradictions, or general advice if most registrations contradict.
    pub(super) fn note(&self, checked: &Checked) -> Option<String> {
        let (reliable, count) = (&checked.reliable, self.poses.len());
        let contradictions = checked.contradictions.len();
        if contradictions < MIN_CONTRADICTIONS {
            return None;
        }
        let leaves_few = |is_explained: &dyn Fn([usize; 2], &IsometryMatrix3<f64>) -> bool| {
            2 * reliable.iter().filter(|(pair, found)| !is_explained(**pair, found)).count() < contradictions
        };
        let agree = |poses: &[Option<IsometryMatrix3<f64>>]| {
            leaves_few(&|[source, target], found| {
                poses[source].zip(poses[target]).is_some_and(|(from, to)| {
                    displacement(&(to.inverse() * from), found, &self.probes[source])
                        <= self.tolerance([source, target])
                })
            })
        };
        // In other sensor axes, a motion has the same angle and about the same length.
        let is_same_motion = |pair, found: &IsometryMatrix3<f64>| {
            self.t_target_source(pair).is_some_and(|prior| {
                let lengths = [found, &prior].map(|motion| motion.translation.vector.norm());
                (found.rotation.angle() - prior.rotation.angle()).abs() < SAME_ANGLE.to_radians()
                    && (lengths[0] - lengths[1]).abs() <= self.tolerance(pair)
            })
        };
        let each = |change: &dyn Fn(&IsometryMatrix3<f64>) -> IsometryMatrix3<f64>| {
            self.poses.iter().map(|pose| pose.as_ref().map(change)).collect::<Vec<_>>()
        };
        let as_text = |first: usize| {
            let mut places: Vec<usize> = (0..count).collect();
            places.sort_by_key(|place| (first + place).to_string());
            places.into_iter().map(|place| self.poses[place]).collect::<Vec<_>>()
        };
        let in_unit = |unit: f64| {
            each(&|pose| IsometryMatrix3::from_parts((unit * pose.translation.vector).into(), pose.rotation))
        };
        let by_number = "they fit clouds that are sorted by number, not as text (0, 1, 10, 2)";
        let others = [
            (each(&IsometryMatrix3::inverse), "their inverses fit: a pose maps a cloud to the common frame"),
            (as_text(0), by_number),
            (as_text(1), by_number),
            (self.poses.iter().rev().copied().collect(), "they fit in reverse order"),
        ];
        let units = [0.001, 0.01, 100.0, 1000.0]
            .map(|unit| (in_unit(unit), "with translations in the unit of the clouds they fit"));
        let all_of = |cloud: &usize| checked.contradictions.keys().all(|pair| pair.contains(cloud));
        let only = (0..count).filter(|_| contradictions < reliable.len()).find(all_of);
        let fits = if let Some(cloud) = only {
            &format!("all are of cloud {cloud} (from 0)")
        } else if let Some((_, words)) = others.iter().chain(&units).find(|(poses, _)| agree(poses)) {
            words
        } else if leaves_few(&is_same_motion) {
            "their motions fit in other axes, such as those of a camera beside the scanner: a pose is that of the cloud's frame"
        } else if 2 * contradictions > reliable.len() {
            "check their order, direction and units"
        } else {
            return None;
        };
        let count = reliable.len();
        Some(format!("{contradictions} of {count} reliable registrations contradict the initial poses; {fits}"))
    }
}
