//! Opens a weight file (safetensors, `format=snake-field`) and loads its tensors by name.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;

use safetensors::{Dtype, SafeTensors};
use serde::de::DeserializeOwned;

use crate::{Error, Result};
use snake_geometry::excerpt;

/// The longest header of a weight file, in bytes: the limit of the safetensors format.
const MAX_HEADER: u64 = 100_000_000;

/// The bytes of a weight file, for [`Model::from_bytes`](crate::Model::from_bytes). A file whose first bytes cannot be the
/// length of a header is not read further, because a device may have no end.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read.
pub fn read_weight_file(path: &Path) -> Result<Vec<u8>> {
    let io = |source| Error::Io { path: path.into(), source };
    let mut file = File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    file.by_ref().take(8).read_to_end(&mut bytes).map_err(io)?;
    let header = bytes.first_chunk().map(|length| u64::from_le_bytes(*length));
    if header.is_some_and(|length| (1..=MAX_HEADER).contains(&length)) {
        file.read_to_end(&mut bytes).map_err(io)?;
    }
    Ok(bytes)
}

/// Tensors and metadata of one weight file, and the names of the tensors that were read.
pub(crate) struct Weights<'data> {
    tensors: SafeTensors<'data>,
    pub(crate) metadata: HashMap<String, String>,
    asked: RefCell<BTreeSet<String>>,
}

impl<'data> Weights<'data> {
    /// Reads the header. Refuses a `format_version` other than 1, or 2 for scene models.
    pub(crate) fn open(bytes: &'data [u8]) -> Result<Self> {
        let broken = |e| error("file", "a safetensors file", format!("{e}"));
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let entries = header.metadata().iter().flatten();
        let metadata = entries.map(|(key, value)| (key.clone(), value.clone())).collect();
        let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
        let weights = Self { tensors, metadata, asked: RefCell::default() };
        let format = weights.metadata.get("format").cloned().unwrap_or_default();
        if format != "snake-field" {
            return Err(error(
                "format",
                "snake-field",
                format!("{format:?}; export the network with snake_training.export"),
            ));
        }
        let is_scene = weights.metadata.get("coordinates").is_some_and(|coordinates| coordinates == "voxel");
        match weights.number::<u32>("format_version")? {
            1 if !is_scene => Ok(weights),
            2 if is_scene => Ok(weights),
            other => {
                let actual = format!("{other}; use a newer snake-rs");
                Err(error("format_version", "1, or 2 with `coordinates` voxel", actual))
            }
        }
    }

    /// A metadata value.
    pub(crate) fn text(&self, key: &str) -> Result<&str> {
        self.metadata.get(key).map(String::as_str).ok_or_else(|| error(key, "a metadata value", "none".into()))
    }

    /// A metadata value as a number.
    pub(crate) fn number<T: std::str::FromStr>(&self, key: &str) -> Result<T> {
        let text = self.text(key)?;
        text.parse().map_err(|_| error(key, "a number", format!("{text:?}")))
    }

    /// The recommended options, else the defaults.
    pub(crate) fn recommended_options<Options: DeserializeOwned + Default>(&self) -> Result<Options> {
        let Some(json) = self.metadata.get("recommended_options") else { return Ok(Options::default()) };
        serde_json::from_str(json)
            .map_err(|e| error("recommended_options", "options of snake-rs as JSON", e.to_string()))
    }

    /// The tensors whose names begin with `name`.
    pub(crate) fn at(&self, name: &str) -> Scope<'_> {
        Scope { weights: self, prefix: name.into() }
    }

    /// Number of values in all tensors.
    pub(crate) fn num_parameters(&self) -> usize {
        self.tensors.iter().map(|(_, view)| view.shape().iter().product::<usize>()).sum()
    }

    /// Fails if a tensor was not read.
    pub(crate) fn finish(self) -> Result<()> {
        let asked = self.asked.borrow();
        let mut unknown: Vec<&str> = self.tensors.names().into_iter().filter(|name| !asked.contains(*name)).collect();
        unknown.sort_unstable();
        match unknown.first() {
            Some(name) => {
                Err(error(name, "no such tensor in this network", format!("{} unknown tensors", unknown.len())))
            }
            None => Ok(()),
        }
    }

    fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let expected = || format!("float32 or float16 of shape {shape:?}");
        let view = self.tensors.tensor(name).map_err(|_| error(name, &expected(), "nothing".into()))?;
        self.asked.borrow_mut().insert(name.into());
        // The data may be unaligned within the file, so numbers are decoded from bytes.
        let data = view.data();
        let values: Vec<f32> = match view.dtype() {
            _ if view.shape() != shape => return Err(error(name, &expected(), format!("shape {:?}", view.shape()))),
            Dtype::F32 => data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            Dtype::F16 => data.as_chunks().0.iter().map(|b| from_half(*b)).collect(),
            other => return Err(error(name, &expected(), format!("{other:?}"))),
        };
        match values.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(error(name, "finite values", format!("{} at index {at}", values[at]))),
            None => Ok(values),
        }
    }
}

/// A number of IEEE 754 binary16: a sign, five bits of an exponent, ten of a fraction.
fn from_half(bytes: [u8; 2]) -> f32 {
    let bits = u16::from_le_bytes(bytes);
    let magnitude = match (bits >> 10 & 31, f32::from(bits & 1023)) {
        (0, fraction) => fraction * f32::powi(2.0, -24),
        (31, 0.0) => f32::INFINITY,
        (31, _) => f32::NAN,
        (exponent, fraction) => (1024.0 + fraction) * f32::powi(2.0, i32::from(exponent) - 25),
    };
    magnitude.copysign(if bits >> 15 == 0 { 1.0 } else { -1.0 })
}

/// The tensors under one prefix.
pub(crate) struct Scope<'w> {
    weights: &'w Weights<'w>,
    prefix: String,
}

impl Scope<'_> {
    /// The tensors under the prefix `name` within this scope.
    pub(crate) fn at(&self, name: &str) -> Scope<'_> {
        Scope { weights: self.weights, prefix: format!("{}.{name}", self.prefix) }
    }

    /// The tensor `name` of this scope, which must have this shape and finite values.
    pub(crate) fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        self.weights.tensor(&format!("{}.{name}", self.prefix), shape)
    }
}

/// An [`Error::Weights`]; text from the file is cut to one short line.
pub(crate) fn error(tensor: &str, expected: &str, found: String) -> Error {
    Error::Weights { tensor: excerpt(tensor, 100), expected: expected.into(), found: excerpt(&found, 200) }
}

#[cfg(test)]
mod tests {
    use super::from_half;

    #[test]
    fn half_numbers_are_those_of_ieee_754() {
        let bits = [0x0000, 0x8001, 0x03ff, 0x0400, 0x3555, 0xbc00, 0x7bff, 0xfc00_u16];
        let values =
            [0.0, -5.960_464_5e-8, 6.097_555e-5, 6.103_515_6e-5, 0.333_251_95, -1.0, 65504.0, f32::NEG_INFINITY];
        assert_eq!(bits.map(|bits| from_half(bits.to_le_bytes())), values);
        assert!(from_half([1, 0x7c]).is_nan());
    }
}
