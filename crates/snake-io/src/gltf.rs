//! Reads glTF scenes, as JSON (gltf) and as binary files (glb).

mod data;
mod document;

use data::Data;
use document::{Document, Node, Primitive};

use super::MAX_EXPANSION;
use super::quaternion::rotation;
use super::shape::{Position, Shape, add_polygon};

/// Reads the vertices of all meshes of the default scene, in the scene's frame (y points up), and their triangles.
pub(super) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let (document, binary) = Document::parse(bytes)?;
    let most = bytes.len().saturating_mul(MAX_EXPANSION).max(LEAST_BYTES) / size_of::<Position>();
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
        // The nodes are a tree. A node with two parents could make any number of points, and a circle has no end.
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

/// The bytes of points that any file may make. A small file may have many instances.
const LEAST_BYTES: usize = 64 << 20;

/// Column by column, as in the file.
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

/// The vertices of a scene as they are collected.
struct SceneReader<'a> {
    document: &'a Document,
    data: Data<'a>,
    /// The most points and the most triangles.
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
        // Before memory is taken: an instance has at least one point.
        if count > self.most {
            return Err(format!("{count} instances"));
        }
        let mut parts = vec![([0.0; 3], [0.0; 4], [1.0; 3]); count];
        let checked = |accessor: Option<usize>, name| match accessor {
            Some(accessor) if self.data.count(accessor)? != count => Err(format!("{name} of instances: not {count} of them")),
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
        // Every second triangle of a strip is wound the other way.
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
