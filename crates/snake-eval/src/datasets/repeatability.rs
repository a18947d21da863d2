//! Data sets of repeatability, recognised by the layout of their folder.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use snake_core::{Cloud, Point, RigidTransform};
use snake_io as io;

use super::super::pairs::{self, ListedPair, find_cloud};
use super::super::read_json;
use super::views::PairClouds;
use crate::inputs::{ColumnArguments, expand};

/// A data set.
pub struct Data {
    /// Determines which settings and figures of the paper apply.
    pub scale: Scale,
    source: Source,
    /// The columns of the coordinates in the files.
    columns: ColumnArguments,
}

/// The units of a data set.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Objects of radius 1, like ModelNet40.
    Object,
    /// Rooms in metres, like Redwood.
    Room,
}

enum Source {
    /// Objects, whose second view is generated.
    Objects { names: Vec<String>, clouds: Clouds },
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
    t_1_2: RigidTransform,
}

/// A row of `index.json`.
#[derive(Deserialize)]
struct IndexRow {
    name: String,
}

impl Data {
    /// Opens the folder of a data set. Other inputs are read as cloud files and folders of cloud files.
    pub fn open(inputs: &[PathBuf], transform: Option<&Path>, columns: &ColumnArguments) -> Result<Self> {
        let (scale, source) = Self::recognise(inputs, transform)?;
        Ok(Self { scale, source, columns: columns.clone() })
    }

    fn recognise(inputs: &[PathBuf], transform: Option<&Path>) -> Result<(Scale, Source)> {
        if let Some(transform) = transform {
            return Self::one_pair(inputs, transform);
        }
        if let [folder] = inputs {
            let has = |name: &str| folder.join(name).exists();
            if has("points.npy") {
                return Self::corpus(folder);
            }
            if has("pairs.json") {
                return Self::pairs(Scale::Room, "pairs.json", listed_pairs(folder)?, folder);
            }
            if has("redwood_pair.txt") {
                return Self::pairs(Scale::Room, "redwood_pair.txt", redwood_pairs(folder)?, folder);
            }
            if has("original") && has("rotated") {
                return Self::pairs(Scale::Object, "transform.npy", modelnet_pairs(folder)?, folder);
            }
        }
        let files = expand(inputs)?;
        let names = files.iter().map(|file| file.display().to_string()).collect();
        Ok((Scale::Object, Source::Objects { names, clouds: Clouds::Files(files) }))
    }

    /// Our own layout: `points.npy` and `index.json`.
    fn corpus(folder: &Path) -> Result<(Scale, Source)> {
        let entries: Vec<IndexRow> = read_json(&folder.join("index.json"))?;
        let clouds = io::read_clouds(&folder.join("points.npy"))?;
        if entries.len() != clouds.len() {
            let (rows, clouds) = (entries.len(), clouds.len());
            bail!("{}: index.json has {rows} rows, points.npy {clouds} clouds", folder.display());
        }
        if clouds.is_empty() {
            bail!("{}: no clouds in points.npy", folder.display());
        }
        let names = entries.into_iter().map(|entry| entry.name).collect();
        Ok((Scale::Object, Source::Objects { names, clouds: Clouds::Loaded(clouds) }))
    }

    /// The pairs of the file `list`. There must be at least one.
    fn pairs(scale: Scale, list: &str, pairs: Vec<PairEntry>, folder: &Path) -> Result<(Scale, Source)> {
        if pairs.is_empty() {
            bail!("{}: no pairs in {list}", folder.display());
        }
        Ok((scale, Source::Pairs { pairs, unit_radius: false }))
    }

