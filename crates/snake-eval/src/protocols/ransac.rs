//! RANSAC as in the 3DMatch benchmark: the transform with the most inliers.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use snake_core::{Error, Result};
use snake_geometry::{Point, RigidTransform, Vector, check_pairs, options, vector};
use snake_registration::kabsch;

/// Samples of one random stream; a stream is drawn by one thread.
const SAMPLES_PER_STREAM: usize = 512;
/// Streams between two checks of the stopping criterion. The number is fixed, so results do not
/// depend on the threads.
const STREAMS_PER_ROUND: usize = 16;

options! {
    /// Options of [`ransac`].
    pub struct RansacOptions {
        /// Distance in cloud units below which a correspondence is an inlier of a transform, above
        /// 0.
        inlier_distance, with_inlier_distance: f64 = 0.05;
        /// Smallest ratio of the shorter to the longer length of an edge in source and target;
        /// samples below are rejected.
        edge_length_ratio, with_edge_length_ratio: f64 = 0.9, from 0 to 1;
        /// Maximum number of samples; a sample is three correspondences.
        max_iterations, with_max_iterations: usize = 100_000, from 1 to 100000000;
        /// The search stops when, with this probability, one of the samples had inliers only; below
        /// 1.
        confidence, with_confidence: f64 = 0.999, from 0 to 1;
        /// Seed of the samples.
        seed, with_seed: u64 = 0;
    }
}

impl RansacOptions {
    fn check(&self) -> Result<()> {
        self.check_ranges()?;
        let refused = |name, value: f64, allowed| Err(Error::Option { name, value: value.to_string(), allowed });
        if !(self.inlier_distance > 0.0 && self.inlier_distance.is_finite()) {
            return refused("inlier_distance", self.inlier_distance, "above 0 (cloud units)");
        }
        if self.confidence >= 1.0 {
            return refused("confidence", self.confidence, "0 or more, below 1");
        }
        Ok(())
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

/// The rigid transform from `source` `(N, 3)` to `target` `(N, 3)`, row i to row i, with the most
/// inliers: RANSAC (Fischler and Bolles 1981) over samples of three correspondences.
///
/// As in Open3D, a sample must have similar edge lengths in both clouds and must consist of inliers
/// of its own transform. The best transform is fitted to its inliers by least squares, repeatedly
/// while that improves it.
///
/// The result depends on the seed and not on the number of threads. It is `None` when no sample
/// passes the checks: with fewer than three correspondences, with collinear points, or when nothing
/// fits.
///
/// ```
/// use snake_eval::{RansacOptions, ransac};
/// use snake_geometry::RigidTransform;
/// let source = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 1.0, 1.0]];
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_target_source = RigidTransform::from_matrix(rows)?;
/// let mut target = source.map(|point| t_target_source.apply(point));
/// target[4] = [9.0, 9.0, 9.0]; // a wrong correspondence
/// let consensus = ransac(&source, &target, &RansacOptions::default())?.expect("four correspondences agree");
/// assert_eq!(consensus.inliers, [0, 1, 2, 3]);
/// # Ok::<(), snake_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] when the arrays differ in length or have a coordinate that is not finite;
/// [`Error::Option`] when an option is outside its range.
pub fn ransac(source: &[Point], target: &[Point], options: &RansacOptions) -> Result<Option<Consensus>> {
    options.check()?;
    let problem = Problem::new(source, target, options)?;
    let best = problem.best_sample().map(|best| problem.refit(best));
    Ok(best.map(|best| problem.consensus(&best.transform)))
}

/// Correspondences and the options of the search.
struct Problem<'a> {
    source: &'a [Point],
    target: &'a [Point],
    /// The correspondences in f64.
    pairs: Vec<Correspondence>,
    options: &'a RansacOptions,
}

/// A source point and its partner in the target.
type Correspondence = (Vector, Vector);

/// A transform and its score.
#[derive(Clone, Copy)]
struct Hypothesis {
    transform: RigidTransform,
    num_inliers: usize,
    squared_residual: f64,
}

impl Hypothesis {
    /// Whether it has more inliers, or as many with a smaller residual.
    fn is_better_than(&self, other: &Option<Self>) -> bool {
        other.is_none_or(|other| {
            self.num_inliers > other.num_inliers
                || self.num_inliers == other.num_inliers && self.squared_residual < other.squared_residual
        })
    }
}

impl<'a> Problem<'a> {
    fn new(source: &'a [Point], target: &'a [Point], options: &'a RansacOptions) -> Result<Self> {
        check_pairs(source, target)?;
        let pairs = source.iter().zip(target).map(|(&s, &t)| (vector(s), vector(t))).collect();
        Ok(Self { source, target, pairs, options })
    }

