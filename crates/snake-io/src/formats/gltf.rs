//! Reads glTF scenes, as JSON (gltf) and as binary files (glb).
//!
//! The crate `gltf` 1.4.1 panics at a missing index unless it validates the whole file. With validation, it refuses files with
//! damaged materials that no vertex needs.

mod data;
mod document;

use data::Data;
use document::{Document, Node, Primitive};

use crate::MAX_EXPANSION;
use crate::formats::quaternion::rotation;
use crate::table::shape::{Position, Shape, add_polygon};

/// Reads the vertices of all meshes of the default scene, in the scene's frame (y points up), and their triangles.
pub(crate) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let (document, binary) = Document::parse(bytes)?;
    let most = bytes.len().saturating_mul(MAX_EXPANSION).max(MIN_BYTES) / size_of::<Position>();
    let mut scene = SceneReader {
        data: Data::new(&document, binary),
        document: &document,
        most: most.min(u32::MAX as usize),
        shape: Shape::default(),
    };
    let mut open: Vec<(usize, Matrix)> = roots(&document)?.into_iter().map(|node| (node, IDENTITY)).collect();
    let mut visited = vec![false; document.nodes.len()];
    while let Some((index, parent)) = open.pop() {
        let node = named(&document.nodes, index, "node")?;
        // The nodes form a tree. A node with two parents could multiply points without limit, and a cycle has no end.
        if std::mem::replace(&mut visited[index], true) {
            return Err(format!("node {index} has two parents"));
        }
        let transform = product(&parent, &matrix(node)?);
        scene.add_mesh(node, &transform)?;
        open.extend(node.children.iter().map(|&child| (child, transform)));
    }
    scene.shape.check_triangles()?;
    Ok(scene.shape)
}

/// Number of bytes of points that any file may create, because a small file may have many instances.
const MIN_BYTES: usize = 64 << 20;

/// A matrix, column by column, as in the file.
type Matrix = [[f64; 4]; 4];

const IDENTITY: Matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    b.map(|column| std::array::from_fn(|row| (0..4).map(|k| a[k][row] * column[k]).sum()))
}

/// The part with this index.
fn named<'a, T>(parts: &'a [T], index: usize, what: &str) -> Result<&'a T, String> {
    parts.get(index).ok_or_else(|| format!("{what} {index} is not there; the file has {}", parts.len()))
}

/// The nodes without a parent in the default scene, or in the whole file if it has no scene.
fn roots(document: &Document) -> Result<Vec<usize>, String> {
    match (document.scene, &document.scenes[..]) {
        (None, []) => {
            let mut is_child = vec![false; document.nodes.len()];
            for &child in document.nodes.iter().flat_map(|node| &node.children) {
                named(&document.nodes, child, "node")?;
                is_child[child] = true;
            }
            Ok((0..is_child.len()).filter(|&node| !is_child[node]).collect())
        }
        (scene, scenes) => Ok(named(scenes, scene.unwrap_or(0), "scene")?.nodes.clone()),
    }
}

fn matrix(node: &Node) -> Result<Matrix, String> {
    if let Some(values) = &node.matrix {
        return Ok(std::array::from_fn(|column| std::array::from_fn(|row| values[4 * column + row])));
    }
    placed(node.translation.unwrap_or_default(), node.rotation.unwrap_or_default(), node.scale.unwrap_or([1.0; 3]))
}

/// The matrix of a translation, a rotation `x y z w` and a scale.
fn placed(translation: [f64; 3], [x, y, z, w]: [f64; 4], scale: [f64; 3]) -> Result<Matrix, String> {
    let rows = rotation([w, x, y, z])?;
    let mut matrix = IDENTITY;
    for row in 0..3 {
        for column in 0..3 {
            matrix[column][row] = rows[row][column] * scale[column];
        }
        matrix[3][row] = translation[row];
    }
    Ok(matrix)
}

