//! Semantic consistency: the agreement of keypoints with human annotations (KeypointNet), and between two poses of a
//! body (SMPL).

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::num::NonZeroUsize;
use std::ops::AddAssign;

use rand::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Coordinate, check_thresholds};
use snake_core::{Control, Error, Result};
use snake_geometry::{Neighbors, Point, check_points, nearest_points, vector};

/// Number of neighbours of a point in the graph of geodesic distances (SNAKE section 4.1, KeypointNet).
const GRAPH_NEIGHBORS: usize = 20;
/// The most edges of that graph, at about 50 bytes an edge.
const MAX_EDGES: usize = 50_000_000;
/// The most geodesic distances that are returned, 2 GiB.
const MAX_DISTANCES: usize = 1 << 28;
/// Number of keypoints per body in the SMPL protocol.
const SMPL_KEYPOINTS: usize = 20;

/// The distance between points that no path of the neighbourhood graph connects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Unreachable {
    /// Infinite: such points never match.
    #[default]
    Strict,
    /// 0, as in the released code through an old scikit-learn: such points always match. The paper's figures need it.
    PaperCompatible,
}

/// The variant of the SMPL protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SmplProtocol {
    /// The detected keypoints only, at most 20 per body; the figure is the mean IoU of the pairs.
    Strict,
    /// As in the released code: random samples of the body fill up fewer than 20 keypoints. Counts accumulate over the
    /// pairs, and the figure is the mean of the accumulated IoU after each pair.
    PaperCompatible {
        /// Seed of the random samples.
        seed: u64,
    },
}

/// Matches of keypoints at one threshold. Add the counts of several shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct MatchCounts {
    /// Ground-truth keypoints (NP).
    pub ground_truth: usize,
    /// Detected keypoints that match no ground-truth keypoint (FP).
    pub false_positives: usize,
    /// Ground-truth keypoints that match no detected keypoint (FN).
    pub false_negatives: usize,
}

impl MatchCounts {
    /// Intersection over union, `(NP - FN) / (NP + FP)`; 0 without keypoints. KeypointNet's figure of a class is the
    /// IoU of the counts summed over its shapes.
    pub fn iou(&self) -> f64 {
        (self.ground_truth - self.false_negatives) as f64 / (self.ground_truth + self.false_positives).max(1) as f64
    }

    /// Share of the ground-truth keypoints that match a detected keypoint, `(NP - FN) / NP`; 0 without ground truth.
    pub fn recall(&self) -> f64 {
        (self.ground_truth - self.false_negatives) as f64 / self.ground_truth.max(1) as f64
    }

    /// The counts at one threshold, from the distance of each keypoint to the nearest keypoint of the other kind.
    fn new(found: &[f64], ground_truth: &[f64], threshold: f64) -> Self {
        let beyond = |distances: &[f64]| distances.iter().filter(|d| **d > threshold).count();
        Self { ground_truth: ground_truth.len(), false_positives: beyond(found), false_negatives: beyond(ground_truth) }
    }
}

impl AddAssign for MatchCounts {
    fn add_assign(&mut self, other: Self) {
        self.ground_truth += other.ground_truth;
        self.false_positives += other.false_positives;
        self.false_negatives += other.false_negatives;
    }
}

/// Geodesic distances `[source][point]`: shortest paths in the undirected graph that connects each point to its
/// `neighbors` nearest other points, with Euclidean edge lengths. Infinite where there is no path.
///
/// # Errors
/// [`Error::Input`] for no points, coordinates that are not finite, a source index out of range or more than 2²⁸ distances,
/// [`Error::Option`] for `neighbors` 0, or so many that all points together have more than 5 · 10⁷.
pub fn geodesic_distances<T: Coordinate>(
    points: &[[T; 3]],
    sources: &[usize],
    neighbors: usize,
) -> Result<Vec<Vec<f64>>> {
    geodesic_distances_with(points, sources, neighbors, &Control::default())
}

