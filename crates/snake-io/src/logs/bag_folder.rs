//! Bags of ROS 2, which are folders with files of messages and a `metadata.yaml`, which is missing after a crash.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use crate::formats::{PointFormat, extension};
use crate::logs::metadata;
use crate::{Error, Result};

/// How a compressed bag is converted.
pub(crate) const COMPRESSED: &str = "its messages are compressed; write them without compression: ros2 bag convert -i FOLDER \
                                     -o OPTIONS.yaml with output_bags: [{uri: drive, storage_id: mcap, all: true}]";

/// Whether a folder has files of messages and a `metadata.yaml`, or without that only parts of one bag.
pub(crate) fn is_bag(folder: &Path) -> bool {
    let Ok(names) = names(folder) else { return false };
    let has_parts = names.iter().any(|name| is_part(Path::new(name)));
    let is_cloud = |name: &OsString| PointFormat::from_path(&folder.join(name)).is_ok();
    has_parts && (metadata_file(folder).is_file() || (!names.iter().any(is_cloud) && numbered(folder).is_ok()))
}

/// The names of the files in a folder.
fn names(folder: &Path) -> Result<Vec<OsString>> {
    let list = || -> std::io::Result<Vec<OsString>> {
        let mut names = Vec::new();
        for entry in folder.read_dir()? {
            let entry = entry?;
            if entry.path().is_file() {
                names.push(entry.file_name());
            }
        }
        Ok(names)
    };
    list().map_err(|source| Error::Io { path: folder.into(), source })
}

/// The parts of a bag without metadata, in the order of their numbers: `NAME_0.db3`, `NAME_1.db3`.
fn numbered(folder: &Path) -> Result<Vec<PathBuf>> {
    let refuse = |reason: String| Err(Error::Format { path: folder.into(), reason });
    let mut parts: Vec<(String, u64, OsString)> = Vec::new();
    for name in names(folder)?.into_iter().filter(|name| is_part(Path::new(name))) {
        if is_compressed(&name) {
            return refuse(format!("{}: {COMPRESSED}", name.display()));
        }
        let stem = Path::new(&name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let split = stem.rsplit_once('_').and_then(|(stem, number)| Some((stem.to_owned(), number.parse().ok()?)));
        let (stem, number) = split.unwrap_or((stem, 0));
        parts.push((stem, number, name));
    }
    parts.sort();
    let Some((stem, ..)) = parts.first() else {
        return refuse("no metadata.yaml and no files of messages (.db3, .mcap) in it".into());
    };
    if let Some((.., other)) = parts.iter().find(|(other, ..)| other != stem) {
        return refuse(format!(
            "no metadata.yaml, and files of several recordings; give one of them: {}",
            folder.join(other).display()
        ));
    }
    if let Some(pair) = parts.windows(2).find(|pair| pair[1].1 != pair[0].1 + 1) {
        let (before, after) = (pair[0].2.display(), pair[1].2.display());
        return refuse(format!(
            "no metadata.yaml, and {after} does not follow {before}; write the metadata: ros2 bag reindex FOLDER"
        ));
    }
    Ok(parts.into_iter().map(|(.., name)| folder.join(name)).collect())
}

/// The files of a bag in the order of its metadata, or without metadata in that of their numbers.
pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let path = metadata_file(folder);
    if !path.exists() {
        return numbered(folder);
    }
    let text = std::fs::read_to_string(&path).map_err(|source| Error::Io { path: path.clone(), source })?;
    let refuse = |reason: String| Error::Format { path: path.clone(), reason };
    let listed = metadata::file_paths(&text).map_err(|reason| {
        refuse(format!("no metadata of a bag of ROS 2: {reason}; write it anew: ros2 bag reindex FOLDER"))
    })?;
    if listed.is_empty() {
        return Err(refuse("it lists no files (relative_file_paths)".into()));
    }
    let file = |listed: PathBuf| match listed.file_name() {
        // Old bags put the name of their folder before the file.
        Some(name) if is_part(Path::new(name)) && !is_compressed(name) => Ok(folder.join(name)),
        Some(name) if is_part(Path::new(name)) => Err(refuse(format!("{}: {COMPRESSED}", name.display()))),
        _ => Err(refuse(format!("{}: no file of messages (.db3, .mcap)", listed.display()))),
    };
    listed.into_iter().map(file).collect()
}

fn metadata_file(folder: &Path) -> PathBuf {
    folder.join("metadata.yaml")
}

/// Whether a file has messages of a bag, also compressed.
fn is_part(path: &Path) -> bool {
    let path = if path.file_name().is_some_and(is_compressed) { path.with_extension("") } else { path.into() };
    matches!(extension(&path).as_str(), "db3" | "mcap")
}

fn is_compressed(name: &OsStr) -> bool {
    extension(Path::new(name)) == "zstd"
}
