//! Classical detectors for comparison: ISS, Harris 3D, SIFT 3D, surface variation, farthest-point
//! sampling and random points.
//!
//! Each returns indices of input points with a score, by falling score and, for equal scores, by
//! rising index. Results are the same for any number of threads. [`Detector::keypoints`] selects
//! keypoints of any of them by a [`Protocol`]. Points that are not finite and
//! [`Outliers`](snake_geometry::Outliers) are skipped. The first of equal points counts, except for
//! random points. Indices refer to the whole cloud.
//!
//! A new detector is a file here and a row of the table of [`Detector`].

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
pub use harris3d::{Harris3dOptions, harris3d, harris3d_with};
pub use iss::{Covariance, IssOptions, iss, iss_with};
pub use random::random_points;
pub use sift3d::{Sift3dOptions, SiftField, sift3d, sift3d_with};
pub use surface_variation::{SurfaceVariationOptions, surface_variation, surface_variation_with};

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
    /// The selection for the baselines in the paper's tables (USIP's test code): a random subset of
    /// the responses, filled up with random points. Without responses it starts with the cloud's
    /// first point. It always returns the number asked for, up to the size of the cloud, but is
    /// hardly better than random points.
    Paper,
}

/// The wanted keypoints of a cloud, and the control of the call.
#[derive(Clone, Copy)]
struct Wanted<'a> {
    count: usize,
    protocol: Protocol,
    seed: u64,
    control: &'a Control,
}

