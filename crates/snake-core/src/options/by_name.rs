//! Options replaced by name, for callers that have them as text: files of settings and other languages.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::Options;
use crate::{Error, Result};

impl Options {
    /// These options with some of them replaced by name, such as `{"max_keypoints": 20, "nms_radius": "3r"}`. The names are
    /// those of the fields of [`EncodeOptions`](crate::EncodeOptions), [`DetectOptions`](crate::DetectOptions) and
    /// [`Options`]; the values are those of their JSON. Ranges are checked by the call that takes the options.
    ///
    /// ```
    /// use snake_core::Options;
    /// let values = serde_json::json!({ "max_keypoints": 20, "rotations": 4 });
    /// let options = Options::default().with_values(values.as_object().unwrap())?;
    /// assert_eq!((options.detect.max_keypoints, options.encode.rotations), (20, 4));
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] for an unknown name, with all names, and for a value of another type.
    pub fn with_values(&self, values: &Map<String, Value>) -> Result<Self> {
        with_named_values(self, values)
    }
}

/// Options of any kind with some of them replaced by name, as [`Options::with_values`] does. Options in groups, such as those
/// of [`Options`] or of a pair of structs, have their names without the group's.
///
/// # Errors
/// [`Error::Input`] for an unknown name, with all names, and for a value of another type.
pub fn with_named_values<T: Clone + Serialize + DeserializeOwned>(
    options: &T,
    values: &Map<String, Value>,
) -> Result<T> {
    let refused = |reason| Error::Input { what: "options", reason };
    let mut tree = serde_json::to_value(options).map_err(|error| refused(error.to_string()))?;
    let mut replaced = options.clone();
    for (name, value) in values {
        let Some((group, _)) = option_names(&tree).into_iter().find(|(_, option)| option == name) else {
            let known: Vec<&str> = option_names(&tree).into_iter().map(|(_, option)| option).collect();
            return Err(refused(format!("unknown option `{name}`; the options are {}", known.join(", "))));
        };
        let place = &format!("{group}/{name}");
        if let Some(slot) = tree.pointer_mut(place) {
            *slot = value.clone();
        }
        replaced = serde_json::from_value(tree.clone())
            .map_err(|error| refused(format!("option `{name}` is {value}: {}", in_words(&error))))?;
    }
    Ok(replaced)
}

/// The fault of a value in words, without Rust's names of types.
#[doc(hidden)]
pub fn in_words(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let words = [
        ("f32", "a number"),
        ("f64", "a number"),
        ("usize", "a whole number, 0 or more"),
        ("u64", "a whole number, 0 or more"),
    ];
    let in_words = words.iter().find_map(|(rust, words)| Some(format!("{}{words}", text.strip_suffix(rust)?)));
    in_words.unwrap_or(text)
}

/// All options, each as the place of its group and its name: those in groups, then the others.
#[doc(hidden)]
pub fn option_names(tree: &Value) -> Vec<(String, &str)> {
    let groups: Vec<(String, &Value)> = match tree {
        Value::Array(groups) => groups.iter().enumerate().map(|(at, group)| (format!("/{at}"), group)).collect(),
        // By falling name, as the groups of [`Options`] are used: encode, detect.
        Value::Object(groups) => groups.iter().rev().map(|(name, group)| (format!("/{name}"), group)).collect(),
        _ => Vec::new(),
    };
    let groups = groups.into_iter().filter(|(_, group)| group.is_object()).chain([(String::new(), tree)]);
    let options = groups.flat_map(|(place, group)| {
        let options = group.as_object().into_iter().flatten().filter(|(_, value)| !value.is_object());
        options.map(move |(name, _)| (place.clone(), name.as_str()))
    });
    options.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_two_structs_are_found_by_name() {
        let both = (Options::default().encode, crate::MeshOptions::default());
        let values = serde_json::json!({ "seed": 7, "resolution": 99 });
        let (encode, mesh) = with_named_values(&both, values.as_object().unwrap()).unwrap();
        assert_eq!((encode.seed, mesh.resolution), (7, 99));
        let values = serde_json::json!({ "snap": true });
        let error = with_named_values(&both, values.as_object().unwrap()).unwrap_err().to_string();
        assert!(
            error.contains("unknown option `snap`") && error.contains("seed") && error.contains("level"),
            "{error}"
        );
    }
}
