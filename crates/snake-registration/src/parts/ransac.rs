//! RANSAC: the transform with the most inliers.

use nalgebra::IsometryMatrix3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::parts::rigid::{best_fit, check_pairs, moved};
use snake_core::{Control, Counter};
use snake_core::{Error, Result};
use snake_geometry::{Point, RigidTransform, Vector, setters, vector};

/// Samples of one random stream; a stream is drawn by one thread.
const SAMPLES_PER_STREAM: usize = 512;
/// Streams between two checks of the stopping criterion. The number is fixed, so results do not depend on the threads.
const STREAMS_PER_ROUND: usize = 16;

/// Options of [`ransac`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RansacOptions {
    /// A correspondence is an inlier of a transform that brings its points closer than this, in cloud units.
    pub inlier_distance: f64,
    /// A sample is rejected if an edge has different lengths in source and target: the ratio of the shorter to the
    /// longer length must be at least this, 0 to 1.
    pub edge_length_ratio: f64,
    /// Maximum number of samples; a sample is three correspondences.
    pub max_iterations: usize,
    /// The search stops when, with this probability, one of the samples had inliers only.
    pub confidence: f64,
    /// Seed of the samples.
    pub seed: u64,
}

setters!(RansacOptions {
    inlier_distance: f64 => with_inlier_distance,
    edge_length_ratio: f64 => with_edge_length_ratio,
    max_iterations: usize => with_max_iterations,
    confidence: f64 => with_confidence,
    seed: u64 => with_seed,
});

impl Default for RansacOptions {
    fn default() -> Self {
        Self { inlier_distance: 0.05, edge_length_ratio: 0.9, max_iterations: 100_000, confidence: 0.999, seed: 0 }
    }
}

impl RansacOptions {
    pub(crate) fn check(&self) -> Result<()> {
        let error = |name, value: f64, allowed| Err(Error::Option { name, value: value.to_string(), allowed });
        if !(self.inlier_distance > 0.0 && self.inlier_distance.is_finite()) {
            return error("inlier_distance", self.inlier_distance, "above 0 (cloud units)");
        }
        if !(0.0..=1.0).contains(&self.edge_length_ratio) {
            return error("edge_length_ratio", self.edge_length_ratio, "0 to 1");
        }
        if !(0.0..1.0).contains(&self.confidence) {
            return error("confidence", self.confidence, "0 or more, below 1");
        }
        match self.max_iterations {
            1..=100_000_000 => Ok(()),
            n => Err(Error::Option { name: "max_iterations", value: n.to_string(), allowed: "1 to 100000000" }),
        }
    }
}

/// A transform and its inliers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Consensus {
    /// Maps source points to the target frame.
    pub t_target_source: RigidTransform,
    /// Indices of the inliers, ascending.
    pub inliers: Vec<usize>,
    /// Root mean square distance of the inliers, in cloud units; 0 without inliers.
    pub rmse: f64,
}

/// The rigid transform from `source` `(N, 3)` to `target` `(N, 3)`, row i to row i, with the most inliers: RANSAC
/// (Fischler and Bolles 1981) over samples of three correspondences.
///
/// As in Open3D, a sample must have similar edge lengths in both clouds and must consist of inliers of its own
/// transform. The best transform is fitted to its inliers by least squares, repeatedly while that improves it.
///
/// The result depends on the seed and not on the number of threads. It is `None` when no sample passes the checks: with
/// fewer than three correspondences, with collinear points, or when nothing fits.
///
/// # Errors
/// [`Error::Input`] when the arrays differ in length or have a coordinate that is not finite; [`Error::Option`] when an
/// option is outside its range.
pub fn ransac(source: &[Point], target: &[Point], options: &RansacOptions) -> Result<Option<Consensus>> {
    check_pairs(source, target)?;
    options.check()?;
    let pairs: Vec<Pair> = source.iter().zip(target).map(|(&s, &t)| (vector(s), vector(t))).collect();
    let best = best_transform(&pairs, options, &Control::default())?;
    Ok(best.map(|transform| consensus(&pairs, &transform, options.inlier_distance)))
}

