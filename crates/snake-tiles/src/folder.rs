//! A folder that belongs to a run: its marker, its files with their checksums, and the removal of these files alone.
//!
//! The marker lists each file before the run makes it. A file that is not listed is never written or removed.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use snake_io::{TEMPORARY, sync_folder, write_atomically};

use crate::lock::{LOCK, Lock};
use crate::{Error, Result};

/// The name of the marker.
const MARKER: &str = "snake-tiles.run";

/// Its first line. A run made the folder, or the folder was there, and stays when the run's files are removed.
const MADE: &str = "folder made";
const FOUND: &str = "folder found";

/// Folders that another process removes while this one claims them are claimed again.
const ATTEMPTS: usize = 100;

/// The name of the plan in the folder.
pub(crate) const PLAN: &str = "plan.json";

/// One run of this process at a time prepares a folder.
static PREPARING: Mutex<()> = Mutex::new(());

/// A folder that belongs to a run.
#[derive(Debug)]
pub struct RunFolder {
    /// Without links, so that each name of the folder gives the same path.
    path: PathBuf,
    /// Keeps other processes away; none for those that the run's process lets in.
    _lock: Option<Lock>,
}

impl RunFolder {
    /// Claims a folder for this process: makes it if it is not there, locks it, and marks it.
    ///
    /// # Errors
    /// [`Error::Refused`] for a folder with files that no run wrote; [`Error::InUse`] when another process has it;
    /// [`Error::File`] when it cannot be read or written.
    pub fn claim(folder: &Path) -> Result<Self> {
        for _ in 0..ATTEMPTS {
            // A run that was killed before it marked the folder may have left its lock.
            let is_made = !folder.exists() || folder.join(LOCK).is_file();
            std::fs::create_dir_all(folder).map_err(Error::file(folder))?;
            let Ok(path) = folder.canonicalize() else { continue };
            refuse_others(&path)?;
            let Some(lock) = Lock::of(&path)? else { continue };
            let claimed = Self { path, _lock: Some(lock) };
            if claimed.marked()?.is_empty() {
                let first = line(if is_made { MADE } else { FOUND });
                let marker = claimed.path.join(MARKER);
                write_atomically(&marker, |file| file.write_all(first.as_bytes())).map_err(Error::file(&marker))?;
            }
            return Ok(claimed);
        }
        let reason = format!("{}: other processes remove it again and again", folder.display());
        Err(Error::Refused { what: "the folder of the tiles", reason })
    }

    /// Joins the run of a folder, which another process may have claimed.
    pub(crate) fn join(folder: &Path) -> Result<Self> {
        let path = folder.canonicalize().map_err(Error::file(folder))?;
        Ok(Self { path, _lock: None })
    }

    /// Waits for other threads that prepare a folder.
    pub(crate) fn begin() -> MutexGuard<'static, ()> {
        PREPARING.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a file of the run, whose folder it makes.
    ///
    /// # Errors
    /// [`Error::Refused`] when something else is in its place, such as a link.
    pub(crate) fn own(&self, name: &str) -> Result<PathBuf> {
        let path = self.path.join(name);
        let between = path.ancestors().skip(1).take_while(|folder| *folder != self.path);
        let is_other = |folder: &Path| folder.symlink_metadata().is_ok_and(|found| !found.is_dir());
        if between.into_iter().any(is_other) || path.symlink_metadata().is_ok_and(|found| !found.is_file()) {
            return Err(Error::not_own(&self.path, Path::new(name)));
        }
        let folder = path.parent().unwrap_or(&self.path);
        std::fs::create_dir_all(folder).map_err(Error::file(folder))?;
        Ok(path)
    }

    /// Lists files in the marker before the run makes them.
    ///
    /// # Errors
    /// [`Error::Refused`] when a file is there that no run wrote; [`Error::File`] when the marker cannot be written.
    pub(crate) fn list(&self, names: impl IntoIterator<Item = String>) -> Result<()> {
        let listed = self.marked()?;
        let new: Vec<String> = names.into_iter().filter(|name| !listed.contains(name)).collect();
        match new.iter().find(|name| self.path.join(name).symlink_metadata().is_ok()) {
            Some(other) => Err(Error::not_own(&self.path, Path::new(other))),
            None => self.mark(&new),
        }
    }

