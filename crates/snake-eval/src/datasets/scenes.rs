//! Scene fragments with known transforms, from `pairs.json` or in the layout of the 3DMatch benchmark.

use std::path::{Path, PathBuf};

use snake_geometry::RigidTransform;

use super::pairs_json::{self, ListedPair};
use super::{find_cloud, read_text, without_extension};
use crate::error::{Error, Result};

/// Fragments, and pairs of fragments that overlap. Lengths are in metres.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Scenes {
    /// The files of the fragments of all scenes.
    pub clouds: Vec<PathBuf>,
    /// The pairs, scene by scene. There is at least one.
    pub pairs: Vec<ScenePair>,
    folder: PathBuf,
}

/// Two fragments of a scene.
#[derive(Debug, Clone)]
pub struct ScenePair {
    /// The name of the scene.
    pub scene: String,
    /// Index of the source in [`Scenes::clouds`].
    pub source: usize,
    /// Index of the target in [`Scenes::clouds`].
    pub target: usize,
    /// Numbers of the fragments within their scene. Fragments without numbers get two that are not consecutive.
    pub fragments: [usize; 2],
    /// Maps the source to the frame of the target.
    pub t_target_source: RigidTransform,
    /// Information matrix of `gt.info`, for coordinates as they are in the files; `None` if it has to be computed from the overlap.
    pub information: Option<[[f64; 6]; 6]>,
}

impl Scenes {
    /// Opens a folder with a `pairs.json`, a scene of the 3DMatch benchmark, or a folder of scenes.
    ///
    /// A scene has the fragments `cloud_bin_0.ply`, .. and the files `gt.log` and `gt.info`, beside the fragments or in
    /// the folder `SCENE-evaluation`. In `pairs.json` (see [`ViewPairs::open`](super::ViewPairs::open)) a fragment named
    /// `SCENE_NUMBER` belongs to that scene.
    ///
    /// # Errors
    /// [`Error::Io`] when a list cannot be read; [`Error::Layout`] when it does not follow its format, a cloud is
    /// missing, or there are no pairs.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut scenes = Self { clouds: Vec::new(), pairs: Vec::new(), folder: folder.into() };
        if folder.join(pairs_json::NAME).exists() {
            pairs_json::read(folder)?.into_iter().try_for_each(|pair| scenes.add_pair(folder, pair))?;
        } else if let Some(truth) = ground_truth(folder) {
            scenes.add_scene(folder, &truth)?;
        } else {
            let entries = folder.read_dir().and_then(Iterator::collect::<std::io::Result<Vec<_>>>);
            let entries = entries.map_err(|source| Error::io(folder, source))?;
            let mut inner: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
            inner.sort();
            inner.retain(|path| path.is_dir() && !name(path).ends_with(EVALUATION));
            for scene in inner {
                ground_truth(&scene).map_or(Ok(()), |truth| scenes.add_scene(&scene, &truth))?;
            }
        }
        if scenes.pairs.is_empty() {
            let reason = "no pairs (looked for pairs.json, gt.log, and folders with gt.log)";
            return Err(Error::layout(folder, reason));
        }
        Ok(scenes)
    }

    fn add_pair(&mut self, folder: &Path, pair: ListedPair) -> Result<()> {
        let ListedPair { source, target, t_target_source } = pair;
        let (scene, fragments) = match (fragment(&source), fragment(&target)) {
            (Some((first, i)), Some((second, j))) if first == second => (first.to_owned(), [i, j]),
            _ => (name(folder), [0, usize::MAX]),
        };
        let (source, target) =
            (self.cloud(find_cloud(&folder.join(source))?), self.cloud(find_cloud(&folder.join(target))?));
        self.pairs.push(ScenePair { scene, source, target, fragments, t_target_source, information: None });
        Ok(())
    }

    /// Adds the pairs of `gt.log`. An entry is `i j n` and the transform from fragment j to fragment i.
    fn add_scene(&mut self, folder: &Path, truth: &Path) -> Result<()> {
        let transforms = entries::<4>(&truth.join("gt.log"))?;
        let information = entries::<6>(&truth.join("gt.info"))?;
        for (fragments, rows) in transforms {
            let [target, source] = fragments;
            let not_rigid = |reason| Error::layout(&truth.join("gt.log"), format!("pair {target} {source}: {reason}"));
            let t_target_source = RigidTransform::from_matrix(rows).map_err(not_rigid)?;
            let Some((_, information)) = information.iter().find(|(same, _)| *same == fragments) else {
                let reason = format!("no entry for the pair {target} {source} of gt.log");
                return Err(Error::layout(&truth.join("gt.info"), reason));
            };
            let mut cloud = |i| Ok::<_, Error>(self.cloud(find_cloud(&folder.join(format!("cloud_bin_{i}")))?));
            let (source, target) = (cloud(source)?, cloud(target)?);
            let scene = name(folder);
            let information = Some(*information);
            self.pairs.push(ScenePair { scene, source, target, fragments, t_target_source, information });
        }
        Ok(())
    }

    /// The index of a cloud, which is added if it is new.
    fn cloud(&mut self, path: PathBuf) -> usize {
        self.clouds.iter().position(|known| *known == path).unwrap_or_else(|| {
            self.clouds.push(path);
            self.clouds.len() - 1
        })
    }

    /// The name of a cloud: its file from the data set's folder on, without extension.
    ///
    /// # Panics
    /// When `cloud` is not an index of [`clouds`](Self::clouds).
    pub fn cloud_name(&self, cloud: usize) -> String {
        let path = &self.clouds[cloud];
        without_extension(&path.strip_prefix(&self.folder).unwrap_or(path).to_string_lossy()).into()
    }

    /// The name of a pair.
    ///
    /// # Panics
    /// When `pair` is not an index of [`pairs`](Self::pairs).
    pub fn name(&self, pair: usize) -> String {
        let ScenePair { source, target, .. } = self.pairs[pair];
        format!("{} to {}", self.clouds[source].display(), self.clouds[target].display())
    }
}