/// [`ransac`] for options that were checked.
pub(crate) fn best_transform(
    pairs: &[Pair],
    options: &RansacOptions,
    control: &Control,
) -> Result<Option<IsometryMatrix3<f64>>> {
    let counter = control.begin("RANSAC", options.max_iterations);
    let best = best_sample(pairs, options, &counter)?;
    Ok(best.map(|best| refit(pairs, best, options.inlier_distance).transform))
}

/// The inliers of a transform.
pub(crate) fn consensus(pairs: &[Pair], transform: &IsometryMatrix3<f64>, inlier_distance: f64) -> Consensus {
    let inliers: Vec<usize> =
        (0..pairs.len()).filter(|&i| squared_distance(transform, &pairs[i]) < inlier_distance.powi(2)).collect();
    // The sum of no floats is -0.
    let sum = inliers.iter().fold(0.0, |sum, &i| sum + squared_distance(transform, &pairs[i]));
    let rmse = (sum / inliers.len().max(1) as f64).sqrt();
    Consensus { t_target_source: (*transform).into(), inliers, rmse }
}

/// A source point and its partner in the target.
pub(crate) type Pair = (Vector, Vector);

/// A transform and its score.
#[derive(Clone, Copy)]
struct Hypothesis {
    transform: IsometryMatrix3<f64>,
    num_inliers: usize,
    squared_residual: f64,
}

impl Hypothesis {
    fn new(pairs: &[Pair], transform: IsometryMatrix3<f64>, inlier_distance: f64) -> Self {
        let distances = pairs.iter().map(|pair| squared_distance(&transform, pair));
        let (num_inliers, squared_residual) = distances
            .filter(|distance| *distance < inlier_distance.powi(2))
            .fold((0, 0.0), |(count, sum), distance| (count + 1, sum + distance));
        Self { transform, num_inliers, squared_residual }
    }

    /// Whether it has more inliers, or as many with a smaller residual.
    fn is_better_than(&self, other: &Option<Self>) -> bool {
        other.is_none_or(|other| {
            self.num_inliers > other.num_inliers
                || self.num_inliers == other.num_inliers && self.squared_residual < other.squared_residual
        })
    }
}

fn best_sample(pairs: &[Pair], options: &RansacOptions, counter: &Counter) -> Result<Option<Hypothesis>> {
    let mut best: Option<Hypothesis> = None;
    let mut drawn = 0;
    while pairs.len() >= 3 && drawn < options.max_iterations {
        let streams = (0..STREAMS_PER_ROUND).into_par_iter().map(|stream| {
            let first = drawn + stream * SAMPLES_PER_STREAM;
            let count = options.max_iterations.saturating_sub(first).min(SAMPLES_PER_STREAM);
            counter.check()?;
            let best = best_of_stream(pairs, options, (first / SAMPLES_PER_STREAM) as u64, count);
            counter.add(count);
            Ok(best)
        });
        // The order of the streams makes the first of equally good samples win.
        for found in streams.collect::<Result<Vec<_>>>()?.into_iter().flatten() {
            if found.is_better_than(&best) {
                best = Some(found);
            }
        }
        drawn += STREAMS_PER_ROUND * SAMPLES_PER_STREAM;
        let inlier_ratio = best.map_or(0.0, |best| best.num_inliers as f64 / pairs.len() as f64);
        let none_of_inliers = (1.0 - inlier_ratio.powi(3)).powf(drawn as f64);
        if none_of_inliers <= 1.0 - options.confidence {
            counter.set_total(drawn.min(options.max_iterations));
            break;
        }
        // This many samples are enough unless a better transform is found; infinite without inliers.
        let enough = ((1.0 - options.confidence).ln() / (1.0 - inlier_ratio.powi(3)).ln()).abs();
        counter.set_total(options.max_iterations.min(drawn.max(enough as usize)));
    }
    Ok(best)
}

