//! Step 4: transforms on which many matches agree, from a graph of compatible matches.
//!
//! Two matches are compatible if one rigid transform can satisfy both: their points are equally far apart in both
//! clouds, and their normals have the same angles with each other and with the line between the points. Correct
//! matches are compatible with each other; wrong matches are compatible only by chance. Two matches therefore belong
//! together if many others are compatible with both (second-order consistency, SC²-PCR, Chen et al. 2022).

mod graph;

use nalgebra::IsometryMatrix3;

use crate::rigid::{best_fit, best_fit_about, displacement};
use crate::steps::matches::{Criteria, Match};
use crate::steps::refine;
use graph::Graph;
use snake_core::{Control, Error, Result};
use snake_geometry::{RigidTransform, Vector, try_in_parallel};

/// Number of transforms that `register` compares on the clouds, at most. Half and twice change no outcome.
pub(crate) const CANDIDATES: usize = 20;
/// Number of matches that are compared, at most. The graph has a bit for every pair of matches, 50
/// MB for this number. It is also the largest value of the option `max_matches`.
const MAX_MATCHES: usize = 20_000;
/// Number of matches from which transforms are estimated: those with the most support in the graph. Half and twice
/// change no outcome.
const MAX_SEEDS: usize = 200;
/// Number of neighbours in the graph to which a seed's first transform is fitted. Half and twice change no outcome.
const GROUP: usize = 20;
/// Number of least-squares fits to the inliers, at most. Half and twice change no outcome.
const MAX_REFITS: usize = 5;
/// Number of points that tell whether two transforms differ. Half and twice change no outcome.
pub(crate) const PROBES: usize = 50;

/// A transform with the support of the matches.
#[derive(Debug, Clone, Copy)]
struct Supported {
    transform: IsometryMatrix3<f64>,
    /// The sum over the inliers of `1 - d²/τ²`, with the inlier distance τ.
    support: f64,
}

/// At most `count` distinct transforms on which matches agree, the best supported first; none if no
/// three matches fit one.
///
/// # Errors
/// [`Error::Input`] when there are more matches than the graph can hold, or one is not finite;
/// [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn consensus(
    matches: &[Match],
    criteria: &Criteria,
    count: usize,
    control: &Control,
) -> Result<Vec<RigidTransform>> {
    check_matches(matches)?;
    let counter = control.begin("consistency", matches.len());
    let graph = Graph::new(matches, criteria, &counter)?;
    let seeds = graph.seeds(MAX_SEEDS);
    let supported = try_in_parallel(seeds.iter(), |&seed| {
        counter.check()?;
        Ok(fit_group(&graph.group(seed, GROUP), matches, criteria))
    });
    let mut supported: Vec<Supported> = supported?.into_iter().flatten().collect();
    // The sort is stable: the order of the seeds decides ties.
    supported.sort_by(|a, b| b.support.total_cmp(&a.support));
    let distinct = distinct(&supported, matches, criteria.inlier_distance, count);
    Ok(distinct.into_iter().map(RigidTransform::from).collect())
}

/// Refuses too many matches, and matches that are not finite.
fn check_matches(matches: &[Match]) -> Result<()> {
    let refused = |reason| Err(Error::Input { what: "matches", reason });
    if matches.len() > MAX_MATCHES {
        return refused(format!("{} of them; at most {} can be compared", matches.len(), MAX_MATCHES));
    }
    let is_finite = |matched: &Match| {
        let vectors = [matched.source, matched.target, matched.source_normal, matched.target_normal];
        vectors.iter().flatten().all(|v| v.is_finite())
    };
    match matches.iter().position(|matched| !is_finite(matched)) {
        Some(bad) => refused(format!("match {bad} is not finite")),
        None => Ok(()),
    }
}

/// Fits a transform to a group of matches, and again to all inliers while the support grows.
fn fit_group(group: &[usize], matches: &[Match], criteria: &Criteria) -> Option<Supported> {
    let fit = |pairs: &[(Vector, Vector)]| match criteria.gravity {
        Some(axis) => best_fit(pairs.iter().copied())
            .filter(|transform| criteria.is_level(&transform.rotation))
            .or_else(|| best_fit_about(&axis, pairs)),
        None => best_fit(pairs.iter().copied()),
    };
    let pairs: Vec<_> = group.iter().map(|&i| (matches[i].source, matches[i].target)).collect();
    let (mut best, mut inliers) = Supported::new(fit(&pairs)?, matches, criteria);
    for _ in 0..MAX_REFITS {
        let Some(transform) = fit(&inliers) else { break };
        let (refitted, refitted_inliers) = Supported::new(transform, matches, criteria);
        if refitted.support <= best.support {
            break;
        }
        (best, inliers) = (refitted, refitted_inliers);
    }
    Some(best)
}

impl Supported {
    /// The support of a transform, and its inliers as pairs of points.
    fn new(transform: IsometryMatrix3<f64>, matches: &[Match], criteria: &Criteria) -> (Self, Vec<(Vector, Vector)>) {
        let (mut support, mut inliers) = (0.0, Vec::new());
        for matched in matches {
            if let Some(squared) = matched.squared_residual(&transform, criteria) {
                support += 1.0 - squared / criteria.inlier_distance.powi(2);
                inliers.push((matched.source, matched.target));
            }
        }
        (Self { transform, support }, inliers)
    }
}

