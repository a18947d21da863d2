//! The files that the arguments stand for.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use snake_core::io;

/// The files to read: what was named, what patterns match, and the clouds within directories, in the order of their
/// names.
pub fn expand(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        for path in matching(input)? {
            if path.is_dir() { files.append(&mut clouds_in(&path)?) } else { files.push(path) }
        }
    }
    Ok(files)
}

/// What a pattern of `*`, `?`, `[..]` and `**` stands for that no shell has expanded, because it was quoted or on Windows;
/// of anything else, and of a file of that very name, the path itself.
fn matching(input: &Path) -> Result<Vec<PathBuf>> {
    let Some(pattern) = input.to_str().filter(|text| text.contains(['*', '?', '[']) && !input.exists()) else {
        return Ok(vec![input.into()]);
    };
    let paths = glob::glob(pattern).with_context(|| format!("{pattern}: not a pattern of file names"))?;
    let paths: Result<Vec<PathBuf>, _> = paths.collect();
    let paths = paths.with_context(|| format!("{pattern}: cannot list"))?;
    if paths.is_empty() {
        bail!("{pattern}: no file has such a name");
    }
    Ok(paths)
}

/// The clouds directly within a directory; results of ours are none.
fn clouds_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in folder.read_dir().with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry.with_context(|| format!("cannot list {}", folder.display()))?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let is_result = path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with(".keypoints"));
        if path.is_file() && io::POINT_EXTENSIONS.contains(&extension.as_str()) && !is_result {
            found.push(path);
        }
    }
    if found.is_empty() {
        bail!("{}: no point clouds in it (looked for .{})", folder.display(), io::POINT_EXTENSIONS.join(", ."));
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_and_directories_become_files_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        std::fs::create_dir_all(root.join("deep/er")).unwrap();
        for name in ["b.ply", "a.ply", "c.keypoints.ply", "notes.md", "deep/d.pcd", "deep/er/e.ply", "odd[1].ply"] {
            std::fs::write(root.join(name), "").unwrap();
        }
        let files = |patterns: &[&str]| -> Result<Vec<String>> {
            let inputs: Vec<PathBuf> = patterns.iter().map(|pattern| root.join(pattern)).collect();
            let name = |path: &PathBuf| path.strip_prefix(root).unwrap().display().to_string().replace('\\', "/");
            Ok(expand(&inputs)?.iter().map(name).collect())
        };
        assert_eq!(files(&["deep/d.pcd", "?.ply"]).unwrap(), ["deep/d.pcd", "a.ply", "b.ply"]);
        assert_eq!(files(&["**/[de].*"]).unwrap(), ["deep/d.pcd", "deep/er/e.ply"]);
        assert_eq!(files(&["."]).unwrap(), ["a.ply", "b.ply", "odd[1].ply"]);
        assert_eq!(files(&["dee*"]).unwrap(), ["deep/d.pcd"]);
        // A name with brackets is a name, and what is not there is for the reader to say.
        assert_eq!(files(&["odd[1].ply", "none.ply"]).unwrap(), ["odd[1].ply", "none.ply"]);
        let refused = |pattern| files(&[pattern]).unwrap_err().to_string();
        assert!(refused("*.xyz").ends_with("no file has such a name"));
        assert!(refused("[").contains("not a pattern"));
    }
}