fn best_of_stream(pairs: &[Pair], options: &RansacOptions, stream: u64, count: usize) -> Option<Hypothesis> {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(stream);
    let mut best = None;
    for _ in 0..count {
        let sample = [(); 3].map(|()| pairs[rng.random_range(0..pairs.len())]);
        if !edges_agree(&sample, options.edge_length_ratio) {
            continue;
        }
        let Some(transform) = best_fit(sample.iter().copied()) else { continue };
        if sample.iter().any(|pair| squared_distance(&transform, pair) >= options.inlier_distance.powi(2)) {
            continue;
        }
        let found = Hypothesis::new(pairs, transform, options.inlier_distance);
        if found.is_better_than(&best) {
            best = Some(found);
        }
    }
    best
}

/// Whether the three edges have similar lengths in source and target. An edge of length 0 never agrees.
fn edges_agree(sample: &[Pair; 3], ratio: f64) -> bool {
    [(0, 1), (1, 2), (2, 0)].into_iter().all(|(a, b)| {
        let [in_source, in_target] =
            [(sample[a].0 - sample[b].0).norm_squared(), (sample[a].1 - sample[b].1).norm_squared()];
        let (shorter, longer) = (in_source.min(in_target), in_source.max(in_target));
        shorter > 0.0 && shorter >= longer * ratio * ratio
    })
}

/// Fits the transform to its inliers by least squares, while that improves it.
fn refit(pairs: &[Pair], mut best: Hypothesis, inlier_distance: f64) -> Hypothesis {
    // Each step gains inliers or lowers the residual, so the loop ends; the limit is for changes by rounding alone.
    for _ in 0..50 {
        let is_inlier = |pair: &&Pair| squared_distance(&best.transform, pair) < inlier_distance.powi(2);
        let Some(transform) = best_fit(pairs.iter().filter(is_inlier).copied()) else { break };
        let found = Hypothesis::new(pairs, transform, inlier_distance);
        if !found.is_better_than(&Some(best)) {
            break;
        }
        best = found;
    }
    best
}

