//! Classical detectors for comparison: ISS, Harris 3D, SIFT 3D, surface variation, farthest-point sampling and random
//! points.
//!
//! Each returns indices of input points with a score, by falling score and, for equal scores, by rising index. Results
//! are the same for any number of threads. A [`Detector`] is one of them with its options, and [`Detector::keypoints`]
//! selects keypoints by a [`Protocol`]. Points that are not finite and [`Outliers`](snake_geometry::Outliers) are skipped. Of equal
//! points the first counts, except for random points. Indices refer to the whole cloud.

mod farthest_point;
mod harris3d;
mod iss;
mod random;
mod sift3d;
mod surface_variation;

use std::collections::HashSet;

use rand::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use snake_core::{Control, Error, Result};
use snake_geometry::{FinitePoints, Neighbors, Point, Vector, vector};

pub use farthest_point::farthest_points;
pub use harris3d::{Harris3dOptions, harris3d};
pub use iss::{Covariance, IssOptions, iss};
pub use random::random_points;
pub use sift3d::{Sift3dOptions, SiftField, sift3d};
pub use surface_variation::{SurfaceVariationOptions, surface_variation};

/// A point of the cloud with its score.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// Index into the cloud.
    pub index: usize,
    /// Strength of the response; its meaning depends on the detector.
    pub score: f64,
}

/// The rule that selects keypoints from a detector's responses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// The strongest responses. There may be fewer than asked for.
    #[default]
    Ranked,
    /// The selection for the baselines in the paper's tables (USIP's test code): a random subset of the responses,
    /// filled up with random points. Without responses it starts with the cloud's first point. It always returns the
    /// number asked for, up to the size of the cloud, but is hardly better than random points.
    Paper,
}

/// A classical detector with its options.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Detector {
    /// Intrinsic shape signatures.
    Iss(IssOptions),
    /// Harris corners of the normals.
    Harris3d(Harris3dOptions),
    /// Extrema of the differences of Gaussians of a field on the points.
    Sift3d(Sift3dOptions),
    /// Maxima of the surface variation.
    #[serde(rename = "surface-variation")]
    SurfaceVariation(SurfaceVariationOptions),
    /// Farthest-point sampling.
    FarthestPoint,
    /// Random points.
    Random,
}

impl Detector {
    /// The names that [`Detector::named`] accepts.
    pub const NAMES: [&'static str; 6] = ["iss", "harris3d", "sift3d", "surface-variation", "fps", "random"];

    /// A detector with its default options. For [`Protocol::Paper`], Harris 3D has no suppression and SIFT 3D uses the
    /// y coordinate, as in the wrapper behind the paper's tables.
    ///
    /// # Errors
    /// [`Error::Option`] for an unknown name.
    pub fn named(name: &str, protocol: Protocol) -> Result<Self> {
        let (harris, sift) = (Harris3dOptions::default(), Sift3dOptions::default());
        Ok(match (name, protocol) {
            ("iss", _) => Self::Iss(IssOptions::default()),
            ("harris3d", Protocol::Ranked) => Self::Harris3d(harris),
            ("harris3d", Protocol::Paper) => Self::Harris3d(Harris3dOptions { non_max: false, ..harris }),
            ("sift3d", Protocol::Ranked) => Self::Sift3d(sift),
            ("sift3d", Protocol::Paper) => Self::Sift3d(Sift3dOptions { field: SiftField::Y, ..sift }),
            ("surface-variation", _) => Self::SurfaceVariation(SurfaceVariationOptions::default()),
            ("fps", _) => Self::FarthestPoint,
            ("random", _) => Self::Random,
            _ => {
                let allowed = "iss, harris3d, sift3d, surface-variation, fps or random";
                return Err(Error::Option { name: "detector", value: name.into(), allowed });
            }
        })
    }

    /// `count` keypoints of a cloud `(N, 3)`. The seed determines all random choices; with [`Protocol::Ranked`] only
    /// random points use it.
    ///
    /// ```
    /// use snake_registration::detectors::{Detector, Protocol};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let keypoints = Detector::named("iss", Protocol::Ranked)?.keypoints(&points, 16, Protocol::Ranked, 0)?;
    /// assert!(keypoints.windows(2).all(|pair| pair[0].score >= pair[1].score));
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] when the cloud has no finite points or is one point repeated;
    /// [`Error::Option`] when an option is outside its range.
    pub fn keypoints(&self, points: &[Point], count: usize, protocol: Protocol, seed: u64) -> Result<Vec<Response>> {
        self.keypoints_with(points, count, protocol, seed, &Control::default())
    }

