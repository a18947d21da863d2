//! Clouds with voxels of several sizes.

use std::collections::BTreeMap;

use super::{PreparedCloud, PreparedClouds, prepare_given};
use crate::options::RegisterOptions;
use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Length, Point};

/// Voxel size relative to that of a further try on finer voxels. Unit: ratio of sides. Of 24 pairs of synthetic
/// sweeps 13 and 17 m apart, 11 are reliable with this try and 5 without (`sweeps` in tests/verdict.rs).
const FINER: f64 = 3.0;
/// Ratio of the voxel sizes of neighbouring scales. Clouds of half to twice the usual size share a
/// scale. Unit: ratio of lengths. Set by hand.
const SCALE_RATIO: f64 = 4.0;

/// Clouds `(N, 3)` as given, and how they are to be prepared.
pub(crate) struct Given<'a> {
    pub(crate) points: Vec<&'a [Point]>,
    /// The names of the clouds in errors; without names, errors give indices.
    pub(crate) names: &'static [&'static str],
    /// The position of each sensor in the frame of its cloud, where it is known.
    pub(crate) viewpoints: Vec<Option<[f64; 3]>>,
    pub(crate) model: Option<&'a Model>,
    pub(crate) options: &'a RegisterOptions,
}

impl Given<'_> {
    pub(crate) fn viewpoint(&self, cloud: usize) -> Option<[f64; 3]> {
        self.viewpoints.get(cloud).copied().flatten()
    }

    /// All clouds with the voxels that the options ask for.
    pub(crate) fn prepare(&self, control: &Control) -> Result<Level> {
        let members = (0..self.points.len()).collect();
        Ok(Level { clouds: prepare_given(self, control)?, members })
    }

    /// The clouds `members`, ascending, with voxels whose side is `side` in cloud units.
    fn prepare_at(&self, members: Vec<usize>, side: f64, control: &Control) -> Result<Level> {
        let given = Given {
            points: members.iter().map(|&cloud| self.points[cloud]).collect(),
            viewpoints: members.iter().map(|&cloud| self.viewpoint(cloud)).collect(),
            options: &self.options.with_voxel_size(Some(Length::Units(side))),
            ..*self
        };
        Ok(Level { clouds: prepare_given(&given, control)?, members })
    }
}

/// Clouds with voxels of one size.
pub(crate) struct Level {
    pub(crate) clouds: PreparedClouds,
    /// Their indices among all clouds, ascending.
    members: Vec<usize>,
}

impl Level {
    pub(crate) fn cloud(&self, cloud: usize) -> Option<&PreparedCloud> {
        self.members.binary_search(&cloud).ok().map(|place| &self.clouds.clouds[place])
    }

    /// Prepares the clouds among `candidates` that have many more points than voxels on finer
    /// voxels; `None` if there are fewer than two, or if the options give a length.
    ///
    /// # Errors
    /// [`Error::Cancelled`] and [`Error::DeadlineExceeded`], and errors of the fine voxels. Other
    /// errors of the preparation give `None`.
    pub(crate) fn finer(
        &self,
        given: &Given,
        candidates: impl Fn(usize) -> bool,
        control: &Control,
    ) -> Result<Option<Self>> {
        let mut members = Vec::new();
        for (&cloud, prepared) in self.members.iter().zip(&self.clouds.clouds) {
            if candidates(cloud) && !given.options.has_lengths() && prepared.fine()?.is_finer {
                members.push(cloud);
            }
        }
        if members.len() < 2 {
            return Ok(None);
        }
        match given.prepare_at(members, self.clouds.lengths.voxel_size / FINER, control) {
            Err(error @ (Error::Cancelled | Error::DeadlineExceeded)) => Err(error),
            level => Ok(level.ok()),
        }
    }
}

/// Clouds of different sizes. Clouds are compared on the voxels that suit the smallest of them.
pub(crate) struct Pyramid {
    usual: Level,
    /// The scale of each cloud as a power of `SCALE_RATIO`; 0 is the usual one.
    scales: Vec<i32>,
    /// The levels of the other scales, each with the clouds of its scale and larger ones.
    others: BTreeMap<i32, Level>,
    /// The clouds of each scale that have many more points than voxels, on finer voxels.
    finer: BTreeMap<i32, Level>,
}

impl Pyramid {
    /// Prepares all clouds with the usual voxels, and with the voxels of every other scale that occurs.
    pub(crate) fn new(given: &Given, control: &Control) -> Result<Self> {
        let usual = given.prepare(control)?;
        let voxel_size = usual.clouds.lengths.voxel_size;
        let scale = |cloud: &PreparedCloud| match given.options.voxel_size {
            Some(_) => 0,
            None => ((cloud.default_voxel_size() / voxel_size).ln() / SCALE_RATIO.ln()).round() as i32,
        };
        let scales: Vec<i32> = usual.clouds.clouds.iter().map(scale).collect();
        let mut pyramid = Self { usual, scales, others: BTreeMap::new(), finer: BTreeMap::new() };
        let mut distinct = pyramid.scales.clone();
        distinct.sort_unstable();
        distinct.dedup();
        for &scale in distinct.iter().filter(|scale| **scale != 0) {
            let members = (0..pyramid.len()).filter(|&cloud| pyramid.scales[cloud] >= scale).collect();
            let level = given.prepare_at(members, voxel_size * SCALE_RATIO.powi(scale), control)?;
            pyramid.others.insert(scale, level);
        }
        for scale in pyramid.others.keys().copied().chain([0]) {
            let is_as_large = |cloud: usize| pyramid.scales[cloud] >= scale;
            if let Some(level) = pyramid.level(scale).finer(given, is_as_large, control)? {
                pyramid.finer.insert(scale, level);
            }
        }
        Ok(pyramid)
    }

    /// All clouds with the usual voxels.
    pub(crate) fn usual(&self) -> &[PreparedCloud] {
        &self.usual.clouds.clouds
    }

    /// The scale at which clouds are compared: that of the smallest.
    pub(crate) fn common(&self, clouds: &[usize]) -> i32 {
        clouds.iter().map(|&cloud| self.scales[cloud]).min().unwrap_or(0)
    }

    /// A cloud with the voxels of a scale: its own or a smaller one.
    pub(crate) fn cloud(&self, cloud: usize, scale: i32) -> &PreparedCloud {
        self.level(scale).cloud(cloud).unwrap_or(&self.usual()[cloud])
    }

    /// A cloud on finer voxels, if it has many more points than voxels.
    pub(crate) fn finer(&self, cloud: usize, scale: i32) -> Option<&PreparedCloud> {
        self.finer.get(&scale)?.cloud(cloud)
    }

    /// A cloud with the voxels of its own scale.
    pub(crate) fn own(&self, cloud: usize) -> &PreparedCloud {
        self.cloud(cloud, self.scales[cloud])
    }

    pub(crate) fn inlier_distance(&self, scale: i32) -> f64 {
        self.level(scale).clouds.lengths.inlier_distance
    }

    fn level(&self, scale: i32) -> &Level {
        self.others.get(&scale).unwrap_or(&self.usual)
    }

    pub(crate) fn len(&self) -> usize {
        self.scales.len()
    }
}
