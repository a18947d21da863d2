//! Keypoints of a downsampled cloud.

use chacha20::ChaCha8Rng;
use rand::SeedableRng;

use super::voxel_cloud::VoxelCloud;
use crate::options::RegisterOptions;
use snake_core::{Control, Result};
use snake_detectors::{Detector, Protocol};
use snake_geometry::{Point, suppress_to_count};

impl VoxelCloud {
    /// At most `count` keypoints `(K, 3)` in the cloud's frame, best first, and no more than the cloud has points.
    /// Only random points depend on the seed. A classical detector is not interrupted.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) when a classical detector is used on a single
    /// voxel; [`Error::Option`](snake_core::Error::Option) when `count` is 0 or there is no model
    /// for its keypoints; [`Error::Weights`](snake_core::Error::Weights) when the model overflows;
    /// [`Error::Cancelled`](snake_core::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
    pub fn keypoints(&self, detector: Detector, count: usize, seed: u64, control: &Control) -> Result<Vec<Point>> {
        // More keypoints than points add no information, and the time of matching grows with the
        // square of their number.
        let count = count.min(self.points.len());
        match detector {
            Detector::Voxels => Ok(self.voxel_sample(count, seed).map(|index| self.voxel_mean(index)).collect()),
            Detector::Snake => {
                let options = self.model()?.1.detect.with_max_keypoints(count);
                let detection = self.field(control)?.detect_with(&options, control)?;
                Ok(detection.keypoints.into_iter().map(|keypoint| keypoint.position).collect())
            }
            classical => {
                let voxels = self.points();
                control.begin("keypoints", 0).check()?;
                let responses = classical.keypoints_with(&voxels, count, Protocol::Ranked, seed, control)?;
                Ok(responses.into_iter().map(|response| voxels[response.index]).collect())
            }
        }
    }

    /// `count` keypoints `(K, 3)` in the cloud's frame, best first, that are spread over the cloud (see
    /// [`suppress_to_count`]); fewer if the detector finds fewer. Voxels have no rank: the seed decides their order.
    ///
    /// # Errors
    /// The errors of [`VoxelCloud::keypoints`].
    pub fn spread_keypoints(
        &self,
        detector: Detector,
        count: usize,
        seed: u64,
        control: &Control,
    ) -> Result<Vec<Point>> {
        let ranked = match detector {
            // Farthest-point sampling already spreads its keypoints.
            Detector::Fps => return self.keypoints(detector, count, seed, control),
            Detector::Voxels => self.keypoints(Detector::Random, self.voxels.points.len(), seed, control)?,
            _ => self.keypoints(detector, self.voxels.points.len(), seed, control)?,
        };
        let (kept, _) = suppress_to_count(&ranked, count)?;
        Ok(kept.into_iter().map(|index| ranked[index]).collect())
    }

    /// Indices of all voxels, or of `count` random ones, ascending.
    fn voxel_sample(&self, count: usize, seed: u64) -> impl Iterator<Item = usize> + use<> {
        let total = self.voxels.points.len();
        let mut sample: Vec<usize> = if count < total {
            rand::seq::index::sample(&mut ChaCha8Rng::seed_from_u64(seed), total, count).into_vec()
        } else {
            (0..total).collect()
        };
        sample.sort_unstable();
        sample.into_iter()
    }

    /// The keypoints that the options ask for, each with the index of the nearest voxel.
    pub(super) fn anchored_keypoints(
        &self,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Vec<(Point, usize)>> {
        let RegisterOptions { detector, max_keypoints, seed, .. } = *options;
        let keypoints = match options.num_keypoints {
            Some(count) => self.spread_keypoints(detector, count, seed, control)?,
            None if detector == Detector::Voxels => {
                let sample = self.voxel_sample(max_keypoints, seed);
                return Ok(sample.map(|index| (self.voxel_mean(index), index)).collect());
            }
            None => self.keypoints(detector, max_keypoints, seed, control)?,
        };
        Ok(keypoints.into_iter().map(|point| (point, self.nearest_voxel(point))).collect())
    }
}

#[cfg(test)]
mod tests;
