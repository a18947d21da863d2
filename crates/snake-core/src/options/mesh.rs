//! Options of meshes.

use serde::{Deserialize, Serialize};

use crate::Result;
use snake_geometry::options;

options! {
    /// Options of [`Field::mesh`](crate::Field::mesh).
    pub struct MeshOptions {
        /// Number of samples of the occupancy along each axis of the feature volume, ends included.
        resolution, with_resolution: usize = 128, from 8 to 512 " (samples along each axis)", flag "NUMBER";
        /// Occupancy at the surface. A higher level gives thinner shells.
        ///
        /// The default is the released code's.
        level, with_level: f32 = 0.4, from 0.001 to 0.999 " (a probability)", flag "PROBABILITY";
        /// Whether only surfaces are kept that can be reached from outside. A thin shell has an outer and an inner surface; this
        /// removes the inner one unless the shell has a hole.
        outer, with_outer: bool = false, flag "OUTER";
    }
}

impl MeshOptions {
    /// Refuses options that [`Field::mesh`](crate::Field::mesh) would refuse, before any work is done.
    ///
    /// # Errors
    /// [`Error::Option`](crate::Error::Option) when an option is out of its range.
    pub fn check(&self) -> Result<()> {
        Ok(self.check_ranges()?)
    }
}