    /// [`Detector::keypoints`] with cancellation and a deadline.
    ///
    /// # Errors
    /// The errors of [`Detector::keypoints`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn keypoints_with(
        &self,
        points: &[Point],
        count: usize,
        protocol: Protocol,
        seed: u64,
        control: &Control,
    ) -> Result<Vec<Response>> {
        if count == 0 {
            return Err(Error::Option { name: "count", value: "0".into(), allowed: "1 or more" });
        }
        among_finite(points, |points| {
            let mut responses = match self {
                Self::Iss(options) => among_distinct(points, |points| iss::find(points, options, control))?,
                Self::Harris3d(options) => among_distinct(points, |points| harris3d::find(points, options, control))?,
                Self::Sift3d(options) => among_distinct(points, |points| sift3d::find(points, options, control))?,
                Self::SurfaceVariation(options) => {
                    among_distinct(points, |points| surface_variation::find(points, options, control))?
                }
                Self::FarthestPoint => return farthest_points(points, count),
                Self::Random => return random_points(points, count, seed),
            };
            match protocol {
                Protocol::Ranked => responses.truncate(count),
                Protocol::Paper => responses = random_subset(points.len(), responses, count, seed),
            }
            Ok(responses)
        })
    }
}

/// The selection of [`Protocol::Paper`].
fn random_subset(num_points: usize, mut responses: Vec<Response>, count: usize, seed: u64) -> Vec<Response> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    if responses.is_empty() {
        responses.push(Response { index: 0, score: 0.0 });
    }
    if responses.len() > count {
        return rand::seq::index::sample(&mut rng, responses.len(), count).into_iter().map(|i| responses[i]).collect();
    }
    let missing = count.min(num_points) - responses.len();
    let filling = rand::seq::index::sample(&mut rng, num_points, missing);
    responses.extend(filling.into_iter().map(|index| Response { index, score: 0.0 }));
    responses
}

/// Runs a detector on the finite points of a cloud and returns indices of the whole cloud.
fn among_finite(points: &[Point], find: impl FnOnce(&[Point]) -> Result<Vec<Response>>) -> Result<Vec<Response>> {
    let finite = FinitePoints::of("points", points)?;
    let found = find(&finite.points)?.into_iter();
    Ok(found.map(|Response { index, score }| Response { index: finite.original_index(index), score }).collect())
}

/// [`among_finite`], of the first of all equal points: a repeated point weighs as much as any other.
fn among_distinct(points: &[Point], find: impl FnOnce(&[Point]) -> Result<Vec<Response>>) -> Result<Vec<Response>> {
    among_finite(points, |points| {
        let mut seen = HashSet::with_capacity(points.len());
        // Zero and minus zero are equal.
        let is_first = |index: &usize| seen.insert(points[*index].map(|v| (v + 0.0).to_bits()));
        let firsts: Vec<usize> = (0..points.len()).filter(is_first).collect();
        if firsts.len() == points.len() {
            return find(points);
        }
        let distinct: Vec<Point> = firsts.iter().map(|&index| points[index]).collect();
        let found = find(&distinct)?.into_iter();
        Ok(found.map(|Response { index, score }| Response { index: firsts[index], score }).collect())
    })
}

/// Refuses a cloud of one point, however often it is repeated.
fn check_distinct(points: &[Point]) -> Result<()> {
    match points.iter().all(|p| *p == points[0]) {
        true => Err(Error::Input { what: "points", reason: "need at least two different points".into() }),
        false => Ok(()),
    }
}

