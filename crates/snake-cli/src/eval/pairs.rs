//! `pairs.json`: a folder's list of pairs of clouds, and files with the transform of one pair.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use snake_core::Transform;
use snake_io as io;

use super::read_json;

/// A row of `pairs.json`; other keys are ignored.
#[derive(Deserialize)]
pub struct ListedPair {
    pub source: String,
    pub target: String,
    #[serde(rename = "T")]
    pub t_target_source: Transform,
}

/// The pairs of a folder.
pub fn listed(folder: &Path) -> Result<Vec<ListedPair>> {
    read_json(&folder.join("pairs.json"))
}

/// The JSON of `register`; other keys are ignored.
#[derive(Deserialize)]
struct Registered {
    t_target_source: Transform,
}

/// Reads a transform as `register` writes it: JSON, or 16 numbers as text, row by row.
pub fn transform(path: &Path) -> Result<Transform> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) {
        return Ok(read_json::<Registered>(path)?.t_target_source);
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let numbers = text.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>().ok();
    match numbers {
        Some(numbers) if numbers.len() == 16 => {
            Ok(std::array::from_fn(|row| std::array::from_fn(|column| numbers[4 * row + column])))
        }
        _ => bail!("{}: needed are 16 numbers, the rows of t_target_source", path.display()),
    }
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
