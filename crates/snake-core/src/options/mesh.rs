//! Options of meshes.

use serde::{Deserialize, Serialize};

use crate::Result;
use snake_geometry::options;

/// Where the vertices of a mesh lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeshSurface {
    /// In the middle of the shell, on the ridge of the occupancy. Both sides of a thin wall lie there, and where they
    /// met some triangles are folded.
    #[default]
    Middle,
    /// Where the occupancy equals the level, as in the released code.
    Level,
}

options! {
    /// Options of [`Field::mesh`](crate::Field::mesh).
    pub struct MeshOptions {
        /// Number of samples of the occupancy along each axis of the feature volume, ends included.
        resolution, with_resolution: usize = 128, from 8 to 512 " (samples along each axis)", flag "NUMBER";
        /// Where the vertices lie: in the middle of the shell, or where the occupancy equals the level.
        surface, with_surface: MeshSurface = MeshSurface::Middle, flag "SURFACE";
        /// Occupancy at the shell. A higher level gives thinner shells with more holes.
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
        self.check_ranges()
    }
}