/// The table of detectors: documentation, variant, name, and the function that finds keypoints
/// among finite points.
macro_rules! detectors {
    ($($(#[$doc:meta])+ $variant:ident = $name:literal: $find:expr;)+) => {
        /// A detector of keypoints: all voxels, the model, or a classical detector with its default
        /// options.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
        pub enum Detector {
            /// Every point of the downsampled cloud.
            #[default]
            #[serde(rename = "voxels")]
            Voxels,
            /// The most salient points of the field.
            #[serde(rename = "snake")]
            Snake,
            $($(#[$doc])+ #[serde(rename = $name)] $variant,)+
        }

        impl Detector {
            /// The classical detectors, which need neither voxels nor a model.
            pub const CLASSICAL: &[Self] = &[$(Self::$variant),+];

            /// The name, as in options and tables.
            pub fn name(self) -> &'static str {
                match self {
                    Self::Voxels => "voxels",
                    Self::Snake => "snake",
                    $(Self::$variant => $name,)+
                }
            }

            /// The keypoints among finite points; `None` if the detector is not a classical one.
            fn find(self, points: &[Point], wanted: Wanted<'_>) -> Option<Result<Vec<Response>>> {
                let find: fn(&[Point], Wanted<'_>) -> Result<Vec<Response>> = match self {
                    Self::Voxels | Self::Snake => return None,
                    $(Self::$variant => $find,)+
                };
                Some(find(points, wanted))
            }
        }
    };
}

detectors! {
    /// Intrinsic shape signatures.
    Iss = "iss": |points, wanted| Ok(wanted.select(points, iss_with(points, &IssOptions::default(), wanted.control)?));
    /// Harris corners of the normals. For [`Protocol::Paper`] without suppression, as in the
    /// wrapper behind the paper's tables.
    Harris3d = "harris3d": |points, wanted| {
        let options = Harris3dOptions::default().with_non_max(wanted.protocol == Protocol::Ranked);
        Ok(wanted.select(points, harris3d_with(points, &options, wanted.control)?))
    };
    /// Extrema of the differences of Gaussians of the curvature, or of the y coordinate for
    /// [`Protocol::Paper`].
    Sift3d = "sift3d": |points, wanted| {
        let field = if wanted.protocol == Protocol::Ranked { SiftField::Curvature } else { SiftField::Y };
        let options = Sift3dOptions::default().with_field(field);
        Ok(wanted.select(points, sift3d_with(points, &options, wanted.control)?))
    };
    /// Maxima of the surface variation.
    SurfaceVariation = "surface-variation": |points, wanted| {
        Ok(wanted.select(points, surface_variation_with(points, &SurfaceVariationOptions::default(), wanted.control)?))
    };
    /// Farthest-point sampling.
    Fps = "fps": |points, wanted| farthest_points(points, wanted.count);
    /// Random points.
    Random = "random": |points, wanted| random_points(points, wanted.count, wanted.seed);
}

impl Detector {
    /// The classical detector of this name.
    ///
    /// # Errors
    /// [`Error::Option`] for another name.
    pub fn classical(name: &str) -> Result<Self> {
        let detector = Self::CLASSICAL.iter().find(|detector| detector.name() == name);
        detector.copied().ok_or_else(|| not_classical(name))
    }

    /// `count` keypoints of a cloud `(N, 3)` by a classical detector. The seed determines all
    /// random choices; with [`Protocol::Ranked`] only random points use it.
    ///
    /// ```
    /// use snake_registration::detectors::{Detector, Protocol};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let keypoints = Detector::Iss.keypoints(&points, 16, Protocol::Ranked, 0)?;
    /// assert!(keypoints.windows(2).all(|pair| pair[0].score >= pair[1].score));
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] when the cloud has no finite points or is one point repeated;
    /// [`Error::Option`] when `count` is 0, and for the detectors `voxels` and `snake`.
    pub fn keypoints(self, points: &[Point], count: usize, protocol: Protocol, seed: u64) -> Result<Vec<Response>> {
        self.keypoints_with(points, count, protocol, seed, &Control::default())
    }

    /// [`Detector::keypoints`] with cancellation and a deadline.
    ///
    /// # Errors
    /// The errors of [`Detector::keypoints`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn keypoints_with(
        self,
        points: &[Point],
        count: usize,
        protocol: Protocol,
        seed: u64,
        control: &Control,
    ) -> Result<Vec<Response>> {
        let wanted = Wanted::new(count, protocol, seed, control)?;
        among_finite(points, |points| self.find(points, wanted).unwrap_or_else(|| Err(not_classical(self.name()))))
    }
}

/// Keypoints of a cloud `(N, 3)` by a detector with options of its own, such as
/// `|points| iss(points, &options)`: `count` of its responses by a protocol.
///
/// # Errors
/// [`Error::Input`] when the cloud has no finite points; [`Error::Option`] when `count` is 0; the
/// errors of the detector.
pub fn select_keypoints(
    points: &[Point],
    detect: impl FnOnce(&[Point]) -> Result<Vec<Response>>,
    count: usize,
    protocol: Protocol,
    seed: u64,
) -> Result<Vec<Response>> {
    let control = Control::default();
    let wanted = Wanted::new(count, protocol, seed, &control)?;
    among_finite(points, |points| Ok(wanted.select(points, detect(points)?)))
}

fn not_classical(name: &str) -> Error {
    let allowed = "iss, harris3d, sift3d, surface-variation, fps or random";
    Error::Option { name: "detector", value: name.into(), allowed }
}

impl<'a> Wanted<'a> {
    fn new(count: usize, protocol: Protocol, seed: u64, control: &'a Control) -> Result<Self> {
        if count == 0 {
            return Err(Error::Option { name: "count", value: "0".into(), allowed: "1 or more" });
        }
        Ok(Self { count, protocol, seed, control })
    }

    /// The wanted keypoints among the responses of a detector to these points.
    fn select(self, points: &[Point], mut responses: Vec<Response>) -> Vec<Response> {
        match self.protocol {
            Protocol::Ranked => {
                responses.truncate(self.count);
                responses
            }
            Protocol::Paper => random_subset(points.len(), responses, self.count, self.seed),
        }
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

/// Runs a detector on the finite points of a cloud and returns indices into the whole cloud.
fn among_finite(points: &[Point], find: impl FnOnce(&[Point]) -> Result<Vec<Response>>) -> Result<Vec<Response>> {
    let finite = FinitePoints::of("points", points)?;
    let responses = find(&finite.points)?.into_iter();
    Ok(responses.map(|Response { index, score }| Response { index: finite.original_index(index), score }).collect())
}

/// [`among_finite`] on the first of all equal points: a repeated point weighs as much as any other.
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
        let responses = find(&distinct)?.into_iter();
        Ok(responses.map(|Response { index, score }| Response { index: firsts[index], score }).collect())
    })
}

