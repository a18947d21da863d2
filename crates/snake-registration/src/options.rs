//! Options of registration.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use snake_core::{Error, Result};
use snake_geometry::{Length, Point, RigidTransform, Vector, resolution, setters};

use crate::parts::medians::upper_median;

/// Options of [`register`](crate::register()).
///
/// A length that is `None` is derived from the clouds. A length in resolutions refers to the coarser of the two clouds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RegisterOptions {
    /// The keypoint detector; by default every voxel is a keypoint.
    pub detector: KeypointDetector,
    /// The descriptor that matches keypoints.
    pub descriptor: Descriptor,
    /// Maximum number of keypoints per cloud; the best are kept. Of too many voxels it keeps a random part.
    pub max_keypoints: usize,
    /// Exactly this many keypoints per cloud, or all if there are fewer, for links of low bandwidth: they are ranked by the
    /// detector and spread over the cloud by [`suppress_to_count`](snake_geometry::suppress_to_count), where the best
    /// ones alone would cluster. It takes the place of `max_keypoints`.
    pub num_keypoints: Option<usize>,
    /// Maximum number of matches; the most distinctive are kept.
    pub max_matches: usize,
    /// Side of the voxels for normals, FPFH and refinement. `None`: 1/80 of the smaller cloud's diameter, which is
    /// twice the largest distance of a point from the mean.
    pub voxel_size: Option<Length>,
    /// Radius of normals. `None`: twice the spacing, which is the voxel size or, if that is greater, the mean distance
    /// between neighbours in the reduced clouds.
    pub normal_radius: Option<Length>,
    /// Radius of FPFH. `None`: 5 times the spacing.
    pub feature_radius: Option<Length>,
    /// A match agrees with a transform that brings its points closer than this. `None`: 1.5 times the spacing.
    pub inlier_distance: Option<Length>,
    /// Whether normals point to the sensor. Without, they have no sign, and the space between the sensor and the points
    /// is not known to be free.
    pub use_viewpoints: bool,
    /// The sensor's position in the source's frame. `None`: the frame's origin, if most of the cloud is visible from
    /// there.
    pub source_viewpoint: Option<[f64; 3]>,
    /// The sensor's position in the target's frame, likewise.
    pub target_viewpoint: Option<[f64; 3]>,
    /// The axis that points up in both clouds. The transform is then a rotation about this axis and a translation.
    pub gravity: Option<Axis>,
    /// A guess of `t_target_source`. It is refined; no other transform is searched for.
    pub initial: Option<RigidTransform>,
    /// Maximum number of transforms to return, best first.
    pub hypotheses: usize,
    /// Seed of random keypoints.
    pub seed: u64,
    /// Maximum number of point-to-plane ICP steps on the reduced clouds; 0 skips ICP. Pairs are closer than
    /// `inlier_distance`.
    pub refine_steps: usize,
}

setters!(RegisterOptions {
    detector: KeypointDetector => with_detector,
    descriptor: Descriptor => with_descriptor,
    max_keypoints: usize => with_max_keypoints,
    num_keypoints: Option<usize> => with_num_keypoints,
    max_matches: usize => with_max_matches,
    voxel_size: Option<Length> => with_voxel_size,
    normal_radius: Option<Length> => with_normal_radius,
    feature_radius: Option<Length> => with_feature_radius,
    inlier_distance: Option<Length> => with_inlier_distance,
    use_viewpoints: bool => with_use_viewpoints,
    source_viewpoint: Option<[f64; 3]> => with_source_viewpoint,
    target_viewpoint: Option<[f64; 3]> => with_target_viewpoint,
    gravity: Option<Axis> => with_gravity,
    initial: Option<RigidTransform> => with_initial,
    hypotheses: usize => with_hypotheses,
    seed: u64 => with_seed,
    refine_steps: usize => with_refine_steps,
});

impl Default for RegisterOptions {
    fn default() -> Self {
        Self {
            detector: KeypointDetector::default(),
            descriptor: Descriptor::default(),
            max_keypoints: 8000,
            num_keypoints: None,
            max_matches: 2000,
            voxel_size: None,
            normal_radius: None,
            feature_radius: None,
            inlier_distance: None,
            use_viewpoints: true,
            source_viewpoint: None,
            target_viewpoint: None,
            gravity: None,
            initial: None,
            hypotheses: 1,
            seed: 0,
            refine_steps: 30,
        }
    }
}

