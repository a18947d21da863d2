//! Transforms on which many matches agree, from a graph of compatible matches.
//!
//! Two matches are compatible if one rigid transform can satisfy both: their points are equally far apart in both clouds,
//! and their normals have the same angles with each other and with the line between the points. Right matches are
//! compatible with each other, and wrong ones by chance only. Two matches therefore belong together if many others are
//! compatible with both (second-order consistency, SC²-PCR, Chen et al. 2022).

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use crate::pair::match_graph::{Criteria, Graph, Match};
use crate::parts::rigid::{best_fit, best_fit_about, moved};
use snake_core::{Control, Result};
use snake_geometry::Vector;

/// Number of matches from which transforms are estimated: those with the most support in the graph.
const MAX_SEEDS: usize = 200;
/// Number of neighbours in the graph that a seed's first transform is fitted to.
const GROUP: usize = 20;
/// Maximum number of least-squares fits to the inliers.
const MAX_REFITS: usize = 5;
/// Number of points that tell whether two transforms differ.
const PROBES: usize = 50;

/// A transform with the support of the matches.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Supported {
    pub(crate) transform: IsometryMatrix3<f64>,
    /// The sum over the inliers of `1 - d²/τ²`, with the inlier distance τ.
    support: f64,
}

/// At most `count` distinct transforms, the best supported first.
pub(crate) fn hypotheses(
    matches: &[Match],
    criteria: &Criteria,
    count: usize,
    control: &Control,
) -> Result<Vec<IsometryMatrix3<f64>>> {
    let counter = control.begin("consistency", matches.len());
    let graph = Graph::new(matches, criteria, &counter)?;
    let seeds = graph.seeds(MAX_SEEDS);
    let found = seeds.par_iter().map(|&seed| {
        counter.check()?;
        Ok(of_group(&graph.group(seed, GROUP), matches, criteria))
    });
    let mut found: Vec<Supported> = found.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    // The order of the seeds decides between equals.
    found.sort_by(|a, b| b.support.total_cmp(&a.support));
    Ok(distinct(&found, matches, criteria.inlier_distance, count))
}

/// The transform of a group of matches, fitted to all inliers while that improves it.
fn of_group(group: &[usize], matches: &[Match], criteria: &Criteria) -> Option<Supported> {
    let fit = |pairs: &[(Vector, Vector)]| match criteria.gravity {
        Some(axis) => best_fit_about(&axis, pairs),
        None => best_fit(pairs.iter().copied()),
    };
    let pairs: Vec<_> = group.iter().map(|&i| (matches[i].source, matches[i].target)).collect();
    let (mut best, mut inliers) = Supported::new(fit(&pairs)?, matches, criteria);
    for _ in 0..MAX_REFITS {
        let Some(transform) = fit(&inliers) else { break };
        let (found, of_found) = Supported::new(transform, matches, criteria);
        if found.support <= best.support {
            break;
        }
        (best, inliers) = (found, of_found);
    }
    Some(best)
}

impl Supported {
    /// The support of a transform, and its inliers as pairs of points.
    fn new(transform: IsometryMatrix3<f64>, matches: &[Match], criteria: &Criteria) -> (Self, Vec<(Vector, Vector)>) {
        let (mut support, mut inliers) = (0.0, Vec::new());
        for found in matches {
            if let Some(squared) = found.squared_residual(&transform, criteria) {
                support += 1.0 - squared / criteria.inlier_distance.powi(2);
                inliers.push((found.source, found.target));
            }
        }
        (Self { transform, support }, inliers)
    }
}

/// The first `count` transforms that differ: they move the matches' points by more than two inlier distances (root mean
/// square) relative to each other.
fn distinct(found: &[Supported], matches: &[Match], inlier_distance: f64, count: usize) -> Vec<IsometryMatrix3<f64>> {
    let probes: Vec<Vector> = matches.iter().step_by(matches.len().div_ceil(PROBES).max(1)).map(|m| m.source).collect();
    let mut kept: Vec<IsometryMatrix3<f64>> = Vec::new();
    for Supported { transform, .. } in found {
        if kept.len() == count {
            break;
        }
        if kept.iter().all(|other| displacement(transform, other, &probes) > 2.0 * inlier_distance) {
            kept.push(*transform);
        }
    }
    kept
}

