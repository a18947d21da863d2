//! The result of registration.

use serde::{Deserialize, Serialize};

use snake_geometry::{Point, RecordKind, RecordValue, RigidTransform, record};

record! {
/// The result of [`register`](crate::register()).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Registration {
    /// Maps source points to the target frame: `p_target = R p_source + t`, or `R (scale p_source) + t` with `scale`.
    pub t_target_source: RigidTransform,
    /// Factor by which source points are multiplied before `t_target_source`: 1 unless `estimate_scale` is set.
    pub scale: f64,
    /// Whether the transform can be relied on, and why or why not.
    pub verdict: Verdict,
    /// How well the clouds fit under the transform.
    pub fit: Fit,
    /// The matches of keypoints, and how many agree with the transform.
    pub matches: Matches,
    /// What was used of source and target.
    pub clouds: [CloudReport; 2],
    /// The best distinct transforms, best first, at most as many as asked for. The first is `t_target_source`.
    pub hypotheses: Vec<Hypothesis>,
    /// Run time in seconds.
    pub seconds: f64,
}
}

record! {
/// Whether a transform can be relied on, with the evidence beside [`Fit`] and [`Matches`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Verdict {
    /// How likely the transform is right, 0 to 1.
    pub confidence: f64,
    /// Whether the transform can be relied on, as the right one of many: `confidence` is at least 0.5. Of rooms
    /// it is then within 15 degrees and 0.3 m of the truth; the last digits depend on the noise.
    pub is_reliable: bool,
    /// Whether the clouds leave more than one answer: the overlap leaves directions of motion open,
    /// as a plane, a cylinder or a sphere does, or another transform fits about as well, as on
    /// periodic structures. Then it is not reliable, and `notes` say why.
    pub is_ambiguous: bool,
    /// What may be wrong with the clouds or the transform, in sentences.
    pub notes: Vec<String>,
    /// Fraction of the squared motion of planar patches that they resist, in the direction of
    /// motion that they resist least.
    ///
    /// It is 0 if the source can slide or rotate on the target, and about 0.1 if surfaces face all ways. Where less
    /// than half of the overlap lies on patches and slides fit worse by 0.07, it is `slide_margin`.
    pub weakest_constraint: f64,
    /// By how much the overlap exceeds that of slides of the source; below 0 if a slide fits better.
    ///
    /// The overlap is a share, 0 to 1, less twice the violated free space. Slides are by 2 to 12
    /// inlier distances along the direction that the overlap fixes least.
    pub slide_margin: f64,
    /// Self-similarity: the share of what the transform explains that another place or heading
    /// explains too, along a repeating structure such as a row of equal pillars or of windows. It is 0
    /// if there is none, and 1 if a part of the scene moved as a whole.
    pub repeat_fit: f64,
    /// Share of the voxels of both clouds, 0 to 1, that lie where the other cloud's sensor saw
    /// through to a farther surface; 0 if the sensors are not known.
    pub free_space_violation: f64,
}
}

record! {
/// How well two clouds fit under a transform.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Fit {
    /// Share of the source's voxels, 0 to 1, that the transform brings closer than `inlier_distance` to a voxel of
    /// the target (Open3D's fitness). The other voxels do not overlap the target, or the transform is wrong.
    pub fitness: f64,
    /// Root mean square distance of these voxels to their nearest ones, in cloud units (Open3D's inlier RMSE); 0
    /// without any. A right transform gives about the mean distance between neighbours.
    pub rmse: f64,
    /// The distance below which voxels overlap and matches agree, in cloud units.
    pub inlier_distance: f64,
    /// Side of the voxels, in cloud units.
    pub voxel_size: f64,
    /// Information matrix (inverse covariance up to the noise) of the transform, for a pose graph: of a small
    /// rotation (radians) and then a small translation (cloud units) of the source in the target frame.
    ///
    /// It is the sum of `J Jᵀ` over the source's voxels on the target, where J is the gradient of
    /// the distance to the tangent plane.
    pub information: [[f64; 6]; 6],
}
}

