//! Input files: expands the arguments to files and reads the clouds.

use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use snake_io::{self as io, Attributes, Cloud, Columns, Contents, POINT_EXTENSIONS, PointFormat, ReadOptions};

use crate::patterns::{each_once, matching};
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
    /// Keep the points of LAS and LAZ files that are withheld or classified as noise (7 and 18), which are left out otherwise.
    #[arg(long)]
    pub keep_withheld: bool,
    #[command(flatten)]
    pub columns: ColumnArguments,
}

/// A list of inputs.
#[derive(Args)]
pub struct ListArgument {
    /// Also read the inputs that this file lists, one on each line; `-` reads the list from the standard input. A command line
    /// holds some thousand names, a list any number.
    #[arg(long, value_name = "FILE")]
    pub input_list: Option<PathBuf>,
}

impl ListArgument {
    /// The inputs of the command line, then those of the list.
    pub fn extend(&self, inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
        let Some(list) = &self.input_list else { return Ok(inputs.to_vec()) };
        let is_stdin = list == Path::new(DASH);
        if is_stdin && inputs.contains(list) {
            bail!("the standard input `-` can be given only once");
        }
        let text = if is_stdin { std::io::read_to_string(std::io::stdin()) } else { std::fs::read_to_string(list) };
        let text = text.with_context(|| format!("cannot read {}", list.display()))?;
        let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim_end).filter(|line| !line.is_empty());
        let inputs: Vec<PathBuf> = inputs.iter().cloned().chain(lines.map(PathBuf::from)).collect();
        if inputs.is_empty() {
            bail!("{}: the list of inputs is empty", list.display());
        }
        Ok(inputs)
    }
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
    /// The options that read clouds.
    pub fn options(&self) -> ReadOptions {
        ReadOptions::default().with_columns(self.columns.clone())
    }
}

impl InputArguments {
    /// How files are read. The seed is used by --sample.
    pub fn options(&self, seed: u64) -> ReadOptions {
        let sample = self.sample.map(|number| number as usize);
        self.columns.options().with_sample(sample).with_seed(seed).with_keep_withheld(self.keep_withheld)
    }

    /// Reads a cloud. Notes on it are printed once a run.
    pub fn read(&self, path: &Path, seed: u64) -> Result<Cloud> {
        self.read_contents(path, seed).map(|contents| contents.cloud)
    }

    /// The colours, intensity and normals of a cloud that was read from a file, for a copy of it. Samples of a mesh and the
    /// standard input have none.
    pub fn read_attributes(&self, path: &Path, cloud: &Cloud) -> Result<Attributes> {
        if self.sample.is_some() || path == Path::new(DASH) {
            return Ok(Attributes::default());
        }
        let mut attributes = io::read_attributes(path, self.input_format, cloud.points.len())?;
        // The sensor's position is relative to the cloud's origin, as the points are.
        attributes.viewpoint.iter_mut().flatten().zip(cloud.origin).for_each(|(v, origin)| *v -= origin);
        Ok(attributes)
    }

    /// [`InputArguments::read`] with what else the file says.
    pub fn read_contents(&self, path: &Path, seed: u64) -> Result<Contents> {
        let contents = self.contents(path, seed)?;
        terminal::hints_once(&path.display().to_string(), &contents.notes);
        Ok(contents)
    }

    fn contents(&self, path: &Path, seed: u64) -> Result<Contents> {
        let options = self.options(seed);
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
/// coordinates; else the function prints a warning.
pub fn output_origin(path: &Path, adds_origin: bool, origin: [f64; 3]) -> [f64; 3] {
    match io::origin_note(adds_origin, origin) {
        Some(note) => {
            terminal::warn(&format!("{}: {note}", path.display()));
            origin
        }
        None => [0.0; 3],
    }
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
/// a directory are sorted by name, and each is given once. A format selects its files.
pub fn expand(inputs: &[PathBuf], format: Option<PointFormat>) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        let mut paths = Vec::new();
        for path in matching(input)? {
            if path.is_dir() { paths.append(&mut clouds_in(&path, format)?) } else { paths.push(path) }
        }
        files.append(&mut each_once(paths));
    }
    Ok(files)
}

/// The most files of a directory that a text names.
const NAMED_FILES: usize = 10;

/// The clouds directly in a directory, except our own results (`NAME.keypoints.EXT`). The other files are named.
fn clouds_in(folder: &Path, format: Option<PointFormat>) -> Result<Vec<PathBuf>> {
    let (mut found, mut skipped) = (Vec::new(), Vec::new());
    for entry in folder.read_dir().with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry.with_context(|| format!("cannot list {}", folder.display()))?.path();
        let is_result = path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with(".keypoints"));
        if path.is_file() {
            let list = if is_cloud(&path, format) && !is_result { &mut found } else { &mut skipped };
            list.push(path);
        }
    }
    found.sort();
    skipped.sort();
    if found.is_empty() {
        // The folder of a bag in SQLite: the error has the command that converts it.
        skipped.iter().find(|file| has_extension(file, "db3")).map(|bag| PointFormat::from_path(bag)).transpose()?;
        bail!("{}: {}", folder.display(), without_clouds(folder, format, &skipped));
    }
    if !skipped.is_empty() {
        let (number, all) = (skipped.len(), skipped.len() + found.len());
        let verb = if number == 1 { "is" } else { "are" };
        terminal::hint(&format!("{}: {number} of {all} files {verb} not read: {}", folder.display(), listed(&skipped)));
    }
    Ok(found)
}

