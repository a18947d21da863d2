//! Data sets of semantic consistency: KeypointNet and pairs of SMPL bodies.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use snake_geometry::Point;
use snake_io as io;

use super::{read_json, read_text};
use crate::error::{Error, Result};
use crate::smpl::BodyPairs;

/// A data set of semantic consistency.
pub enum SemanticData {
    /// Shapes with annotated keypoints.
    KeypointNet(Vec<Shape>),
    /// The first and the second bodies of all pairs. Point i of both bodies of a pair is the same point of the surface.
    Bodies([Vec<Vec<Point>>; 2]),
    /// A body model, which is posed for each pair.
    BodyModel(Box<BodyPairs>),
}

/// A shape of KeypointNet.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Shape {
    /// `CLASS_ID-MODEL_ID`, as in the released code's lists.
    pub name: String,
    /// The name of the annotation file, such as `chair`.
    pub class: String,
    /// The file of the cloud.
    pub cloud: PathBuf,
    /// Indices of the annotated points in the cloud.
    pub keypoints: Vec<usize>,
}

/// An entry of an annotation file; other keys are ignored.
#[derive(Deserialize)]
struct Annotation {
    class_id: String,
    model_id: String,
    keypoints: Vec<Marked>,
}

#[derive(Deserialize)]
struct Marked {
    pcd_info: MarkedPoint,
}

#[derive(Deserialize)]
struct MarkedPoint {
    point_index: usize,
}

/// Indices of the annotated points of one shape in an annotation file of KeypointNet: of the entry with the shape's
/// `model_id`, or of the only entry.
///
/// # Errors
/// [`Error::Io`] and [`Error::File`] when the file cannot be read; [`Error::Layout`] when no entry is the shape's.
pub fn annotated_points(file: &Path, model_id: &str) -> Result<Vec<usize>> {
    let mut entries: Vec<Annotation> = read_json(file)?;
    if entries.len() != 1 {
        entries.retain(|entry| entry.model_id == model_id);
    }
    let entry = entries.pop().ok_or_else(|| Error::layout(file, format!("no entry with the model_id {model_id}")))?;
    Ok(entry.keypoints.into_iter().map(|marked| marked.pcd_info.point_index).collect())
}

