//! Options of registration.

use serde::{Deserialize, Serialize};

use snake_core::{Error, Model, Result};
use snake_detectors::Detector;
use snake_geometry::{Length, RigidTransform, Vector, options, setters};

options! {
    /// Options of every registration, of two clouds by [`register`](crate::register()) and of many
    /// by [`align`](crate::align()).
    ///
    /// A length that is `None` is derived from the clouds. A length in resolutions refers to the
    /// coarser of the two clouds.
    pub struct RegisterOptions {
        /// Detector of keypoints: voxels (all points of the downsampled clouds), snake (the model),
        /// or one of the others on the downsampled clouds.
        detector, with_detector: Detector = Detector::Voxels, flag "DETECTOR";
        /// Descriptor that matches keypoints: fpfh, which is invariant to rotation, or field, for
        /// clouds of about the same orientation.
        descriptor, with_descriptor: Descriptor = Descriptor::Fpfh;
        /// Largest number of keypoints of a cloud; the best are kept, and a random part of too many voxels.
        max_keypoints, with_max_keypoints: usize = 8000, from 3 or more;
        /// Number of keypoints of a cloud, spread evenly over it, for links of low bandwidth.
        ///
        /// Exactly this many, or all if there are fewer: they are ranked by the detector and spread
        /// by [`suppress_to_count`](snake_geometry::suppress_to_count), where the best ones alone
        /// would cluster. It takes the place of `max_keypoints`.
        num_keypoints, with_num_keypoints: Option<usize> = None, none "`max_keypoints` counts", from 3 or more;
        /// Largest number of matches; the most distinctive are kept.
        ///
        /// The graph of matches has a bit for every pair of them.
        max_matches, with_max_matches: usize = 2000, from 3 to 20000;
        /// Size of the voxels to which both clouds are downsampled for normals, FPFH, ICP and the
        /// classical detectors. It is also the smallest distance between the keypoints of snake.
        voxel_size, with_voxel_size: Option<Length> = None, none "1/80 of the diameter of the smaller cloud", flag "LENGTH";
        /// Radius of the neighbourhood of a normal.
        ///
        /// The spacing is the voxel size or, if that is greater, the mean distance between
        /// neighbours in the downsampled clouds.
        normal_radius, with_normal_radius: Option<Length> = None, none "twice the spacing of the voxels";
        /// Radius of the neighbourhood of FPFH.
        feature_radius, with_feature_radius: Option<Length> = None, none "5 times the spacing";
        /// Distance within which a match agrees with a transform.
        inlier_distance, with_inlier_distance: Option<Length> = None, none "1.5 times the spacing";
        /// Whether normals point to the sensor. Without, they have no sign, and the space between
        /// the sensor and the points is not known to be free.
        use_viewpoints, with_use_viewpoints: bool = true;
        /// Axis that points up in both clouds, to within 5 degrees: no sensor is quite level.
        ///
        /// Transforms that tilt it more are not searched for.
        gravity, with_gravity: Option<Axis> = None, none "any rotation", flag "AXIS";
        /// Seed of random keypoints.
        seed, with_seed: u64 = 0;
        /// Largest number of point-to-plane ICP steps on the downsampled clouds; 0 skips ICP.
        ///
        /// Pairs are closer than `inlier_distance`.
        icp_steps, with_icp_steps: usize = 30;
    }
}

options! {
    /// Options of the registration of two clouds, beside [`RegisterOptions`].
    pub struct PairOptions {
        /// Position of the sensor in the source's frame.
        source_viewpoint, with_source_viewpoint: Option<[f64; 3]> = None,
            none "its place as the points tell it, if they do";
        /// Position of the sensor in the target's frame.
        target_viewpoint, with_target_viewpoint: Option<[f64; 3]> = None,
            none "its place as the points tell it, if they do";
        /// Guess of `t_target_source`, four rows of four numbers. It is refined, and no other
        /// transform is searched for.
        initial, with_initial: Option<RigidTransform> = None, none "a search";
        /// Largest number of transforms to return, best first.
        hypotheses, with_hypotheses: usize = 1, from 1 or more;
        /// Whether to find the scale of the source too, such as of a cloud from photogrammetry.
        ///
        /// Factors of 0.2 to 5 are tried until one is reliable. `t_target_source` stays rigid: the
        /// source is multiplied by `scale` first.
        estimate_scale, with_estimate_scale: bool = false, flag "SCALE";
    }
}

options! {
    /// Options of the alignment of many clouds, beside [`RegisterOptions`].
    pub struct AlignOptions {
        /// Approximate number of other clouds to which each cloud is registered: those with the most
        /// similar descriptors, and its neighbours in the given order.
        max_partners, with_max_partners: usize = 20, from 1 or more, flag "NUMBER";
        /// Distance by which a transform may move the source away from where the initial poses put it,
        /// root mean square over its points. What moves it farther is left out.
        pose_tolerance, with_pose_tolerance: Option<Length> = None,
            none "1.5 standard deviations of the smaller cloud along its thinnest direction, less than the height of a storey",
            flag "LENGTH";
    }
}

