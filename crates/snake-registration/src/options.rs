//! Options of registration.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use snake_core::{Error, Result};
use snake_geometry::{Length, Point, RigidTransform, Vector, options, resolution};

use crate::parts::medians::upper_median;

options! {
    /// Options of [`register`](crate::register()).
    ///
    /// A length that is `None` is derived from the clouds. A length in resolutions refers to the coarser of the two clouds.
    pub struct RegisterOptions {
        /// Detector of keypoints: voxels (all points of the downsampled clouds), snake (the model), or one of the others on the
        /// downsampled clouds.
        detector, with_detector: KeypointDetector = KeypointDetector::Voxels, flag "DETECTOR";
        /// Descriptor that matches keypoints: fpfh, which is invariant to rotation, or field, for clouds of about the same
        /// orientation.
        descriptor, with_descriptor: Descriptor = Descriptor::Fpfh;
        /// Largest number of keypoints of a cloud; the best are kept, and of too many voxels a random part.
        max_keypoints, with_max_keypoints: usize = 8000, from 3 or more;
        /// Number of keypoints of a cloud, spread evenly over it, for links of low bandwidth.
        ///
        /// Exactly this many, or all if there are fewer: they are ranked by the detector and spread by
        /// [`suppress_to_count`](snake_geometry::suppress_to_count), where the best ones alone would cluster. It takes the
        /// place of `max_keypoints`.
        num_keypoints, with_num_keypoints: Option<usize> = None, none "`max_keypoints` counts", from 3 or more;
        /// Largest number of matches; the most distinctive are kept.
        ///
        /// The graph of matches has a bit for every pair of them.
        max_matches, with_max_matches: usize = 2000, from 3 to 20000;
        /// Size of the voxels to which both clouds are downsampled for normals, FPFH, ICP and the classical detectors. It is
        /// also the least distance between the keypoints of snake.
        voxel_size, with_voxel_size: Option<Length> = None, none "1/80 of the diameter of the smaller cloud", flag "LENGTH";
        /// Radius of the neighbourhood of a normal.
        ///
        /// The spacing is the voxel size or, if that is greater, the mean distance between neighbours in the reduced clouds.
        normal_radius, with_normal_radius: Option<Length> = None, none "twice the spacing of the voxels";
        /// Radius of the neighbourhood of FPFH.
        feature_radius, with_feature_radius: Option<Length> = None, none "5 times the spacing";
        /// Distance within which a match agrees with a transform.
        inlier_distance, with_inlier_distance: Option<Length> = None, none "1.5 times the spacing";
        /// Whether normals point to the sensor. Without, they have no sign, and the space between the sensor and the points
        /// is not known to be free.
        use_viewpoints, with_use_viewpoints: bool = true;
        /// Position of the sensor in the source's frame.
        source_viewpoint, with_source_viewpoint: Option<[f64; 3]> = None,
            none "the frame's origin, if most of the cloud is visible from there";
        /// Position of the sensor in the target's frame.
        target_viewpoint, with_target_viewpoint: Option<[f64; 3]> = None, none "likewise";
        /// Axis that points up in both clouds: the transform is a rotation about it and a translation.
        gravity, with_gravity: Option<Axis> = None, none "any rotation", flag "AXIS";
        /// Guess of `t_target_source`, four rows of four numbers. It is refined, and no other transform is searched for.
        initial, with_initial: Option<RigidTransform> = None, none "a search";
        /// Largest number of transforms to return, best first.
        hypotheses, with_hypotheses: usize = 1, from 1 or more;
        /// Seed of random keypoints.
        seed, with_seed: u64 = 0;
        /// Largest number of point-to-plane ICP steps on the reduced clouds; 0 skips ICP.
        ///
        /// Pairs are closer than `inlier_distance`.
        refine_steps, with_refine_steps: usize = 30;
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

/// The largest coordinate of a viewpoint, in cloud units. Points may lie as far; squares of what is much farther overflow.
const MAX_COORDINATE: f64 = 1e15;

/// Refuses a viewpoint with a coordinate that is not finite or too far.
pub(crate) fn check_viewpoint(name: &'static str, viewpoint: &Option<[f64; 3]>) -> Result<()> {
    match viewpoint {
        Some(position) if !position.iter().all(|v| v.abs() <= MAX_COORDINATE) => {
            Err(Error::Option { name, value: format!("{position:?}"), allowed: "three numbers from -1e15 to 1e15" })
        }
        _ => Ok(()),
    }
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
        self.check_ranges()?;
        check_viewpoint("source_viewpoint", &self.source_viewpoint)?;
        check_viewpoint("target_viewpoint", &self.target_viewpoint)?;
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
