//! Pairs of views for repeatability: two samples of an object, or two clouds of the same scene.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use snake_geometry::{Cloud, Point, RigidTransform};
use snake_io::{self as io, ReadOptions};

use super::pairs_json::{self, ListedPair};
use super::{find_cloud, read_json, read_text, without_extension};
use crate::error::{Error, Result};
use crate::views::PairClouds;

/// A data set of pairs of views.
pub struct ViewPairs {
    scale: Scale,
    source: Source,
}

/// The units of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Objects of radius 1, like ModelNet40.
    Object,
    /// Objects in the units of their files, like KeypointNet.
    Annotated,
    /// Rooms in metres, like Redwood.
    Room,
}

enum Source {
    /// Objects, whose second view is generated.
    Objects { names: Vec<String>, clouds: Clouds, unit_radius: bool },
    /// Pairs of given clouds, scaled to radius 1 or left in their units.
    Pairs { pairs: Vec<PairEntry>, unit_radius: bool },
}

/// Clouds in memory, or the files to read them from.
enum Clouds {
    Loaded(Vec<Vec<Point>>),
    Files(Vec<PathBuf>),
}

struct PairEntry {
    name: String,
    /// Files of views 1 and 2; a path may lack the extension.
    clouds: [PathBuf; 2],
    cloud_names: [String; 2],
    t_1_2: RigidTransform,
}

/// A row of `index.json`.
#[derive(Deserialize)]
struct IndexRow {
    name: String,
}