/// Indexes a cloud of at least two different finite points.
fn index_cloud(points: &[Point]) -> Result<Neighbors> {
    check_distinct(points)?;
    Ok(Neighbors::new(points.iter().map(|&p| vector(p)).collect())?)
}

/// A value of each point, unless the call must stop.
fn each_point<T: Send>(cloud: &Neighbors, control: &Control, value: impl Fn(&Vector) -> T + Sync) -> Result<Vec<T>> {
    cloud.points.par_iter().map(|point| control.check().map(|()| value(point))).collect()
}

/// Non-maximum suppression: the indices of points that pass and whose score no point closer than `radius` exceeds.
/// Points with equal scores all stay. As in PCL and Open3D, every neighbour counts, whether it passes or not.
fn local_maxima(
    cloud: &Neighbors,
    scores: &[f64],
    radius: f64,
    min_neighbors: usize,
    control: &Control,
    passes: impl Fn(f64) -> bool + Sync,
) -> Result<Vec<Response>> {
    let is_maximum = |index: usize| {
        passes(scores[index]) && {
            let neighbors = cloud.within(&cloud.points[index], radius);
            neighbors.len() >= min_neighbors && neighbors.iter().all(|&other| scores[other] <= scores[index])
        }
    };
    let maximum = |index: usize| {
        control.check()?;
        Ok(is_maximum(index).then(|| Response { index, score: scores[index] }))
    };
    let found: Vec<Option<Response>> = (0..scores.len()).into_par_iter().map(maximum).collect::<Result<_>>()?;
    Ok(by_falling_score(found.into_iter().flatten().collect()))
}

/// Sorts by falling score and, for equal scores, by rising index.
fn by_falling_score(mut responses: Vec<Response>) -> Vec<Response> {
    responses.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.index.cmp(&b.index)));
    responses
}

#[cfg(test)]
mod tests {
    use super::*;
    use snake_geometry::Length;

    #[test]
    fn a_flat_plate_has_no_keypoints() {
        let at = |i: usize| (i % 30) as f32 * 0.1;
        let plate = |tilt: f32| -> Vec<Point> { (0..900).map(|i| [at(i), at(i / 30), tilt * at(i)]).collect() };
        let flat = plate(0.0);
        let found = [
            harris3d(&flat, &Harris3dOptions::default()).unwrap(),
            iss(&flat, &IssOptions::default()).unwrap(),
            surface_variation(&flat, &SurfaceVariationOptions::default()).unwrap(),
            sift3d(&flat, &Sift3dOptions::default()).unwrap(),
        ];
        assert_eq!(found.map(|responses| responses.len()), [0; 4]);
        // Rounded to f32, the points of a tilted plate lie a little apart from it, which ISS and the others see.
        assert!(harris3d(&plate(0.3), &Harris3dOptions::default()).unwrap().is_empty());
    }

    /// A unit cube's surface: `side`² points on each face, the edges doubled as its faces share them.
    pub(super) fn cube(side: usize) -> Vec<Point> {
        let at = |i: usize| i as f32 / (side - 1) as f32;
        let on_faces = (0..6 * side * side).map(|i| {
            let (face, row, column) = (i / (side * side), i / side % side, i % side);
            let mut point = [at(row), at(column), (face % 2) as f32];
            point.rotate_right(face / 2);
            point
        });
        let mut points: Vec<Point> = on_faces.collect();
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        points.dedup();
        points
    }

    /// The index of the corner of [`cube`] near a point, as bits of x, y and z.
    pub(super) fn corner(point: Point) -> Option<usize> {
        let near = point.iter().all(|v| !(0.25..=0.75).contains(v));
        near.then(|| point.iter().enumerate().map(|(axis, v)| usize::from(*v > 0.5) << axis).sum())
    }

    fn every_detector() -> Vec<Detector> {
        let sum = IssOptions { covariance: Covariance::AboutPoint, ..Default::default() };
        let protocols = [Protocol::Ranked, Protocol::Paper].into_iter();
        let named = protocols.flat_map(|protocol| Detector::NAMES.map(|name| Detector::named(name, protocol).unwrap()));
        named.chain([Detector::Iss(sum)]).collect()
    }

