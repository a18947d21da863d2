//! Input files: expands the arguments to files and reads the clouds.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Once;

use anyhow::{Context, Result, bail};
use clap::Args;
use snake_io::{self as io, Cloud, Columns, Contents, POINT_EXTENSIONS, PointFormat, ReadOptions};

use crate::terminal;

/// The argument for the standard input or output.
pub const DASH: &str = "-";

/// Options of reading clouds.
#[derive(Args)]
pub struct InputArguments {
    /// Read the inputs in the format of this extension, or as sweeps of `kitti` (4 float32 values a point), `nuscenes` (5) or
    /// `kitti:N` (N values), regardless of their names. The standard input (`-`) needs this
    /// option for text, obj and binary stl; other formats are recognised by their content [default: each input's own
    /// extension].
    #[arg(long, value_name = "EXTENSION", value_parser = point_format)]
    pub input_format: Option<PointFormat>,
    /// Sample this many points from the surface of a mesh, uniformly by area [default: the vertices of the mesh].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    pub sample: Option<u32>,
    #[command(flatten)]
    pub columns: ColumnArguments,
}

/// The columns of text files and NumPy arrays that hold the coordinates.
#[derive(Args, Clone, Default)]
pub struct ColumnArguments {
    /// Columns of x, y and z in text files and NumPy arrays: names in the header or numbers from 1, such as `x,y,z`,
    /// `Points:0,Points:1,Points:2` or `4,5,6` [default: x, y and z of the header, or without a header the first
    /// three].
    #[arg(long, value_name = "X,Y,Z")]
    pub columns: Option<Columns>,
}

impl ColumnArguments {
    /// Reads a cloud of a data set.
    pub fn read(&self, path: &Path) -> Result<Cloud> {
        Ok(io::read_cloud(path, &self.options())?)
    }

    /// The options that read the clouds of a data set.
    pub fn options(&self) -> ReadOptions {
        ReadOptions::default().with_columns(self.columns.clone())
    }
}

impl InputArguments {
    /// Reads a cloud. The seed is used by --sample. Warns once if the vertices of a mesh stand in for its surface.
    pub fn read(&self, path: &Path, seed: u64) -> Result<Cloud> {
        self.read_contents(path, seed).map(|contents| contents.cloud)
    }

    /// [`InputArguments::read`] with what else the file says.
    pub fn read_contents(&self, path: &Path, seed: u64) -> Result<Contents> {
        let contents = self.contents(path, seed)?;
        let Contents { cloud, unsampled_faces, .. } = &contents;
        if *unsampled_faces > 0 {
            Self::warn_of_faces(path, *unsampled_faces, cloud.points.len());
        }
        Ok(contents)
    }

    fn warn_of_faces(path: &Path, unsampled_faces: usize, vertices: usize) {
        static WARNED: Once = Once::new();
        let name = path.display();
        WARNED.call_once(|| {
            terminal::warn(&format!(
                "{name} is a mesh of {unsampled_faces} faces: its {vertices} vertices are used; \
                 --sample N draws N points from the surface"
            ));
        });
    }

    fn contents(&self, path: &Path, seed: u64) -> Result<Contents> {
        let sample = self.sample.map(|number| number as usize);
        let options = self.columns.options().with_sample(sample).with_seed(seed);
        if path == Path::new(DASH) {
            let mut bytes = Vec::new();
            std::io::stdin().lock().read_to_end(&mut bytes).context("cannot read the standard input")?;
            let Some(format) = self.input_format.or_else(|| PointFormat::from_content(&bytes)) else {
                bail!("standard input: its content shows no known format; give --input-format");
            };
            return io::parse_contents(&bytes, format, &options).context("standard input");
        }
        match self.input_format {
            Some(format) => {
                let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
                io::parse_contents(&bytes, format, &options).with_context(|| path.display().to_string())
            }
            None => Ok(io::read_contents(path, &options)?),
        }
    }
}

