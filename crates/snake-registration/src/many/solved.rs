//! From registrations of pairs to poses, and from poses to further pairs.

use std::collections::{HashMap, HashSet};

use nalgebra::Matrix6;

use snake_core::{Control, Result};
use snake_geometry::{RigidTransform, Vector, in_parallel, some_in_parallel};

use super::graph::{Part, split};
use super::loops::{Witness, doubts};
use super::pose_graph::Link;
use super::refine::refine;
use super::{Edge, Pose};
use crate::cloud::surface::Surface;
use crate::options::RegisterOptions;
use crate::result::{Registration, Verdict};
use crate::rigid::moved;
use crate::steps::prepare::Pyramid;
use crate::steps::{PreparedCloud, consensus, judge};

/// A loop of three transforms is closed if it moves points by less than this. Unit: inlier distances. Set by hand.
const LOOP_DISTANCE: f64 = 3.0;
/// Clouds are registered from their poses if this share of the probes is close to the other cloud. Set by hand.
const MIN_OVERLAP: f64 = 0.2;
/// Clouds refine the poses if this share of the probes is close to the other cloud. Set by hand.
const MIN_COMMON: f64 = 0.1;
/// Points are close if they are nearer than this. Unit: inlier distances. Set by hand.
const OVERLAP_DISTANCE: f64 = 2.0;

/// Source and target with the transform to start from, if there is one.
pub(super) type Trial = ([usize; 2], Option<RigidTransform>);
/// Source and target with their registration.
pub(super) type Registered = ([usize; 2], Registration);

/// A transform takes part in the pose graph if its probability of being wrong is at most this.
fn max_doubt() -> f64 {
    1.0 - judge::RELIABLE
}

/// Poses that were solved from registrations.
pub(super) struct Solved {
    registered: Vec<Registered>,
    /// Indices of the registrations that take part in the pose graph.
    kept: Vec<usize>,
    /// Their probabilities of being wrong.
    doubts: Vec<f64>,
    /// The same registrations as links of the pose graph.
    links: Vec<Link>,
    pub(super) parts: Vec<Part>,
}

/// Selects registrations by their own evidence and by loops, and fits the poses to them.
pub(super) fn solve(
    pyramid: &Pyramid,
    registered: Vec<Registered>,
    options: &RegisterOptions,
    control: &Control,
) -> Result<Solved> {
    let counter = control.begin("poses", 0);
    let probes: Vec<Vec<Vector>> = (0..pyramid.len()).map(|cloud| probes(pyramid.own(cloud))).collect();
    let distance = |pair: &[usize; 2]| pyramid.inlier_distance(pyramid.common(pair));
    let all = all_doubts(pyramid, &registered, &probes);
    let kept: Vec<usize> = (0..registered.len()).filter(|&i| all[i] <= max_doubt()).collect();
    let links: Vec<Link> = kept.iter().map(|&i| link(registered[i].0, &registered[i].1)).collect();
    let doubts: Vec<f64> = kept.iter().map(|&i| all[i]).collect();
    let thresholds: Vec<f64> = kept.iter().map(|&i| distance(&registered[i].0)).collect();
    let mut parts = split(pyramid.len(), &links, &doubts, &thresholds, &counter)?;
    if options.icp_steps > 0 {
        for part in &mut parts {
            let scale = pyramid.common(&part.clouds);
            let pairs = overlapping(part, pyramid, MIN_COMMON);
            let usual = |cloud| pyramid.cloud(cloud, scale);
            let finer = |cloud| pyramid.finer(cloud, scale).unwrap_or(usual(cloud));
            refine(part, &pairs, &surfaces(part, usual), &probes, &counter)?;
            if part.clouds.iter().any(|&cloud| pyramid.finer(cloud, scale).is_some()) {
                refine(part, &pairs, &surfaces(part, finer), &probes, &counter)?;
            }
            part.measure_errors(&links);
        }
    }
    Ok(Solved { registered, kept, doubts, links, parts })
}