/// The keypoint detector: the model, or a classical detector of [`detectors`](crate::detectors) with its default
/// options. Classical detectors select points of the reduced cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeypointDetector {
    /// Every point of the reduced cloud.
    #[default]
    Voxels,
    /// The most salient points of the field, at least a voxel apart.
    Snake,
    /// Intrinsic shape signatures.
    Iss,
    /// Harris corners of the normals.
    Harris3d,
    /// Extrema of the differences of Gaussians of the curvature.
    Sift3d,
    /// Farthest-point sampling.
    Fps,
    /// Random points.
    Random,
}

/// The descriptor that matches keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Descriptor {
    /// FPFH of the reduced cloud at the point nearest to the keypoint; invariant to rotation.
    #[default]
    Fpfh,
    /// The features of the field. Their definition is not invariant to rotation; the built-in model has learnt
    /// invariance only in part.
    Field,
}

/// An axis of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// The first coordinate.
    X,
    /// The second.
    Y,
    /// The third.
    Z,
}

impl Axis {
    pub(crate) fn unit(self) -> Vector {
        match self {
            Self::X => Vector::x(),
            Self::Y => Vector::y(),
            Self::Z => Vector::z(),
        }
    }
}

/// The largest number of matches: the graph of matches has a bit for every pair of them.
const MOST_MATCHES: usize = 20_000;

impl RegisterOptions {
    /// Converts the viewpoints and the guess to points relative to their origins (see [`Cloud`](snake_geometry::Cloud)). A
    /// cloud with an origin other than zero is georeferenced: no sensor stands at the zero of its frame.
    pub fn place(&mut self, source: [f64; 3], target: [f64; 3]) {
        let viewpoints = [(&mut self.source_viewpoint, source), (&mut self.target_viewpoint, target)];
        for (viewpoint, origin) in viewpoints {
            match viewpoint {
                Some(viewpoint) => viewpoint.iter_mut().zip(origin).for_each(|(v, origin)| *v -= origin),
                None => self.use_viewpoints &= origin == [0.0; 3],
            }
        }
        self.initial = self.initial.map(|initial| initial.subtract_origins(source, target));
    }

    pub(crate) fn check(&self) -> Result<()> {
        let number = |name, value: usize, allowed| Err(Error::Option { name, value: value.to_string(), allowed });
        if self.max_keypoints < 3 {
            return number("max_keypoints", self.max_keypoints, "3 or more");
        }
        if let Some(count @ ..3) = self.num_keypoints {
            return number("num_keypoints", count, "3 or more");
        }
        if !(3..=MOST_MATCHES).contains(&self.max_matches) {
            return number("max_matches", self.max_matches, "3 to 20000");
        }
        if self.hypotheses == 0 {
            return number("hypotheses", self.hypotheses, "1 or more");
        }
        for (name, viewpoint) in
            [("source_viewpoint", self.source_viewpoint), ("target_viewpoint", self.target_viewpoint)]
        {
            if let Some(value) = viewpoint.filter(|position| !position.iter().all(|v| v.is_finite())) {
                return Err(Error::Option { name, value: format!("{value:?}"), allowed: "three finite numbers" });
            }
        }
        Ok(())
    }

    /// The lengths that are set, in cloud units: voxel size, radius of normals, radius of FPFH, inlier distance.
    pub(crate) fn lengths(&self, clouds: &[Cow<[Point]>]) -> Result<[Option<f64>; 4]> {
        let given = [
            ("voxel_size", self.voxel_size),
            ("normal_radius", self.normal_radius),
            ("feature_radius", self.feature_radius),
            ("inlier_distance", self.inlier_distance),
        ];
        let is_multiple = |length: Option<Length>| matches!(length, Some(Length::Resolutions(_)));
        let coarser = match given.iter().any(|(_, length)| is_multiple(*length)) {
            true => {
                let resolutions = clouds.iter().map(|points| resolution("points", points));
                upper_median(&resolutions.collect::<std::result::Result<Vec<f64>, _>>()?)
            }
            false => 0.0,
        };
        let mut lengths = [None; 4];
        for (slot, (name, length)) in lengths.iter_mut().zip(given) {
            *slot = length.map(|length| length.resolve(name, || coarser)).transpose()?;
        }
        Ok(lengths)
    }
}
