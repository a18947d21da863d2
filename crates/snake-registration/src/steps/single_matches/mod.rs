//! Transforms from single matches, for pairs with too few correct matches for a consensus.
//!
//! A match of two points with normals leaves one angle open: the rotation about the normal. The
//! surroundings of the two points determine it: under the correct angle, surfaces meet surfaces, and no
//! surface lies in the free space of the other sensor. One correct match is then enough, where a
//! consensus needs three. The transforms of correct matches support each other. (SCVC, IEEE Transactions
//! on Image Processing 2024, also searches by single matches and uses free space to evaluate them.)

mod free_space;
mod surroundings;

use std::cmp::Reverse;

use nalgebra::IsometryMatrix3;

use crate::cloud::depth_image::{COARSE, DepthImage};
use crate::cloud::near_grid::NearGrid;
use crate::cloud::surface;
use crate::rigid::moved;
use crate::steps::pair::Pair;
use free_space::FreeSpace;
use snake_core::{Control, Counter, Result};
use snake_geometry::{Vector, in_parallel, some_in_parallel, try_in_parallel, vector};
use surroundings::{AZIMUTHS, Oriented, Scene, Surroundings};

/// Radius of the surroundings. Unit: inlier distances. Set by hand.
const RADIUS: f64 = 16.0;
/// Side of the cells that tell free space. Unit: inlier distances. Set by hand.
const FREE_SIDE: f64 = 1.3;
/// Step between the used voxels of a cloud. Set for time: with 1, 2 and 3, as many pairs of scenes are correct.
const SCENE_STEP: usize = 4;
/// Number of transforms that can support each other, at most: those whose surroundings fit best. Set by hand.
const MAX_VOTERS: usize = 500;
/// A transform supports another that brings the points of its match closer than this. Unit: inlier distances. Set by
/// hand.
const SUPPORT_DISTANCE: f64 = 4.0;
/// A transform supports another whose rotation differs by less than this. Unit: degrees. Set by hand: a step of the
/// azimuth is 11 degrees.
const SUPPORT_ANGLE: f64 = 20.0;

/// The transform of a match, and its points.
#[derive(Debug, Clone, Copy)]
struct Voter {
    transform: IsometryMatrix3<f64>,
    source: Vector,
    target: Vector,
    /// How well the surroundings of the points fit.
    score: i32,
}

/// The transforms of the single matches whose surroundings fit best, best first.
pub(crate) struct Voters {
    all: Vec<Voter>,
    support_distance: f64,
}

impl Voters {
    /// The transforms of matches, given as keypoint indices `[source, target]`. The list is empty unless
    /// both sensors are known: without free space, the surroundings are not distinctive enough.
    pub(crate) fn new(pair: &Pair, matches: &[[usize; 2]], control: &Control) -> Result<Self> {
        let num_keypoints = pair.clouds().map(|cloud| cloud.keypoints.len());
        let counter = control.begin("surroundings", num_keypoints.iter().sum());
        let [source, target] = [0, 1].map(|side| places(pair, side, matches, &counter));
        let (source, target) = (source?, target?);
        let vote = |&[from, to]: &[usize; 2]| best_voter(source[from].as_ref()?, target[to].as_ref()?);
        let mut all: Vec<Voter> = some_in_parallel(matches.iter(), vote);
        all.retain(|voter| pair.criteria().is_level(&voter.transform.rotation));
        // The sort is stable: the order of the matches decides ties.
        all.sort_by_key(|voter| Reverse(voter.score));
        all.truncate(MAX_VOTERS);
        Ok(Self { all, support_distance: SUPPORT_DISTANCE * pair.criteria().inlier_distance })
    }

    /// Number of single matches whose transforms are close to this one.
    pub(crate) fn support(&self, transform: &IsometryMatrix3<f64>) -> usize {
        self.all.iter().filter(|voter| self.supports(voter, transform)).count()
    }

    fn supports(&self, voter: &Voter, transform: &IsometryMatrix3<f64>) -> bool {
        (moved(transform, &voter.source) - voter.target).norm() < self.support_distance
            && transform.rotation.angle_to(&voter.transform.rotation) < SUPPORT_ANGLE.to_radians()
    }

    /// At most `count` distinct transforms, the best supported first.
    pub(crate) fn transforms(&self, count: usize) -> Vec<IsometryMatrix3<f64>> {
        let support: Vec<usize> = in_parallel(self.all.iter(), |voter| self.support(&voter.transform));
        let mut order: Vec<usize> = (0..self.all.len()).collect();
        // The better score decides ties.
        order.sort_by_key(|&voter| Reverse(support[voter]));
        let mut distinct: Vec<IsometryMatrix3<f64>> = Vec::new();
        for voter in order.into_iter().map(|voter| &self.all[voter]) {
            if distinct.len() < count && !distinct.iter().any(|other| self.supports(voter, other)) {
                distinct.push(voter.transform);
            }
        }
        distinct
    }
}

/// A keypoint with its normal and surroundings.
type Place = (Oriented, Surroundings);

/// The keypoints of source (0) or target (1) that are matched and have a normal, by their index.
fn places(pair: &Pair, side: usize, matches: &[[usize; 2]], counter: &Counter) -> Result<Vec<Option<Place>>> {
    let cloud = pair.clouds()[side];
    let distance = pair.criteria().inlier_distance;
    let voxels = &cloud.voxels.voxels.points;
    let margin = surface::DEPTH_MARGIN * distance;
    let Some(viewpoint) = pair.surfaces()[side].viewpoint() else { return Ok(vec![None; cloud.keypoints.len()]) };
    let image = DepthImage::new(voxels, viewpoint, margin, COARSE);
    let sample: Vec<Vector> = voxels.iter().step_by(SCENE_STEP).copied().collect();
    let scene = Scene {
        normals: cloud.voxels.normals.iter().step_by(SCENE_STEP).copied().collect(),
        grid: NearGrid::new(&sample, RADIUS * distance),
        free: FreeSpace::new(voxels, &image, FREE_SIDE * distance),
    };
    let mut is_matched = vec![false; cloud.keypoints.len()];
    matches.iter().for_each(|matched| is_matched[matched[side]] = true);
    let place = |(&(point, voxel), &is_matched): (&(_, usize), &bool)| {
        let place = Oriented { point: vector(point), normal: cloud.voxels.normals[voxel] };
        counter.check()?;
        counter.add(1);
        if !is_matched || place.normal.norm_squared() < 0.5 {
            return Ok(None);
        }
        let around = Surroundings::new(&place, &scene, distance);
        Ok(Some((place, if side == 0 { around } else { around.dilated() })))
    };
    try_in_parallel(cloud.keypoints.iter().zip(&is_matched), place)
}

/// The transform of a match with the best rotation about the normal.
fn best_voter((from, around): &Place, (to, target): &Place) -> Option<Voter> {
    let score = |turn: u32| (around.score(target, turn), Reverse(turn));
    let (score, Reverse(turn)) = (0..AZIMUTHS).map(score).max()?;
    let transform = from.laid_on(to, f64::from(turn) / f64::from(AZIMUTHS));
    Some(Voter { transform, source: from.point, target: to.point, score })
}
