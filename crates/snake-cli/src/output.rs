//! Output files: they never replace an input, and each result has a name of its own.

use std::collections::{HashMap, HashSet};
use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::inputs::DASH;

/// The input files by identity, because several paths may lead to the same file.
#[derive(Default)]
pub struct InputFiles(HashSet<Identity>);

impl InputFiles {
    /// The files at these paths. Paths that are not files, such as names of models, are ignored.
    pub fn new<'a, P: AsRef<Path> + ?Sized + 'a>(paths: impl IntoIterator<Item = &'a P>) -> Self {
        Self(paths.into_iter().filter_map(|path| identity(path.as_ref())).collect())
    }

    /// Returns an error if the output is one of these files.
    pub fn refuse_as_output(&self, output: &Path) -> Result<()> {
        if output != Path::new(DASH) && identity(output).is_some_and(|output| self.0.contains(&output)) {
            bail!("{}: is an input, which this output would overwrite; give another name", output.display());
        }
        Ok(())
    }
}

/// Returns an error if a page cannot be written to a file of this name.
pub fn check_page_path(path: &Path) -> Result<()> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if !["html", "htm"].contains(&extension.as_str()) {
        bail!("{}: unknown extension; files that can be written: .html", path.display());
    }
    Ok(())
}

/// Writes a page.
pub fn write_page(path: &Path, html: &str) -> Result<()> {
    snake_io::write_atomically(path, |file| file.write_all(html.as_bytes()))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// The identity of a regular file, the same for all of its paths: device and inode on Unix, the canonical path
/// elsewhere.
#[cfg(unix)]
type Identity = (u64, u64);
#[cfg(not(unix))]
type Identity = PathBuf;

/// The identity of a regular file. Anything else gives `None`, because only regular files can be replaced.
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
/// Inputs with the same name, such as `a.las` and `a.laz`, are numbered if `number` is set:
/// `NAME.2.keypoints.EXTENSION`. Otherwise each of them gives an error that names it and another one.
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
        // A numbered name may be the name of another input.
        let mut free = names.filter(|name| name == stem || !by_stem.contains_key(name));
        free.find(|name| taken.insert(name.clone())).unwrap_or_default()
    };
    let output = |input: &PathBuf| {
        let stem = stem(input);
        // Compares by address, because the same path may be given twice.
        let other = by_stem[&stem].iter().find(|other| !std::ptr::eq(**other, input));
        match other {
            None => Ok(path(&stem)),
            Some(_) if number => Ok(path(&numbered(&stem))),
            Some(other) => bail!(
                "{} and {} would both write {}; give --number-results or different output directories",
                input.display(),
                other.display(),
                path(&stem).display()
            ),
        }
    };
    inputs.iter().map(output).collect()
}