fn squared_distance(transform: &IsometryMatrix3<f64>, (source, target): &Pair) -> f64 {
    (moved(transform, source) - target).norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parts::rigid::tests::{random_points, random_transform};
    use snake_core::Progress;

    /// `count` correspondences of which the first `inliers` fit a transform, up to noise of 0.005 along each axis.
    fn problem(seed: u64, count: usize, inliers: usize) -> (Vec<Point>, Vec<Point>, IsometryMatrix3<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let truth = random_transform(&mut rng);
        let source = random_points(&mut rng, count);
        let elsewhere = random_points(&mut rng, count);
        let noise = random_points(&mut rng, count);
        let target = (0..count).map(|i| {
            let partner = vector(if i < inliers { source[i] } else { elsewhere[i] });
            (moved(&truth, &partner) + 0.005 * vector(noise[i])).map(|v| v as f32).into()
        });
        let target = target.collect();
        (source, target, truth)
    }

    const OPTIONS: RansacOptions = RansacOptions {
        inlier_distance: 0.02,
        edge_length_ratio: 0.9,
        max_iterations: 100_000,
        confidence: 0.999,
        seed: 0,
    };

    #[test]
    fn the_truth_is_found_among_outliers() {
        for outlier_percent in [0, 50, 70, 80, 90] {
            for seed in 0..10 {
                let inliers = 300 - 3 * outlier_percent;
                let (source, target, truth) = problem(seed, 300, inliers);
                let found = ransac(&source, &target, &OPTIONS).unwrap().unwrap();
                let right = found.inliers.iter().filter(|&&i| i < inliers).count();
                assert!(right == inliers && found.inliers.len() <= inliers + 3, "{outlier_percent} % seed {seed}");
                let moved_by = |t: RigidTransform| vector(t.apply([0.5, -0.5, 0.7]));
                let error = (moved_by(found.t_target_source) - moved_by(truth.into())).norm();
                assert!(error < 0.004, "{outlier_percent} % seed {seed}: {error}");
                assert!((0.001..0.009).contains(&found.rmse), "{}", found.rmse);
            }
        }
    }

    #[test]
    fn threads_do_not_matter_but_the_seed_does() {
        let (source, target, _) = problem(3, 200, 0);
        let with = |threads, seed| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            // Noise, where chance decides what is best.
            let options = RansacOptions { max_iterations: 20_000, seed, inlier_distance: 0.3, ..OPTIONS };
            pool.install(|| ransac(&source, &target, &options).unwrap())
        };
        let one = with(1, 0);
        assert!(one.is_some());
        for threads in [2, 3, 7] {
            assert_eq!(one, with(threads, 0), "{threads} threads");
        }
        assert!((1..5).any(|seed| with(1, seed) != one));
    }

    #[test]
    fn the_iterations_are_bounded_and_end_early() {
        // Only 3 of 2000 correspondences fit, and one sample does not find them.
        let (source, target, _) = problem(4, 2000, 3);
        let one = RansacOptions { max_iterations: 1, inlier_distance: 1e-6, ..OPTIONS };
        assert_eq!(ransac(&source, &target, &one).unwrap(), None);
        // All correspondences fit, so the first round is enough.
        let (source, target, _) = problem(4, 2000, 2000);
        let many = RansacOptions { max_iterations: 100_000_000, ..OPTIONS };
        assert_eq!(ransac(&source, &target, &many).unwrap().unwrap().inliers.len(), 2000);
        let pairs: Vec<Pair> = source.iter().zip(&target).map(|(&s, &t)| (vector(s), vector(t))).collect();
        let progress = Progress::default();
        best_transform(&pairs, &many, &Control::new().progress(&progress)).unwrap().unwrap();
        let stage = progress.stage().unwrap();
        assert_eq!((stage.done, stage.total), (8192, 8192));
    }

    #[test]
    fn degenerate_correspondences_have_no_transform() {
        let line: Vec<Point> = (0..20).map(|i| [i as f32, 2.0 * i as f32, 0.0]).collect();
        for points in [vec![], vec![[1.0; 3]; 2], vec![[1.0; 3]; 50], line] {
            assert_eq!(ransac(&points, &points, &OPTIONS).unwrap(), None);
        }
        assert_eq!(consensus(&[], &IsometryMatrix3::identity(), 1.0).rmse.to_string(), "0");
        // A plane has one, and it is a rotation.
        let plane: Vec<Point> = (0..25).map(|i| [(i % 5) as f32, (i / 5) as f32, 0.0]).collect();
        let found = ransac(&plane, &plane, &OPTIONS).unwrap().unwrap();
        assert_eq!(found.inliers.len(), 25);
        assert!((found.t_target_source.to_matrix()[2][2] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn bad_options_and_points_are_refused() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        for (options, name) in [
            (RansacOptions { inlier_distance: 0.0, ..OPTIONS }, "inlier_distance"),
            (RansacOptions { inlier_distance: f64::NAN, ..OPTIONS }, "inlier_distance"),
            (RansacOptions { edge_length_ratio: 1.1, ..OPTIONS }, "edge_length_ratio"),
            (RansacOptions { max_iterations: 0, ..OPTIONS }, "max_iterations"),
            (RansacOptions { confidence: 1.0, ..OPTIONS }, "confidence"),
        ] {
            assert!(ransac(&points, &points, &options).unwrap_err().to_string().contains(name));
        }
        assert!(ransac(&points, &points[1..], &OPTIONS).is_err());
        assert!(ransac(&points, &[[f32::INFINITY; 3]; 3], &OPTIONS).is_err());
    }
}
