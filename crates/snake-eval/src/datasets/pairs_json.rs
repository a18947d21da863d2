//! `pairs.json`: a folder's list of pairs of clouds.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use serde::Deserialize;
use snake_core::RigidTransform;
use snake_io as io;

use super::read_json;

/// A row of `pairs.json`; other keys are ignored.
#[derive(Deserialize)]
pub struct ListedPair {
    pub source: String,
    pub target: String,
    #[serde(rename = "T")]
    pub t_target_source: RigidTransform,
}

/// The pairs of a folder.
pub fn listed(folder: &Path) -> Result<Vec<ListedPair>> {
    read_json(&folder.join("pairs.json"))
}

/// The file at this path, or at this path with the extension of a known format.
pub fn find_cloud(path: &Path) -> Result<PathBuf> {
    let with = |extension: &&str| PathBuf::from(format!("{}.{extension}", path.display()));
    let named = std::iter::once(path.to_path_buf()).chain(io::POINT_EXTENSIONS.iter().map(with));
    let Some(found) = named.into_iter().find(|path| path.is_file()) else {
        bail!("{}: no such cloud (looked for .{})", path.display(), io::POINT_EXTENSIONS.join(", ."))
    };
    Ok(found)
}
