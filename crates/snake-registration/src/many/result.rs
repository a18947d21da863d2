//! The result of alignment, and its options.

use serde::{Deserialize, Serialize};

use snake_core::{Error, Result};
use snake_geometry::RigidTransform;

use crate::options::{RegisterOptions, check_viewpoint};

/// The largest number of clouds: the poses are solved for in one dense matrix.
const MOST_CLOUDS: usize = 500;

/// Options of [`align`](crate::align()).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct AlignOptions {
    /// Options of every pair. The viewpoints of source and target, `initial` and `hypotheses` are not for many clouds.
    pub register: RegisterOptions,
    /// Each cloud is registered to about this many others: those with the most similar descriptors, and its neighbours
    /// in the given order.
    pub max_partners: usize,
    /// The sensor's position in the frame of each cloud, where it is known; empty if none is.
    pub viewpoints: Vec<Option<[f64; 3]>>,
}

impl Default for AlignOptions {
    fn default() -> Self {
        Self { register: RegisterOptions::default(), max_partners: 20, viewpoints: Vec::new() }
    }
}

impl AlignOptions {
    /// Sets [`AlignOptions::register`].
    #[must_use]
    pub fn with_register(mut self, register: RegisterOptions) -> Self {
        self.register = register;
        self
    }

    /// Sets [`AlignOptions::max_partners`].
    #[must_use]
    pub fn with_max_partners(mut self, max_partners: usize) -> Self {
        self.max_partners = max_partners;
        self
    }

    /// Sets [`AlignOptions::viewpoints`].
    #[must_use]
    pub fn with_viewpoints(mut self, viewpoints: Vec<Option<[f64; 3]>>) -> Self {
        self.viewpoints = viewpoints;
        self
    }

    /// Converts the viewpoints to points relative to their clouds' origins (see [`Cloud`](snake_geometry::Cloud)). If a cloud
    /// without a viewpoint has an origin other than zero, no cloud's frame is taken to start at its sensor.
    pub fn place(&mut self, origins: &[[f64; 3]]) {
        if self.viewpoints.is_empty() {
            self.viewpoints = vec![None; origins.len()];
        }
        for (viewpoint, origin) in self.viewpoints.iter_mut().zip(origins) {
            match viewpoint {
                Some(viewpoint) => viewpoint.iter_mut().zip(origin).for_each(|(v, origin)| *v -= origin),
                None => self.register.use_viewpoints &= *origin == [0.0; 3],
            }
        }
    }

    /// The viewpoint of each of `count` clouds, after a check of all options.
    pub(super) fn checked_viewpoints(&self, count: usize) -> Result<Vec<Option<[f64; 3]>>> {
        let refused = |name, value: String, allowed| Err(Error::Option { name, value, allowed });
        self.register.check()?;
        if !(2..=MOST_CLOUDS).contains(&count) {
            return Err(Error::Input {
                what: "clouds",
                reason: format!("{count} of them; needed are 2 to {MOST_CLOUDS}"),
            });
        }
        if self.max_partners == 0 {
            return refused("max_partners", "0".into(), "1 or more");
        }
        if self.register.initial.is_some() {
            return refused("initial", "a transform".into(), "none: it is for one pair of clouds");
        }
        if self.register.source_viewpoint.is_some() || self.register.target_viewpoint.is_some() {
            return refused("source_viewpoint, target_viewpoint", "a position".into(), "none: `viewpoints` has them");
        }
        if self.register.hypotheses != 1 {
            return refused("hypotheses", self.register.hypotheses.to_string(), "1: a pair has its best transform");
        }
        if ![0, count].contains(&self.viewpoints.len()) {
            return refused("viewpoints", format!("{} of them", self.viewpoints.len()), "one for each cloud, or none");
        }
        self.viewpoints.iter().try_for_each(|position| check_viewpoint("viewpoints", position))?;
        let mut viewpoints = self.viewpoints.clone();
        viewpoints.resize(count, None);
        Ok(viewpoints)
    }
}

/// The result of [`align`](crate::align()).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Alignment {
    /// The pose of each cloud.
    pub poses: Vec<Pose>,
    /// The clouds that are linked to each other, as indices in rising order; the part with the most clouds comes first.
    /// Parts have frames of their own: poses of different parts cannot be compared.
    pub parts: Vec<Vec<usize>>,
    /// The registrations of pairs that the poses follow.
    pub edges: Vec<Edge>,
    /// Number of pairs that were registered.
    pub num_pairs: usize,
    /// Number of points of each cloud that were skipped because they are not finite, or are outliers.
    pub num_skipped: Vec<usize>,
    /// Run time.
    pub seconds: f64,
}

/// The pose of a cloud in the frame of its part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Pose {
    /// Index of the cloud's part.
    pub part: usize,
    /// Maps the cloud's points to the frame of the part, which is that of its first cloud: `p_part = R p_cloud + t`.
    pub t_part_cloud: RigidTransform,
    /// Covariance of a small rotation (radians) and then a small translation (cloud units) of the cloud in its own frame,
    /// relative to the first cloud of the part; zeros for the first. It is that of independent errors of the points and,
    /// where loops disagree more, that of the disagreement.
    pub covariance: [[f64; 6]; 6],
}

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
    /// The information matrix of the pair, as [`Registration::information`](crate::Registration::information).
    pub information: [[f64; 6]; 6],
}

impl Alignment {
    /// Converts the transforms from points relative to an origin (see [`Cloud`](snake_geometry::Cloud)) to points with their
    /// origins added. `origins` has one for each cloud.
    #[must_use]
    pub fn between_origins(mut self, origins: &[[f64; 3]]) -> Self {
        for (pose, origin) in self.poses.iter_mut().zip(origins) {
            let of_part = origins[self.parts[pose.part][0]];
            pose.t_part_cloud = pose.t_part_cloud.add_origins(*origin, of_part);
        }
        for edge in &mut self.edges {
            edge.t_target_source = edge.t_target_source.add_origins(origins[edge.source], origins[edge.target]);
        }
        self
    }
}
