//! The numbers of a glTF document. Offsets and counts are checked against the data.

use std::borrow::Cow;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use snake_geometry::excerpt;

use super::document::{Accessor, Document};
use super::named;

const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The data of a document.
pub(super) struct Data<'a> {
    document: &'a Document,
    /// The bytes of each buffer, or the reason why they cannot be read. The reason matters only if a vertex is in it.
    buffers: Vec<Result<Cow<'a, [u8]>, String>>,
}

impl<'a> Data<'a> {
    /// `binary` is the data of the first buffer of a binary file.
    pub(super) fn new(document: &'a Document, binary: Option<&'a [u8]>) -> Self {
        let buffer = |index: usize| match (&document.buffers[index].uri, binary) {
            (Some(uri), _) => embedded(uri).map(Cow::Owned),
            (None, Some(binary)) if index == 0 => Ok(Cow::Borrowed(binary)),
            (None, _) => Err(document.without_data(&format!("buffer {index}"))),
        };
        Self { document, buffers: (0..document.buffers.len()).map(buffer).collect() }
    }

    /// The number of items of an accessor.
    pub(super) fn count(&self, accessor: usize) -> Result<usize, String> {
        Ok(named(&self.document.accessors, accessor, "accessor")?.count)
    }

    /// The vectors of an accessor.
    pub(super) fn vectors<const N: usize>(&self, index: usize) -> Result<impl Iterator<Item = [f64; N]>, String> {
        let accessor = named(&self.document.accessors, index, "accessor")?;
        let size = match accessor.component_type {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5126 => 4,
            other => {
                return Err(format!("accessor {index} has numbers of type {other}; expected are 5120 to 5123 or 5126"));
            }
        };
        if accessor.shape != format!("VEC{N}") {
            return Err(format!("accessor {index} has items {}, not VEC{N}", excerpt(&accessor.shape, 20)));
        }
        let items = self.items(index, accessor, N * size)?;
        Ok(items.map(move |item| std::array::from_fn(|axis| number(accessor, &item[axis * size..][..size]))))
    }

    /// The indices of an accessor.
    pub(super) fn indices(&self, index: usize) -> Result<impl Iterator<Item = u32>, String> {
        let accessor = named(&self.document.accessors, index, "accessor")?;
        let size = match (accessor.component_type, accessor.shape.as_str()) {
            (5121, "SCALAR") => 1,
            (5123, "SCALAR") => 2,
            (5125, "SCALAR") => 4,
            (other, shape) => {
                return Err(format!("accessor {index} has {} of type {other}, not indices", excerpt(shape, 20)));
            }
        };
        let items = self.items(index, accessor, size)?;
        Ok(items.map(|item| item.iter().rev().fold(0, |index, &byte| index << 8 | u32::from(byte))))
    }

    /// The bytes of each item of an accessor.
    fn items(&self, index: usize, accessor: &Accessor, size: usize) -> Result<impl Iterator<Item = &[u8]>, String> {
        if accessor.sparse.is_some() {
            return Err("sparse accessors are not read; write them in full: npx @gltf-transform/cli sparse IN.glb \
                        OUT.glb --ratio 0"
                .into());
        }
        let what = format!("accessor {index}");
        let view = accessor.buffer_view.ok_or_else(|| self.document.without_data(&what))?;
        let view = named(&self.document.buffer_views, view, "buffer view")?;
        let buffer = named(&self.buffers, view.buffer, "buffer")?.as_ref().map_err(Clone::clone)?;
        let (stride, count) = (view.byte_stride.unwrap_or(size), accessor.count);
        let within = || {
            let bytes = buffer.get(view.byte_offset..)?.get(..view.byte_length)?.get(accessor.byte_offset..)?;
            let needed = match count {
                0 => 0,
                _ => (count - 1).checked_mul(stride)?.checked_add(size)?,
            };
            (stride >= size && needed <= bytes.len()).then_some(bytes)
        };
        let bytes = within().ok_or_else(|| format!("{what} reaches beyond its data"))?;
        Ok((0..count).map(move |index| &bytes[index * stride..][..size]))
    }
}

/// The value of a number. A normalised integer is mapped to -1 to 1.
fn number(accessor: &Accessor, bytes: &[u8]) -> f64 {
    let (value, most) = match (accessor.component_type, bytes) {
        (5120, &[a]) => (f64::from(a as i8), 127.0),
        (5121, &[a]) => (f64::from(a), 255.0),
        (5122, &[a, b]) => (f64::from(i16::from_le_bytes([a, b])), 32767.0),
        (5123, &[a, b]) => (f64::from(u16::from_le_bytes([a, b])), 65535.0),
        (_, &[a, b, c, d]) => return f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => return f64::NAN,
    };
    if accessor.normalized { (value / most).max(-1.0) } else { value }
}

/// The bytes of a data URI. Buffers in separate files are not read.
fn embedded(uri: &str) -> Result<Vec<u8>, String> {
    let Some((_, data)) = uri.strip_prefix("data:").and_then(|rest| rest.split_once(";base64,")) else {
        let name = excerpt(uri, 60);
        return Err(format!(
            "its data is in another file, `{name}`; convert it: npx @gltf-transform/cli copy IN.gltf OUT.glb"
        ));
    };
    BASE64.decode(data).map_err(|error| format!("a buffer is not base64: {error}"))
}
