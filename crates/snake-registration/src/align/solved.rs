//! From registrations of pairs to poses, and from poses to further pairs.

use std::collections::HashSet;

use nalgebra::Matrix6;
use rayon::prelude::*;

use snake_core::space::Vector;
use snake_core::{Control, Result};

use super::super::prepared::{Prepared, PreparedClouds};
use super::super::result::Registration;
use super::super::rigid::moved;
use super::super::surface::Surface;
use super::loops::{Witness, doubts};
use super::parts::{Part, split};
use super::pose_graph::Link;
use super::refine::refine;
use super::{AlignOptions, Found, Trial};

/// Number of points of a cloud that tell whether a loop is closed, and whether clouds overlap.
const PROBES: usize = 50;
/// A loop of three transforms is closed if it moves points by less than this many inlier distances.
const LOOP_DISTANCE: f64 = 3.0;
/// Transforms with at most this probability of being wrong take part in the pose graph.
const MOST_DOUBT: f64 = 0.5;
/// Clouds overlap enough for a registration if this share of the probes is close to the other cloud by the poses,
const LEAST_OVERLAP: f64 = 0.2;
/// and enough to refine the poses if this share is,
const LEAST_COMMON: f64 = 0.1;
/// closer than this many inlier distances.
const OVERLAP_DISTANCE: f64 = 2.0;

/// Poses that follow registrations.
pub(super) struct Solved {
    pub(super) found: Vec<Found>,
    /// Indices of the registrations that take part, with the probabilities that they are wrong and as links.
    pub(super) kept: Vec<usize>,
    pub(super) doubts: Vec<f64>,
    pub(super) links: Vec<Link>,
    pub(super) parts: Vec<Part>,
}

/// Believes registrations by their own evidence and by loops, and fits the poses to them.
pub(super) fn solve(
    prepared: &PreparedClouds,
    found: Vec<Found>,
    options: &AlignOptions,
    control: &Control,
) -> Result<Solved> {
    let PreparedClouds { clouds, inlier_distance } = prepared;
    let (inlier_distance, gravity) = (*inlier_distance, options.register.gravity.map(|axis| axis.unit()));
    let counter = control.begin("poses", 0);
    let probes: Vec<Vec<Vector>> = clouds.iter().map(probes).collect();
    let witnesses: Vec<Witness> = found.iter().map(|(pair, found)| witness(*pair, found)).collect();
    let all = doubts(&witnesses, &probes, LOOP_DISTANCE * inlier_distance);
    let kept: Vec<usize> = (0..found.len()).filter(|&i| all[i] <= MOST_DOUBT).collect();
    let links: Vec<Link> = kept.iter().map(|&i| link(found[i].0, &found[i].1)).collect();
    let doubts: Vec<f64> = kept.iter().map(|&i| all[i]).collect();
    let mut parts = split(clouds.len(), &links, &doubts, inlier_distance, &counter)?;
    if options.register.refine_steps > 0 {
        let surfaces: Vec<Surface> =
            clouds.par_iter().map(|cloud| cloud.surface(cloud.viewpoint.is_some(), inlier_distance)).collect();
        for part in &mut parts {
            let pairs = overlapping(part, clouds, LEAST_COMMON, inlier_distance);
            refine(part, &pairs, &surfaces, &probes, gravity, &counter)?;
            part.measure_errors(&links);
        }
    }
    Ok(Solved { found, kept, doubts, links, parts })
}

impl Solved {
    /// The pairs without a link in use whose clouds overlap by the poses, with their transforms.
    pub(super) fn guesses(&self, clouds: &[Prepared], inlier_distance: f64) -> Vec<Trial> {
        let used = self.parts.iter().flat_map(|part| part.links.iter().map(|(index, _)| &self.links[*index]));
        let linked: HashSet<[usize; 2]> = used.map(|link| [link.source, link.target]).collect();
        let mut guesses: Vec<Trial> = Vec::new();
        for part in &self.parts {
            for [at, before] in overlapping(part, clouds, LEAST_OVERLAP, inlier_distance) {
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

/// The pairs `[source, target]` of clouds, by their places in the part, that overlap by its poses.
fn overlapping(part: &Part, clouds: &[Prepared], least: f64, inlier_distance: f64) -> Vec<[usize; 2]> {
    let all = (1..part.clouds.len()).flat_map(|at| (0..at).map(move |before| [at, before])).collect::<Vec<_>>();
    let overlap = |&[at, before]: &[usize; 2]| {
        let transform = part.poses[before].inverse() * part.poses[at];
        let target = &clouds[part.clouds[before]].scan.voxels;
        let probes = probes(&clouds[part.clouds[at]]);
        let is_close =
            |probe: &&Vector| target.distance(&moved(&transform, probe)) < OVERLAP_DISTANCE * inlier_distance;
        probes.iter().filter(is_close).count() as f64 >= least * probes.len() as f64
    };
    all.into_par_iter().filter(overlap).collect()
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