record! {
/// The matches of keypoints, and how many agree with a transform.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Matches {
    /// Number of matches.
    pub num_matches: usize,
    /// Number of matches that the transform brings closer than the inlier distance, with normals
    /// that agree, before ICP.
    pub num_inliers: usize,
    /// Root mean square distance of the inliers before ICP, in cloud units; 0 without inliers.
    pub rmse: f64,
    /// Number of matches that agree with the refined transform.
    pub num_agreeing: usize,
    /// Number of matches that agree with the best other transform, at least two inlier distances away; 0 without one.
    pub num_rival_agreeing: usize,
    /// Standard deviation of the matches that agree, in the direction in which they are spread
    /// least, in cloud units. Matches on one plane, with a spread near 0, do not fix a transform.
    pub spread: f64,
    /// The matches that agree with the refined transform, as source points (times `scale`) and
    /// target points in cloud units, relative to the clouds' origins. They are not part of files.
    #[serde(skip)]
    pub pairs: Vec<[Point; 2]>,
}
}

record! {
/// What was used of a cloud.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct CloudReport {
    /// The viewpoint that gave the normals their signs.
    pub viewpoint: ViewpointUsed,
    /// Position of the sensor, in the cloud's frame and units; none without a viewpoint.
    #[serde(default)]
    pub position: Option<[f64; 3]>,
    /// Share of the points, 0 to 1, that nothing hides from there.
    #[serde(default)]
    pub visible: Option<f64>,
    /// Number of points that were skipped because they are not finite, are outliers or stand for missing returns.
    pub num_skipped: usize,
}
}

record! {
/// A transform with the figures that ranked it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Hypothesis {
    /// Maps source points to the target frame.
    pub t_target_source: RigidTransform,
    /// The score that ranks the transforms: the share of the source's voxels on the target with
    /// agreeing normals, less twice `free_space_violation`, plus 0.005 for each inlier.
    pub score: f64,
    /// See [`Matches::num_inliers`].
    pub num_inliers: usize,
    /// As [`Verdict::free_space_violation`], from depth images that are quicker to make and less sharp.
    pub free_space_violation: f64,
}
}

/// The viewpoint that gave a cloud's normals their signs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ViewpointUsed {
    /// The option's or the file's.
    Given,
    /// The place that the densities of the points tell.
    Found,
    /// The origin of the cloud's frame, to which the densities lead, or ahead of which all of the cloud lies.
    Origin,
    /// None: normals have no sign.
    None,
}

impl RecordValue for ViewpointUsed {
    fn kind() -> RecordKind {
        RecordKind::Text
    }
}

impl ViewpointUsed {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Found => "found",
            Self::Origin => "origin",
            Self::None => "none",
        }
    }
}

impl Verdict {
    /// The verdict in a word or two: reliable, ambiguous or not reliable.
    pub fn word(&self) -> &'static str {
        match (self.is_reliable, self.is_ambiguous) {
            (true, _) => "reliable",
            (false, true) => "ambiguous",
            (false, false) => "not reliable",
        }
    }

    /// A sentence for a user who does not look at the verdict, where the transform is not reliable.
    pub fn warning(&self) -> Option<String> {
        let Self { confidence, is_reliable, .. } = self;
        (!is_reliable).then(|| format!("the transform is not reliable: its confidence is {confidence:.2}"))
    }
}

impl Registration {
    /// Adds what is to be said of the files of source and target to the notes of the verdict.
    #[must_use]
    pub fn with_notes_on_clouds(mut self, notes: [&[String]; 2]) -> Self {
        let named = |(name, notes): (&str, &[String])| notes.iter().map(|note| format!("{name}: {note}")).collect();
        let notes: [Vec<String>; 2] = [("source", notes[0]), ("target", notes[1])].map(named);
        self.verdict.notes.extend(notes.concat());
        self
    }

    /// Converts the transforms from points relative to an origin (see [`Cloud`](snake_geometry::Cloud)) to points
    /// with their origins added. The information matrix is about the same axes, and stays.
    #[must_use]
    pub fn between_origins(mut self, source: [f64; 3], target: [f64; 3]) -> Self {
        let source = source.map(|v| self.scale * v);
        self.t_target_source = self.t_target_source.add_origins(source, target);
        for (cloud, origin) in self.clouds.iter_mut().zip([source, target]) {
            cloud.position.iter_mut().flatten().zip(origin).for_each(|(v, origin)| *v += origin);
        }
        for hypothesis in &mut self.hypotheses {
            hypothesis.t_target_source = hypothesis.t_target_source.add_origins(source, target);
        }
        self
    }
}
