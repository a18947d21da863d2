//! The lock of a run's folder: one process at a time prepares or detects there.
//!
//! The operating system releases the lock of a process that ends, however it ends. The lock's file says who holds it.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::{Error, Result};

/// The name of the lock's file.
pub(crate) const LOCK: &str = "snake-tiles.lock";

/// A lock that this process holds.
struct Held {
    file: File,
    /// A fork inherits this list, but not the lock.
    process: u32,
    users: usize,
}

/// The locks of this process by folder. Several runs of one process may share a folder: a notebook repeats its cells.
static HELD: Mutex<BTreeMap<PathBuf, Held>> = Mutex::new(BTreeMap::new());

fn held() -> MutexGuard<'static, BTreeMap<PathBuf, Held>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A share in this process' lock of a folder, which ends with the last share.
#[derive(Debug)]
pub(crate) struct Lock {
    folder: PathBuf,
}

impl Lock {
    /// Locks a folder, given by its canonical path. `None` when another process removed the folder meanwhile.
    ///
    /// # Errors
    /// [`Error::InUse`] when another process has it; [`Error::File`] when the lock's file cannot be opened or locked.
    pub(crate) fn of(folder: &Path) -> Result<Option<Self>> {
        let lock = Self { folder: folder.to_owned() };
        let mut all = held();
        if let Some(held) = all.get_mut(folder).filter(|held| held.process == std::process::id()) {
            held.users += 1;
            return Ok(Some(lock));
        }
        let path = folder.join(LOCK);
        if path.is_symlink() {
            return Err(Error::not_own(folder, Path::new(LOCK)));
        }
        let mut file = match File::options().read(true).write(true).create(true).truncate(false).open(&path) {
            Ok(file) => file,
            Err(_) if !folder.exists() => return Ok(None),
            Err(error) => return Err(Error::file(&path)(error)),
        };
        let locked = file.try_lock();
        let holder = Holder::read(&mut file);
        let in_use = |holder, advice| Error::InUse { folder: folder.to_owned(), holder, advice };
        match locked {
            Ok(()) => (),
            Err(TryLockError::WouldBlock) => {
                let name = holder.map_or("another process".into(), |holder| holder.to_string());
                return Err(in_use(name, "wait until it ends, or choose another folder".into()));
            }
            Err(TryLockError::Error(error)) => return Err(Error::file(&path)(error)),
        }
        if !is_at(&file, &path) {
            return Ok(None);
        }
        let own = Holder::own();
        // Some network file systems keep the locks of other hosts from us.
        if let Some(other) = holder.filter(|other| !other.is_on_the_host_of(&own)) {
            let advice = format!("if that process no longer runs, remove {} and try again", path.display());
            return Err(in_use(other.to_string(), advice));
        }
        own.write(&mut file).map_err(Error::file(&path))?;
        all.insert(folder.to_owned(), Held { file, process: std::process::id(), users: 1 });
        Ok(Some(lock))
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        let mut all = held();
        let Some(held) = all.get_mut(&self.folder) else { return };
        held.users -= 1;
        if held.users == 0 {
            if held.process == std::process::id() {
                // If this fails, the next process on this host finds the lock released, though with a name in it.
                let _name_stays = held.file.set_len(0);
            }
            all.remove(&self.folder);
        }
    }
}

/// Whether a path still leads to the open file.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let is_same = |(a, b): (std::fs::Metadata, std::fs::Metadata)| (a.dev(), a.ino()) == (b.dev(), b.ino());
    file.metadata().ok().zip(path.metadata().ok()).is_some_and(is_same)
}

#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

/// The process that holds a lock.
#[derive(Debug, PartialEq)]
struct Holder {
    process: String,
    host: String,
    /// Changes when the host starts, and is the same in all containers on it; empty where there is none.
    boot: String,
}

impl Holder {
    fn own() -> Self {
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let host = gethostname::gethostname().to_string_lossy().into_owned();
        Self { process: std::process::id().to_string(), host, boot: boot.trim().into() }
    }

    /// The holder that a lock's file names; `None` for a released lock.
    fn read(file: &mut File) -> Option<Self> {
        let mut text = String::new();
        file.rewind().ok()?;
        file.take(4096).read_to_string(&mut text).ok()?;
        let mut lines = text.lines().map(str::to_owned);
        Some(Self { process: lines.next()?, host: lines.next()?, boot: lines.next().unwrap_or_default() })
    }

    fn write(&self, file: &mut File) -> std::io::Result<()> {
        file.set_len(0)?;
        file.rewind()?;
        write!(file, "{}\n{}\n{}\n", self.process, self.host, self.boot)
    }

    fn is_on_the_host_of(&self, other: &Self) -> bool {
        self.host == other.host || (!self.boot.is_empty() && self.boot == other.boot)
    }
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "process {} on {}", self.process, self.host)
    }
}
