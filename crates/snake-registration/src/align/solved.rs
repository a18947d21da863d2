//! From registrations of pairs to poses, and from poses to further pairs.

use std::collections::HashSet;

use nalgebra::Matrix6;

use snake_core::space::Vector;
use snake_core::{Control, Result};

use super::super::prepared::Prepared;
use super::super::result::Registration;
use super::super::rigid::moved;
use super::loops::{Witness, beliefs};
use super::parts::{Part, split};
use super::pose_graph::Link;
use super::{Found, Trial};

/// Number of points of a cloud that tell whether a loop is closed, and whether clouds overlap.
const PROBES: usize = 50;
/// A loop of three transforms is closed if it moves points by less than this many inlier distances.
const LOOP_DISTANCE: f64 = 3.0;
/// Transforms with at least this belief take part in the pose graph.
const LEAST_BELIEF: f64 = 0.5;
/// Clouds overlap by their poses if this share of the probes is close to the other cloud,
const LEAST_OVERLAP: f64 = 0.2;
/// closer than this many inlier distances.
const OVERLAP_DISTANCE: f64 = 2.0;

/// Poses that follow registrations.
pub(super) struct Solved {
    pub(super) found: Vec<Found>,
    /// Indices of the registrations that take part, with their beliefs and as links.
    pub(super) kept: Vec<usize>,
    pub(super) believed: Vec<f64>,
    pub(super) links: Vec<Link>,
    pub(super) parts: Vec<Part>,
}

/// Believes registrations by their own evidence and by loops, and fits the poses to them.
pub(super) fn solve(clouds: &[Prepared], found: Vec<Found>, inlier_distance: f64, control: &Control) -> Result<Solved> {
    let counter = control.begin("poses", 0);
    let probes: Vec<Vec<Vector>> = clouds.iter().map(probes).collect();
    let witnesses: Vec<Witness> = found.iter().map(|(pair, found)| witness(*pair, found)).collect();
    let all = beliefs(&witnesses, &probes, LOOP_DISTANCE * inlier_distance);
    let kept: Vec<usize> = (0..found.len()).filter(|&i| all[i] >= LEAST_BELIEF).collect();
    let links: Vec<Link> = kept.iter().map(|&i| link(found[i].0, &found[i].1)).collect();
    let believed: Vec<f64> = kept.iter().map(|&i| all[i]).collect();
    let parts = split(clouds.len(), &links, &believed, inlier_distance, &counter)?;
    Ok(Solved { found, kept, believed, links, parts })
}

impl Solved {
    /// The pairs without a link whose clouds overlap by the poses, with their transforms.
    pub(super) fn guesses(&self, clouds: &[Prepared], inlier_distance: f64) -> Vec<Trial> {
        let linked: HashSet<[usize; 2]> = self.links.iter().map(|link| [link.source, link.target]).collect();
        let mut guesses: Vec<Trial> = Vec::new();
        for part in &self.parts {
            for (at, &source) in part.clouds.iter().enumerate() {
                for (before, &target) in part.clouds[..at].iter().enumerate() {
                    if linked.contains(&[source, target]) {
                        continue;
                    }
                    let guess = part.poses[before].inverse() * part.poses[at];
                    let probes = probes(&clouds[source]);
                    let is_close = |probe: &&Vector| {
                        clouds[target].scan.voxels.distance(&moved(&guess, probe)) < OVERLAP_DISTANCE * inlier_distance
                    };
                    let close = probes.iter().filter(is_close).count();
                    if close as f64 >= LEAST_OVERLAP * probes.len() as f64 {
                        guesses.push(([source, target], Some(guess.into())));
                    }
                }
            }
        }
        guesses.sort_by_key(|(pair, _)| *pair);
        guesses
    }

    /// The registrations, in which `more` that are reliable replace those of the same pairs.
    pub(super) fn with_reliable(self, more: Vec<Found>) -> Vec<Found> {
        let more: Vec<Found> = more.into_iter().filter(|(_, found)| found.is_reliable).collect();
        let replaced: HashSet<[usize; 2]> = more.iter().map(|(pair, _)| *pair).collect();
        let mut all: Vec<Found> = self.found.into_iter().filter(|(pair, _)| !replaced.contains(pair)).collect();
        all.extend(more);
        all.sort_by_key(|(pair, _)| *pair);
        all
    }
}

fn probes(cloud: &Prepared) -> Vec<Vector> {
    let points = &cloud.scan.voxels.points;
    points.iter().step_by(points.len().div_ceil(PROBES).max(1)).copied().collect()
}

fn witness([source, target]: [usize; 2], found: &Registration) -> Witness {
    let t_target_source = *found.t_target_source.isometry();
    Witness { source, target, t_target_source, confidence: found.confidence }
}

fn link([source, target]: [usize; 2], found: &Registration) -> Link {
    let information = Matrix6::from_fn(|row, column| found.information[row][column]);
    Link { source, target, t_target_source: *found.t_target_source.isometry(), information }
}
