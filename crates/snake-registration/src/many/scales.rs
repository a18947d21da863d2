//! Clouds of different size: each pair has the voxels that suit the smaller cloud.

use std::collections::BTreeMap;

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Length, Point};

use super::TUNING;
use crate::options::RegisterOptions;
use crate::register::second_look::TUNING as SECOND_LOOK;
use crate::steps::prepare;
use crate::steps::{Lengths, PreparedCloud, PreparedClouds};

/// Clouds `(N, 3)` as they were given.
pub(super) struct Given<'a> {
    pub(super) points: Vec<&'a [Point]>,
    /// One for each cloud, or none.
    pub(super) viewpoints: &'a [Option<[f64; 3]>],
    pub(super) model: Option<&'a Model>,
    pub(super) options: &'a RegisterOptions,
}

impl Given<'_> {
    /// Some of the clouds, prepared with these options.
    pub(super) fn prepare(
        &self,
        members: &[usize],
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<PreparedClouds> {
        let clouds: Vec<&[Point]> = members.iter().map(|&cloud| self.points[cloud]).collect();
        let viewpoints: Vec<_> = members.iter().map(|&cloud| self.viewpoints.get(cloud).copied().flatten()).collect();
        prepare(&clouds, &viewpoints, self.model, options, control)
    }
}

/// Some of the clouds with voxels of one size.
struct Level {
    prepared: PreparedClouds,
    /// The place of each cloud, if it is among them.
    places: Vec<Option<usize>>,
}

impl Level {
    /// The members with voxels of this side, in cloud units.
    fn new(given: &Given, members: &[usize], side: f64, control: &Control) -> Result<Self> {
        let mut places = vec![None; given.points.len()];
        members.iter().enumerate().for_each(|(place, &cloud)| places[cloud] = Some(place));
        let options = given.options.with_voxel_size(Some(Length::Units(side)));
        Ok(Self { prepared: given.prepare(members, &options, control)?, places })
    }

    fn cloud(&self, cloud: usize) -> Option<&PreparedCloud> {
        self.places[cloud].map(|place| &self.prepared.clouds[place])
    }
}

/// All clouds with the voxels of the usual scale, and those of larger and smaller scales where
/// clouds have them.
pub(super) struct Scales {
    usual: PreparedClouds,
    /// The scale of each cloud, 0 for the usual one, as a power of `scale_ratio`.
    scale_numbers: Vec<i32>,
    /// The other scales: the clouds of this size and larger ones.
    others: BTreeMap<i32, Level>,
    /// By scale, the clouds with much more points than voxels, on finer voxels.
    finer: BTreeMap<i32, Level>,
}

impl Scales {
    pub(super) fn new(given: &Given, control: &Control) -> Result<Self> {
        let Given { points: clouds, viewpoints, model, options } = given;
        let usual = prepare(clouds, viewpoints, *model, options, control)?;
        let voxel_size = usual.lengths.voxel_size;
        let scale_numbers: Vec<i32> = match options.voxel_size {
            Some(_) => vec![0; clouds.len()],
            None => usual.clouds.iter().map(|cloud| scale(cloud.default_voxel_size() / voxel_size)).collect(),
        };
        let mut others = BTreeMap::new();
        for &scale in scale_numbers.iter().filter(|scale| **scale != 0) {
            if others.contains_key(&scale) {
                continue;
            }
            let members: Vec<usize> = (0..clouds.len()).filter(|&cloud| scale_numbers[cloud] >= scale).collect();
            let side = voxel_size * TUNING.scale_ratio.powi(scale);
            others.insert(scale, Level::new(given, &members, side, control)?);
        }
        let mut scales = Self { usual, scale_numbers, others, finer: BTreeMap::new() };
        scales.finer = scales.finer_levels(given, control)?;
        Ok(scales)
    }

    /// The clouds with much more points than voxels on finer voxels; none if a length is given.
    fn finer_levels(&self, given: &Given, control: &Control) -> Result<BTreeMap<i32, Level>> {
        let mut levels = BTreeMap::new();
        if given.options.has_lengths() {
            return Ok(levels);
        }
        for scale in self.others.keys().copied().chain([0]) {
            let members = self.much_finer(scale)?;
            if members.len() < 2 {
                continue;
            }
            match Level::new(given, &members, self.lengths(scale).voxel_size / SECOND_LOOK.finer, control) {
                Ok(level) => {
                    levels.insert(scale, level);
                }
                Err(error @ (Error::Cancelled | Error::DeadlineExceeded)) => return Err(error),
                // These clouds have no finer voxels.
                Err(_) => {}
            }
        }
        Ok(levels)
    }

    /// The clouds of a scale and larger ones that have much more points than its voxels.
    fn much_finer(&self, scale: i32) -> Result<Vec<usize>> {
        let mut members = Vec::new();
        for cloud in (0..self.len()).filter(|&cloud| self.scale_numbers[cloud] >= scale) {
            if self.cloud(cloud, scale).fine()?.is_finer {
                members.push(cloud);
            }
        }
        Ok(members)
    }

    /// All clouds with the usual voxels.
    pub(super) fn usual(&self) -> &[PreparedCloud] {
        &self.usual.clouds
    }

    /// The scale at which clouds are compared: that of the smallest.
    pub(super) fn common(&self, clouds: &[usize]) -> i32 {
        clouds.iter().map(|&cloud| self.scale_numbers[cloud]).min().unwrap_or(0)
    }

    /// A cloud with the voxels of its own size or a smaller one.
    pub(super) fn cloud(&self, cloud: usize, scale: i32) -> &PreparedCloud {
        self.others.get(&scale).and_then(|level| level.cloud(cloud)).unwrap_or(&self.usual.clouds[cloud])
    }

    /// A cloud with much more points than voxels, on finer voxels.
    pub(super) fn finer(&self, cloud: usize, scale: i32) -> Option<&PreparedCloud> {
        self.finer.get(&scale)?.cloud(cloud)
    }

    /// A cloud with the voxels of its own size.
    pub(super) fn own(&self, cloud: usize) -> &PreparedCloud {
        self.cloud(cloud, self.scale_numbers[cloud])
    }

    pub(super) fn inlier_distance(&self, scale: i32) -> f64 {
        self.lengths(scale).inlier_distance
    }

    fn lengths(&self, scale: i32) -> &Lengths {
        self.others.get(&scale).map_or(&self.usual.lengths, |level| &level.prepared.lengths)
    }

    pub(super) fn len(&self) -> usize {
        self.scale_numbers.len()
    }
}

/// The scale of voxels that are so many times as large as the usual ones.
fn scale(ratio: f64) -> i32 {
    (ratio.ln() / TUNING.scale_ratio.ln()).round() as i32
}