/// The first `count` transforms that move the matches' source points to different places.
fn distinct(
    supported: &[Supported],
    matches: &[Match],
    inlier_distance: f64,
    count: usize,
) -> Vec<IsometryMatrix3<f64>> {
    let probes: Vec<Vector> = matches.iter().step_by(matches.len().div_ceil(PROBES).max(1)).map(|m| m.source).collect();
    let mut kept: Vec<IsometryMatrix3<f64>> = Vec::new();
    for Supported { transform, .. } in supported {
        if kept.len() == count {
            break;
        }
        if kept.iter().all(|other| displacement(transform, other, &probes) > refine::MIN_DIFFERENCE * inlier_distance) {
            kept.push(*transform);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;

    use super::*;
    use crate::rigid::moved;
    use crate::rigid::tests::{random_points, random_transform};
    use snake_geometry::vector;

    const CRITERIA: Criteria = Criteria { inlier_distance: 0.03, signed: true, gravity: None };

    /// `inliers` correct matches with noise of 0.005, then random ones; normals too.
    fn problem(seed: u64, inliers: usize, outliers: usize, truth: &IsometryMatrix3<f64>) -> Vec<Match> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut vectors = |count| random_points(&mut rng, count).into_iter().map(vector).collect::<Vec<Vector>>();
        let count = inliers + outliers;
        let (source, normals, noise, elsewhere, other_normals) =
            (vectors(count), vectors(count), vectors(count), vectors(count), vectors(count));
        let one = |i: usize| {
            let (source, source_normal) = (source[i], normals[i].normalize());
            let (target, target_normal) = if i < inliers {
                (moved(truth, &source) + 0.005 * noise[i], truth.rotation * source_normal)
            } else {
                (moved(truth, &elsewhere[i]), other_normals[i].normalize())
            };
            Match { source, target, source_normal, target_normal }
        };
        (0..count).map(one).collect()
    }

    fn error(a: &IsometryMatrix3<f64>, b: &IsometryMatrix3<f64>) -> f64 {
        displacement(a, b, &[Vector::new(0.5, -0.5, 0.7), Vector::new(-0.9, 0.1, 0.0), Vector::y()])
    }

    #[test]
    fn three_percent_of_right_matches_are_enough() {
        for seed in 0..10 {
            let truth = random_transform(&mut ChaCha8Rng::seed_from_u64(100 + seed));
            let matches = problem(seed, 24, 800, &truth);
            let transforms = consensus(&matches, &CRITERIA, 5, &Control::default()).unwrap();
            assert!(error(transforms[0].isometry(), &truth) < 0.01, "seed {seed}");
            let unsigned = Criteria { signed: false, ..CRITERIA };
            let flipped: Vec<Match> = matches
                .iter()
                .enumerate()
                .map(|(i, m)| if i % 2 == 0 { Match { source_normal: -m.source_normal, ..*m } } else { *m })
                .collect();
            let transforms = consensus(&flipped, &unsigned, 5, &Control::default()).unwrap();
            assert!(error(transforms[0].isometry(), &truth) < 0.01, "seed {seed}");
        }
    }

    #[test]
    fn a_known_axis_has_a_tolerance() {
        let tilted = |degrees: f64| {
            let tilt = IsometryMatrix3::rotation(degrees.to_radians() * Vector::x());
            let truth = tilt * IsometryMatrix3::new(Vector::new(1.0, 2.0, 3.0), Vector::new(0.0, 0.0, 2.5));
            let matches = problem(3, 30, 800, &truth);
            let criteria = Criteria { gravity: Some(Vector::z()), ..CRITERIA };
            let transforms = consensus(&matches, &criteria, 1, &Control::default()).unwrap();
            (error(transforms[0].isometry(), &truth), criteria.is_level(&transforms[0].isometry().rotation))
        };
        // A rotation about the axis alone would be off by 0.05.
        for degrees in [0.0, 3.0] {
            let (error, is_level) = tilted(degrees);
            assert!(error < 0.01 && is_level, "{error}");
        }
        let (error, is_level) = tilted(30.0);
        assert!(error > 0.1 && is_level, "{error}");
    }

    #[test]
    fn transforms_are_distinct_and_do_not_depend_on_threads() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let [first, second] = [(); 2].map(|()| random_transform(&mut rng));
        let mut matches = problem(1, 60, 200, &first);
        matches.extend(problem(2, 40, 0, &second));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| consensus(&matches, &CRITERIA, 2, &Control::default()).unwrap())
        };
        let transforms = run(1);
        let errors = transforms.iter().zip([&first, &second]).map(|(found, truth)| error(found.isometry(), truth));
        assert!(transforms.len() == 2 && errors.fold(0.0, f64::max) < 0.01);
        assert_eq!(transforms, run(3));
    }

    #[test]
    fn few_or_degenerate_matches_are_no_panic() {
        let run = |matches: &[Match]| consensus(matches, &CRITERIA, 3, &Control::default()).unwrap().len();
        let matches = problem(0, 2, 0, &IsometryMatrix3::identity());
        assert_eq!((run(&[]), run(&matches[..1]), run(&matches)), (0, 0, 0));
        assert_eq!(run(&[matches[0]; 30]), 0);
        let refused =
            |matches: &[Match]| consensus(matches, &CRITERIA, 3, &Control::default()).unwrap_err().to_string();
        let bad = Match { target: Vector::repeat(f64::NAN), ..matches[0] };
        assert!(refused(&[matches[0], bad]).contains("match 1 is not finite"));
        assert!(refused(&vec![matches[0]; 20_001]).contains("20001 of them"));
        let line = |i: usize| Match {
            source: 0.1 * i as f64 * Vector::x(),
            target: 0.1 * i as f64 * Vector::y(),
            ..matches[0]
        };
        let line: Vec<Match> =
            (0..30).map(|i| Match { source_normal: Vector::z(), target_normal: Vector::z(), ..line(i) }).collect();
        assert_eq!(run(&line), 0);
    }
}
