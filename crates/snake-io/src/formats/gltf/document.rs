//! The parts of a glTF document that place vertices. Materials, textures and other parts are not read.

use std::collections::BTreeMap;

use serde::Deserialize;
use snake_geometry::excerpt;

/// A document. Its parts refer to each other by index.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    asset: Asset,
    pub(super) scene: Option<usize>,
    #[serde(default)]
    pub(super) scenes: Vec<Scene>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<Mesh>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default)]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default)]
    extensions_used: Vec<String>,
    #[serde(default)]
    extensions_required: Vec<String>,
}

#[derive(Deserialize)]
struct Asset {
    version: String,
}

#[derive(Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub(super) nodes: Vec<usize>,
}

#[derive(Deserialize)]
pub(super) struct Node {
    #[serde(default)]
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    /// Column by column.
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    /// `x y z w`.
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    #[serde(default)]
    pub(super) extensions: NodeExtensions,
}

#[derive(Deserialize, Default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instances: Option<Instances>,
}

/// Instances of a node's mesh: accessors of `TRANSLATION`, `ROTATION` and `SCALE`.
#[derive(Deserialize)]
pub(super) struct Instances {
    pub(super) attributes: BTreeMap<String, usize>,
}

#[derive(Deserialize)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<String, usize>,
    pub(super) indices: Option<usize>,
    pub(super) mode: Option<u32>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) shape: String,
    pub(super) sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
}

#[derive(Deserialize)]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
}

/// Extensions that this reader implements.
const READ: [&str; 2] = ["EXT_mesh_gpu_instancing", "KHR_mesh_quantization"];

/// Words in the names of extensions that change the appearance of a surface but not its position.
const APPEARANCE: [&str; 12] = [
    "material",
    "texture",
    "light",
    "image",
    "animation",
    "metadata",
    "feature",
    "outline",
    "audio",
    "shader",
    "xmp",
    "webgl",
];

/// Extensions that compress vertices.
const COMPRESSIONS: [&str; 3] = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

impl Document {
    /// The document and the binary data of a file.
    pub(super) fn parse(bytes: &[u8]) -> Result<(Self, Option<&[u8]>), String> {
        let (json, data) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
        let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
        let document: Self = serde_json::from_slice(json)
            .map_err(|error| format!("not a glTF document: {}", excerpt(&error.to_string(), 200)))?;
        if !document.asset.version.starts_with("2.") {
            return Err(old_version(&document.asset.version));
        }
        document.check_extensions()?;
        Ok((document, data))
    }

    /// Refuses extensions that may move vertices.
    fn check_extensions(&self) -> Result<(), String> {
        // This extension moves every vertex, even if the file does not require it.
        if self.extensions_used.iter().chain(&self.extensions_required).any(|name| name == "CESIUM_RTC") {
            return Err(
                "its vertices are relative to the centre in its extension CESIUM_RTC, which is not read; give the \
                        root node this centre as its `translation`, and remove the extension"
                    .into(),
            );
        }
        let is_known = |name: &str| {
            let lower = name.to_lowercase();
            READ.contains(&name) || APPEARANCE.iter().any(|word| lower.contains(word))
        };
        match self.extensions_required.iter().find(|name| !is_known(name)) {
            None => Ok(()),
            Some(name) if COMPRESSIONS.contains(&name.as_str()) => Err(compressed(name)),
            Some(name) => Err(format!(
                "it requires the extension {}, which is not read and may move its vertices; export it without this \
                 extension, for example with Blender",
                excerpt(name, 60)
            )),
        }
    }

    /// The error for missing data.
    pub(super) fn without_data(&self, what: &str) -> String {
        match self.extensions_used.iter().find(|name| COMPRESSIONS.contains(&name.as_str())) {
            Some(name) => compressed(name),
            None => format!("{what} has no data"),
        }
    }
}

fn compressed(extension: &str) -> String {
    format!("its vertices are compressed with {extension}; decompress it: npx @gltf-transform/cli copy IN.glb OUT.glb")
}

fn old_version(version: &str) -> String {
    format!("glTF {}; only glTF 2 is read; convert it: npx gltf-pipeline -i IN.glb -o OUT.glb", excerpt(version, 20))
}

/// The JSON and the binary data of a binary file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let number = |at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?) as usize);
    let cut = |expected: usize| format!("cut short: {} of {expected} bytes", bytes.len());
    let (Some(version), Some(length)) = (number(4), number(8)) else { return Err(cut(12)) };
    if version != 2 {
        return Err(old_version(&version.to_string()));
    }
    if length > bytes.len() {
        return Err(cut(length));
    }
    let chunk = |at: usize, kind: &[u8]| -> Result<Option<&[u8]>, String> {
        let (Some(length), Some(found)) = (number(at), bytes.get(at + 4..at + 8)) else { return Ok(None) };
        let end = at.saturating_add(8).saturating_add(length);
        match bytes.get(at + 8..end) {
            _ if found != kind => Ok(None),
            Some(data) => Ok(Some(data)),
            None => Err(cut(end)),
        }
    };
    let json = chunk(12, b"JSON")?.ok_or("its first chunk is not JSON")?;
    Ok((json, chunk(20 + json.len(), b"BIN\0")?))
}