/// Collects the vertices of a scene.
struct SceneReader<'a> {
    document: &'a Document,
    data: Data<'a>,
    /// The maximum number of points, and of triangles.
    most: usize,
    shape: Shape,
}

impl SceneReader<'_> {
    /// Adds the mesh of a node, or its instances.
    fn add_mesh(&mut self, node: &Node, transform: &Matrix) -> Result<(), String> {
        let Some(mesh) = node.mesh else { return Ok(()) };
        let primitives = &named(&self.document.meshes, mesh, "mesh")?.primitives;
        for instance in self.instances(node)? {
            let transform = product(transform, &instance);
            primitives.iter().try_for_each(|primitive| self.add_primitive(primitive, &transform))?;
        }
        Ok(())
    }

    /// The matrix of each instance of a node's mesh.
    fn instances(&self, node: &Node) -> Result<Vec<Matrix>, String> {
        let Some(instances) = &node.extensions.instances else { return Ok(vec![IDENTITY]) };
        let attribute = |name: &str| instances.attributes.get(name).copied();
        let [places, turns, scales] = ["TRANSLATION", "ROTATION", "SCALE"].map(attribute);
        let Some(first) = places.or(turns).or(scales) else { return Ok(vec![IDENTITY]) };
        let count = self.data.count(first)?;
        // Checked before memory is allocated: an instance has at least one point.
        if count > self.most {
            return Err(format!("{count} instances"));
        }
        let mut parts = vec![([0.0; 3], [0.0; 4], [1.0; 3]); count];
        let checked = |accessor: Option<usize>, name| match accessor {
            Some(accessor) if self.data.count(accessor)? != count => {
                Err(format!("{name} of instances: not {count} of them"))
            }
            _ => Ok(accessor),
        };
        if let Some(accessor) = checked(places, "TRANSLATION")? {
            parts.iter_mut().zip(self.data.vectors(accessor)?).for_each(|(part, value)| part.0 = value);
        }
        if let Some(accessor) = checked(turns, "ROTATION")? {
            parts.iter_mut().zip(self.data.vectors(accessor)?).for_each(|(part, value)| part.1 = value);
        }
        if let Some(accessor) = checked(scales, "SCALE")? {
            parts.iter_mut().zip(self.data.vectors(accessor)?).for_each(|(part, value)| part.2 = value);
        }
        parts.into_iter().map(|(place, turn, scale)| placed(place, turn, scale)).collect()
    }

    fn add_primitive(&mut self, primitive: &Primitive, transform: &Matrix) -> Result<(), String> {
        let Some(&positions) = primitive.attributes.get("POSITION") else { return Ok(()) };
        let first = self.shape.points.len();
        self.check_number(first, self.data.count(positions)?, "points")?;
        let [a, b, c, d] = transform;
        let place = |[x, y, z]: [f64; 3]| std::array::from_fn(|row| a[row] * x + b[row] * y + c[row] * z + d[row]);
        self.shape.points.extend(self.data.vectors(positions)?.map(place));
        let end = self.shape.points.len();
        let num_corners = primitive.indices.map_or(Ok(end - first), |accessor| self.data.count(accessor))?;
        self.check_number(self.shape.triangles.len(), num_corners, "corners")?;
        // The limit of the points keeps their indices in range.
        let first = first as u32;
        let corners: Vec<u32> = match primitive.indices {
            None => (first..end as u32).collect(),
            Some(accessor) => self.data.indices(accessor)?.map(|index| first.saturating_add(index)).collect(),
        };
        add_triangles(&mut self.shape.triangles, primitive.mode.unwrap_or(4), &corners)
    }

    /// Refuses more points or corners than the size of the file allows.
    fn check_number(&self, present: usize, added: usize, what: &str) -> Result<(), String> {
        match present.checked_add(added) {
            Some(number) if number <= self.most => Ok(()),
            _ => Err(format!("more than {} {what}, too many for the size of the file", self.most)),
        }
    }
}

