//! Data sets and their layouts on disk.
//!
//! | type | data sets |
//! |---|---|
//! | [`ViewPairs`] | objects, `pairs.json`, ModelNet40 and Redwood in the layout of USIP |
//! | [`SemanticData`] | KeypointNet, pairs of SMPL bodies, SMPL body models |
//! | [`Scenes`] | `pairs.json`, 3DMatch |
//!
//! Opening a data set reads its lists and checks them. The clouds are read one by one, when they are needed.

mod pairs_json;
mod repeatability;
mod scenes;
mod semantic;

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use snake_io::POINT_EXTENSIONS;

use crate::error::{Error, Result};

pub use repeatability::{Scale, ViewPairs};
pub use scenes::{ScenePair, Scenes};
pub use semantic::{SemanticData, Shape, annotated_points};

/// A text file, without the byte order mark that some editors write.
fn read_text(path: &Path) -> Result<String> {
    let text = std::fs::read_to_string(path).map_err(|reason| Error::io(path, reason))?;
    Ok(text.trim_start_matches('\u{feff}').to_owned())
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_str(&read_text(path)?).map_err(|reason| Error::layout(path, reason.to_string()))
}

/// The file at this path, or at this path with the extension of a known format.
fn find_cloud(path: &Path) -> Result<PathBuf> {
    let with = |extension: &&str| PathBuf::from(format!("{}.{extension}", path.display()));
    let named = std::iter::once(path.to_path_buf()).chain(POINT_EXTENSIONS.iter().map(with));
    let file = named.into_iter().find(|path| path.is_file());
    file.ok_or_else(|| Error::layout(path, format!("no such cloud (looked for .{})", POINT_EXTENSIONS.join(", ."))))
}

/// The name of a cloud's file without the extension of a known format.
fn without_extension(file: &str) -> &str {
    match file.rsplit_once('.') {
        Some((name, extension)) if POINT_EXTENSIONS.contains(&extension) => name,
        _ => file,
    }
}