    fn is_inlier(&self, transform: &RigidTransform, pair: &Correspondence) -> bool {
        squared_distance(transform, pair) < self.options.inlier_distance.powi(2)
    }

    /// The least-squares transform of some of the correspondences; `None` if they are collinear.
    fn fit(&self, indices: &[usize]) -> Option<RigidTransform> {
        let [source, target] =
            [self.source, self.target].map(|points| indices.iter().map(|&i| points[i]).collect::<Vec<Point>>());
        kabsch(&source, &target).ok()
    }

    fn score(&self, transform: RigidTransform) -> Hypothesis {
        let distances = self.pairs.iter().map(|pair| squared_distance(&transform, pair));
        let (num_inliers, squared_residual) = distances
            .filter(|distance| *distance < self.options.inlier_distance.powi(2))
            .fold((0, 0.0), |(count, sum), distance| (count + 1, sum + distance));
        Hypothesis { transform, num_inliers, squared_residual }
    }

    /// The best of all samples.
    fn best_sample(&self) -> Option<Hypothesis> {
        let RansacOptions { max_iterations, confidence, .. } = *self.options;
        let mut best: Option<Hypothesis> = None;
        let mut drawn = 0;
        while self.pairs.len() >= 3 && drawn < max_iterations {
            let streams = (0..STREAMS_PER_ROUND).into_par_iter().map(|stream| {
                let first = drawn + stream * SAMPLES_PER_STREAM;
                let count = max_iterations.saturating_sub(first).min(SAMPLES_PER_STREAM);
                self.best_of_stream((first / SAMPLES_PER_STREAM) as u64, count)
            });
            // The order of the streams makes the first of equally good samples win.
            for hypothesis in streams.collect::<Vec<_>>().into_iter().flatten() {
                if hypothesis.is_better_than(&best) {
                    best = Some(hypothesis);
                }
            }
            drawn += STREAMS_PER_ROUND * SAMPLES_PER_STREAM;
            let inlier_ratio = best.map_or(0.0, |best| best.num_inliers as f64 / self.pairs.len() as f64);
            let none_of_inliers = (1.0 - inlier_ratio.powi(3)).powf(drawn as f64);
            if none_of_inliers <= 1.0 - confidence {
                break;
            }
        }
        best
    }

    fn best_of_stream(&self, stream: u64, count: usize) -> Option<Hypothesis> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed);
        rng.set_stream(stream);
        let mut best = None;
        for _ in 0..count {
            let indices = [(); 3].map(|()| rng.random_range(0..self.pairs.len()));
            let sample = indices.map(|index| self.pairs[index]);
            if !edges_agree(&sample, self.options.edge_length_ratio) {
                continue;
            }
            let Some(transform) = self.fit(&indices) else { continue };
            if !sample.iter().all(|pair| self.is_inlier(&transform, pair)) {
                continue;
            }
            let hypothesis = self.score(transform);
            if hypothesis.is_better_than(&best) {
                best = Some(hypothesis);
            }
        }
        best
    }

    /// Fits the transform to its inliers by least squares, while that improves it.
    fn refit(&self, mut best: Hypothesis) -> Hypothesis {
        // Each step gains inliers or lowers the residual, so the loop ends; the limit is for
        // changes by rounding alone.
        for _ in 0..50 {
            let Some(transform) = self.fit(&self.inliers(&best.transform)) else { break };
            let refitted = self.score(transform);
            if !refitted.is_better_than(&Some(best)) {
                break;
            }
            best = refitted;
        }
        best
    }

    fn inliers(&self, transform: &RigidTransform) -> Vec<usize> {
        (0..self.pairs.len()).filter(|&i| self.is_inlier(transform, &self.pairs[i])).collect()
    }

    fn consensus(&self, transform: &RigidTransform) -> Consensus {
        let inliers = self.inliers(transform);
        // The sum of no floats is -0.
        let sum = inliers.iter().fold(0.0, |sum, &i| sum + squared_distance(transform, &self.pairs[i]));
        let rmse = (sum / inliers.len().max(1) as f64).sqrt();
        Consensus { t_target_source: *transform, inliers, rmse }
    }
}