impl SemanticData {
    /// Opens a data set by its layout. For KeypointNet, `split` is a file with a `CLASS_ID-MODEL_ID` for each shape to
    /// use.
    ///
    /// | layout | content |
    /// |---|---|
    /// | KeypointNet | `annotations/CLASS.json` and the clouds `CLASS_ID/MODEL_ID.pcd`, in `pcds/` or in the folder itself |
    /// | body model | a file `.npz`, or a folder with `model.npz`, see [`BodyPairs::open`] |
    /// | bodies | `body_1.npy` and `body_2.npy` `(S, N, 3)` |
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::File`] when a list, an array or a model cannot be read; [`Error::Layout`] when the
    /// folder has none of the layouts, a file does not follow it, or a shape of `split` has no annotation.
    pub fn open(folder: &Path, split: Option<&Path>) -> Result<Self> {
        if folder.join("annotations").is_dir() {
            return keypointnet(folder, split).map(Self::KeypointNet);
        }
        if split.is_some() {
            return Err(Error::layout(folder, "the split is for KeypointNet, and this is another data set"));
        }
        if let Some(pairs) = BodyPairs::open(folder)? {
            return Ok(Self::BodyModel(Box::new(pairs)));
        }
        let [first, second] = ["body_1.npy", "body_2.npy"].map(|name| folder.join(name));
        if !first.exists() || !second.exists() {
            return Err(Error::layout(
                folder,
                "neither annotations/ (KeypointNet) nor model.npz, or body_1.npy and body_2.npy (SMPL)",
            ));
        }
        let bodies = [io::read_clouds(&first)?, io::read_clouds(&second)?];
        let [one, two] = bodies.each_ref().map(Vec::len);
        if one != two || one == 0 {
            return Err(Error::layout(folder, format!("{one} bodies in body_1.npy, {two} in body_2.npy")));
        }
        Ok(Self::Bodies(bodies))
    }

    /// The cloud files that will be read.
    pub fn files(&self) -> Vec<&Path> {
        match self {
            Self::KeypointNet(shapes) => shapes.iter().map(|shape| shape.cloud.as_path()).collect(),
            Self::Bodies(_) | Self::BodyModel(_) => Vec::new(),
        }
    }

    /// Number of shapes or of pairs of bodies.
    pub fn len(&self) -> usize {
        match self {
            Self::KeypointNet(shapes) => shapes.len(),
            Self::Bodies([bodies, _]) => bodies.len(),
            Self::BodyModel(pairs) => pairs.len(),
        }
    }

    /// Whether there are no shapes and no pairs.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The name of a shape or a pair.
    ///
    /// # Panics
    /// When `index` is not below [`len`](Self::len).
    pub fn name(&self, index: usize) -> String {
        match self {
            Self::KeypointNet(shapes) => shapes[index].name.clone(),
            Self::Bodies(_) | Self::BodyModel(_) => format!("pair {index}"),
        }
    }

    /// The class of a shape; `None` for bodies.
    ///
    /// # Panics
    /// When `index` is not below [`len`](Self::len).
    pub fn class(&self, index: usize) -> Option<&str> {
        match self {
            Self::KeypointNet(shapes) => Some(&shapes[index].class),
            Self::Bodies(_) | Self::BodyModel(_) => None,
        }
    }
}

/// The annotated shapes, class by class.
fn keypointnet(folder: &Path, split: Option<&Path>) -> Result<Vec<Shape>> {
    let annotations = folder.join("annotations");
    let entries = annotations.read_dir().and_then(Iterator::collect::<std::io::Result<Vec<_>>>);
    let entries = entries.map_err(|source| Error::io(&annotations, source))?;
    let is_class =
        |path: &PathBuf| path.extension().is_some_and(|e| e == "json") && path.file_stem().is_some_and(|s| s != "all");
    let mut files: Vec<PathBuf> = entries.iter().map(|entry| entry.path()).filter(is_class).collect();
    files.sort();
    let pcds = folder.join("pcds");
    let clouds = if pcds.is_dir() { &pcds } else { folder };
    let mut shapes = Vec::new();
    for file in files {
        let class = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        for Annotation { class_id, model_id, keypoints } in read_json::<Vec<Annotation>>(&file)? {
            shapes.push(Shape {
                name: format!("{class_id}-{model_id}"),
                class: class.clone(),
                cloud: clouds.join(class_id).join(format!("{model_id}.pcd")),
                keypoints: keypoints.into_iter().map(|marked| marked.pcd_info.point_index).collect(),
            });
        }
    }
    if let Some(split) = split {
        let text = read_text(split)?;
        let mut listed: BTreeMap<&str, bool> = text.split_whitespace().map(|name| (name, false)).collect();
        shapes.retain(|shape| listed.get_mut(shape.name.as_str()).is_some_and(|found| !std::mem::replace(found, true)));
        if let Some((name, _)) = listed.iter().find(|(_, found)| !**found) {
            return Err(Error::layout(split, format!("{name} is not among the annotations")));
        }
    }
    if shapes.is_empty() {
        return Err(Error::layout(&annotations, "no annotated shapes"));
    }
    Ok(shapes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn any_annotations_are_read_or_refused(
            index in "-?[0-9]{1,25}|1e9|null|\"3\"", name in "[a-z./\\\\]{0,9}", length: prop::sample::Index, bytes: Vec<u8>,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let annotations = folder.path().join("annotations");
            std::fs::create_dir(&annotations).unwrap();
            let shape = format!(
                r#"[{{"class_id": "{name}", "model_id": "1", "keypoints": [{{"pcd_info": {{"point_index": {index}}}}}], "x": 0}}]"#
            );
            for text in [shape.as_bytes(), &shape.as_bytes()[..length.index(shape.len())], &bytes] {
                std::fs::write(annotations.join("chair.json"), text).unwrap();
                if let Ok(data) = SemanticData::open(folder.path(), None) {
                    prop_assert_eq!(data.len(), 1);
                }
            }
        }
    }
}