    /// Lists the files of a plan again where the marker was damaged.
    pub(crate) fn mend(&self, names: impl IntoIterator<Item = String>) -> Result<()> {
        let listed = self.marked()?;
        self.mark(&names.into_iter().filter(|name| !listed.contains(name)).collect::<Vec<_>>())
    }

    /// Adds entries to the marker.
    fn mark(&self, entries: &[String]) -> Result<()> {
        let lines: String = entries.iter().map(|entry| line(entry)).collect();
        let path = self.path.join(MARKER);
        let append = || {
            let mut file = File::options().read(true).append(true).open(&path)?;
            // A process that was killed may have left a part of a line.
            let mut last = [b'\n'];
            if file.seek(SeekFrom::End(-1)).is_ok() {
                file.read_exact(&mut last)?;
            }
            let start = if last == [b'\n'] { "" } else { "\n" };
            file.write_all(format!("{start}{lines}").as_bytes())?;
            file.sync_all()
        };
        if lines.is_empty() { Ok(()) } else { append().map_err(Error::file(&path)) }
    }

    /// Writes a listed file whole, with its checksum.
    pub(crate) fn write(&self, name: &str, content: &[u8]) -> Result<()> {
        let path = self.own(name)?;
        let write = |file: &mut dyn Write| {
            file.write_all(content)?;
            file.write_all(&trailer(content))
        };
        write_atomically(&path, write).map_err(Error::file(&path))
    }

    /// Reads what [`RunFolder::write`] wrote.
    ///
    /// # Errors
    /// [`Error::Damaged`] for another content.
    pub(crate) fn read(&self, name: &str) -> Result<Vec<u8>> {
        let path = self.path.join(name);
        let mut bytes = std::fs::read(&path).map_err(Error::file(&path))?;
        let length = bytes.len().checked_sub(trailer(b"").len());
        match length.filter(|&length| trailer(&bytes[..length]) == bytes[length..]) {
            Some(length) => {
                bytes.truncate(length);
                Ok(bytes)
            }
            None => Err(Error::damaged(&path)),
        }
    }

    /// The copy of another file in this folder, if it is there, undamaged.
    pub fn copied(&self, name: &str) -> Option<PathBuf> {
        let (digest, path) = (self.read(&digest_name(name)).ok()?, self.path.join(name));
        (digest_of(&path).ok()?.into_bytes() == digest).then_some(path)
    }

    /// The path to which a file is copied before [`RunFolder::finish_copy`].
    ///
    /// # Errors
    /// [`Error::Refused`] when a file is there that no run wrote; [`Error::File`] when the folder cannot be written.
    pub fn begin_copy(&self, name: &str) -> Result<PathBuf> {
        let part = format!("{name}{}", TEMPORARY[1]);
        self.list([name.into(), digest_name(name), part.clone()])?;
        self.own(&part)
    }

    /// Takes a complete copy in.
    ///
    /// # Errors
    /// [`Error::File`] when the folder cannot be written.
    pub fn finish_copy(&self, name: &str) -> Result<PathBuf> {
        let (part, path) = (self.own(&format!("{name}{}", TEMPORARY[1]))?, self.own(name)?);
        let digest = digest_of(&part).map_err(Error::file(&part))?;
        let sync = || File::open(&part)?.sync_all().and_then(|()| std::fs::rename(&part, &path));
        sync().map_err(Error::file(&path))?;
        path.parent().into_iter().for_each(sync_folder);
        self.write(&digest_name(name), digest.as_bytes())?;
        Ok(path)
    }

    /// Removes the run's files except those to keep.
    ///
    /// # Errors
    /// [`Error::Refused`], and nothing is removed, when the folder has files that the run did not write.
    pub(crate) fn clear(&self, is_kept: impl Fn(&str) -> bool) -> Result<()> {
        let (own, others) = self.content()?;
        if let Some(other) = others.first() {
            return Err(Error::not_own(&self.path, other));
        }
        self.remove(own.iter().filter(|name| !is_kept(name)))
    }

    /// Removes all files of the run, and the folder if the run made it. Returns the files that others wrote, which stay.
    ///
    /// # Errors
    /// [`Error::File`] when a file cannot be removed.
    pub(crate) fn remove_all(self) -> Result<Vec<PathBuf>> {
        let is_made = self.marked()?.contains(MADE);
        let (own, others) = self.content()?;
        self.remove(own.iter())?;
        let folders: BTreeSet<&Path> = own.iter().flat_map(|name| Path::new(name).ancestors().skip(1)).collect();
        // A folder comes after those that contain it. Those that others have files in stay.
        for folder in folders.into_iter().rev().filter(|folder| !folder.as_os_str().is_empty()) {
            let _if_empty = std::fs::remove_dir(self.path.join(folder));
        }
        for name in [MARKER, LOCK] {
            let path = self.path.join(name);
            std::fs::remove_file(&path).map_err(Error::file(&path))?;
        }
        if is_made {
            let _if_empty = std::fs::remove_dir(&self.path);
        }
        Ok(others)
    }