/// Suffix of the folder with a scene's ground truth.
const EVALUATION: &str = "-evaluation";

/// The folder that holds a scene's `gt.log`.
fn ground_truth(scene: &Path) -> Option<PathBuf> {
    let beside = scene.with_file_name(name(scene) + EVALUATION);
    [scene.to_path_buf(), beside].into_iter().find(|folder| folder.join("gt.log").is_file())
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The scene and the number in a fragment's name, such as `SCENE_7` or `SCENE_7.ply`.
fn fragment(cloud: &str) -> Option<(&str, usize)> {
    let cloud = Path::new(cloud).file_stem()?.to_str()?;
    let scene = cloud.trim_end_matches(|c: char| c.is_ascii_digit());
    Some((scene.trim_end_matches(['_', '-']), cloud[scene.len()..].parse().ok()?))
}

/// The numbers of two fragments, and an N×N matrix.
type Entry<const N: usize> = ([usize; 2], [[f64; N]; N]);

/// Reads the entries of a `.log` or `.info` file. A third number stands between the fragments and the matrix.
fn entries<const N: usize>(path: &Path) -> Result<Vec<Entry<N>>> {
    let text = read_text(path)?;
    let words: Vec<&str> = text.split_whitespace().collect();
    let mut entries = Vec::new();
    for entry in words.chunks(3 + N * N) {
        if entry.len() < 3 + N * N {
            return Err(Error::layout(path, "ends within an entry"));
        }
        let number = entries.len();
        let wrong = |word: &str| Error::layout(path, format!("entry {number}: `{word:.20}` is not a valid number"));
        let mut fragments = [0; 2];
        for (fragment, word) in fragments.iter_mut().zip(entry) {
            *fragment = word.parse().map_err(|_| wrong(word))?;
        }
        let mut matrix = [[0.0; N]; N];
        for (value, word) in matrix.as_flattened_mut().iter_mut().zip(&entry[3..]) {
            *value = word.parse().map_err(|_| wrong(word))?;
        }
        entries.push((fragments, matrix));
    }
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fragments_are_named_by_scene_and_number() {
        assert_eq!(fragment("hotel-uc__07"), Some(("hotel-uc", 7)));
        assert_eq!(fragment("a/cloud_bin_12.ply"), Some(("cloud_bin", 12)));
        assert_eq!(fragment("bunny.ply"), None);
        assert_eq!(fragment("99999999999999999999999"), None);
    }

    proptest::proptest! {
        #[test]
        fn any_lists_are_read_or_refused(
            log in "([-0-9.e]{1,4}[ \n]){0,60}",
            info in "([0-9]{1,2}[ \n]){0,90}|.{0,40}",
            pairs in r#"\[(\{"(source|target|T|x)":("[a-z./\\]{0,9}"|\[{0,5}[0-9,]{0,40}\]{0,5}|null)[,}\]]){0,4}\]?"#,
            bytes: Vec<u8>,
        ) {
            for files in [[log.as_bytes(), info.as_bytes(), pairs.as_bytes()], [&bytes[..]; 3]] {
                let folder = tempfile::tempdir().unwrap();
                for (name, content) in ["gt.log", "gt.info", "pairs.json"].into_iter().zip(files) {
                    std::fs::write(folder.path().join(name), content).unwrap();
                    // There are no clouds to find.
                    assert!(Scenes::open(folder.path()).is_err());
                }
            }
        }
    }

    #[test]
    fn broken_entries_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gt.log");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            entries::<1>(&path)
        };
        assert_eq!(read("0 2 9\n 0.5\n1\t3 9\n-1e0\n").unwrap(), [([0, 2], [[0.5]]), ([1, 3], [[-1.0]])]);
        assert!(read("").unwrap().is_empty());
        for (text, message) in [
            ("0 2 9\n 0.5\n1 3 9", "ends within an entry"),
            ("0 2 9 0.5 -1 3 9 1", "entry 1: `-1` is not a valid number"),
            ("0 2 9 x", "entry 0: `x` is not a valid number"),
        ] {
            assert!(read(text).unwrap_err().to_string().ends_with(message), "{text}");
        }
    }
}
