//! What a prepared cloud provides for the steps: voxels with normals, surfaces as a sensor saw
//! them, planar patches, and pairs of points and planes.

pub(crate) mod depth_image;
pub(crate) mod near_grid;
pub(crate) mod normals;
pub(crate) mod patches;
pub(crate) mod planes;
pub(crate) mod surface;
pub(crate) mod voxels;
