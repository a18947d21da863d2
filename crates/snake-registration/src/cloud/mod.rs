//! What a prepared cloud offers to the steps: voxels with normals, surfaces seen from a sensor,
//! planar patches, and pairs of points with planes.

pub(crate) mod depth_image;
pub(crate) mod near_grid;
pub(crate) mod normals;
pub(crate) mod patches;
pub(crate) mod planes;
pub(crate) mod surface;
pub(crate) mod voxels;
