//! Several poses of the source in the target, such as of equal parts in a bin.

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::cloud::planes::PlanePair;
use crate::cloud::surface::{Surface, coarse_step};
use crate::options::PairOptions;
use crate::result::{Instance, Matches, Registration};
use crate::rigid::{displacement, moved};
use crate::steps::Pair;
use crate::steps::judge::{judge_counted, less_confident};
use crate::steps::refine::Candidate;
use crate::steps::refine::icp::{iterate, symmetric_icp};
use crate::steps::votes::{Vote, Votes, votes};
use snake_core::{Control, Error, Result};
use snake_geometry::{Vector, least_spread};

/// Number of poses that are compared for each instance, at most. Set for time.
const TRIED: usize = 40;
/// Distance between pairs of ICP, round by round. A vote is off by up to a tenth of the part. Unit: inlier distances.
/// Set by hand.
const ROUNDS: [f64; 3] = [4.0, 2.0, 1.0];
/// Number of ICP steps of a round. Set for time.
const STEPS: usize = 10;
/// Two instances share at most this much of the target's voxels that the smaller explains. Unit: share of the voxels.
/// Set by hand: parts that touch share some.
const MAX_SHARED: f64 = 0.2;
/// Number of poses that are judged for each instance, at most. Set for time.
const JUDGED: usize = 2;
/// An instance has this share of the score of the best. Set by hand: parts lie on each other.
const MIN_SCORE: f64 = 0.4;

/// Number of ICP steps at the end, at most.
const ICP_STEPS: usize = 30;

/// A pose with the voxels of the target that it explains, ascending.
struct Placed {
    candidate: Candidate,
    explained: Vec<usize>,
}

impl Placed {
    fn new(pair: &Pair, transform: IsometryMatrix3<f64>, votes: &Votes, step: usize) -> Self {
        let [source, target] = pair.surfaces();
        let agreement = Surface::agreement(source, target, &transform, step);
        let mut explained: Vec<usize> =
            (0..source.points.len()).filter_map(|index| source.partner(index, target, &transform)).collect();
        explained.sort_unstable();
        explained.dedup();
        let (t_target_source, num_agreeing) = (transform.into(), votes.agreeing(&transform).count());
        Self { candidate: Candidate::new(t_target_source, num_agreeing, 0.0, agreement), explained }
    }

    fn transform(&self) -> &IsometryMatrix3<f64> {
        self.candidate.t_target_source.isometry()
    }

    fn score(&self) -> f64 {
        self.candidate.score()
    }

    /// Whether two poses explain the same part of the target.
    fn overlaps(&self, other: &Self) -> bool {
        let shared = self.explained.iter().filter(|voxel| other.explained.binary_search(voxel).is_ok()).count();
        let smaller = self.explained.len().min(other.explained.len());
        shared as f64 > MAX_SHARED * smaller as f64
    }
}

/// The registration by the most confident of the poses that do not overlap, with all of them.
///
/// # Errors
/// The errors of [`register_with`](crate::register_with).
pub(super) fn register_instances(pair: &Pair, pair_options: &PairOptions, control: &Control) -> Result<Registration> {
    let pair = &pair.with_target_space();
    let votes = votes(pair, control)?;
    let placed = placed(pair, &votes, TRIED * pair_options.instances, control)?;
    let counter = control.begin("instances", pair_options.instances);
    let (mut reliable, mut doubtful) = (Vec::new(), Vec::new());
    for rough in placed.iter().take_while(|rough| rough.score() > MIN_SCORE * placed[0].score()) {
        let is_enough = reliable.len() == pair_options.instances;
        if is_enough || reliable.len() + doubtful.len() == JUDGED * pair_options.instances {
            break;
        }
        if is_taken(rough, &reliable) {
            continue;
        }
        let refined = symmetric_icp(pair.surfaces(), *rough.transform(), pair.criteria().gravity, ICP_STEPS, &counter)?;
        let refined = Placed::new(pair, refined, &votes, 1);
        // Of many poses that are judged, one looks right by chance.
        let registration = less_confident(judge_placed(pair, &votes, &refined, &placed)?);
        if is_taken(&refined, &reliable) {
            continue;
        }
        if registration.verdict.is_reliable {
            counter.add(1);
            reliable.push((refined, registration));
        } else {
            doubtful.push((refined, registration));
        }
    }
    collected(reliable, doubtful, pair_options)
}

/// Whether one of the poses explains what this one does.
fn is_taken(placed: &Placed, others: &[(Placed, Registration)]) -> bool {
    others.iter().any(|(other, _)| other.overlaps(placed))
}

