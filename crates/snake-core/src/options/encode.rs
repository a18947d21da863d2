//! Options of encoding.

use serde::{Deserialize, Serialize};

use super::none_if_zero;
use crate::{Error, Result};
use snake_geometry::{Length, NormalizationMethod, OptionGroup, options};

options! {
    /// Options of [`Model::encode`](crate::Model::encode).
    pub struct EncodeOptions {
        /// Method that maps the cloud into the network's frame, from the statistics of all its points.
        normalization, with_normalization: NormalizationMethod = NormalizationMethod::UnitSphere;
        /// Largest number of points to encode, drawn at random without replacement from the finite ones.
        max_points, with_max_points: Option<usize> = None, none "all points", from 1 or more;
        /// Seed of the draw of `max_points`.
        seed, with_seed: u64 = 0;
        /// Number of rotated copies of the cloud whose fields are averaged. Keypoints repeat far better, and the time grows
        /// in proportion.
        ///
        /// The mean is that of the log-odds. The network is only roughly equivariant, and its errors in the copies are nearly
        /// independent. A rotated cube leaves the volume.
        rotations, with_rotations: usize = 1,
            from 1 to 64 ", above 1 only with unit-sphere or principal-axes normalization", flag "NUMBER";
        /// Size of a voxel, for scene models: in cloud units, or in multiples of the cloud's resolution (`2r`). Details
        /// smaller than a voxel are not seen.
        #[serde(deserialize_with = "none_if_zero")]
        voxel_size, with_voxel_size: Option<Length> = None, none "chosen from the cloud", flag "LENGTH";
    }
}

impl EncodeOptions {
    /// Checks the ranges.
    pub(crate) fn check(&self) -> Result<()> {
        self.check_ranges()?;
        if self.rotations > 1 && !self.normalization.allows_rotations() {
            let allowed = Self::range("rotations");
            return Err(Error::Option { name: "rotations", value: self.rotations.to_string(), allowed });
        }
        Ok(())
    }
}