    fn remove<'a>(&self, names: impl Iterator<Item = &'a String>) -> Result<()> {
        for name in names {
            let path = self.path.join(name);
            std::fs::remove_file(&path).map_err(Error::file(&path))?;
        }
        Ok(())
    }

    /// The entries of the marker. Lines that are damaged are left out.
    fn marked(&self) -> Result<BTreeSet<String>> {
        let path = self.path.join(MARKER);
        match std::fs::read(&path) {
            Ok(bytes) => Ok(entries(&bytes)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(BTreeSet::new()),
            Err(error) => Err(Error::file(&path)(error)),
        }
    }

    /// The files of the run that are there, and those of others, relative to the folder.
    fn content(&self) -> Result<(Vec<String>, Vec<PathBuf>)> {
        let listed = self.marked()?;
        let (mut own, mut others) = (Vec::new(), Vec::new());
        let mut open = vec![PathBuf::new()];
        while let Some(folder) = open.pop() {
            let full = self.path.join(&folder);
            for entry in full.read_dir().map_err(Error::file(&full))? {
                let entry = entry.map_err(Error::file(&full))?;
                let (name, kind) = (folder.join(entry.file_name()), entry.file_type().map_err(Error::file(&full))?);
                let relative = name.components().map(Component::as_os_str).map(|part| part.to_str());
                let relative = relative.collect::<Option<Vec<_>>>().map(|parts| parts.join("/"));
                match relative {
                    Some(name) if kind.is_file() && [MARKER, LOCK].contains(&&*name) => (),
                    Some(name) if kind.is_file() && (listed.contains(&name) || is_temporary(&name)) => own.push(name),
                    _ if kind.is_dir() => open.push(name),
                    _ => others.push(name),
                }
            }
        }
        own.sort_unstable();
        Ok((own, others))
    }
}

/// Refuses a folder that is not marked unless it is empty. A process that was killed may have left the lock alone.
fn refuse_others(folder: &Path) -> Result<()> {
    let marker = folder.join(MARKER);
    if marker.is_symlink() {
        return Err(Error::not_own(folder, Path::new(MARKER)));
    }
    let is_marked = std::fs::read(&marker).is_ok_and(|bytes| !entries(&bytes).is_empty());
    // A whole plan is as good as a marker that is damaged.
    if is_marked || RunFolder::join(folder)?.read(PLAN).is_ok() {
        return Ok(());
    }
    for entry in folder.read_dir().map_err(Error::file(folder))? {
        let name = entry.map_err(Error::file(folder))?.file_name();
        if name != *LOCK && !is_temporary(&name.to_string_lossy()) {
            return Err(Error::not_own(folder, Path::new(&name)));
        }
    }
    Ok(())
}

fn is_temporary(name: &str) -> bool {
    let [prefix, suffix] = TEMPORARY;
    name.rsplit('/').next().is_some_and(|name| name.starts_with(prefix) && name.ends_with(suffix))
}

/// A line of the marker: a checksum and an entry.
fn line(entry: &str) -> String {
    format!("{} {entry}\n", &blake3::hash(entry.as_bytes()).to_hex()[..16])
}

/// The entries of the lines that are whole.
fn entries(bytes: &[u8]) -> BTreeSet<String> {
    let text = String::from_utf8_lossy(bytes);
    let whole = text.split_inclusive('\n').filter_map(|found| {
        let (_, entry) = found.strip_suffix('\n')?.split_once(' ')?;
        (line(entry) == found).then(|| entry.to_owned())
    });
    whole.collect()
}

/// The end of a file after its content: a line with its digest.
fn trailer(content: &[u8]) -> Vec<u8> {
    format!("\n{}\n", blake3::hash(content)).into_bytes()
}

fn digest_name(name: &str) -> String {
    format!("{name}.digest")
}

/// The digest of a file's content.
pub(crate) fn digest_of(path: &Path) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(File::open(path)?)?;
    Ok(hasher.finalize().to_string())
}
