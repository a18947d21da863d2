//! Reads glTF scenes, as JSON (gltf) and as binary files (glb), with the crate `gltf`.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use gltf::accessor::{DataType, Dimensions};
use gltf::json::Root;
use gltf::{Accessor, Document, Gltf, Node, Primitive, Semantic, buffer, mesh};
use snake_core::excerpt;

use super::shape::{Position, Shape};

/// Reads the vertices of all meshes of the default scene, in the scene's frame (y points up), and their triangles.
pub(super) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let Gltf { document, mut blob } = Gltf::from_slice_without_validation(bytes).map_err(refused)?;
    let document = validated(document.into_json())?;
    let buffers = document.buffers().map(|buffer| match buffer.source() {
        buffer::Source::Bin => blob.take().ok_or_else(|| "a buffer has no data".to_owned()),
        buffer::Source::Uri(uri) => embedded(uri),
    });
    let buffers: Vec<Vec<u8>> = buffers.collect::<Result<_, _>>()?;
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let mut open: Vec<(Node, [[f64; 4]; 4])> = match scene {
        Some(scene) => scene.nodes().map(|node| (node, IDENTITY)).collect(),
        None => document.nodes().filter(|node| node.mesh().is_some()).map(|node| (node, IDENTITY)).collect(),
    };
    let mut visited = vec![false; document.nodes().len()];
    let mut shape = Shape::default();
    while let Some((node, parent)) = open.pop() {
        // The nodes are a tree. A node with two parents could make any number of points, and a circle has no end.
        if std::mem::replace(&mut visited[node.index()], true) {
            return Err(format!("node {} has two parents", node.index()));
        }
        let transform = product(&parent, &node.transform().matrix().map(|column| column.map(f64::from)));
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            add_primitive(&mut shape, &primitive, &buffers, &transform)?;
        }
        open.extend(node.children().map(|child| (child, transform)));
    }
    shape.check_triangles()?;
    Ok(shape)
}

fn refused(error: gltf::Error) -> String {
    excerpt(&error.to_string(), 200)
}

/// The document of a file. The crate's own validation looks positions up before it checks that they are there.
fn validated(root: Root) -> Result<Document, String> {
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let mut attributes = primitives.flat_map(|primitive| primitive.attributes.values());
    if attributes.any(|accessor| accessor.value() >= root.accessors.len()) {
        return Err("a mesh has an accessor that is not there".into());
    }
    Document::from_json(root).map_err(refused)
}

/// Column by column, as in the file.
const IDENTITY: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn product(a: &[[f64; 4]; 4], b: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
    b.map(|column| std::array::from_fn(|row| (0..4).map(|k| a[k][row] * column[k]).sum()))
}

/// The bytes of a data URI. Buffers in files of their own are not read.
fn embedded(uri: &str) -> Result<Vec<u8>, String> {
    let Some((_, data)) = uri.strip_prefix("data:").and_then(|rest| rest.split_once(";base64,")) else {
        let name = excerpt(uri, 60);
        return Err(format!(
            "its data is in another file, `{name}`; convert it: npx @gltf-transform/cli copy IN.gltf OUT.glb"
        ));
    };
    BASE64_STANDARD.decode(data).map_err(|error| format!("a buffer is not base64: {error}"))
}

