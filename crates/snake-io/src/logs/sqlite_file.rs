//! Opens SQLite files for reading. Nothing is written beside them, also where SQLite itself would make files.

use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags};
use tempfile::TempDir;

/// A connection to a file, or to a copy, which is removed with it.
pub(crate) struct Database {
    // The connection is dropped first.
    pub(crate) connection: Connection,
    _copy: Option<TempDir>,
}

impl Database {
    /// Opens a file.
    ///
    /// SQLite has a journal beside a file that is being written or whose writer did not end. Reading it makes further files
    /// and changes both. Such a file is copied with its journal. A file in WAL mode without a journal is complete: it is
    /// opened as one that does not change, else SQLite would make a journal.
    pub(crate) fn open(path: &Path) -> Result<Self, String> {
        // SQLite looks for journals beside the file that a link leads to.
        let path = &path.canonicalize().map_err(|error| error.to_string())?;
        let journals: Vec<PathBuf> =
            ["-wal", "-journal"].map(|end| beside(path, end)).into_iter().filter(|path| has_bytes(path)).collect();
        let shared = OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let (opened, copy) = match &journals[..] {
            [] if is_wal(path) => {
                let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | shared;
                (Connection::open_with_flags(unchanging(path), flags), None)
            }
            [] => (Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY | shared), None),
            journals => {
                let (folder, copy) = copied(path, journals)?;
                (Connection::open_with_flags(copy, OpenFlags::SQLITE_OPEN_READ_WRITE | shared), Some(folder))
            }
        };
        Ok(Self { connection: opened.map_err(|error| error.to_string())?, _copy: copy })
    }
}

/// The file with this name after its own.
pub(crate) fn beside(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    name.into()
}

fn has_bytes(path: &Path) -> bool {
    path.metadata().is_ok_and(|metadata| metadata.len() > 0)
}

/// Whether the header of a file says that it is in WAL mode.
fn is_wal(path: &Path) -> bool {
    let mut header = [0; 20];
    let read = std::fs::File::open(path).and_then(|mut file| io::Read::read_exact(&mut file, &mut header));
    read.is_ok() && header[18..] == [2, 2]
}

/// The name of a file as a URI that says that the file does not change.
fn unchanging(path: &Path) -> String {
    let text = path.as_os_str().as_encoded_bytes();
    // A canonical path of Windows begins with `\\\\?\\`.
    let text = if cfg!(windows) { text.strip_prefix(br"\\?\").unwrap_or(text) } else { text };
    let mut uri = String::from(if cfg!(windows) { "file:///" } else { "file:" });
    for &byte in text {
        match byte {
            b'\\' if cfg!(windows) => uri.push('/'),
            b'/' | b'.' | b'-' | b'_' | b':' => uri.push(byte.into()),
            _ if byte.is_ascii_alphanumeric() => uri.push(byte.into()),
            _ => uri += &format!("%{byte:02X}"),
        }
    }
    uri + "?immutable=1"
}

/// Copies a file and its journals into a folder of their own.
fn copied(path: &Path, journals: &[PathBuf]) -> Result<(TempDir, PathBuf), String> {
    let copy = || -> io::Result<(TempDir, PathBuf, bool)> {
        let folder = tempfile::tempdir()?;
        let into = |source: &Path| folder.path().join(source.file_name().unwrap_or_default());
        let state =
            || -> io::Result<Vec<_>> { files(path, journals).map(|file| Ok(version(&file.metadata()?))).collect() };
        let before = state()?;
        for file in files(path, journals) {
            std::fs::copy(file, into(file))?;
            make_writable(&into(file))?;
        }
        let is_whole = state()? == before;
        let copy = into(path);
        Ok((folder, copy, is_whole))
    };
    let advice = "its writer did not end it; end it: sqlite3 FILE.db3 'PRAGMA wal_checkpoint(TRUNCATE)'";
    match copy() {
        Ok((folder, copy, true)) => Ok((folder, copy)),
        Ok((_, _, false)) => Err("it is being written; read it when the recording has ended".into()),
        Err(error) => Err(format!("cannot copy it with its journal: {error}; {advice}")),
    }
}

fn files<'a>(path: &'a Path, journals: &'a [PathBuf]) -> impl Iterator<Item = &'a Path> {
    std::iter::once(path).chain(journals.iter().map(PathBuf::as_path))
}

/// The parts of the metadata that change when a file is written.
fn version(metadata: &Metadata) -> (u64, Option<std::time::SystemTime>) {
    (metadata.len(), metadata.modified().ok())
}

/// A copy has the permissions of its source, which may be for reading only.
fn make_writable(path: &Path) -> io::Result<()> {
    let mut permissions = path.metadata()?.permissions();
    #[cfg(unix)]
    std::os::unix::fs::PermissionsExt::set_mode(&mut permissions, 0o600);
    #[cfg(not(unix))]
    permissions.set_readonly(false);
    std::fs::set_permissions(path, permissions)
}