/// [`geodesic_distances`] with cancellation and a deadline.
///
/// # Errors
/// The errors of [`geodesic_distances`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn geodesic_distances_with<T: Coordinate>(
    points: &[[T; 3]],
    sources: &[usize],
    neighbors: usize,
    control: &Control,
) -> Result<Vec<Vec<f64>>> {
    check_points("points", points)?;
    check_indices("sources", sources, points.len())?;
    if sources.len().saturating_mul(points.len()) > MAX_DISTANCES {
        let reason = format!("{} times {} points are more than 2^28 distances", sources.len(), points.len());
        return Err(Error::Input { what: "sources", reason });
    }
    let graph = neighbor_graph(points, neighbors)?;
    let paths = |&source| control.check().map(|()| shortest_paths(&graph, source));
    sources.par_iter().map(paths).collect()
}

/// KeypointNet's counts for one shape, one for each threshold (SNAKE section 4.1).
///
/// Each detected keypoint is snapped to its nearest point of the cloud. A detected and a ground-truth keypoint match
/// when their geodesic distance in the 20-nearest-neighbour graph is at most the threshold. Several keypoints may match
/// one.
///
/// `ground_truth` holds indices into `points`; duplicates count once. The figure of a class is the
/// [`MatchCounts::iou`] of its shapes' summed counts.
///
/// # Errors
/// [`Error::Input`] for no points, coordinates that are not finite or an index out of range,
/// [`Error::Option`] for a negative threshold.
pub fn semantic_counts(
    points: &[Point],
    ground_truth: &[usize],
    found: &[Point],
    thresholds: &[f64],
    unreachable: Unreachable,
) -> Result<Vec<MatchCounts>> {
    check_thresholds("thresholds", thresholds)?;
    check_points("points", points)?;
    check_indices("ground_truth", ground_truth, points.len())?;
    let mut ground_truth = ground_truth.to_vec();
    ground_truth.sort_unstable();
    ground_truth.dedup();
    let graph = neighbor_graph(points, GRAPH_NEIGHBORS)?;
    let found = snap("found", found, points)?;
    let between = |from_start: f64| match unreachable {
        Unreachable::PaperCompatible if from_start.is_infinite() => 0.0,
        _ => from_start,
    };
    // Only rows of detected points are computed: rows of all points take quadratic memory if every point is annotated.
    let row = |&start: &usize| -> Vec<f64> {
        let distances = shortest_paths(&graph, start);
        found.iter().map(|&f| between(distances[f])).collect()
    };
    let distances: Vec<Vec<f64>> = ground_truth.par_iter().map(row).collect();
    let to_ground_truth: Vec<f64> = (0..found.len()).map(|f| smallest(distances.iter().map(|row| row[f]))).collect();
    let to_found: Vec<f64> = distances.iter().map(|row| smallest(row.iter().copied())).collect();
    Ok(thresholds.iter().map(|&t| MatchCounts::new(&to_ground_truth, &to_found, t)).collect())
}

