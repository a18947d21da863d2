//! Files of clouds and meshes, one format a file.

#[cfg(feature = "e57")]
pub(crate) mod e57;
#[cfg(feature = "gltf")]
pub(crate) mod gltf;
pub(crate) mod lzf;
pub(crate) mod obj;
pub(crate) mod off;
pub(crate) mod pcd;
pub(crate) mod ply;
pub(crate) mod ply_header;
pub(crate) mod quaternion;
pub(crate) mod stl;
pub(crate) mod sweep;
