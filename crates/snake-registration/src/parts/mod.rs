//! Plain parts: voxels and normals, descriptors, matching, transforms from correspondences, nearest points.

pub(crate) mod cloud;
pub(crate) mod depth_image;
pub(crate) mod fast_fpfh;
pub(crate) mod fpfh;
pub(crate) mod matching;
pub(crate) mod medians;
pub(crate) mod near_grid;
pub(crate) mod nearest;
pub(crate) mod ransac;
pub(crate) mod rigid;
pub(crate) mod spread;