/// The SMPL counts of one pair of bodies, one for each threshold.
///
/// `body_1` and `body_2` `(N, 3)` are the same samples of one surface in two poses, row by row. The best 20 keypoints
/// of each body, given best first, are snapped to their nearest samples. A keypoint is transferred to the same sample
/// of the other body. It matches a keypoint of that body at a Euclidean distance of at most the threshold. Body 2 is
/// the ground truth.
///
/// # Errors
/// [`Error::Input`] when the bodies differ in their number of samples, have none, or a coordinate is not finite,
/// [`Error::Option`] for a negative threshold.
pub fn smpl_pair_counts(
    body_1: &[Point],
    body_2: &[Point],
    keypoints_1: &[Point],
    keypoints_2: &[Point],
    thresholds: &[f64],
    protocol: SmplProtocol,
) -> Result<Vec<MatchCounts>> {
    check_thresholds("thresholds", thresholds)?;
    check_points("body_1", body_1)?;
    check_points("body_2", body_2)?;
    if body_1.len() != body_2.len() {
        let reason = format!("{} samples, but body_1 has {}; row i is the same place", body_2.len(), body_1.len());
        return Err(Error::Input { what: "body_2", reason });
    }
    let mut first = snap("keypoints_1", &keypoints_1[..keypoints_1.len().min(SMPL_KEYPOINTS)], body_1)?;
    let mut second = snap("keypoints_2", &keypoints_2[..keypoints_2.len().min(SMPL_KEYPOINTS)], body_2)?;
    if let SmplProtocol::PaperCompatible { seed } = protocol {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        for keypoints in [&mut first, &mut second] {
            let missing = (SMPL_KEYPOINTS - keypoints.len()).min(body_1.len());
            keypoints.extend(rand::seq::index::sample(&mut rng, body_1.len(), missing));
        }
    }
    let carried = |from: &[usize], to: &[usize], body: &[Point]| -> Vec<f64> {
        let distance = |&a: &usize, &b: &usize| (vector(body[a]) - vector(body[b])).norm();
        from.iter().map(|a| smallest(to.iter().map(|b| distance(a, b)))).collect()
    };
    let (on_body_2, on_body_1) = (carried(&first, &second, body_2), carried(&second, &first, body_1));
    Ok(thresholds.iter().map(|&t| MatchCounts::new(&on_body_2, &on_body_1, t)).collect())
}

/// The SMPL figure at one threshold from the counts of all pairs.
///
/// # Errors
/// [`Error::Input`] without pairs.
pub fn smpl_iou(pairs: &[MatchCounts], protocol: SmplProtocol) -> Result<f64> {
    if pairs.is_empty() {
        return Err(Error::Input { what: "pairs", reason: "no pairs".into() });
    }
    let mut running = MatchCounts::default();
    let mut sum = 0.0;
    for &pair in pairs {
        running += pair;
        sum += match protocol {
            SmplProtocol::Strict => pair.iou(),
            SmplProtocol::PaperCompatible { .. } => running.iou(),
        };
    }
    Ok(sum / pairs.len() as f64)
}

fn smallest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::INFINITY, f64::min)
}

fn check_indices(what: &'static str, indices: &[usize], length: usize) -> Result<()> {
    match indices.iter().find(|&&index| index >= length) {
        Some(bad) => Err(Error::Input { what, reason: format!("index {bad} is outside a cloud of {length} points") }),
        None => Ok(()),
    }
}

/// Index of the point nearest to each keypoint.
fn snap(what: &'static str, keypoints: &[Point], points: &[Point]) -> Result<Vec<usize>> {
    if keypoints.is_empty() {
        return Ok(Vec::new());
    }
    check_points(what, keypoints)?;
    Ok(nearest_points(points, keypoints)?)
}

/// For each point its neighbours in the graph and the lengths of the edges.
type Graph = Vec<Vec<(usize, f64)>>;

fn neighbor_graph<T: Coordinate>(points: &[[T; 3]], neighbors: usize) -> Result<Graph> {
    let others = neighbors.min(points.len());
    let is_small = points.len().saturating_mul(others) <= MAX_EDGES;
    let Some(with_itself) = NonZeroUsize::new(others).filter(|_| is_small).and_then(|n| n.checked_add(1)) else {
        let allowed = "1 or more, and at most 50000000 neighbours of all points together";
        return Err(Error::Option { name: "neighbors", value: neighbors.to_string(), allowed });
    };
    let tree = Neighbors::new(points.iter().map(|&p| vector(p)).collect())?;
    let nearest: Graph = tree.points.par_iter().map(|p| tree.nearest(p, with_itself)).collect();
    let mut graph = vec![Vec::new(); points.len()];
    for (point, found) in nearest.iter().enumerate() {
        // A point with more duplicates than neighbours may not find itself.
        for &(other, length) in found.iter().filter(|(other, _)| *other != point).take(neighbors) {
            graph[point].push((other, length));
            graph[other].push((point, length));
        }
    }
    Ok(graph)
}

