//! Classical detectors for comparison: ISS, Harris 3D, SIFT 3D, surface variation, farthest-point
//! sampling and random points.
//!
//! Each returns indices of input points with a score, by falling score and, for equal scores, by rising index.
//! Results are the same for any number of threads. [`Detector::keypoints`] selects the keypoints of any detector by a
//! [`Protocol`]. Points that are not finite, missing returns and [`Outliers`](snake_geometry::Outliers) are skipped.
//! Of equal points only the first counts, except for random points. Indices refer to the whole cloud.
//!
//! To add a detector, add a file here and a row to the table of [`Detector`].

#![forbid(unsafe_code)]

mod farthest_point;
mod harris3d;
mod iss;
mod random;
mod sift3d;
mod surface_variation;

use std::collections::HashSet;

use rand::SeedableRng;
use serde::{Deserialize, Serialize};

use snake_core::{Control, Error, Result};
use snake_geometry::{FinitePoints, Neighbors, Point, Vector, try_in_parallel, vector};

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
    /// The selection for the baselines in the paper's tables (USIP's test code): a random subset of the responses,
    /// filled up with random points. Without responses it starts with the cloud's first point. It always returns the
    /// number asked for, up to the size of the cloud, but is hardly better than random points.
    Paper,
}

/// The requested keypoints of a cloud, and the control of the call.
#[derive(Clone, Copy)]
struct Wanted<'a> {
    count: usize,
    protocol: Protocol,
    seed: u64,
    control: &'a Control,
}

/// The table of detectors: documentation, variant, name, and the function that finds keypoints among finite points.
macro_rules! detectors {
    ($($(#[$doc:meta])+ $variant:ident = $name:literal: $find:expr;)+) => {
        /// A detector of keypoints: all voxels, the model, or a classical detector with its default options.
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
    /// Extrema of the differences of Gaussians of the curvature, or of the y coordinate for [`Protocol::Paper`].
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
    /// use snake_detectors::{Detector, Protocol};
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

/// `count` keypoints of a cloud `(N, 3)`, selected by a protocol. `detect` is a detector with options
/// of its own, such as `|points| iss(points, &options)`.
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

    /// The requested keypoints among a detector's responses to these points.
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
    let mut rng = chacha20::ChaCha8Rng::seed_from_u64(seed);
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
    let finite = FinitePoints::clean("points", points, None)?;
    let responses = find(&finite.points)?.into_iter();
    Ok(responses.map(|Response { index, score }| Response { index: finite.original_index(index), score }).collect())
}

/// [`among_finite`] for the first of all equal points: a repeated point counts once.
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

/// Refuses a cloud that consists of a single point, however often it is repeated.
fn check_distinct(points: &[Point]) -> Result<()> {
    if points.iter().all(|p| *p == points[0]) {
        return Err(Error::Input { what: "points", reason: "need at least two different points".into() });
    }
    Ok(())
}

/// Indexes a cloud of at least two different finite points.
fn index_cloud(points: &[Point]) -> Result<Neighbors> {
    check_distinct(points)?;
    Neighbors::new(points.iter().map(|&p| vector(p)).collect())
}

/// The value of each point, unless the call must stop.
fn each_point<T: Send>(cloud: &Neighbors, control: &Control, value: impl Fn(&Vector) -> T + Sync) -> Result<Vec<T>> {
    try_in_parallel(cloud.points.iter(), |point| control.check().map(|()| value(point)))
}

/// Non-maximum suppression: the indices of points that pass and that have no point with a higher
/// score closer than `radius`. Points with equal scores all stay. As in PCL and Open3D, every
/// neighbour counts, whether it passes or not.
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
    let maxima = try_in_parallel(0..scores.len(), maximum)?;
    Ok(by_falling_score(maxima.into_iter().flatten().collect()))
}

/// Sorts by falling score and, for equal scores, by rising index.
fn by_falling_score(mut responses: Vec<Response>) -> Vec<Response> {
    responses.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.index.cmp(&b.index)));
    responses
}

#[cfg(test)]
mod tests;