    #[test]
    fn the_papers_harris_is_random_and_its_sift_is_of_y() {
        let named = |name| Detector::named(name, Protocol::Paper).unwrap();
        assert!(matches!(named("harris3d"), Detector::Harris3d(Harris3dOptions { non_max: false, .. })));
        assert!(matches!(named("sift3d"), Detector::Sift3d(Sift3dOptions { field: SiftField::Y, .. })));
        assert_eq!(named("iss"), Detector::named("iss", Protocol::Ranked).unwrap());
    }

    #[test]
    fn every_detector_gives_different_indices_by_falling_score() {
        let points = cube(12);
        for detector in every_detector() {
            let found = detector.keypoints(&points, 20, Protocol::Ranked, 0).unwrap();
            assert!(!found.is_empty() && found.len() <= 20, "{detector:?}");
            assert!(found.windows(2).all(|pair| pair[0].score >= pair[1].score), "{detector:?}");
            let mut indices: Vec<_> = found.iter().map(|response| response.index).collect();
            indices.sort_unstable();
            indices.dedup();
            assert_eq!(indices.len(), found.len(), "{detector:?}");
            assert!(indices.iter().all(|&index| index < points.len()));
        }
    }

    #[test]
    fn threads_do_not_matter() {
        let points = cube(12);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let all = || every_detector().into_iter().map(|d| d.keypoints(&points, 50, Protocol::Paper, 3).unwrap());
            pool.install(|| all().collect::<Vec<_>>())
        };
        assert_eq!(run(1), run(5));
    }

    #[test]
    fn clouds_that_cannot_be_used_are_refused() {
        let bad = [
            vec![],
            vec![[1.0; 3]],
            vec![[2.0; 3]; 40],
            vec![[0.0; 3], [f32::NAN; 3]],
            vec![[0.0; 3], [f32::INFINITY; 3]],
        ];
        for (detector, points) in every_detector().iter().flat_map(|d| bad.iter().map(move |points| (d, points))) {
            let found = detector.keypoints(points, 5, Protocol::Ranked, 0);
            assert!(matches!(found, Err(Error::Input { what: "points", .. })), "{detector:?} {points:?}");
        }
    }

    #[test]
    fn two_points_and_far_points_are_no_panic() {
        for points in
            [vec![[0.0; 3], [1.0, 0.0, 0.0]], vec![[3e38; 3], [-3e38; 3], [0.0; 3]], vec![[1e-40; 3], [0.0; 3]]]
        {
            for detector in every_detector() {
                match detector.keypoints(&points, 5, Protocol::Paper, 0) {
                    Ok(found) => assert!(!found.is_empty() && found.len() <= points.len(), "{detector:?} {found:?}"),
                    // Its radius is a part of the cloud's, which must be within bounds.
                    Err(error) => assert!(
                        matches!(detector, Detector::SurfaceVariation(_)) && error.to_string().contains("extent"),
                        "{detector:?} {error}"
                    ),
                }
            }
        }
    }

    #[test]
    fn points_that_are_not_finite_are_skipped() {
        let clean = cube(8);
        let mut whole = vec![[f32::NAN; 3]; 2];
        for &point in &clean {
            whole.extend([point, [0.0, f32::INFINITY, 0.0]]);
        }
        for detector in every_detector() {
            for protocol in [Protocol::Ranked, Protocol::Paper] {
                let found = detector.keypoints(&whole, 30, protocol, 1).unwrap();
                let expected = detector.keypoints(&clean, 30, protocol, 1).unwrap().into_iter();
                let expected = expected.map(|r| Response { index: 2 + 2 * r.index, ..r }).collect::<Vec<_>>();
                assert_eq!(found, expected, "{detector:?}");
            }
        }
        // By themselves, too.
        let first = |found: Result<Vec<Response>>| whole[found.unwrap()[0].index][0];
        assert!(first(iss(&whole, &IssOptions::default())).is_finite());
        assert!(first(harris3d(&whole, &Harris3dOptions::default())).is_finite());
        assert!(first(sift3d(&whole, &Sift3dOptions::default())).is_finite());
        assert!(first(farthest_points(&whole, 1)).is_finite() && first(random_points(&whole, 1, 0)).is_finite());
    }

    #[test]
    fn lengths_that_cannot_be_used_are_refused() {
        let points = cube(5);
        for length in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-200] {
            for length in [Length::Units(length), Length::Resolutions(length)] {
                let detectors = [
                    Detector::Iss(IssOptions { salient_radius: length, ..Default::default() }),
                    Detector::Iss(IssOptions { non_max_radius: length, ..Default::default() }),
                    Detector::Harris3d(Harris3dOptions { radius: length, ..Default::default() }),
                    Detector::Sift3d(Sift3dOptions { min_scale: length, ..Default::default() }),
                    Detector::Sift3d(Sift3dOptions { field: SiftField::Curvature(length), ..Default::default() }),
                ];
                for detector in detectors {
                    let found = detector.keypoints(&points, 5, Protocol::Ranked, 0);
                    assert!(matches!(found, Err(Error::Option { .. })), "{detector:?}");
                }
            }
        }
        // Every point occurs twice, and counts once.
        let doubled = [points.clone(), points.clone()].concat();
        let of = |points: &[Point]| iss(points, &IssOptions::default()).unwrap();
        assert_eq!(of(&doubled), of(&points));
        let options =
            IssOptions { salient_radius: Length::Units(0.5), non_max_radius: Length::Units(0.3), ..Default::default() };
        assert!(iss(&doubled, &options).is_ok());
    }

    #[test]
    fn other_options_out_of_range_are_refused() {
        let points = cube(5);
        let detectors = [
            Detector::Iss(IssOptions { gamma_21: 0.0, ..Default::default() }),
            Detector::Iss(IssOptions { gamma_32: f64::NAN, ..Default::default() }),
            Detector::Harris3d(Harris3dOptions { threshold: f64::NAN, ..Default::default() }),
            Detector::Sift3d(Sift3dOptions { octaves: 0, ..Default::default() }),
            Detector::Sift3d(Sift3dOptions { scales_per_octave: 1000, ..Default::default() }),
            Detector::Sift3d(Sift3dOptions { min_contrast: -1.0, ..Default::default() }),
        ];
        for detector in detectors {
            let found = detector.keypoints(&points, 5, Protocol::Ranked, 0);
            assert!(matches!(found, Err(Error::Option { .. })), "{detector:?}");
        }
        assert!(Detector::Random.keypoints(&points, 0, Protocol::Ranked, 0).is_err());
        let unknown = Detector::named("orb", Protocol::Ranked).unwrap_err().to_string();
        assert!(Detector::NAMES.iter().all(|name| unknown.contains(name)), "{unknown}");
    }

    #[test]
    fn the_paper_protocol_draws_and_fills_up() {
        let responses =
            |number| (0..number).map(|index| Response { index: index + 100, score: 1.0 }).collect::<Vec<_>>();
        let indices = |number, count, seed| -> Vec<usize> {
            random_subset(1000, responses(number), count, seed).into_iter().map(|r| r.index).collect()
        };
        // More than asked for: a subset of them, and not the first.
        let drawn = indices(50, 10, 0);
        assert_eq!(drawn.len(), 10);
        assert!(drawn.iter().all(|i| (100..150).contains(i)) && drawn.iter().any(|&i| i >= 110));
        assert_ne!(drawn, indices(50, 10, 1));
        // Fewer: all of them, then random points. None: the first point, then random points.
        let filled = indices(3, 10, 0);
        assert_eq!((filled.len(), &filled[..3]), (10, &[100, 101, 102][..]));
        assert_ne!(filled, indices(3, 10, 1));
        assert_eq!((indices(0, 10, 0).len(), indices(0, 10, 0)[0]), (10, 0));
        assert_eq!(random_subset(4, responses(0), 10, 0).len(), 4);
    }
}