fn add_primitive(
    shape: &mut Shape,
    primitive: &Primitive,
    buffers: &[Vec<u8>],
    transform: &[[f64; 4]; 4],
) -> Result<(), String> {
    let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
    if (positions.data_type(), positions.dimensions()) != (DataType::F32, Dimensions::Vec3) {
        return Err("positions that are not three float32 values (a compressed mesh?) are not read; convert it: npx \
                    @gltf-transform/cli dequantize IN.glb OUT.glb"
            .into());
    }
    let first = shape.points.len() as u32;
    for item in items(&positions, buffers)? {
        let (values, _) = item.as_chunks::<4>();
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(f32::from_le_bytes(values[axis])));
        let [a, b, c, d] = transform;
        shape.points.push(std::array::from_fn(|row| a[row] * x + b[row] * y + c[row] * z + d[row]) as Position);
    }
    if primitive.mode() != mesh::Mode::Triangles {
        return Ok(());
    }
    let corners: Vec<u32> = match primitive.indices() {
        None => (first..shape.points.len() as u32).collect(),
        Some(accessor) => {
            let index = |item: &[u8]| item.iter().rev().fold(0_u32, |index, &byte| index << 8 | u32::from(byte));
            items(&accessor, buffers)?.map(|item| first.saturating_add(index(item))).collect()
        }
    };
    shape.triangles.extend(corners.as_chunks::<3>().0);
    Ok(())
}

/// The bytes of each item of an accessor. The crate's own readers trust offsets and counts.
fn items<'a>(accessor: &Accessor, buffers: &'a [Vec<u8>]) -> Result<impl Iterator<Item = &'a [u8]> + use<'a>, String> {
    if accessor.sparse().is_some() {
        return Err(
            "sparse accessors are not read; convert the file: npx @gltf-transform/cli copy IN.glb OUT.glb".into()
        );
    }
    let view = accessor.view().ok_or("an accessor has no data; compressed meshes are not read")?;
    let (size, count) = (accessor.size(), accessor.count());
    let stride = view.stride().unwrap_or(size);
    let within = || {
        let bytes = buffers.get(view.buffer().index())?.get(view.offset()..)?;
        let bytes = bytes.get(..view.length())?.get(accessor.offset()..)?;
        let needed = count.checked_sub(1)?.checked_mul(stride)?.checked_add(size)?;
        (stride >= size && size > 0 && needed <= bytes.len()).then_some(bytes)
    };
    let bytes = within().ok_or("an accessor reaches beyond its data")?;
    Ok((0..count).map(move |index| &bytes[index * stride..][..size]))
}

#[cfg(test)]
mod tests {
    use super::super::tests::points;

    fn scene(nodes: &str, extra: &str) -> String {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": {nodes},
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "mode": 0}}]}}],
            "accessors": [{{"componentType": 5126, "count": 1, "type": "VEC3", "bufferView": 0, "min": [1, 2, 3],
            "max": [1, 2, 3] {extra}}}], "bufferViews": [{{"buffer": 0, "byteLength": 12}}],
            "buffers": [{{"byteLength": 12, "uri": "data:application/octet-stream;base64,AACAPwAAAEAAAEBA"}}]}}"#
        )
    }

    fn read(text: &str) -> Result<Vec<snake_core::Point>, String> {
        points(super::read(text.as_bytes()))
    }

    #[test]
    fn nodes_are_placed_in_the_scene() {
        let nodes = r#"[{"children": [1], "translation": [10, 0, 0]}, {"mesh": 0, "scale": [2, 2, 2]}]"#;
        assert_eq!(read(&scene(nodes, "")).unwrap(), [[12.0, 4.0, 6.0]]);
    }

    #[test]
    fn data_that_is_not_there_and_circles_are_refused() {
        let mesh = r#"[{"mesh": 0}]"#;
        assert!(read(&scene(mesh, r#", "byteOffset": 4"#)).unwrap_err().contains("beyond its data"));
        assert!(read(&scene(r#"[{"children": [1]}, {"children": [0]}]"#, "")).unwrap_err().contains("two parents"));
        let absent = scene(mesh, "").replace(r#""POSITION": 0"#, r#""POSITION": 1"#);
        assert!(read(&absent).unwrap_err().contains("not there"));
        let elsewhere = scene(mesh, "").replace("data:application/octet-stream;base64,AACAPwAAAEAAAEBA", "part.bin");
        let error = read(&elsewhere).unwrap_err();
        assert!(error.contains("part.bin") && error.contains("gltf-transform"), "{error}");
    }
}