    /// The user's two clouds, source and target, in unknown units.
    fn one_pair(inputs: &[PathBuf], transform: &Path) -> Result<(Scale, Source)> {
        let [source, target] = inputs else {
            bail!("--transform is for two clouds, SOURCE and TARGET; for more give a folder with pairs.json");
        };
        let name = format!("{} to {}", source.display(), target.display());
        let pair = PairEntry { name, clouds: [target.clone(), source.clone()], t_1_2: io::read_transform(transform)? };
        Ok((Scale::Object, Source::Pairs { pairs: vec![pair], unit_radius: true }))
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

    /// The name of a pair of views.
    pub fn name(&self, pair: usize) -> String {
        match &self.source {
            Source::Objects { names, .. } => names[pair].clone(),
            Source::Pairs { pairs, .. } => pairs[pair].name.clone(),
        }
    }

    /// The clouds that the views of a pair are drawn from.
    pub fn clouds(&self, pair: usize) -> Result<PairClouds> {
        match &self.source {
            Source::Objects { clouds: Clouds::Loaded(clouds), .. } => PairClouds::object(&clouds[pair]),
            Source::Objects { clouds: Clouds::Files(files), .. } => {
                PairClouds::object(&self.finite_points(&files[pair])?.points)
            }
            Source::Pairs { pairs, unit_radius } => {
                let PairEntry { clouds: [first, second], t_1_2, .. } = &pairs[pair];
                let clouds = [self.finite_points(&find_cloud(first)?)?, self.finite_points(&find_cloud(second)?)?];
                if clouds.iter().any(|cloud| cloud.points.is_empty()) {
                    bail!("a cloud without points");
                }
                let [first, second] = clouds.each_ref().map(|cloud| cloud.origin);
                let t_1_2 = t_1_2.subtract_origins(second, first);
                let pair = PairClouds::Real { clouds: clouds.map(|cloud| cloud.points), t_1_2 };
                if *unit_radius { pair.with_unit_radius() } else { Ok(pair) }
            }
        }
    }

    /// The finite points of a cloud, so that views have the requested number of points.
    fn finite_points(&self, path: &Path) -> Result<Cloud> {
        let mut cloud = self.columns.read(path)?;
        cloud.points.retain(|point| point.iter().all(|v| v.is_finite()));
        Ok(cloud)
    }
}

/// `pairs.json`: the target is the first view.
fn listed_pairs(folder: &Path) -> Result<Vec<PairEntry>> {
    let entry = |ListedPair { source, target, t_target_source }| PairEntry {
        name: format!("{source} to {target}"),
        clouds: [folder.join(target), folder.join(source)],
        t_1_2: t_target_source,
    };
    Ok(pairs::listed(folder)?.into_iter().map(entry).collect())
}

/// USIP's ModelNet40: `original/I.npy`, the rotated object `rotated/I.npy`, and row I of `transform.npy`.
fn modelnet_pairs(folder: &Path) -> Result<Vec<PairEntry>> {
    let entry = |(i, t_1_2)| PairEntry {
        name: format!("{i}"),
        clouds: ["original", "rotated"].map(|view| folder.join(view).join(format!("{i}.npy"))),
        t_1_2,
    };
    Ok(io::read_transforms(&folder.join("transform.npy"))?.into_iter().enumerate().map(entry).collect())
}

/// USIP's Redwood: a line `SCENE I J` of `redwood_pair.txt` stands for the clouds `SCENE/I.npy` and `SCENE/J.npy`, and
/// `transform.npy` has a row for each line.
fn redwood_pairs(folder: &Path) -> Result<Vec<PairEntry>> {
    let path = folder.join("redwood_pair.txt");
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    let transforms = io::read_transforms(&folder.join("transform.npy"))?;
    if lines.len() != transforms.len() {
        let (lines, rows) = (lines.len(), transforms.len());
        bail!("{}: {lines} pairs in redwood_pair.txt, but {rows} transforms in transform.npy", folder.display());
    }
    let entry = |(line, t_1_2): (&str, RigidTransform)| {
        let [scene, first, second] = line.split_whitespace().collect::<Vec<_>>()[..] else {
            bail!("{}: expected a scene and two numbers, found `{line}`", path.display());
        };
        let clouds = [first, second].map(|number| folder.join(scene).join(format!("{number}.npy")));
        Ok(PairEntry { name: format!("{scene} {first} {second}"), clouds, t_1_2 })
    };
    lines.into_iter().zip(transforms).map(entry).collect()
}
