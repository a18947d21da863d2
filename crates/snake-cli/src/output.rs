//! Where results go: never onto an input, and each to a name of its own.

use std::collections::{HashMap, HashSet};
use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

use crate::inputs::DASH;

/// The files that are read, by identity: a file has many spellings and may have several names.
#[derive(Default)]
pub struct InputFiles(HashSet<Identity>);

impl InputFiles {
    /// Of these paths; those that are no files, such as names of models, do not count.
    pub fn new<'a, P: AsRef<Path> + ?Sized + 'a>(paths: impl IntoIterator<Item = &'a P>) -> Self {
        Self(paths.into_iter().filter_map(|path| identity(path.as_ref())).collect())
    }

    /// Refuses an output that is one of these files.
    pub fn refuse_as_output(&self, output: &Path) -> Result<()> {
        if output != Path::new(DASH) && identity(output).is_some_and(|output| self.0.contains(&output)) {
            bail!("{}: is an input, which would be lost; give another name to write to", output.display());
        }
        Ok(())
    }
}

/// What is the same for all paths to a regular file: on Unix its device and number, elsewhere its canonical path.
#[cfg(unix)]
type Identity = (u64, u64);
#[cfg(not(unix))]
type Identity = PathBuf;

/// `None` of what is no regular file, as no other file can be replaced.
fn identity(path: &Path) -> Option<Identity> {
    let metadata = if path == Path::new(DASH) { stdin_metadata() } else { path.metadata() }.ok()?;
    if !metadata.is_file() {
        return None;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        Some((metadata.dev(), metadata.ino()))
    }
    #[cfg(not(unix))]
    path.canonicalize().ok()
}

#[cfg(unix)]
fn stdin_metadata() -> io::Result<Metadata> {
    use std::os::fd::AsFd;
    std::fs::File::from(io::stdin().as_fd().try_clone_to_owned()?).metadata()
}

#[cfg(not(unix))]
fn stdin_metadata() -> io::Result<Metadata> {
    Err(io::ErrorKind::Unsupported.into())
}

/// The file in `folder` for the result of each input, `NAME.keypoints.EXTENSION`.
///
/// Inputs of one name, as `a.las` and `a.laz`, are numbered if so wanted: `NAME.2.keypoints.EXTENSION`. Otherwise each of
/// them has an error that names it and another.
pub fn in_folder(folder: &Path, inputs: &[PathBuf], extension: &str, number: bool) -> Vec<Result<PathBuf>> {
    let stem = |input: &PathBuf| input.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut by_stem: HashMap<String, Vec<&PathBuf>> = HashMap::new();
    for input in inputs {
        by_stem.entry(stem(input)).or_default().push(input);
    }
    let path = |stem: &str| folder.join(format!("{stem}.keypoints.{extension}"));
    let mut taken: HashSet<String> = HashSet::new();
    let mut numbered = |stem: &str| {
        let names = std::iter::once(stem.to_owned()).chain((2..).map(|number| format!("{stem}.{number}")));
        // A number of one input may be the name of another.
        let mut free = names.filter(|name| name == stem || !by_stem.contains_key(name));
        free.find(|name| taken.insert(name.clone())).unwrap_or_default()
    };
    let output = |input: &PathBuf| {
        let stem = stem(input);
        // The same path may be given twice.
        let other = by_stem[&stem].iter().find(|other| !std::ptr::eq(**other, input));
        match other {
            None => Ok(path(&stem)),
            Some(_) if number => Ok(path(&numbered(&stem))),
            Some(other) => bail!(
                "{} and {}: both results would be {}; give --number-results, or run them into different directories",
                input.display(),
                other.display(),
                path(&stem).display()
            ),
        }
    };
    inputs.iter().map(output).collect()
}