/// The pairs whose registrations would take part in the pose graph.
pub(super) fn believed(pyramid: &Pyramid, registered: &[Registered]) -> Vec<[usize; 2]> {
    let probes: Vec<Vec<Vector>> = (0..pyramid.len()).map(|cloud| probes(pyramid.own(cloud))).collect();
    let doubts = all_doubts(pyramid, registered, &probes).into_iter();
    doubts.zip(registered).filter(|(doubt, _)| *doubt <= max_doubt()).map(|(_, (pair, _))| *pair).collect()
}

/// The probability that each registration is wrong.
fn all_doubts(pyramid: &Pyramid, registered: &[Registered], probes: &[Vec<Vector>]) -> Vec<f64> {
    let distance = |pair: &[usize; 2]| pyramid.inlier_distance(pyramid.common(pair));
    let witness = |(pair, registration): &Registered| witness(*pair, registration, LOOP_DISTANCE * distance(pair));
    doubts(&registered.iter().map(witness).collect::<Vec<_>>(), probes)
}

/// The surfaces of the clouds of a part.
fn surfaces<'a>(part: &Part, cloud: impl Fn(usize) -> &'a PreparedCloud + Sync) -> Vec<Surface<'a>> {
    let surface = |&index: &usize| {
        let cloud = cloud(index);
        cloud.surface(cloud.viewpoint.is_some(), cloud.lengths.inlier_distance)
    };
    in_parallel(part.clouds.iter(), surface)
}

impl Solved {
    /// The pairs of clouds that overlap by the poses but have no link in use, with the transforms of the poses.
    pub(super) fn guesses(&self, pyramid: &Pyramid) -> Vec<Trial> {
        let used = self.parts.iter().flat_map(|part| part.links.iter().map(|(index, _)| &self.links[*index]));
        let linked: HashSet<[usize; 2]> = used.map(|link| [link.source, link.target]).collect();
        let mut guesses: Vec<Trial> = Vec::new();
        for part in &self.parts {
            for [at, before] in overlapping(part, pyramid, MIN_OVERLAP) {
                let pair = [part.clouds[at], part.clouds[before]];
                if !linked.contains(&pair) {
                    let guess = part.poses[before].inverse() * part.poses[at];
                    guesses.push((pair, Some(guess.into())));
                }
            }
        }
        guesses.sort_by_key(|(pair, _)| *pair);
        guesses
    }

    /// The registrations that are not reliable and would join two parts, the most confident first.
    /// Each part has at most `count`, and more if the other part has fewer.
    pub(super) fn joining(&self, count: usize, is_wanted: impl Fn(&Verdict) -> bool) -> Vec<&Registered> {
        let mut part_of = HashMap::new();
        for (index, part) in self.parts.iter().enumerate() {
            part_of.extend(part.clouds.iter().map(|&cloud| (cloud, index)));
        }
        let is_open = |(pair, registration): &&Registered| {
            let verdict = &registration.verdict;
            !verdict.is_reliable && is_wanted(verdict) && part_of[&pair[0]] != part_of[&pair[1]]
        };
        let mut open: Vec<&Registered> = self.registered.iter().filter(is_open).collect();
        // The sort is stable, and the registrations are ordered by their clouds.
        open.sort_by(|(_, a), (_, b)| b.verdict.confidence.total_cmp(&a.verdict.confidence));
        let mut counts = vec![0; self.parts.len()];
        open.retain(|(pair, _)| {
            let parts = pair.map(|cloud| part_of[&cloud]);
            let is_kept = parts.iter().any(|&part| counts[part] < count);
            parts.iter().filter(|_| is_kept).for_each(|&part| counts[part] += 1);
            is_kept
        });
        open
    }

    /// Whether the poses follow a registration of this pair.
    pub(super) fn follows(&self, pair: [usize; 2]) -> bool {
        self.parts.iter().flat_map(|part| &part.links).any(|(at, _)| self.registered[self.kept[*at]].0 == pair)
    }

