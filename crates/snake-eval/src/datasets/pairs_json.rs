//! `pairs.json`: the list of a folder's pairs of clouds.

use std::path::Path;

use serde::Deserialize;
use snake_geometry::RigidTransform;

use super::read_json;
use crate::error::Result;

/// The name of the list.
pub(super) const NAME: &str = "pairs.json";

/// A row of the list; other keys are ignored.
#[derive(Deserialize)]
pub(super) struct ListedPair {
    pub(super) source: String,
    pub(super) target: String,
    #[serde(rename = "T")]
    pub(super) t_target_source: RigidTransform,
}

/// Reads the list of a folder.
pub(super) fn read(folder: &Path) -> Result<Vec<ListedPair>> {
    read_json(&folder.join(NAME))
}