/// An entry of the priority queue of Dijkstra's algorithm; the nearest entry is the greatest.
#[derive(PartialEq)]
struct Frontier {
    distance: f64,
    point: usize,
}

impl Eq for Frontier {}

impl Ord for Frontier {
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance)
    }
}

impl PartialOrd for Frontier {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Dijkstra's algorithm.
fn shortest_paths(graph: &Graph, source: usize) -> Vec<f64> {
    let mut distances = vec![f64::INFINITY; graph.len()];
    distances[source] = 0.0;
    let mut frontier = BinaryHeap::from([Frontier { distance: 0.0, point: source }]);
    while let Some(Frontier { distance, point }) = frontier.pop() {
        if distance > distances[point] {
            continue;
        }
        for &(other, length) in &graph[point] {
            if distance + length < distances[other] {
                distances[other] = distance + length;
                frontier.push(Frontier { distance: distances[other], point: other });
            }
        }
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rows of `length` points at unit steps, far apart.
    fn rows(length: usize) -> Vec<Point> {
        (0..2 * length).map(|i| [(i % length) as f32, (i / length) as f32 * 1e4, 0.0]).collect()
    }

    fn counts(ground_truth: usize, false_positives: usize, false_negatives: usize) -> MatchCounts {
        MatchCounts { ground_truth, false_positives, false_negatives }
    }

    #[test]
    fn geodesics_follow_the_cloud() {
        // On a ring of 12 the longest path has 6 chords and is not the diameter.
        let ring: Vec<Point> = (0..12)
            .map(|i| (f64::from(i) * std::f64::consts::TAU / 12.0).sin_cos())
            .map(|(sin, cos)| [cos as f32, sin as f32, 0.0])
            .collect();
        let chord = 2.0 * (std::f64::consts::PI / 12.0).sin();
        let rows = geodesic_distances(&ring, &[0, 3], 2).unwrap();
        for (source, row) in [0_usize, 3].into_iter().zip(&rows) {
            for (point, distance) in row.iter().enumerate() {
                let steps = source.abs_diff(point).min(12 - source.abs_diff(point));
                assert!((distance - steps as f64 * chord).abs() < 1e-6, "{source} {point}");
            }
        }
    }

    #[test]
    fn edges_go_both_ways_and_need_not_be_mutual() {
        // The nearest point of 3 is 2, and the nearest point of 2 is 1: the edge between 2 and 3 exists nevertheless.
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.5, 0.0, 0.0], [9.0, 0.0, 0.0]];
        assert_eq!(geodesic_distances(&points, &[0], 1).unwrap(), [[0.0, 1.0, 2.5, 9.0]]);
    }

    #[test]
    fn components_are_unreachable() {
        let points = rows(30);
        let distances = &geodesic_distances(&points, &[4], 20).unwrap()[0];
        assert_eq!(distances[29], 25.0);
        assert!(distances[30..].iter().all(|d| d.is_infinite()));
    }

    #[test]
    fn counts_by_hand() {
        let points = rows(30);
        let ground_truth = [10, 5, 10];
        // The keypoints snap to points 5, 12, 12 and, in the other component, 40.
        let detected = [[5.2, 0.0, 0.0], [12.4, 0.0, 0.0], [11.8, 1.0, 0.0], [10.0, 1e4, 0.0]];
        let call =
            |unreachable| semantic_counts(&points, &ground_truth, &detected, &[0.0, 1.9, 2.0], unreachable).unwrap();
        let strict = call(Unreachable::Strict);
        assert_eq!(strict, [counts(2, 3, 1), counts(2, 3, 1), counts(2, 1, 0)]);
        assert_eq!(strict[2].iou(), 2.0 / 3.0);
        assert_eq!([strict[1].recall(), strict[2].recall()], [0.5, 1.0]);
        // The point of the other component matches every keypoint.
        assert_eq!(call(Unreachable::PaperCompatible), [counts(2, 2, 0), counts(2, 2, 0), counts(2, 0, 0)]);
    }