/// The root mean square distance between the positions of points under two transforms.
pub(crate) fn displacement(a: &IsometryMatrix3<f64>, b: &IsometryMatrix3<f64>, points: &[Vector]) -> f64 {
    let squared = points.iter().map(|point| (moved(a, point) - moved(b, point)).norm_squared());
    (squared.sum::<f64>() / points.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::parts::rigid::tests::{random_points, random_transform};
    use snake_geometry::vector;

    const CRITERIA: Criteria = Criteria { inlier_distance: 0.03, signed: true, gravity: None };

    /// `inliers` right matches with noise of 0.005, then random ones; normals too.
    fn problem(seed: u64, inliers: usize, outliers: usize, truth: &IsometryMatrix3<f64>) -> Vec<Match> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut vectors = |count| random_points(&mut rng, count).into_iter().map(vector).collect::<Vec<Vector>>();
        let count = inliers + outliers;
        let (source, normals, noise, elsewhere, other_normals) =
            (vectors(count), vectors(count), vectors(count), vectors(count), vectors(count));
        let of = |i: usize| {
            let (source, source_normal) = (source[i], normals[i].normalize());
            let (target, target_normal) = if i < inliers {
                (moved(truth, &source) + 0.005 * noise[i], truth.rotation * source_normal)
            } else {
                (moved(truth, &elsewhere[i]), other_normals[i].normalize())
            };
            Match { source, target, source_normal, target_normal }
        };
        (0..count).map(of).collect()
    }

    fn error(a: &IsometryMatrix3<f64>, b: &IsometryMatrix3<f64>) -> f64 {
        displacement(a, b, &[Vector::new(0.5, -0.5, 0.7), Vector::new(-0.9, 0.1, 0.0), Vector::y()])
    }

    #[test]
    fn three_percent_of_right_matches_are_enough() {
        for seed in 0..10 {
            let truth = random_transform(&mut ChaCha8Rng::seed_from_u64(100 + seed));
            let matches = problem(seed, 24, 800, &truth);
            let found = hypotheses(&matches, &CRITERIA, 5, &Control::default()).unwrap();
            assert!(error(&found[0], &truth) < 0.01, "seed {seed}");
            let unsigned = Criteria { signed: false, ..CRITERIA };
            let flipped: Vec<Match> = matches
                .iter()
                .enumerate()
                .map(|(i, m)| if i % 2 == 0 { Match { source_normal: -m.source_normal, ..*m } } else { *m })
                .collect();
            let found = hypotheses(&flipped, &unsigned, 5, &Control::default()).unwrap();
            assert!(error(&found[0], &truth) < 0.01, "seed {seed}");
        }
    }

    #[test]
    fn a_known_axis_is_kept() {
        let truth = IsometryMatrix3::new(Vector::new(1.0, 2.0, 3.0), Vector::new(0.0, 0.0, 2.5));
        let matches = problem(3, 10, 800, &truth);
        let criteria = Criteria { gravity: Some(Vector::z()), ..CRITERIA };
        let found = hypotheses(&matches, &criteria, 1, &Control::default()).unwrap();
        assert!(error(&found[0], &truth) < 0.02);
        assert!((found[0].rotation * Vector::z() - Vector::z()).norm() < 1e-12);
    }

    #[test]
    fn transforms_are_distinct_and_do_not_depend_on_threads() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let [first, second] = [(); 2].map(|()| random_transform(&mut rng));
        let mut matches = problem(1, 60, 200, &first);
        matches.extend(problem(2, 40, 0, &second));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| hypotheses(&matches, &CRITERIA, 2, &Control::default()).unwrap())
        };
        let found = run(1);
        assert!(found.len() == 2 && error(&found[0], &first) < 0.01 && error(&found[1], &second) < 0.01);
        assert_eq!(found, run(3));
    }

    #[test]
    fn few_or_degenerate_matches_are_no_panic() {
        let run = |matches: &[Match]| hypotheses(matches, &CRITERIA, 3, &Control::default()).unwrap().len();
        let matches = problem(0, 2, 0, &IsometryMatrix3::identity());
        assert_eq!((run(&[]), run(&matches[..1]), run(&matches)), (0, 0, 0));
        assert_eq!(run(&[matches[0]; 30]), 0);
        let line = |i: usize| Match {
            source: 0.1 * i as f64 * Vector::x(),
            target: 0.1 * i as f64 * Vector::y(),
            ..matches[0]
        };
        let line: Vec<Match> =
            (0..30).map(|i| Match { source_normal: Vector::z(), target_normal: Vector::z(), ..line(i) }).collect();
        assert_eq!(run(&line), 0);
        let _ = ChaCha8Rng::seed_from_u64(0).random::<u8>();
    }
}
