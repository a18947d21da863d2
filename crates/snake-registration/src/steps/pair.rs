//! Two prepared clouds, source and target.

use std::sync::OnceLock;

use crate::cloud::patches::FineCloud;
use crate::cloud::surface::{self, Surface};
use crate::options::Axis;
use crate::result::ViewpointUsed;
use crate::steps::matches::{Criteria, Match};
use crate::steps::prepare::{PreparedCloud, PreparedClouds, Viewpoint};
use snake_core::{Error, Result};
use snake_geometry::{RigidTransform, vector};

/// Two prepared clouds, source and target, with the criteria by which matches agree.
pub struct Pair<'a> {
    clouds: [&'a PreparedCloud; 2],
    criteria: Criteria,
    /// Whether the known sensors are used to find free space.
    shows_space: bool,
    surfaces: OnceLock<[Surface<'a>; 2]>,
}

impl<'a> Pair<'a> {
    /// A pair of clouds that were prepared with the same lengths; the pair uses the lengths of the
    /// target. `gravity` is the axis that points up in both clouds, if it is known. Normals are
    /// signed if the sensors of both clouds are known.
    pub fn new(source: &'a PreparedCloud, target: &'a PreparedCloud, gravity: Option<Axis>) -> Self {
        let signed = source.viewpoint.is_some() && target.viewpoint.is_some();
        let inlier_distance = target.lengths.inlier_distance;
        let criteria = Criteria { inlier_distance, signed, gravity: gravity.map(Axis::unit) };
        Self { clouds: [source, target], criteria, shows_space: true, surfaces: OnceLock::new() }
    }

    /// The same pair with unsigned normals and without its sensors.
    #[must_use]
    pub fn without_signs(&self) -> Self {
        let criteria = Criteria { signed: false, ..self.criteria };
        Self { clouds: self.clouds, criteria, shows_space: false, surfaces: OnceLock::new() }
    }

    /// Source and target.
    pub fn clouds(&self) -> [&'a PreparedCloud; 2] {
        self.clouds
    }

    /// The criteria by which matches agree.
    pub fn criteria(&self) -> &Criteria {
        &self.criteria
    }

    /// Whether the normals of both clouds point to their sensors.
    pub fn is_signed(&self) -> bool {
        self.criteria.signed
    }

    /// The matches of keypoints by their indices `[source, target]`, with the normals of the voxels next to them.
    ///
    /// # Errors
    /// [`Error::Input`] when there is no keypoint of an index.
    pub fn matches(&self, indices: &[[usize; 2]]) -> Result<Vec<Match>> {
        let [source, target] = self.clouds;
        let matched = |&[s, t]: &[usize; 2]| {
            let (Some(from), Some(to)) = (source.keypoints.get(s), target.keypoints.get(t)) else {
                let counts = [source, target].map(|cloud| cloud.keypoints.len());
                let reason = format!("match {s} to {t} of {} and {} keypoints", counts[0], counts[1]);
                return Err(Error::Input { what: "matches", reason });
            };
            Ok(Match {
                source: vector(from.0),
                target: vector(to.0),
                source_normal: source.voxels.normals[from.1],
                target_normal: target.voxels.normals[to.1],
            })
        };
        indices.iter().map(matched).collect()
    }

    /// Whether a sensor was assumed at the origin of a cloud, and opposite normals on the overlap contradict that.
    pub fn contradicts_viewpoints(&self, t_target_source: &RigidTransform) -> bool {
        let [source, target] = self.surfaces();
        self.viewpoints().iter().flatten().any(|viewpoint| viewpoint.used == ViewpointUsed::Origin)
            && Surface::opposed(source, target, t_target_source.isometry()) > surface::MAX_OPPOSED
    }

    /// Whether the signs of normals and the free space are doubtful: much of a cloud is hidden from
    /// its sensor, because the voxels are too coarse for what the sensor sees.
    pub(crate) fn has_doubtful_signs(&self) -> bool {
        self.is_signed() && !self.clouds.iter().all(|cloud| cloud.is_visible())
    }

    /// The viewpoints that are used, of source and target.
    pub(crate) fn viewpoints(&self) -> [Option<Viewpoint>; 2] {
        self.clouds.map(|cloud| cloud.viewpoint.filter(|_| self.shows_space))
    }

    pub(crate) fn surfaces(&self) -> &[Surface<'a>; 2] {
        self.surfaces.get_or_init(|| self.surfaces_within(self.criteria.inlier_distance))
    }

    pub(crate) fn surfaces_within(&self, distance: f64) -> [Surface<'a>; 2] {
        let surfaces = self.clouds.map(|cloud| cloud.surface(self.shows_space, distance));
        if self.is_signed() { surfaces } else { surfaces.map(Surface::without_signs) }
    }

    pub(crate) fn fine(&self) -> Result<[&'a FineCloud; 2]> {
        let [source, target] = self.clouds;
        Ok([source.fine()?, target.fine()?])
    }

    pub(crate) fn diameters(&self) -> [f64; 2] {
        self.clouds.map(|cloud| cloud.diameter)
    }
}

impl PreparedClouds {
    /// The pair of the first two clouds.
    pub(crate) fn pair(&self, gravity: Option<Axis>) -> Pair<'_> {
        Pair::new(&self.clouds[0], &self.clouds[1], gravity)
    }
}