    /// The registrations that the poses follow, ordered by their clouds.
    pub(super) fn edges(&self) -> Vec<Edge> {
        let edge = |(at, residual): &(usize, f64)| {
            let ([source, target], registration) = &self.registered[self.kept[*at]];
            Edge {
                source: *source,
                target: *target,
                t_target_source: registration.t_target_source,
                confidence: registration.verdict.confidence,
                belief: 1.0 - self.doubts[*at],
                residual: *residual,
                information: registration.fit.information,
            }
        };
        let mut edges: Vec<Edge> = self.parts.iter().flat_map(|part| part.links.iter().map(edge)).collect();
        edges.sort_by_key(|edge| (edge.source, edge.target));
        edges
    }

    /// The pose of each cloud.
    pub(super) fn poses(&self) -> Vec<Pose> {
        let variance = |part: &Part| {
            let squared = part.links.iter().map(|(at, _)| self.registered[self.kept[*at]].1.fit.rmse.powi(2));
            squared.sum::<f64>() / part.links.len().max(1) as f64
        };
        let mut poses: Vec<(usize, Pose)> = Vec::new();
        for (index, part) in self.parts.iter().enumerate() {
            let covariances = part.covariances(&self.links, variance(part));
            for ((&cloud, pose), covariance) in part.clouds.iter().zip(&part.poses).zip(covariances) {
                let covariance = std::array::from_fn(|row| std::array::from_fn(|column| covariance[(row, column)]));
                poses.push((cloud, Pose { part: index, t_part_cloud: (*pose).into(), covariance }));
            }
        }
        poses.sort_by_key(|(cloud, _)| *cloud);
        poses.into_iter().map(|(_, pose)| pose).collect()
    }

    /// Solves again after the reliable registrations of `more` replace those of the same pairs.
    pub(super) fn with(
        self,
        mut more: Vec<Registered>,
        pyramid: &Pyramid,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Self> {
        more.retain(|(_, registration)| registration.verdict.is_reliable);
        if more.is_empty() {
            return Ok(self);
        }
        let replaced: HashSet<[usize; 2]> = more.iter().map(|(pair, _)| *pair).collect();
        let kept = self.registered.into_iter().filter(|(pair, _)| !replaced.contains(pair));
        let mut all: Vec<Registered> = kept.chain(more).collect();
        all.sort_by_key(|(pair, _)| *pair);
        solve(pyramid, all, options, control)
    }
}

/// The pairs `[source, target]` of clouds that overlap by the poses of a part, as places within the part.
fn overlapping(part: &Part, pyramid: &Pyramid, min_overlap: f64) -> Vec<[usize; 2]> {
    let all = (1..part.clouds.len()).flat_map(|at| (0..at).map(move |before| [at, before])).collect::<Vec<_>>();
    let scale = pyramid.common(&part.clouds);
    let inlier_distance = pyramid.inlier_distance(scale);
    let overlap = |&[at, before]: &[usize; 2]| {
        let transform = part.poses[before].inverse() * part.poses[at];
        let target = &pyramid.cloud(part.clouds[before], scale).voxels.voxels;
        let probes = probes(pyramid.cloud(part.clouds[at], scale));
        let is_close =
            |probe: &&Vector| target.distance(&moved(&transform, probe)) < OVERLAP_DISTANCE * inlier_distance;
        probes.iter().filter(is_close).count() as f64 >= min_overlap * probes.len() as f64
    };
    some_in_parallel(all.iter(), |pair| overlap(pair).then_some(*pair))
}

/// Sample points of a cloud, which measure how far it moves.
pub(super) fn probes(cloud: &PreparedCloud) -> Vec<Vector> {
    let points = &cloud.voxels.voxels.points;
    points.iter().step_by(points.len().div_ceil(consensus::PROBES).max(1)).copied().collect()
}

fn witness([source, target]: [usize; 2], registration: &Registration, distance: f64) -> Witness {
    let t_target_source = *registration.t_target_source.isometry();
    let Verdict { confidence, is_ambiguous, .. } = registration.verdict;
    Witness { source, target, t_target_source, confidence, is_ambiguous, distance }
}

fn link([source, target]: [usize; 2], registration: &Registration) -> Link {
    let information = Matrix6::from_fn(|row, column| registration.fit.information[row][column]);
    Link { source, target, t_target_source: *registration.t_target_source.isometry(), information }
}