/// Adds the triangles of a primitive. Points and lines have none.
fn add_triangles(triangles: &mut Vec<[u32; 3]>, mode: u32, corners: &[u32]) -> Result<(), String> {
    match mode {
        0..=3 => (),
        4 => triangles.extend(corners.as_chunks::<3>().0),
        // Every second triangle of a strip has the opposite winding.
        5 => triangles.extend(corners.windows(3).enumerate().map(|(number, corner)| match number % 2 {
            0 => [corner[0], corner[1], corner[2]],
            _ => [corner[0], corner[2], corner[1]],
        })),
        6 => add_polygon(triangles, corners),
        other => return Err(format!("primitives of mode {other}; the modes are 0 to 6")),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::tests::points;

    fn scene(nodes: &str, extra: &str) -> String {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": {nodes},
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "mode": 0}}]}}],
            "accessors": [{{"componentType": 5126, "count": 1, "type": "VEC3", "bufferView": 0, "min": [1, 2, 3],
            "max": [1, 2, 3] {extra}}}], "bufferViews": [{{"buffer": 0, "byteLength": 12}}],
            "buffers": [{{"byteLength": 12, "uri": "data:application/octet-stream;base64,AACAPwAAAEAAAEBA"}}]}}"#
        )
    }

    fn read(text: &str) -> Result<Vec<snake_geometry::Point>, String> {
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

    /// A scene with one mesh of 6 corners, a strip of squares, in which some parts are replaced.
    fn strip(replaced: &[(&str, &str)]) -> Vec<u8> {
        let corners = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [2.0, 0.0], [2.0, 1.0]];
        let corners = corners.iter().flat_map(|[x, y]| [*x, *y, 0.0_f32]);
        let places = [5.0, 0.0, 0.0, 0.0, 7.0, 0.0_f32];
        let data: Vec<u8> = corners.chain(places).flat_map(f32::to_le_bytes).collect();
        let mut json = r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]}],
            "accessors": [{"componentType": 5126, "count": 6, "type": "VEC3", "bufferView": 0},
            {"componentType": 5126, "count": 2, "type": "VEC3", "bufferView": 1}],
            "bufferViews": [{"buffer": 0, "byteLength": 72}, {"buffer": 0, "byteOffset": 72, "byteLength": 24}],
            "buffers": [{"byteLength": 96}]}"#
            .to_owned();
        for (old, new) in replaced {
            assert!(json.contains(old), "{old}");
            json = json.replace(old, new);
        }
        json += &" ".repeat(json.len().next_multiple_of(4) - json.len());
        let mut bytes = [b"glTF".as_slice(), &2_u32.to_le_bytes()].concat();
        bytes.extend((28 + json.len() as u32 + data.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", json.as_bytes()), (b"BIN\0", &data)] {
            bytes.extend((chunk.len() as u32).to_le_bytes());
            bytes.extend(kind.iter().chain(chunk));
        }
        bytes
    }

    #[test]
    fn strips_and_fans_have_triangles_and_points_and_lines_have_none() {
        let triangles = |mode: &str| super::read(&strip(&[(r#""mode": 5"#, mode)])).unwrap().triangles;
        assert_eq!(triangles(r#""mode": 5"#), [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]);
        assert_eq!(triangles(r#""mode": 6"#), [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]);
        assert_eq!(triangles(r#""mode": 4"#), [[0, 1, 2], [3, 4, 5]]);
        for mode in 0..4 {
            assert!(triangles(&format!(r#""mode": {mode}"#)).is_empty());
        }
        assert!(super::read(&strip(&[(r#""mode": 5"#, r#""mode": 7"#)])).unwrap_err().contains("mode 7"));
    }

    const INSTANCES: &str = r#"{"mesh": 0, "translation": [0, 0, 1], "extensions": {"EXT_mesh_gpu_instancing":
        {"attributes": {"TRANSLATION": 1}}}}"#;

    #[test]
    fn instances_are_placed_below_their_node() {
        let with = |more: &[(&str, &str)]| super::read(&strip(&[&[(r#"{"mesh": 0}"#, INSTANCES)], more].concat()));
        let shape = with(&[]).unwrap();
        assert_eq!((shape.points.len(), shape.triangles.len()), (12, 8));
        assert_eq!((shape.points[2], shape.points[8]), ([6.0, 0.0, 1.0], [1.0, 7.0, 1.0]));
        assert_eq!(shape.triangles[4], [6, 7, 8]);
        // Used as scales: the second instance has none along x.
        let scaled = with(&[("\"TRANSLATION\"", "\"SCALE\"")]).unwrap();
        assert_eq!((scaled.points[2], scaled.points[9]), ([5.0, 0.0, 1.0], [0.0, 7.0, 1.0]));
        assert!(with(&[(r#""count": 2"#, r#""count": 3"#)]).unwrap_err().contains("beyond its data"));
        let both = r#""TRANSLATION": 1, "SCALE": 0"#;
        assert!(with(&[(r#""TRANSLATION": 1"#, both)]).unwrap_err().contains("SCALE of instances"));
    }

    #[test]
    fn a_small_file_cannot_make_any_number_of_points() {
        let stride = |count: usize| format!(r#""count": {count}, "type": "VEC3", "bufferView": 1"#);
        let many = |count: usize| {
            let replaced = [
                (r#"{"mesh": 0}"#, INSTANCES),
                (r#""count": 2, "type": "VEC3", "bufferView": 1"#, &stride(count)),
                (r#""byteLength": 24}"#, r#""byteLength": 24, "byteStride": 0}"#),
            ];
            super::read(&strip(&replaced)).map(drop).unwrap_err()
        };
        assert!(many(usize::MAX).contains("instances") && many(1 << 40).contains("instances"));
        // Many nodes share one mesh of many parts.
        let primitive = r#"{"attributes": {"POSITION": 0}, "mode": 5}"#;
        let read = |number: usize| {
            let nodes = vec![r#"{"mesh": 0}"#; number].join(", ");
            let roots = (0..number).map(|node| node.to_string()).collect::<Vec<_>>().join(", ");
            let roots = format!(r#"{{"nodes": [{roots}]}}"#);
            let primitives = vec![primitive; 1000].join(", ");
            let replaced = [(r#"{"mesh": 0}"#, &*nodes), (r#"{"nodes": [0]}"#, &roots), (primitive, &primitives)];
            super::read(&strip(&replaced)).map(|shape| shape.points.len())
        };
        assert_eq!(read(300), Ok(1_800_000));
        assert!(read(1000).unwrap_err().contains("too many for the size of the file"));
    }

    #[test]
    fn quantised_positions_are_numbers_of_their_type() {
        let read = |kind: u32, normalized: bool, count: usize, stride: usize| {
            let accessor = format!(r#"{{"componentType": {kind}, "normalized": {normalized}, "count": {count},"#);
            let view = format!(r#""byteLength": 72, "byteStride": {stride}}}"#);
            let first = r#"{"componentType": 5126, "count": 6,"#;
            points(super::read(&strip(&[(first, &accessor), (r#""byteLength": 72}"#, &view)])))
        };
        // The float 1 is the bytes 0, 0, 128, 63.
        assert_eq!(read(5121, false, 18, 4).unwrap()[4], [0.0, 0.0, 128.0]);
        assert_eq!(read(5120, true, 18, 4).unwrap()[4], [0.0, 0.0, -1.0]);
        assert_eq!(read(5123, true, 9, 8).unwrap()[2], [0.0, 16256.0 / 65535.0, 0.0].map(|v: f64| v as f32));
        assert_eq!(read(5122, false, 9, 8).unwrap()[2][1], 16256.0);
        assert!(read(5125, false, 6, 12).unwrap_err().contains("type 5125"));
    }

    #[test]
    fn extensions_that_may_move_vertices_are_refused_with_what_to_type() {
        let with = |key: &str, name: &str| {
            let extension = format!(r#"{{"{key}": ["{name}"], "asset":"#);
            super::read(&strip(&[(r#"{"asset":"#, &extension)])).map(|shape| shape.points.len())
        };
        for name in [
            "KHR_texture_basisu",
            "EXT_texture_webp",
            "KHR_materials_unlit",
            "KHR_texture_transform",
            "KHR_lights_punctual",
            "KHR_mesh_quantization",
            "EXT_mesh_gpu_instancing",
            "EXT_structural_metadata",
        ] {
            assert_eq!(with("extensionsRequired", name), Ok(6), "{name}");
        }
        for (name, expected) in [
            ("KHR_draco_mesh_compression", "npx @gltf-transform/cli copy"),
            ("EXT_meshopt_compression", "npx @gltf-transform/cli copy"),
            ("VENDOR_geometry", "requires the extension VENDOR_geometry"),
            ("CESIUM_RTC", "as its `translation`"),
        ] {
            assert!(with("extensionsRequired", name).unwrap_err().contains(expected), "{name}");
        }
        assert!(with("extensionsUsed", "CESIUM_RTC").is_err(), "it moves vertices also where it is not required");
        assert_eq!(with("extensionsUsed", "KHR_draco_mesh_compression"), Ok(6), "the file has them uncompressed too");
        let compressed = [
            (r#"{"asset":"#, r#"{"extensionsUsed": ["EXT_meshopt_compression"], "asset":"#),
            (r#""type": "VEC3", "bufferView": 0"#, r#""type": "VEC3""#),
        ];
        assert!(super::read(&strip(&compressed)).map(drop).unwrap_err().contains("compressed with EXT_meshopt"));
    }

    #[test]
    fn what_does_not_place_vertices_is_not_looked_at() {
        let nodes = r#"[{"mesh": 0, "camera": 99, "skin": 4}]"#;
        let text = scene(nodes, "").replace(r#""min": [1, 2, 3],"#, "").replace(
            r#""asset""#,
            r#""textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}], "materials": [7], "asset""#,
        );
        let text = text.replace(r#"{"POSITION": 0}"#, r#"{"POSITION": 0, "_BATCHID": 5, "NORMAL": 9}"#);
        assert_eq!(read(&format!("\u{feff}{text}")).unwrap(), [[1.0, 2.0, 3.0]]);
        let unpadded = text.replace("AACAPwAAAEAAAEBA", "AACAPwAAAEAAAEBAAAA");
        assert_eq!(read(&unpadded).unwrap(), [[1.0, 2.0, 3.0]]);
    }

    #[test]
    fn rotations_of_any_length_do_not_scale_and_files_without_scenes_have_roots() {
        let rotated = r#"[{"mesh": 0, "rotation": [0, 0, 3, 3]}]"#;
        let near = |found: &[f32; 3], expected: [f32; 3]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(&read(&scene(rotated, "")).unwrap()[0], [-2.0, 1.0, 3.0]));
        let zero = r#"[{"mesh": 0, "rotation": [0, 0, 0, 0]}]"#;
        assert_eq!(read(&scene(zero, "")).unwrap(), [[1.0, 2.0, 3.0]]);
        let nodes = r#"[{"mesh": 0}, {"children": [0], "translation": [10, 0, 0]}]"#;
        let without = scene(nodes, "").replace(r#""scene": 0, "scenes": [{"nodes": [0]}],"#, "");
        assert_eq!(read(&without).unwrap(), [[11.0, 2.0, 3.0]]);
    }

    #[test]
    fn cut_and_old_files_say_so() {
        let whole = strip(&[]);
        for length in 5..whole.len() {
            let error = super::read(&whole[..length]).map(drop).unwrap_err();
            assert!(error.contains("cut short"), "{length}: {error}");
        }
        let mut old = whole.clone();
        old[4] = 1;
        assert!(super::read(&old).map(drop).unwrap_err().contains("gltf-pipeline"));
        assert!(super::read(b"no scene").map(drop).unwrap_err().starts_with("not a glTF document"));
    }
}