/// Refuses a cloud of one point, however often it is repeated.
fn check_distinct(points: &[Point]) -> Result<()> {
    if points.iter().all(|p| *p == points[0]) {
        return Err(Error::Input { what: "points", reason: "need at least two different points".into() });
    }
    Ok(())
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

/// Non-maximum suppression: the indices of points that pass and whose score no point closer than
/// `radius` exceeds. Points with equal scores all stay. As in PCL and Open3D, every neighbour counts,
/// whether it passes or not.
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
    let maxima: Vec<Option<Response>> = (0..scores.len()).into_par_iter().map(maximum).collect::<Result<_>>()?;
    Ok(by_falling_score(maxima.into_iter().flatten().collect()))
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
        let plate = |tilt: f32| (0..900).map(|i| [at(i), at(i / 30), tilt * at(i)]).collect::<Vec<Point>>();
        let level = plate(0.0);
        let keypoints = [
            harris3d(&level, &Harris3dOptions::default()).unwrap(),
            iss(&level, &IssOptions::default()).unwrap(),
            surface_variation(&level, &SurfaceVariationOptions::default()).unwrap(),
            sift3d(&level, &Sift3dOptions::default()).unwrap(),
        ];
        assert_eq!(keypoints.map(|responses| responses.len()), [0; 4]);
        // The coordinates of a tilted plate are rounded to f32, which ISS, surface variation and SIFT
        // take for its shape.
        assert_eq!(harris3d(&plate(0.3), &Harris3dOptions::default()).unwrap(), []);
    }

    /// A unit cube's surface: `side`² points on each face, the edges doubled as its faces share
    /// them.
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

    #[test]
    fn a_detector_has_its_name_in_options_and_tables() {
        for &detector in Detector::CLASSICAL {
            assert_eq!(Detector::classical(detector.name()).unwrap(), detector);
        }
        for detector in [&[Detector::Voxels, Detector::Snake], Detector::CLASSICAL].concat() {
            assert_eq!(serde_json::to_value(detector).unwrap(), detector.name());
        }
        for name in ["orb", "voxels", "snake"] {
            let error = Detector::classical(name).unwrap_err().to_string();
            assert!(Detector::CLASSICAL.iter().all(|detector| error.contains(detector.name())), "{error}");
        }
        let error = Detector::Voxels.keypoints(&cube(4), 5, Protocol::Ranked, 0).unwrap_err().to_string();
        assert!(error.contains("`detector` is voxels"), "{error}");
    }

    #[test]
    fn harris_of_the_paper_is_random_and_its_sift_is_of_y() {
        let points = cube(12);
        let paper = |detector: Detector| detector.keypoints(&points, 100, Protocol::Paper, 3).unwrap();
        let selected = |responses: Result<Vec<Response>>| {
            select_keypoints(&points, |_| responses, 100, Protocol::Paper, 3).unwrap()
        };
        let every = harris3d(&points, &Harris3dOptions::default().with_non_max(false));
        assert_eq!(paper(Detector::Harris3d), selected(every));
        let y = sift3d(&points, &Sift3dOptions::default().with_field(SiftField::Y));
        assert_eq!(paper(Detector::Sift3d), selected(y));
        assert_eq!(paper(Detector::Iss), selected(iss(&points, &IssOptions::default())));
    }

    #[test]
    fn every_detector_gives_different_indices_by_falling_score() {
        let points = cube(12);
        for &detector in Detector::CLASSICAL {
            let keypoints = detector.keypoints(&points, 20, Protocol::Ranked, 0).unwrap();
            assert!(!keypoints.is_empty() && keypoints.len() <= 20, "{detector:?}");
            assert!(keypoints.windows(2).all(|pair| pair[0].score >= pair[1].score), "{detector:?}");
            let mut indices: Vec<_> = keypoints.iter().map(|response| response.index).collect();
            indices.sort_unstable();
            indices.dedup();
            assert_eq!(indices.len(), keypoints.len(), "{detector:?}");
            assert!(indices.iter().all(|&index| index < points.len()));
        }
    }

    #[test]
    fn threads_do_not_matter() {
        let points = cube(12);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let all = || Detector::CLASSICAL.iter().map(|d| d.keypoints(&points, 50, Protocol::Paper, 3).unwrap());
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
        for (detector, points) in Detector::CLASSICAL.iter().flat_map(|d| bad.iter().map(move |points| (d, points))) {
            let keypoints = detector.keypoints(points, 5, Protocol::Ranked, 0);
            assert!(matches!(keypoints, Err(Error::Input { what: "points", .. })), "{detector:?} {points:?}");
        }
    }

    #[test]
    fn two_points_and_far_points_are_no_panic() {
        for points in
            [vec![[0.0; 3], [1.0, 0.0, 0.0]], vec![[3e38; 3], [-3e38; 3], [0.0; 3]], vec![[1e-40; 3], [0.0; 3]]]
        {
            for &detector in Detector::CLASSICAL {
                match detector.keypoints(&points, 5, Protocol::Paper, 0) {
                    Ok(keypoints) => {
                        assert!(!keypoints.is_empty() && keypoints.len() <= points.len(), "{detector:?} {keypoints:?}")
                    }
                    // Its radius is a part of the cloud's, which must be within bounds.
                    Err(error) => assert!(
                        detector == Detector::SurfaceVariation && error.to_string().contains("extent"),
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
        for &detector in Detector::CLASSICAL {
            for protocol in [Protocol::Ranked, Protocol::Paper] {
                let keypoints = detector.keypoints(&whole, 30, protocol, 1).unwrap();
                let expected = detector.keypoints(&clean, 30, protocol, 1).unwrap().into_iter();
                let expected = expected.map(|r| Response { index: 2 + 2 * r.index, ..r }).collect::<Vec<_>>();
                assert_eq!(keypoints, expected, "{detector:?}");
            }
        }
        // By themselves, too.
        let first = |keypoints: Result<Vec<Response>>| whole[keypoints.unwrap()[0].index][0];
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
                let refused = [
                    iss(&points, &IssOptions::default().with_salient_radius(length)),
                    iss(&points, &IssOptions::default().with_non_max_radius(length)),
                    harris3d(&points, &Harris3dOptions::default().with_radius(length)),
                    sift3d(&points, &Sift3dOptions::default().with_min_scale(length)),
                    sift3d(&points, &Sift3dOptions::default().with_curvature_radius(length)),
                ];
                for (place, keypoints) in refused.into_iter().enumerate() {
                    assert!(matches!(keypoints, Err(Error::Option { .. })), "{place} {length:?}");
                }
            }
        }
        // Every point occurs twice, and counts once.
        let doubled = [points.clone(), points.clone()].concat();
        let keypoints = |points: &[Point]| iss(points, &IssOptions::default()).unwrap();
        assert_eq!(keypoints(&doubled), keypoints(&points));
        let options =
            IssOptions { salient_radius: Length::Units(0.5), non_max_radius: Length::Units(0.3), ..Default::default() };
        assert!(iss(&doubled, &options).is_ok());
    }

    #[test]
    fn other_options_out_of_range_are_refused() {
        let points = cube(5);
        let refused = [
            iss(&points, &IssOptions::default().with_gamma_21(0.0)),
            iss(&points, &IssOptions::default().with_gamma_32(f64::NAN)),
            harris3d(&points, &Harris3dOptions::default().with_threshold(f64::NAN)),
            sift3d(&points, &Sift3dOptions::default().with_octaves(0)),
            sift3d(&points, &Sift3dOptions::default().with_scales_per_octave(1000)),
            sift3d(&points, &Sift3dOptions::default().with_min_contrast(-1.0)),
            Detector::Random.keypoints(&points, 0, Protocol::Ranked, 0),
        ];
        for (place, keypoints) in refused.into_iter().enumerate() {
            assert!(matches!(keypoints, Err(Error::Option { .. })), "{place}");
        }
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