fn has_extension(file: &Path, extension: &str) -> bool {
    file.extension().is_some_and(|own| own == extension)
}

/// Whether a file of a directory is a cloud, or one of the given format. Only its name counts.
fn is_cloud(path: &Path, format: Option<PointFormat>) -> bool {
    let Some(format) = format else { return PointFormat::from_path(path).is_ok() };
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match PointFormat::from_extension(&extension) {
        Some(own) => own == format,
        None => extension == "bin" && extensions(format).is_empty(),
    }
}

/// The extensions of a format; none for sweeps, which are `.bin` files.
fn extensions(format: PointFormat) -> Vec<&'static str> {
    let is_its = |extension: &&str| PointFormat::from_extension(extension) == Some(format);
    POINT_EXTENSIONS.iter().copied().filter(is_its).collect()
}

/// The first names of files.
fn listed(files: &[PathBuf]) -> String {
    let names = files.iter().take(NAMED_FILES).filter_map(|file| Some(file.file_name()?.to_string_lossy()));
    let more = if files.len() > NAMED_FILES { ", …" } else { "" };
    names.collect::<Vec<_>>().join(", ") + more
}

/// The error for a directory without clouds, with its content and advice.
fn without_clouds(folder: &Path, format: Option<PointFormat>, files: &[PathBuf]) -> String {
    let sought = match format.map(extensions) {
        None => POINT_EXTENSIONS.join(", ."),
        Some(sought) if sought.is_empty() => "bin".into(),
        Some(sought) => sought.join(", ."),
    };
    let folder = folder.display();
    let mut text = format!("no point clouds in it (looked for .{sought})");
    if !files.is_empty() {
        text += &format!("; it has {} other files: {}", files.len(), listed(files));
    }
    let with = |extension: &str| files.iter().find(|file| has_extension(file, extension));
    match (with("mcap"), with("bin"), format) {
        (Some(recording), ..) => text += &format!("; a recording is an input of its own: {}", recording.display()),
        (_, Some(_), None) => text += "; .bin files need --input-format kitti or nuscenes",
        _ => text += &format!("; a pattern finds those in its folders: '{folder}/**/*.ply'"),
    }
    text
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
            Ok(expand(&inputs, None)?.iter().map(name).collect())
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

    #[test]
    fn a_directory_with_a_format_has_the_files_of_that_format() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["1.bin", "0.BIN", "a.ply", "b.txt", "c.csv", "d.dat"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let files = |format: &str| -> Result<Vec<String>> {
            let format = PointFormat::from_extension(format);
            let paths = expand(&[folder.path().to_owned()], format)?;
            Ok(paths.iter().map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect())
        };
        assert_eq!(files("kitti").unwrap(), ["0.BIN", "1.bin"]);
        assert_eq!(files("nuscenes").unwrap(), ["0.BIN", "1.bin"]);
        assert_eq!(files("ply").unwrap(), ["a.ply"]);
        assert_eq!(files("xyz").unwrap(), ["b.txt", "c.csv"]);
        let error = files("las").unwrap_err().to_string();
        assert!(
            error.contains("looked for .las, .laz") && error.contains("6 other files: 0.BIN, 1.bin, a.ply"),
            "{error}"
        );
    }

    #[test]
    fn a_directory_without_clouds_says_what_it_has_and_what_to_type() {
        let error = |names: &[&str]| {
            let folder = tempfile::tempdir().unwrap();
            names.iter().for_each(|name| std::fs::write(folder.path().join(name), "").unwrap());
            expand(&[folder.path().to_owned()], None).unwrap_err().to_string()
        };
        assert!(
            error(&["0.bin", "1.bin"]).contains("2 other files: 0.bin, 1.bin; .bin files need --input-format kitti")
        );
        assert!(error(&["a.mcap", "b.bin"]).contains("a recording is an input of its own: "));
        assert!(error(&["metadata.yaml", "old.db3"]).contains("ros2 bag convert -i FOLDER"));
        assert!(error(&[]).contains("**/*.ply'"));
        let many: Vec<String> = (0..12).map(|number| format!("{number:02}.md")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        assert!(error(&many).contains("12 other files: 00.md, 01.md") && error(&many).contains("09.md, …"));
    }
}