/// The offset that a reader has to add to the coordinates of a written file. It is zero if the format holds full
/// coordinates. A format with four bytes a coordinate needs the origin; the function then prints a warning.
pub fn output_origin(path: &Path, adds_origin: bool, origin: [f64; 3]) -> [f64; 3] {
    if adds_origin || origin == [0.0; 3] {
        return [0.0; 3];
    }
    let [x, y, z] = origin;
    terminal::warn(&format!(
        "{}: the coordinates are relative to the origin {x} {y} {z}, because this format holds about seven digits; add the \
         origin to them, or write another format",
        path.display()
    ));
    origin
}

/// Refuses to read the standard input twice.
pub fn check_inputs<'a>(inputs: impl IntoIterator<Item = &'a PathBuf>) -> Result<()> {
    if inputs.into_iter().filter(|input| **input == Path::new(DASH)).count() > 1 {
        bail!("the standard input `-` can be given only once");
    }
    Ok(())
}

fn point_format(extension: &str) -> Result<PointFormat> {
    let known = || format!("known are {}, kitti, nuscenes, kitti:N", POINT_EXTENSIONS.join(", "));
    PointFormat::from_extension(extension.trim_start_matches('.')).with_context(known)
}

/// The files to read: named files, files that match a pattern, and the clouds in directories. The files of a pattern or
/// a directory are sorted by name. A directory that is an input itself, as a bag of ROS 2 is for `detect`, stays what it is.
pub fn expand(inputs: &[PathBuf], is_input: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        for path in matching(input)? {
            if path.is_dir() && !is_input(&path) { files.append(&mut clouds_in(&path)?) } else { files.push(path) }
        }
    }
    Ok(files)
}

/// The paths that match a pattern of `*`, `?`, `[..]` and `**`. The shell leaves patterns to us when they are quoted,
/// and on Windows. Any other path, and a pattern that is also the name of a file, gives the path itself.
fn matching(input: &Path) -> Result<Vec<PathBuf>> {
    let Some(pattern) = input.to_str().filter(|text| text.contains(['*', '?', '[']) && !input.exists()) else {
        return Ok(vec![input.into()]);
    };
    let paths = glob::glob(pattern).with_context(|| format!("{pattern}: not a valid pattern"))?;
    let paths: Result<Vec<PathBuf>, _> = paths.collect();
    let paths = paths.with_context(|| format!("{pattern}: cannot list"))?;
    if paths.is_empty() {
        bail!("{pattern}: no file matches this pattern");
    }
    Ok(paths)
}

/// The clouds directly in a directory, except our own results (`NAME.keypoints.EXT`).
fn clouds_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in folder.read_dir().with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry.with_context(|| format!("cannot list {}", folder.display()))?.path();
        let is_result = path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with(".keypoints"));
        if path.is_file() && PointFormat::from_path(&path).is_ok() && !is_result {
            found.push(path);
        }
    }
    if found.is_empty() {
        let (folder, extensions) = (folder.display(), POINT_EXTENSIONS.join(", ."));
        bail!(
            "{folder}: no point clouds in it (looked for .{extensions}); a pattern finds those in its folders: '{folder}/**/*.ply'"
        );
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
            Ok(expand(&inputs, |_| false)?.iter().map(name).collect())
        };
        assert_eq!(files(&["deep/d.pcd", "?.ply"]).unwrap(), ["deep/d.pcd", "a.ply", "b.ply"]);
        assert_eq!(files(&["**/[de].*"]).unwrap(), ["deep/d.pcd", "deep/er/e.ply"]);
        assert_eq!(files(&["."]).unwrap(), ["a.ply", "b.ply", "odd[1].ply"]);
        assert_eq!(files(&["dee*"]).unwrap(), ["deep/d.pcd"]);
        // A file name may have brackets, and a missing file is left to the reader.
        assert_eq!(files(&["odd[1].ply", "none.ply"]).unwrap(), ["odd[1].ply", "none.ply"]);
        let refused = |pattern| files(&[pattern]).unwrap_err().to_string();
        assert!(refused("*.xyz").ends_with("no file matches this pattern"));
        assert!(refused("[").contains("not a valid pattern"));
    }
}
