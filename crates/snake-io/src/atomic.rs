//! Writes a file whole or not at all.

use std::fs::{self, File, metadata, read_link};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{PoisonError, RwLock, RwLockWriteGuard};

/// Every writer of a temporary file holds a read lock on this.
static WRITING: RwLock<()> = RwLock::new(());

/// Waits until no file is being written, and blocks new writes until the guard is dropped. A program that ends on a
/// signal holds this guard so that it leaves no temporary file behind.
pub fn hold_writes() -> RwLockWriteGuard<'static, ()> {
    WRITING.write().unwrap_or_else(PoisonError::into_inner)
}

/// Beginning and end of the names of temporary files of [`write_atomically`]. A killed program leaves such a file behind.
pub const TEMPORARY: [&str; 2] = [".snake-rs.", ".part"];

/// Writes a file whole or not at all, even if the power fails: fills a temporary file in the folder of the target, waits until
/// it is on the disk, and then renames it.
///
/// A symbolic link is followed: the link stays and its target is written. A device, a FIFO or a socket is written
/// directly.
///
/// # Errors
/// The errors of the file system and of `fill`, which do not name the temporary file. The old target then remains.
pub fn write_atomically(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    match metadata(path) {
        Ok(found) if found.is_file() => replace(&path.canonicalize()?, fill),
        Ok(found) if found.is_dir() => Err(ErrorKind::IsADirectory.into()),
        Ok(_) => write_to(&File::options().write(true).open(path)?, fill),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            // A link may point to a file that does not exist yet.
            let mut target = path.to_owned();
            while let Ok(next) = read_link(&target) {
                target = target.parent().unwrap_or(Path::new("")).join(next);
            }
            replace(&target, fill)
        }
        Err(error) => Err(error),
    }
}

fn replace(target: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let _writing = WRITING.read().unwrap_or_else(PoisonError::into_inner);
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (temporary, file) = Temporary::create_in(folder)?;
    // A new file has the mode of the umask. A replaced file keeps its mode, which may hide it from others.
    if let Ok(replaced) = metadata(target) {
        file.set_permissions(replaced.permissions())?;
    }
    write_to(&file, fill)?;
    file.sync_all()?;
    temporary.rename(target)?;
    sync_folder(folder);
    Ok(())
}

/// A temporary file, which is removed unless it is renamed.
struct Temporary {
    path: PathBuf,
    is_renamed: bool,
}

impl Temporary {
    /// Creates a file in a folder under an unused name.
    fn create_in(folder: &Path) -> io::Result<(Self, File)> {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let [prefix, suffix] = TEMPORARY;
        loop {
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!("{prefix}{}-{number}{suffix}", std::process::id()));
            match File::create_new(&path) {
                // Left by a killed program, or used by a program that writes to the same folder from another machine.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                created => return Ok((Self { path, is_renamed: false }, created?)),
            }
        }
    }

    fn rename(mut self, target: &Path) -> io::Result<()> {
        fs::rename(&self.path, target)?;
        self.is_renamed = true;
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.is_renamed {
            let _may_be_gone = fs::remove_file(&self.path);
        }
    }
}

/// Waits until the names in a folder are on the disk. Does nothing where folders cannot be opened as files.
pub fn sync_folder(folder: &Path) {
    let _not_everywhere = File::open(folder).and_then(|folder| folder.sync_all());
}

fn write_to(file: &File, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::new(file);
    fill(&mut writer)?;
    writer.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_holds_writes_sees_no_file_half_written() {
        let folder = tempfile::tempdir().unwrap();
        let (begun, told) = std::sync::mpsc::channel();
        let path = folder.path().join("slow.txt");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let slowly = |file: &mut dyn Write| {
                    begun.send(()).unwrap();
                    std::thread::sleep(std::time::Duration::from_millis(300));
                    file.write_all(b"whole")
                };
                write_atomically(&path, slowly).unwrap();
            });
            told.recv().unwrap();
            let _writes = hold_writes();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), "whole");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files remain");
        });
    }

    #[test]
    fn what_fails_leaves_the_old_file_alone_and_names_of_killed_programs_are_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.txt");
        let [prefix, suffix] = TEMPORARY;
        let left = |number: usize| folder.path().join(format!("{prefix}{}-{number}{suffix}", std::process::id()));
        (0..100).for_each(|number| fs::write(left(number), "left").unwrap());
        write_atomically(&path, |file| file.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |file| file.write_all(b"ne").and(Err(ErrorKind::StorageFull.into())));
        assert_eq!(failed.unwrap_err().kind(), ErrorKind::StorageFull);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert!((0..100).all(|number| fs::read_to_string(left(number)).unwrap() == "left"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 101);
    }

    #[cfg(unix)]
    #[test]
    fn a_replaced_file_keeps_its_mode_and_a_new_one_has_that_of_the_umask() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let [path, other] = ["written", "created"].map(|name| folder.path().join(name));
        let mode = |path: &Path| metadata(path).unwrap().permissions().mode() & 0o777;
        let write = || write_atomically(&path, |file| file.write_all(b"text"));
        write().unwrap();
        File::create(&other).unwrap();
        assert_eq!(mode(&path), mode(&other));
        for kept in [0o600, 0o640, 0o664, 0o444] {
            fs::set_permissions(&path, fs::Permissions::from_mode(kept)).unwrap();
            write().unwrap();
            assert_eq!(mode(&path), kept, "{kept:o}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_lead_to_what_was_written() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        symlink("deep/file", path("link")).unwrap();
        symlink("link", path("link to link")).unwrap();
        symlink("loop", path("loop")).unwrap();
        // Without the folder nothing can be written and nothing is replaced.
        let write =
            |name: &str, text: &'static str| write_atomically(&path(name), |file| file.write_all(text.as_bytes()));
        assert_eq!(write("link", "none").unwrap_err().kind(), ErrorKind::NotFound);
        assert!(write("loop", "none").is_err() && path("loop").is_symlink());
        std::fs::create_dir(path("deep")).unwrap();
        for (name, text) in [("link to link", "first"), ("link", "second"), ("link to link", "third")] {
            write(name, text).unwrap();
            assert!(path(name).is_symlink());
            assert_eq!(std::fs::read_to_string(path("deep/file")).unwrap(), text);
        }
        assert_eq!(write("deep", "none").unwrap_err().kind(), ErrorKind::IsADirectory);
    }
}
