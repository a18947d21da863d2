//! Bags of ROS 2, which are folders with files of messages and a `metadata.yaml`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::format::extension;
use crate::{Error, Result};

/// How a compressed bag is converted.
pub(crate) const COMPRESSED: &str = "its messages are compressed; write them without compression: ros2 bag convert -i FOLDER \
                                     -o OPTIONS.yaml with output_bags: [{uri: drive, storage_id: mcap, all: true}]";

/// What is read of `metadata.yaml`.
#[derive(Deserialize)]
struct Metadata {
    rosbag2_bagfile_information: Information,
}

#[derive(Deserialize)]
struct Information {
    relative_file_paths: Vec<PathBuf>,
}

/// Whether a folder has a `metadata.yaml` and files of messages.
pub(crate) fn is_bag(folder: &Path) -> bool {
    let has_messages = |entry: std::io::Result<std::fs::DirEntry>| entry.is_ok_and(|entry| is_part(&entry.path()));
    metadata(folder).is_file() && folder.read_dir().is_ok_and(|mut entries| entries.any(has_messages))
}

/// The files of a bag in the order of its metadata.
pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let path = metadata(folder);
    let text = std::fs::read_to_string(&path).map_err(|source| Error::Io { path: path.clone(), source })?;
    let refuse = |reason: String| Error::Format { path: path.clone(), reason };
    let metadata: Metadata = serde_saphyr::from_str(&text).map_err(|error| {
        // The error goes on with an excerpt of the file.
        refuse(format!("no metadata of a bag of ROS 2: {}", error.without_snippet()))
    })?;
    let listed = metadata.rosbag2_bagfile_information.relative_file_paths;
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

fn metadata(folder: &Path) -> PathBuf {
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
