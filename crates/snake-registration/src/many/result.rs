//! The result of alignment.

use serde::{Deserialize, Serialize};

use snake_geometry::{RigidTransform, record};

record! {
/// The result of [`align`](crate::align()).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Alignment {
    /// The pose of each cloud.
    pub poses: Vec<Pose>,
    /// The clouds that are linked to each other, as indices in rising order; the part with the most clouds comes
    /// first. Parts have frames of their own: poses of different parts cannot be compared.
    pub parts: Vec<Vec<usize>>,
    /// The registrations of pairs that the poses follow.
    pub edges: Vec<Edge>,
    /// The reliable registrations that were left out because they contradict the initial poses.
    pub contradictions: Vec<Contradiction>,
    /// Clouds whose units may be others, and pairs that are left out because
    /// [`register`](crate::register()) of the two does not rely on them, in sentences.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Number of pairs that were registered.
    pub num_pairs: usize,
    /// Number of points of each cloud that were skipped because they are not finite, or are outliers.
    pub num_skipped: Vec<usize>,
    /// Run time.
    pub seconds: f64,
}
}

record! {
/// The pose of a cloud in the frame of its part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Pose {
    /// Index of the cloud's part.
    pub part: usize,
    /// Maps the cloud's points to the frame of the part, which is that of its first cloud: `p_part = R p_cloud + t`.
    pub t_part_cloud: RigidTransform,
    /// Covariance of a small rotation (radians) and then a small translation (cloud units) of the cloud in its own
    /// frame, relative to the first cloud of the part; zeros for the first. It is that of independent errors of the
    /// points and, where loops disagree more, that of the disagreement.
    pub covariance: [[f64; 6]; 6],
}
}

record! {
/// A registration that the poses follow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Edge {
    /// Index of the source.
    pub source: usize,
    /// Index of the target.
    pub target: usize,
    /// The transform of the pair alone.
    pub t_target_source: RigidTransform,
    /// How likely the transform is right by its own evidence, 0 to 1.
    pub confidence: f64,
    /// How likely it is right by its own evidence and the loops of three transforms that it closes, 0 to 1.
    pub belief: f64,
    /// The root mean square distance between the tangent planes of the pair and the poses' transform, in cloud units.
    pub residual: f64,
    /// The information matrix of the pair, as [`Fit::information`](crate::Fit::information).
    pub information: [[f64; 6]; 6],
}
}

record! {
/// A reliable registration that contradicts the initial poses, such as that of two storeys with one floor plan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Contradiction {
    /// Index of the source.
    pub source: usize,
    /// Index of the target.
    pub target: usize,
    /// The root mean square distance of the source's points from where the initial poses put them, in cloud units.
    pub distance: f64,
    /// The largest distance that does not contradict them; see
    /// [`AlignOptions::pose_tolerance`](crate::AlignOptions::pose_tolerance).
    pub tolerance: f64,
}
}

impl Alignment {
    /// A warning for the user if there are several parts.
    pub fn warning(&self) -> Option<String> {
        let parts = self.parts.len();
        (parts > 1).then(|| format!("the clouds are in {parts} parts, which nothing reliable connects"))
    }

    /// Adds notes about the files of the clouds.
    #[must_use]
    pub fn with_notes_on_clouds(mut self, notes: &[Vec<String>]) -> Self {
        for (cloud, notes) in notes.iter().enumerate() {
            self.notes.extend(notes.iter().map(|note| format!("cloud {cloud} (from 0): {note}")));
        }
        self
    }

    /// Converts the transforms from points relative to an origin (see [`Cloud`](snake_geometry::Cloud)) to points
    /// with their origins added. `origins` has one for each cloud.
    #[must_use]
    pub fn between_origins(mut self, origins: &[[f64; 3]]) -> Self {
        for (pose, origin) in self.poses.iter_mut().zip(origins) {
            let part_origin = origins[self.parts[pose.part][0]];
            pose.t_part_cloud = pose.t_part_cloud.add_origins(*origin, part_origin);
        }
        for edge in &mut self.edges {
            edge.t_target_source = edge.t_target_source.add_origins(origins[edge.source], origins[edge.target]);
        }
        self
    }
}
