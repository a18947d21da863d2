//! Patterns of `*`, `?`, `[..]` and `**` as inputs. Links to folders are followed, and each file is given once.

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, bail};
use glob::{MatchOptions, Pattern};

/// The paths that match a pattern. The shell leaves patterns to us when they are quoted, and on Windows. Any other path, and a
/// pattern that is also the name of a file, gives the path itself.
pub fn matching(input: &Path) -> Result<Vec<PathBuf>> {
    let Some(text) = input.to_str().filter(|text| text.contains(['*', '?', '[']) && !input.exists()) else {
        return Ok(vec![input.into()]);
    };
    let pattern = Pattern::new(text).with_context(|| format!("{text}: not a valid pattern"))?;
    let paths = if text.contains("**") {
        let mut paths = Vec::new();
        walk(&start(input), &mut HashSet::new(), &mut paths);
        let options = MatchOptions { require_literal_separator: true, ..MatchOptions::new() };
        paths.retain(|path| pattern.matches_path_with(path, options));
        paths
    } else {
        let paths = glob::glob(text).with_context(|| format!("{text}: not a valid pattern"))?;
        paths.collect::<Result<_, _>>().with_context(|| format!("{text}: cannot list"))?
    };
    if paths.is_empty() {
        bail!("{text}: no file matches this pattern");
    }
    Ok(paths)
}

/// The folder above all matches of a pattern: its components without wildcards.
fn start(pattern: &Path) -> PathBuf {
    let is_plain = |component: &Component| !component.as_os_str().to_string_lossy().contains(['*', '?', '[']);
    pattern.components().take_while(is_plain).collect()
}

/// Lists the files and folders within a folder. A folder that several links lead to is listed once, so that a link to a folder
/// above it ends. Folders that cannot be read are left out.
fn walk(folder: &Path, visited: &mut HashSet<PathBuf>, paths: &mut Vec<PathBuf>) {
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let (Ok(real), Ok(entries)) = (here.canonicalize(), here.read_dir()) else { return };
    if !visited.insert(real) {
        return;
    }
    let mut entries: Vec<_> = entries.filter_map(Result::ok).collect();
    // Folders themselves come before links to them.
    entries.sort_by_key(|entry| (entry.file_type().is_ok_and(|kind| kind.is_symlink()), entry.file_name()));
    for entry in entries {
        let path = folder.join(entry.file_name());
        if path.is_dir() {
            walk(&path, visited, paths);
        }
        paths.push(path);
    }
}

/// The paths in order, those that lead to one file once: by the path without links, if it is among them.
pub fn each_once(paths: Vec<PathBuf>) -> Vec<PathBuf> {
    let real = |path: PathBuf| (path.canonicalize().unwrap_or_else(|_| path.clone()), path);
    let mut paths: Vec<(PathBuf, PathBuf)> = paths.into_iter().map(real).collect();
    let is_link = |(real, path): &(PathBuf, PathBuf)| std::path::absolute(path).is_ok_and(|path| path != *real);
    paths.sort_by_cached_key(|pair| (is_link(pair), pair.1.clone()));
    let mut seen = HashSet::new();
    paths.retain(|(real, _)| seen.insert(real.clone()));
    let mut paths: Vec<PathBuf> = paths.into_iter().map(|(_, path)| path).collect();
    paths.sort();
    paths
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_to_folders_above_end_and_each_file_is_given_once() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        std::fs::create_dir_all(root.join("a/b")).unwrap();
        std::fs::write(root.join("x.npy"), "").unwrap();
        std::fs::write(root.join("a/b/y.npy"), "").unwrap();
        symlink(&root, root.join("a/back")).unwrap();
        symlink(".", root.join("self")).unwrap();
        symlink("a/b", root.join("A")).unwrap();
        symlink("x.npy", root.join("again.npy")).unwrap();
        symlink("nowhere", root.join("dangling")).unwrap();
        let names = |pattern: &str| {
            let paths = each_once(matching(&root.join(pattern)).unwrap());
            let name = |path: &PathBuf| path.strip_prefix(&root).unwrap().display().to_string();
            paths.iter().map(name).collect::<Vec<_>>()
        };
        assert_eq!(names("**/*.npy"), ["a/b/y.npy", "x.npy"]);
        assert_eq!(names("*/*/*.npy"), ["a/b/y.npy", "a/back/again.npy"]);
        assert_eq!(names("**/b/*"), ["a/b/y.npy"]);
        assert_eq!(names("*.npy"), ["x.npy"]);
    }
}