/// What is known of the clouds that [`align_with`](crate::align_with) aligns, beside their points.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct AlignPriors {
    /// The sensor's position in the frame of each cloud, where it is known: one for each cloud, or none at all.
    pub viewpoints: Vec<Option<[f64; 3]>>,
    /// An approximate pose of each cloud in one common frame, where it is known: one for each cloud,
    /// or none at all. Pairs of clouds with poses start from them beside the search, and a transform
    /// that contradicts them is left out.
    pub initial_poses: Vec<Option<RigidTransform>>,
}

setters!(AlignPriors {
    viewpoints: Vec<Option<[f64; 3]>> => with_viewpoints,
    initial_poses: Vec<Option<RigidTransform>> => with_initial_poses
});

/// The descriptor that matches keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Descriptor {
    /// FPFH of the downsampled cloud at the voxel nearest to the keypoint; invariant to rotation.
    #[default]
    Fpfh,
    /// The features of the field. Their definition is not invariant to rotation; the built-in model
    /// has learnt invariance only in part.
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

impl RegisterOptions {
    /// Whether a length is given.
    pub(crate) fn has_lengths(&self) -> bool {
        let Self { voxel_size, normal_radius, feature_radius, inlier_distance, .. } = self;
        [voxel_size, normal_radius, feature_radius, inlier_distance].iter().any(|length| length.is_some())
    }

    /// Whether the detector or the descriptor runs a model.
    pub fn needs_model(&self) -> bool {
        self.detector == Detector::Snake || self.descriptor == Descriptor::Field
    }

    /// The model, if these options run it.
    pub(crate) fn model_to_run<'a>(&self, model: Option<&'a Model>) -> Result<Option<&'a Model>> {
        match model {
            None if self.needs_model() => Err(no_model()),
            given => Ok(given.filter(|_| self.needs_model())),
        }
    }
}

/// A viewpoint relative to its cloud's origin (see [`Cloud`](snake_geometry::Cloud)).
pub(crate) fn place_viewpoint(viewpoint: Option<[f64; 3]>, origin: [f64; 3]) -> Option<[f64; 3]> {
    viewpoint.map(|viewpoint| std::array::from_fn(|axis| viewpoint[axis] - origin[axis]))
}

impl AlignPriors {
    /// Converts viewpoints and poses to points relative to the clouds' origins, and the common frame
    /// to the origin of the first cloud; see [`Cloud`](snake_geometry::Cloud).
    pub fn place(&mut self, origins: &[[f64; 3]]) {
        let placed = self.viewpoints.iter().zip(origins);
        self.viewpoints = placed.map(|(viewpoint, origin)| place_viewpoint(*viewpoint, *origin)).collect();
        let frame = origins.first().copied().unwrap_or_default();
        for (pose, origin) in self.initial_poses.iter_mut().zip(origins) {
            *pose = pose.map(|pose| pose.subtract_origins(*origin, frame));
        }
    }

    /// Refuses viewpoints and poses that are not one for each cloud, and viewpoints that are too far.
    pub(crate) fn check(&self, count: usize) -> Result<()> {
        for (name, given) in [("viewpoints", self.viewpoints.len()), ("initial_poses", self.initial_poses.len())] {
            if ![0, count].contains(&given) {
                let (value, allowed) = (format!("{given} of them"), "one for each cloud, or none");
                return Err(Error::Option { name, value, allowed });
            }
        }
        self.viewpoints.iter().try_for_each(|viewpoint| check_viewpoint("viewpoints", *viewpoint))
    }
}

impl PairOptions {
    /// Converts the viewpoints and the guess to points relative to the clouds' origins; see
    /// [`Cloud`](snake_geometry::Cloud).
    pub fn place(&mut self, source: [f64; 3], target: [f64; 3]) {
        self.source_viewpoint = place_viewpoint(self.source_viewpoint, source);
        self.target_viewpoint = place_viewpoint(self.target_viewpoint, target);
        self.initial = self.initial.map(|initial| initial.subtract_origins(source, target));
    }

    /// The viewpoints of source and target.
    pub(crate) fn viewpoints(&self) -> [Option<[f64; 3]>; 2] {
        [self.source_viewpoint, self.target_viewpoint]
    }

    pub(crate) fn check(&self) -> Result<()> {
        self.check_ranges()?;
        if self.estimate_scale && self.initial.is_some() {
            let allowed = "false with `initial`, which has no scale";
            return Err(Error::Option { name: "estimate_scale", value: "true".into(), allowed });
        }
        check_viewpoint("source_viewpoint", self.source_viewpoint)?;
        check_viewpoint("target_viewpoint", self.target_viewpoint)
    }
}

/// The largest coordinate of a viewpoint, in cloud units. Points may lie as far; squares of what is
/// much farther overflow.
const MAX_COORDINATE: f64 = 1e15;

/// Refuses a viewpoint with a coordinate that is not finite or too far.
pub(crate) fn check_viewpoint(name: &'static str, viewpoint: Option<[f64; 3]>) -> Result<()> {
    match viewpoint {
        Some(position) if !position.iter().all(|v| v.abs() <= MAX_COORDINATE) => {
            Err(Error::Option { name, value: format!("{position:?}"), allowed: "three numbers from -1e15 to 1e15" })
        }
        _ => Ok(()),
    }
}

/// The error of a call without a model that asks for its keypoints or descriptors.
pub(crate) fn no_model() -> Error {
    let allowed = "a model for the detector snake and the descriptor field";
    Error::Option { name: "model", value: "none".into(), allowed }
}