/// Whether the three edges have similar lengths in source and target. An edge of length 0 never
/// agrees.
fn edges_agree(sample: &[Correspondence; 3], ratio: f64) -> bool {
    [(0, 1), (1, 2), (2, 0)].into_iter().all(|(a, b)| {
        let [in_source, in_target] =
            [(sample[a].0 - sample[b].0).norm_squared(), (sample[a].1 - sample[b].1).norm_squared()];
        let (shorter, longer) = (in_source.min(in_target), in_source.max(in_target));
        shorter > 0.0 && shorter >= longer * ratio * ratio
    })
}

fn squared_distance(transform: &RigidTransform, (source, target): &Correspondence) -> f64 {
    (transform.apply_vector(source) - target).norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{IsometryMatrix3, Vector3};

    fn random_points(rng: &mut ChaCha8Rng, count: usize) -> Vec<Point> {
        (0..count).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect()
    }

    /// `count` correspondences of which the first `inliers` fit a transform, up to noise of 0.005
    /// along each axis.
    fn problem(seed: u64, count: usize, inliers: usize) -> (Vec<Point>, Vec<Point>, RigidTransform) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut vector3 = |size: f64| Vector3::from_fn(|_, _| size * rng.random_range(-1.0..1.0));
        let truth = RigidTransform::from(IsometryMatrix3::new(vector3(3.0), vector3(3.0)));
        let source = random_points(&mut rng, count);
        let elsewhere = random_points(&mut rng, count);
        let noise = random_points(&mut rng, count);
        let target = (0..count).map(|i| {
            let partner = vector(if i < inliers { source[i] } else { elsewhere[i] });
            (truth.apply_vector(&partner) + 0.005 * vector(noise[i])).map(|v| v as f32).into()
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
                let consensus = ransac(&source, &target, &OPTIONS).unwrap().unwrap();
                let right = consensus.inliers.iter().filter(|&&i| i < inliers).count();
                assert!(right == inliers && consensus.inliers.len() <= inliers + 3, "{outlier_percent} % seed {seed}");
                let moved_by = |t: RigidTransform| vector(t.apply([0.5, -0.5, 0.7]));
                let error = (moved_by(consensus.t_target_source) - moved_by(truth)).norm();
                assert!(error < 0.004, "{outlier_percent} % seed {seed}: {error}");
                assert!((0.001..0.009).contains(&consensus.rmse), "{}", consensus.rmse);
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
        // All correspondences fit, so the first round is enough: all samples would take minutes.
        let (source, target, _) = problem(4, 2000, 2000);
        let many = RansacOptions { max_iterations: 100_000_000, ..OPTIONS };
        assert_eq!(ransac(&source, &target, &many).unwrap().unwrap().inliers.len(), 2000);
    }

    #[test]
    fn degenerate_correspondences_have_no_transform() {
        let line: Vec<Point> = (0..20).map(|i| [i as f32, 2.0 * i as f32, 0.0]).collect();
        for points in [vec![], vec![[1.0; 3]; 2], vec![[1.0; 3]; 50], line] {
            assert_eq!(ransac(&points, &points, &OPTIONS).unwrap(), None);
        }
        let none = Problem::new(&[], &[], &OPTIONS).unwrap().consensus(&RigidTransform::identity());
        assert_eq!(none.rmse.to_string(), "0");
        // A plane has one, and it is a rotation.
        let plane: Vec<Point> = (0..25).map(|i| [(i % 5) as f32, (i / 5) as f32, 0.0]).collect();
        let consensus = ransac(&plane, &plane, &OPTIONS).unwrap().unwrap();
        assert_eq!(consensus.inliers.len(), 25);
        assert!((consensus.t_target_source.to_matrix()[2][2] - 1.0).abs() < 1e-9);
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