/// The poses that get most votes, after ICP, best first.
fn placed(pair: &Pair, votes: &Votes, count: usize, control: &Control) -> Result<Vec<Placed>> {
    let [source, target] = pair.surfaces();
    let distance = pair.criteria().inlier_distance;
    let wide = ROUNDS.map(|factor| pair.surfaces_within(factor * distance));
    let step = coarse_step(source.points.len());
    let coarse: Vec<Vector> = source.points.iter().step_by(step).copied().collect();
    let guesses = votes.poses(count);
    let counter = control.begin("ICP", guesses.len());
    let refined = guesses.into_par_iter().map(|guess| {
        counter.add(1);
        let mut transform = guess;
        for [source, target] in &wide {
            let pairs = |transform: &IsometryMatrix3<f64>| agreeing_pairs(source, target, transform, step);
            let steps = (STEPS, target.grid.distance());
            transform = iterate(pairs, transform, pair.criteria().gravity, steps, &counter)?;
        }
        Ok((transform, Surface::agreement(source, target, &transform, step).fit()))
    });
    let mut refined = refined.collect::<Result<Vec<_>>>()?;
    refined.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut distinct: Vec<IsometryMatrix3<f64>> = Vec::new();
    for (transform, _) in refined {
        if distinct.iter().all(|other| displacement(&transform, other, &coarse) > 2.0 * distance) {
            distinct.push(transform);
        }
    }
    let mut placed: Vec<Placed> =
        distinct.into_par_iter().map(|transform| Placed::new(pair, transform, votes, step)).collect();
    placed.sort_by(|a, b| b.score().total_cmp(&a.score()));
    Ok(placed)
}

/// Every `step`-th point of the source and the tangent plane of the nearest target point, where
/// their normals agree: the floor must not attract the sides of a part.
fn agreeing_pairs(source: &Surface, target: &Surface, transform: &IsometryMatrix3<f64>, step: usize) -> Vec<PlanePair> {
    let pair = |index: usize| {
        let (partner, point) = (source.partner(index, target, transform)?, moved(transform, &source.points[index]));
        let normal = target.normals[partner];
        Some(PlanePair { point, normal, distance: normal.dot(&(target.points[partner] - point)) })
    };
    (0..source.points.len()).step_by(step).filter_map(pair).collect()
}

/// The verdict about a pose. Its rivals explain the same part of the target.
fn judge_placed(pair: &Pair, votes: &Votes, best: &Placed, placed: &[Placed]) -> Result<Registration> {
    let distance = 2.0 * pair.criteria().inlier_distance;
    let points = pair.surfaces()[0].points;
    let is_other =
        |other: &&Placed| displacement(other.transform(), best.transform(), points) > distance && other.overlaps(best);
    let rivals = placed.iter().filter(is_other).map(|rival| rival.candidate).take(2);
    let candidates: Vec<Candidate> = std::iter::once(best.candidate).chain(rivals).collect();
    let agreeing: Vec<_> = votes.agreeing(best.transform()).collect();
    let target = pair.surfaces()[1].points;
    let explained: Vec<Vector> = best.explained.iter().map(|&voxel| target[voxel]).collect();
    let residual = |vote: &&Vote| (moved(best.transform(), &vote.source) - vote.target).norm_squared();
    let squared = agreeing.iter().map(residual).sum::<f64>();
    let counts = Matches {
        num_matches: votes.all.len(),
        num_inliers: agreeing.len(),
        rmse: (squared / agreeing.len().max(1) as f64).sqrt(),
        num_agreeing: agreeing.len(),
        num_rival_agreeing: candidates[1..].iter().map(|rival| rival.num_inliers).max().unwrap_or(0),
        spread: least_spread(&explained),
        pairs: agreeing.iter().map(|vote| [vote.source, vote.target].map(|end| end.map(|v| v as f32).into())).collect(),
    };
    judge_counted(pair, &candidates, counts, |candidate| candidate.num_inliers)
}

/// The registration by the most confident pose, with all poses that do not overlap.
fn collected(
    mut chosen: Vec<(Placed, Registration)>,
    mut doubtful: Vec<(Placed, Registration)>,
    pair_options: &PairOptions,
) -> Result<Registration> {
    let most_confident =
        |a: &(_, Registration), b: &(_, Registration)| b.1.verdict.confidence.total_cmp(&a.1.verdict.confidence);
    doubtful.sort_by(most_confident);
    for one in doubtful {
        if chosen.len() < pair_options.instances && !is_taken(&one.0, &chosen) {
            chosen.push(one);
        }
    }
    chosen.sort_by(most_confident);
    let instance = |(_, one): &(_, Registration)| Instance {
        t_target_source: one.t_target_source,
        verdict: one.verdict.clone(),
        fit: one.fit,
    };
    let instances: Vec<Instance> = chosen.iter().map(instance).collect();
    let Some((_, mut first)) = chosen.into_iter().next() else {
        return Err(Error::NoTransform { reason: "no point pairs of the source are alike in the target".into() });
    };
    let (asked, count) = (pair_options.instances, instances.iter().filter(|one| one.verdict.is_reliable).count());
    if count < asked {
        first.verdict.notes.push(format!("{count} reliable instances of {asked} were found"));
    }
    first.hypotheses.truncate(pair_options.hypotheses);
    Ok(Registration { instances, ..first })
}