impl ViewPairs {
    /// Opens the folder of a data set. A folder in none of the known layouts gives `None`.
    ///
    /// | layout | content |
    /// |---|---|
    /// | objects | `points.npy` `(S, N, 3)` and `index.json`, a list of S objects with the key `name` |
    /// | pairs | `pairs.json`, in metres: `[{"source": "a.ply", "target": "b.ply", "T": [[..4], ..4]}, ..]`, where T maps the source to the target, the first view |
    /// | Redwood of USIP | `redwood_pair.txt` with lines `SCENE I J`, `SCENE/I.npy` and `transform.npy`, whose rows map cloud J to cloud I, the first view |
    /// | ModelNet40 of USIP | `original/I.npy`, `rotated/I.npy` and `transform.npy`, whose row I maps the rotated object to the original |
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::File`] when a list cannot be read; [`Error::Layout`] when it does not follow its
    /// layout or is empty.
    pub fn open(folder: &Path) -> Result<Option<Self>> {
        let has = |name: &str| folder.join(name).exists();
        let opened = if has("points.npy") {
            Self::corpus(folder)
        } else if has(pairs_json::NAME) {
            Self::pairs(Scale::Room, pairs_json::NAME, listed_pairs(folder)?, folder)
        } else if has("redwood_pair.txt") {
            Self::pairs(Scale::Room, "redwood_pair.txt", redwood_pairs(folder)?, folder)
        } else if has("original") && has("rotated") {
            Self::pairs(Scale::Object, "transform.npy", modelnet_pairs(folder)?, folder)
        } else {
            return Ok(None);
        };
        opened.map(Some)
    }

    /// The objects in these cloud files. Each object is scaled to radius 1, and its second view is generated.
    pub fn from_objects(files: Vec<PathBuf>) -> Self {
        let names = files.iter().map(|file| file.display().to_string()).collect();
        let source = Source::Objects { names, clouds: Clouds::Files(files), unit_radius: true };
        Self { scale: Scale::Object, source }
    }

    /// The objects of KeypointNet in a list, a `CLASS_ID-MODEL_ID` for each. They keep the units of their files
    /// `CLASS_ID/MODEL_ID.pcd`, in `pcds/` or in the folder itself, and the second view of each is generated.
    ///
    /// # Errors
    /// [`Error::Io`] when the list cannot be read; [`Error::Layout`] when it is empty, a name of it is of another form, or has no
    /// file.
    pub fn from_split(folder: &Path, split: &Path) -> Result<Self> {
        let text = read_text(split)?;
        let names: Vec<String> = text.split_whitespace().map(String::from).collect();
        if names.is_empty() {
            return Err(Error::layout(split, "an empty list"));
        }
        let pcds = folder.join("pcds");
        let clouds = if pcds.is_dir() { &pcds } else { folder };
        let file = |name: &String| {
            let (class, model) =
                name.split_once('-').ok_or_else(|| Error::layout(split, format!("{name} is no CLASS_ID-MODEL_ID")))?;
            find_cloud(&clouds.join(class).join(model))
        };
        let files = names.iter().map(file).collect::<Result<_>>()?;
        let source = Source::Objects { names, clouds: Clouds::Files(files), unit_radius: false };
        Ok(Self { scale: Scale::Annotated, source })
    }

    /// One pair of cloud files in unknown units, with the transform from the source to the target. The target is the
    /// first view, and the pair is scaled so that the target has radius 1.
    pub fn from_pair(source: &Path, target: &Path, t_target_source: RigidTransform) -> Self {
        let name = format!("{} to {}", source.display(), target.display());
        let cloud_names = [target, source].map(|path| path.display().to_string());
        let pair = PairEntry { name, clouds: [target.into(), source.into()], cloud_names, t_1_2: t_target_source };
        Self { scale: Scale::Object, source: Source::Pairs { pairs: vec![pair], unit_radius: true } }
    }

    /// Our own layout: `points.npy` and `index.json`.
    fn corpus(folder: &Path) -> Result<Self> {
        let entries: Vec<IndexRow> = read_json(&folder.join("index.json"))?;
        let clouds = io::read_clouds(&folder.join("points.npy"))?;
        if entries.len() != clouds.len() {
            let (rows, clouds) = (entries.len(), clouds.len());
            return Err(Error::layout(folder, format!("index.json has {rows} rows, points.npy {clouds} clouds")));
        }
        if clouds.is_empty() {
            return Err(Error::layout(folder, "no clouds in points.npy"));
        }
        let names = entries.into_iter().map(|entry| entry.name).collect();
        let source = Source::Objects { names, clouds: Clouds::Loaded(clouds), unit_radius: true };
        Ok(Self { scale: Scale::Object, source })
    }

    /// The pairs of the file `list`. There must be at least one.
    fn pairs(scale: Scale, list: &str, pairs: Vec<PairEntry>, folder: &Path) -> Result<Self> {
        if pairs.is_empty() {
            return Err(Error::layout(folder, format!("no pairs in {list}")));
        }
        Ok(Self { scale, source: Source::Pairs { pairs, unit_radius: false } })
    }

    /// The units of the data set, which select the figures of the paper to compare with.
    pub fn scale(&self) -> Scale {
        self.scale
    }

    /// The cloud files that will be read. A path lacks the extension if the list leaves it out.
    pub fn files(&self) -> Vec<&Path> {
        match &self.source {
            Source::Objects { clouds: Clouds::Loaded(_), .. } => Vec::new(),
            Source::Objects { clouds: Clouds::Files(files), .. } => files.iter().map(PathBuf::as_path).collect(),
            Source::Pairs { pairs, .. } => pairs.iter().flat_map(|pair| &pair.clouds).map(PathBuf::as_path).collect(),
        }
    }

    /// The number of pairs of views.
    pub fn len(&self) -> usize {
        match &self.source {
            Source::Objects { names, .. } => names.len(),
            Source::Pairs { pairs, .. } => pairs.len(),
        }
    }

    /// Whether there are no pairs.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The name of a pair of views.
    ///
    /// # Panics
    /// When `pair` is not below [`len`](Self::len).
    pub fn name(&self, pair: usize) -> String {
        match &self.source {
            Source::Objects { names, .. } => names[pair].clone(),
            Source::Pairs { pairs, .. } => pairs[pair].name.clone(),
        }
    }

    /// The names of clouds 1 and 2 of a pair: their files from the data set's folder on, without extension. `None` for objects,
    /// whose views are drawn at random, and for clouds that are scaled.
    ///
    /// # Panics
    /// When `pair` is not below [`len`](Self::len).
    pub fn cloud_names(&self, pair: usize) -> Option<&[String; 2]> {
        match &self.source {
            Source::Pairs { pairs, unit_radius: false } => Some(&pairs[pair].cloud_names),
            _ => None,
        }
    }

    /// Reads the clouds that the views of a pair are drawn from. Points that are not finite are left out, so that views
    /// have the requested number of points.
    ///
    /// # Errors
    /// [`Error::File`] when a cloud cannot be read; [`Error::Core`] when it has no extent; [`Error::Layout`] when it
    /// cannot be found or has no points.
    ///
    /// # Panics
    /// When `pair` is not below [`len`](Self::len).
    pub fn clouds(&self, pair: usize, options: &ReadOptions) -> Result<PairClouds> {
        match &self.source {
            Source::Objects { clouds: Clouds::Loaded(clouds), .. } => PairClouds::object(&clouds[pair]),
            Source::Objects { clouds: Clouds::Files(files), unit_radius, .. } => {
                let points = finite_points(&files[pair], options)?.points;
                let scaled = PairClouds::object(&points)?;
                Ok(if *unit_radius { scaled } else { PairClouds::Object(points) })
            }
            Source::Pairs { pairs, unit_radius } => {
                let PairEntry { clouds: [first, second], t_1_2, .. } = &pairs[pair];
                let files = [find_cloud(first)?, find_cloud(second)?];
                let clouds = [finite_points(&files[0], options)?, finite_points(&files[1], options)?];
                if let Some((file, _)) = files.iter().zip(&clouds).find(|(_, cloud)| cloud.points.is_empty()) {
                    return Err(Error::layout(file, "a cloud without points"));
                }
                let origins = clouds.each_ref().map(|cloud| cloud.origin);
                let t_1_2 = t_1_2.subtract_origins(origins[1], origins[0]);
                let pair = PairClouds::Real { clouds: clouds.map(|cloud| cloud.points), t_1_2, origins };
                if *unit_radius { pair.with_unit_radius() } else { Ok(pair) }
            }
        }
    }
}

/// Reads the finite points of a cloud.
fn finite_points(path: &Path, options: &ReadOptions) -> Result<Cloud> {
    let mut cloud = io::read_cloud(path, options)?;
    cloud.points.retain(|point| point.iter().all(|v| v.is_finite()));
    Ok(cloud)
}

/// `pairs.json`: the target is the first view.
fn listed_pairs(folder: &Path) -> Result<Vec<PairEntry>> {
    let entry = |ListedPair { source, target, t_target_source }| PairEntry {
        name: format!("{source} to {target}"),
        cloud_names: [&target, &source].map(|file| without_extension(file).into()),
        clouds: [folder.join(target), folder.join(source)],
        t_1_2: t_target_source,
    };
    Ok(pairs_json::read(folder)?.into_iter().map(entry).collect())
}

/// USIP's ModelNet40: `original/I.npy`, the rotated object `rotated/I.npy`, and row I of `transform.npy`.
fn modelnet_pairs(folder: &Path) -> Result<Vec<PairEntry>> {
    let entry = |(i, t_1_2)| PairEntry {
        name: format!("{i}"),
        clouds: ["original", "rotated"].map(|view| folder.join(view).join(format!("{i}.npy"))),
        cloud_names: ["original", "rotated"].map(|view| format!("{view}/{i}")),
        t_1_2,
    };
    Ok(io::read_transforms(&folder.join("transform.npy"))?.into_iter().enumerate().map(entry).collect())
}

/// USIP's Redwood: a line `SCENE I J` of `redwood_pair.txt` stands for the clouds `SCENE/I.npy` and `SCENE/J.npy`, and
/// `transform.npy` has a row for each line.
fn redwood_pairs(folder: &Path) -> Result<Vec<PairEntry>> {
    let path = folder.join("redwood_pair.txt");
    let text = read_text(&path)?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    let transforms = io::read_transforms(&folder.join("transform.npy"))?;
    if lines.len() != transforms.len() {
        let (lines, rows) = (lines.len(), transforms.len());
        let reason = format!("{lines} pairs in redwood_pair.txt, but {rows} transforms in transform.npy");
        return Err(Error::layout(folder, reason));
    }
    let entry = |(line, t_1_2): (&str, RigidTransform)| {
        let [scene, first, second] = line.split_whitespace().collect::<Vec<_>>()[..] else {
            return Err(Error::layout(&path, format!("expected a scene and two numbers, found `{line}`")));
        };
        let clouds = [first, second].map(|number| folder.join(scene).join(format!("{number}.npy")));
        let cloud_names = [first, second].map(|number| format!("{scene}/{number}"));
        Ok(PairEntry { name: format!("{scene} {first} {second}"), clouds, cloud_names, t_1_2 })
    };
    lines.into_iter().zip(transforms).map(entry).collect()
}
