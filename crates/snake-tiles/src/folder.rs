//! The folder of a run. It is new or carries the run's id. A file in it is either complete or missing, and is not written again.
//!
//! No lock is needed. A folder refuses every other run, and the id covers everything that determines the bytes of a file, so two
//! processes in one folder write the same bytes. A file of results is renamed to its final name once it is complete. Points are
//! written to the same positions of the same files, and count once the plan exists.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use snake_io::{TEMPORARY, write_atomically};

use crate::{Error, Result};

/// The marker's name begins with this and ends with the run's id. A name is created atomically, a content is not.
const MARKER: &str = "snake-tiles.";

/// The content of the marker if the run created the folder, which is then removed with the run.
const MADE: &[u8] = b"the run made this folder";

/// The name of the plan in the folder.
pub(crate) const PLAN: &str = "plan.json";

/// The subfolders of the other files.
const PARTS: [&str; 2] = ["points", "candidates"];

/// The folder of a run.
#[derive(Debug)]
pub(crate) struct RunFolder {
    pub(crate) path: PathBuf,
    id: String,
}

impl RunFolder {
    /// A folder for the run of this id. A folder with another run, or with files that no run wrote, is refused. Nothing is written
    /// before [`RunFolder::mark`].
    pub(crate) fn new(path: &Path, id: String) -> Result<Self> {
        let folder = Self { path: std::path::absolute(path).map_err(Error::file(path))?, id };
        folder.refuse_others().map(|_| folder)
    }

    /// The folder of a run that already began there.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let path = std::path::absolute(path).map_err(Error::file(path))?;
        match names(&path)?.iter().find_map(|name| name.strip_prefix(MARKER)) {
            Some(id) => Ok(Self { id: id.into(), path }),
            None => Err(Error::file(&path.join(PLAN))(ErrorKind::NotFound.into())),
        }
    }

    /// Creates the folder if it does not exist, and marks it.
    pub(crate) fn mark(&self) -> Result<()> {
        if self.refuse_others()? {
            return Ok(());
        }
        let (marker, content) = (self.marker(), if self.path.exists() { b"" } else { MADE });
        fs::create_dir_all(&self.path).and_then(|()| fs::write(&marker, content)).map_err(Error::file(&marker))?;
        // If two runs begin in a new folder at once, at least one of them sees the other's marker.
        self.refuse_others().map(drop).inspect_err(|_| drop(fs::remove_file(&marker)))
    }

    fn marker(&self) -> PathBuf {
        self.path.join(format!("{MARKER}{}", self.id))
    }

    /// Refuses the run of another id, and files without a run. Returns whether the folder is already marked.
    fn refuse_others(&self) -> Result<bool> {
        let (mut is_marked, mut other) = (false, None);
        for name in names(&self.path)? {
            match name.strip_prefix(MARKER) {
                Some(id) if id == self.id => is_marked = true,
                Some(_) => return Err(Error::other_run(&self.path)),
                None if !is_temporary(&name) => other = Some(name),
                None => (),
            }
        }
        match other.filter(|_| !is_marked) {
            Some(other) => Err(Error::not_own(&self.path, &other)),
            None => Ok(is_marked),
        }
    }

    /// Refuses to continue after another process has removed the run, which removes the plan first.
    pub(crate) fn check(&self) -> Result<()> {
        if self.has(PLAN) { Ok(()) } else { Err(Error::removed(&self.path)) }
    }

    /// The path of a file of the run. A link in its place is refused, because it would lead out of the folder.
    fn own(&self, name: &str) -> Result<PathBuf> {
        let path = self.path.join(name);
        let is_linked = path.ancestors().take_while(|path| *path != self.path).any(Path::is_symlink);
        if is_linked { Err(Error::not_own(&self.path, name)) } else { Ok(path) }
    }

    /// [`RunFolder::own`] for a file to write; creates the folder of `points` or `candidates`.
    pub(crate) fn to_write(&self, name: &str) -> Result<PathBuf> {
        let path = self.own(name)?;
        // If the folder cannot be created, writing the file fails.
        let _is_there = path.parent().map(fs::create_dir);
        Ok(path)
    }

    /// Whether a file exists; it is then complete.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.own(name).is_ok_and(|path| path.is_file())
    }

    /// Writes a file completely or not at all. It ends with the run's id.
    pub(crate) fn write(&self, name: &str, content: &[u8]) -> Result<()> {
        let path = self.to_write(name)?;
        write_atomically(&path, |file| file.write_all(&[content, self.id.as_bytes()].concat()))
            .map_err(Error::file(&path))
    }

    /// Reads the content of [`RunFolder::write`]. A file without the run's id at its end, such as one cut short, is damaged.
    pub(crate) fn read(&self, name: &str) -> Result<Vec<u8>> {
        let path = self.path.join(name);
        let bytes = fs::read(&path).map_err(Error::file(&path))?;
        let content = bytes.strip_suffix(self.id.as_bytes()).ok_or_else(|| Error::damaged(&path, "its end is missing"));
        content.map(<[u8]>::to_vec)
    }

    /// Removes these files of the run, and the folder if the run created it. Returns the files that others wrote there; they remain.
    pub(crate) fn remove(&self, files: impl Iterator<Item = String>) -> Result<Vec<PathBuf>> {
        let is_made = fs::read(self.marker()).is_ok_and(|content| content == MADE);
        for path in std::iter::once(PLAN.to_owned()).chain(files).filter_map(|name| self.own(&name).ok()) {
            match fs::remove_file(&path) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(Error::file(&path)(error)),
                _ => (),
            }
        }
        let mut others = Vec::new();
        for part in PARTS.into_iter().chain([""]).filter(|part| !self.path.join(part).is_symlink() || part.is_empty()) {
            for name in names(&self.path.join(part))? {
                let path = self.path.join(part).join(&name);
                if is_temporary(&name) {
                    let _others_may = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
                } else if path != self.marker() && !(PARTS.contains(&&*name) && path.is_dir() && !path.is_symlink()) {
                    others.push(Path::new(part).join(name));
                }
            }
            let _if_empty = (!part.is_empty()).then(|| fs::remove_dir(self.path.join(part)));
        }
        // The marker is removed last, so a run that is killed before can be resumed.
        let _others_may = fs::remove_file(self.marker());
        let _if_empty = is_made.then(|| fs::remove_dir(&self.path));
        Ok(others)
    }
}

/// The names in a folder; none if it does not exist.
fn names(folder: &Path) -> Result<Vec<String>> {
    match folder.read_dir() {
        Ok(entries) => entries
            .map(|entry| Ok(entry.map_err(Error::file(folder))?.file_name().to_string_lossy().into_owned()))
            .collect(),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(Error::file(folder)(error)),
    }
}

/// Whether a killed program left this file, see [`TEMPORARY`].
fn is_temporary(name: &str) -> bool {
    let [start, end] = TEMPORARY;
    name.starts_with(start) && name.ends_with(end)
}
