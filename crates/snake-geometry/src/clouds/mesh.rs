//! Triangle meshes.

use serde::{Deserialize, Serialize};

use crate::Point;

/// A triangle mesh with shared vertices. Each edge belongs to two triangles, which use it in opposite directions.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Mesh {
    /// Positions `(V, 3)` in the cloud's frame and units.
    pub vertices: Vec<Point>,
    /// Unit normals `(V, 3)` that point out of the occupied region: the negative gradient of the occupancy.
    pub normals: Vec<[f32; 3]>,
    /// Indices of vertices `(T, 3)`, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// With the option `outer`, the number of triangles of inner surfaces that were removed.
    #[serde(default)]
    pub num_removed: Option<usize>,
}

/// Smallest ratio of the triangles on the inner side of a closed shell to the remaining ones.
const INNER_SIDE: f64 = 0.1;

impl Mesh {
    /// Notes for the user, in sentences: about a field without a surface, and about an open shell.
    pub fn notes(&self) -> Vec<String> {
        let empty = || "no surface: a lower `level` may have one".into();
        self.shell_hint().into_iter().chain(self.triangles.is_empty().then(empty)).collect()
    }

    /// One sentence for the user if `outer` was requested and the surface still has an inner side. If a shell has a
    /// hole, both sides are one surface, all of which can be reached from outside.
    fn shell_hint(&self) -> Option<String> {
        let (removed, kept) = (self.num_removed?, self.triangles.len());
        (kept > 0 && (removed as f64) < INNER_SIDE * kept as f64).then(|| {
            format!(
                "`outer` removed {removed} of {} triangles: the shell is open, so that its inner side is a part of the \
                 surface, or it has no inside; a lower `level` closes holes",
                removed + kept
            )
        })
    }

    /// The area of all triangles, in squared cloud units.
    pub fn area(&self) -> f64 {
        // `sum` would return -0 for no triangles.
        self.triangles.iter().fold(0.0, |sum, &triangle| sum + norm(self.area_vector(triangle)) / 2.0)
    }

    /// The unit normal of a triangle; zero if its area is zero.
    ///
    /// # Panics
    /// If a vertex of the triangle is not among [`Mesh::vertices`].
    pub fn triangle_normal(&self, triangle: [u32; 3]) -> [f32; 3] {
        unit(self.area_vector(triangle))
    }

    /// A vector along the normal of a triangle with twice the triangle's area as its length.
    ///
    /// # Panics
    /// If a vertex of the triangle is not among [`Mesh::vertices`].
    pub fn area_vector(&self, triangle: [u32; 3]) -> [f64; 3] {
        let [a, b, c] = triangle.map(|vertex| self.vertices[vertex as usize].map(f64::from));
        let [u, v]: [[f64; 3]; 2] = [b, c].map(|end| std::array::from_fn(|axis| end[axis] - a[axis]));
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    }
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// The unit vector in the same direction; a zero vector stays zero.
pub fn unit(vector: [f64; 3]) -> [f32; 3] {
    let length = norm(vector);
    if length > 0.0 { vector.map(|v| (v / length) as f32) } else { [0.0; 3] }
}
