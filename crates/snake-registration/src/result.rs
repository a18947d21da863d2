//! The result of registration.

use serde::{Deserialize, Serialize};

use snake_geometry::{Point, RigidTransform};

/// The result of [`register`](crate::register()).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Registration {
    /// Maps source points to the target frame: `p_target = R p_source + t`.
    pub t_target_source: RigidTransform,
    /// How likely the transform is right, 0 to 1; see [`Registration::is_reliable`].
    pub confidence: f64,
    /// Whether the transform can be relied on: `confidence` is at least 0.5.
    pub is_reliable: bool,
    /// Whether the clouds leave more than one answer: the overlap leaves directions of motion open, as a plane, a cylinder or
    /// a sphere does, or another transform fits about as well, as on periodic structures. Then it is not reliable, and
    /// `notes` say why.
    pub is_ambiguous: bool,
    /// Number of matches that the transform brings closer than `inlier_distance`, with normals that agree, before ICP.
    pub num_inliers: usize,
    /// Number of matches that agree with the refined transform.
    pub num_agreeing: usize,
    /// The same for the best other transform, at least two inlier distances away; 0 without one.
    pub num_rival_agreeing: usize,
    /// Number of matches of keypoints.
    pub num_correspondences: usize,
    /// Root mean square distance of the inliers before ICP, in cloud units; 0 without inliers.
    pub rmse: f64,
    /// The distance below which matches agree and voxels overlap, in cloud units.
    pub inlier_distance: f64,
    /// Share of the source's voxels, 0 to 1, that `t_target_source` brings closer than `inlier_distance` to a voxel of
    /// the target (Open3D's fitness). The other voxels do not overlap the target, or the transform is wrong.
    pub fitness: f64,
    /// Root mean square distance of these voxels to their nearest ones, in cloud units (Open3D's inlier RMSE); 0
    /// without any. A correct transform gives about the mean distance between neighbours.
    pub fitness_rmse: f64,
    /// Share of the voxels of both clouds, 0 to 1, that lie where the other cloud's sensor saw through to a farther
    /// surface; 0 if the viewpoints are not known.
    pub free_space_violation: f64,
    /// How far the matches that agree are spread in the direction in which they are spread least, as a standard deviation
    /// in cloud units. Matches on one plane, with a spread near 0, do not fix a transform.
    pub match_spread: f64,
    /// How well planar patches of the overlap fix the direction of motion that they fix least: of their squared motion, the
    /// share against patches that face it. It is 0 if the source can slide or turn on the target, about 0.1 if surfaces face
    /// all ways. Where less than half of the overlap lies on patches and slides fit worse by 0.07, it is `slide_margin`.
    pub weakest_constraint: f64,
    /// By how much the overlap (a share, 0 to 1, less twice the violated free space) exceeds that of slides of the source
    /// by 2 to 12 inlier distances along the direction that is fixed least; below 0 if a slide fits better.
    pub slide_margin: f64,
    /// Of the patches that tell, the share that agrees where the target looks alike, as one period farther along a row of
    /// equal pillars; 0 if it looks alike nowhere or `fitness` is at most 0.8.
    pub repeat_fit: f64,
    /// The information matrix (inverse covariance up to the noise) of the transform, for a pose graph: of a small
    /// rotation (radians) and then a small translation (cloud units) of the source in the target frame. It is the sum of
    /// `J Jᵀ` over the source's voxels on the target, where J is the gradient of the distance to the tangent plane.
    pub information: [[f64; 6]; 6],
    /// The best distinct transforms, best first, at most as many as asked for. The first is `t_target_source`.
    pub hypotheses: Vec<Hypothesis>,
    /// The matches that agree with the refined transform (`num_agreeing`), as source and target points in cloud units,
    /// relative to the clouds' origins. They are not part of files.
    #[serde(skip)]
    pub matches: Vec<[Point; 2]>,
    /// Which viewpoints were used for source and target.
    pub viewpoints: [ViewpointUsed; 2],
    /// What may be wrong with the clouds.
    pub notes: Vec<String>,
    /// Number of source and target points that were skipped because they are not finite, are outliers or stand for missing
    /// returns.
    pub num_skipped: [usize; 2],
    /// Run time.
    pub seconds: f64,
}

/// A transform with figures of its quality.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Hypothesis {
    /// Maps source points to the target frame.
    pub t_target_source: RigidTransform,
    /// What ranks the transforms: the share of the source's voxels on the target with agreeing normals, less twice
    /// `free_space_violation`, plus 0.005 for each inlier.
    pub score: f64,
    /// See [`Registration::num_inliers`].
    pub num_inliers: usize,
    /// As [`Registration::free_space_violation`], from depth images that are quicker to make and less sharp.
    pub free_space_violation: f64,
}

/// The viewpoint that gave a cloud's normals their signs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ViewpointUsed {
    /// The option's or the file's.
    Given,
    /// The origin of the cloud's frame, from which most of the cloud is visible.
    Origin,
    /// None: normals have no sign.
    None,
}

impl ViewpointUsed {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Origin => "origin",
            Self::None => "none",
        }
    }
}

impl Registration {
    /// Converts the transforms from points relative to an origin (see [`Cloud`](snake_geometry::Cloud)) to points with their
    /// origins added. The information matrix is about the same axes, and stays.
    #[must_use]
    pub fn between_origins(mut self, source: [f64; 3], target: [f64; 3]) -> Self {
        self.t_target_source = self.t_target_source.add_origins(source, target);
        for hypothesis in &mut self.hypotheses {
            hypothesis.t_target_source = hypothesis.t_target_source.add_origins(source, target);
        }
        self
    }
}