    #[test]
    fn nothing_found_or_nothing_to_find() {
        let points = rows(30);
        for unreachable in [Unreachable::Strict, Unreachable::PaperCompatible] {
            let call =
                |truth: &[usize], found: &[Point]| semantic_counts(&points, truth, found, &[9.0], unreachable).unwrap();
            assert_eq!(call(&[1, 2], &[]), [counts(2, 0, 2)]);
            assert_eq!(call(&[], &points[..3]), [counts(0, 3, 0)]);
            assert_eq!((call(&[], &[])[0].iou(), call(&[], &[])[0].recall()), (0.0, 0.0));
        }
    }

    #[test]
    fn smpl_pairs_by_hand() {
        let body_1: Vec<Point> = (0..30).map(|i| [i as f32, 0.0, 0.0]).collect();
        let body_2: Vec<Point> = (0..30).map(|i| [0.0, 2.0 * i as f32, 0.0]).collect();
        // Keypoints are at samples 3, 8, 20 and at samples 4, 8. The distances of the first are 2, 0 and 24 on body 2;
        // those of the second are 1 and 0 on body 1.
        let (first, second) = ([body_1[3], body_1[8], body_1[20]], [body_2[4], body_2[8]]);
        let call =
            |thresholds| smpl_pair_counts(&body_1, &body_2, &first, &second, thresholds, SmplProtocol::Strict).unwrap();
        assert_eq!(call(&[0.0, 1.0, 2.0]), [counts(2, 2, 1), counts(2, 2, 0), counts(2, 1, 0)]);
        let paper = SmplProtocol::PaperCompatible { seed: 1 };
        let filled = smpl_pair_counts(&body_1, &body_2, &first, &second, &[0.0], paper).unwrap()[0];
        assert_eq!(filled.ground_truth, 20);
        assert_eq!(filled, smpl_pair_counts(&body_1, &body_2, &first, &second, &[0.0], paper).unwrap()[0]);
        let many = smpl_pair_counts(&body_1, &body_2, &body_1, &body_2, &[0.0], SmplProtocol::Strict).unwrap();
        assert_eq!(many, [counts(20, 0, 0)]);
        assert!(smpl_pair_counts(&body_1, &body_2[1..], &first, &second, &[0.0], paper).is_err());
    }

    #[test]
    fn smpl_averages_by_hand() {
        let pairs = [counts(4, 0, 0), counts(4, 4, 4)];
        assert_eq!(smpl_iou(&pairs, SmplProtocol::Strict).unwrap(), 0.5);
        // The accumulated IoU is 4 / 4, then 4 / 12.
        let paper = smpl_iou(&pairs, SmplProtocol::PaperCompatible { seed: 0 }).unwrap();
        assert!((paper - (1.0 + 1.0 / 3.0) / 2.0).abs() < 1e-12);
        assert!(smpl_iou(&[], SmplProtocol::Strict).is_err());
    }

    #[test]
    fn bad_input_is_refused() {
        let points = rows(3);
        let call = |points: &[Point], truth: usize, found: Point, threshold: f64| {
            semantic_counts(points, &[truth], &[found], &[threshold], Unreachable::Strict).map_err(|e| e.to_string())
        };
        assert_eq!(
            call(&points, 6, [0.0; 3], 0.0).unwrap_err(),
            "ground_truth: index 6 is outside a cloud of 6 points"
        );
        assert!(call(&[], 0, [0.0; 3], 0.0).is_err());
        assert!(call(&points, 0, [f32::NAN; 3], 0.0).is_err());
        assert!(call(&points, 0, [0.0; 3], -1.0).is_err());
        assert!(geodesic_distances(&points, &[0], 0).is_err());
        // More neighbours than points are all points.
        let of = |neighbors| geodesic_distances(&points, &[0], neighbors).unwrap();
        assert_eq!(of(usize::MAX), of(points.len()));
        assert_eq!(geodesic_distances(&[[1.0; 3]], &[0], 20).unwrap(), [[0.0]]);
    }
}
