//! The body models of SMPL, SMPL+H and SMPL-X: a mesh that is deformed by shape and pose parameters.
//!
//! "SMPL: A Skinned Multi-Person Linear Model", Loper and others, 2015, sections 3 and 3.1.

use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use snake_io::{self as io, Array};

use crate::error::{Error, Result};

/// The arrays in a file of a body model.
const NAMES: [&str; 7] = ["v_template", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table", "f"];

/// A body model of V vertices and K joints.
#[derive(Debug, PartialEq)]
pub struct BodyModel {
    /// The mean body: V vertices in metres.
    template: Vec<Vector3<f64>>,
    /// Displacement of each coordinate per unit of each shape parameter, `(V, 3, num_betas)`.
    shape_directions: Vec<f64>,
    num_betas: usize,
    /// Displacement of each coordinate per unit of each entry of the joints' rotation matrices, `(V, 3, 9 (K - 1))`.
    pose_directions: Vec<f64>,
    /// Skinning weights of each vertex for each joint, `(V, K)`.
    weights: Vec<f64>,
    /// Weights that give the joints' positions from the vertices, `(K, V)`.
    regressor: Vec<f64>,
    /// The parent of each joint except the first. Parents come before their children.
    parents: Vec<usize>,
    /// Vertex indices of each triangle.
    pub faces: Vec<[usize; 3]>,
}

impl BodyModel {
    /// Reads a model from an `.npz` file. `python -m snake_training.body_model` makes one of a pickle, as SMPL is distributed.
    ///
    /// # Errors
    /// [`Error::File`] when the file cannot be read; [`Error::Layout`] when it is no body model, or a file of another
    /// extension.
    pub fn open(path: &Path) -> Result<Self> {
        if path.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("npz")) {
            let reason = "body models are read from .npz; `python -m snake_training.body_model FILE model.npz` converts a \
                          pickle, as SMPL is distributed";
            return Err(Error::layout(path, reason));
        }
        Self::new(io::read_arrays(path, &NAMES)?).map_err(|reason| Error::layout(path, reason))
    }

    /// A model from the arrays of [`NAMES`], in that order.
    fn new(arrays: Vec<Array>) -> std::result::Result<Self, String> {
        let Ok([template, shape, pose, weights, regressor, tree, faces]) = <[Array; 7]>::try_from(arrays) else {
            return Err("an array is missing".into());
        };
        let num_vertices = template.shape.first().copied().unwrap_or(0);
        let num_joints = tree.items.len() / 2;
        if num_vertices == 0 || num_joints == 0 || faces.items.is_empty() {
            return Err("no vertices, joints or faces".into());
        }
        let num_betas = shape.shape.last().copied().unwrap_or(0);
        let expected = [
            vec![num_vertices, 3],
            vec![num_vertices, 3, num_betas],
            vec![num_vertices, 3, 9 * (num_joints - 1)],
            vec![num_vertices, num_joints],
            vec![num_joints, num_vertices],
            vec![2, num_joints],
            vec![faces.items.len() / 3, 3],
        ];
        let arrays = [&template, &shape, &pose, &weights, &regressor, &tree, &faces];
        for ((name, array), expected) in NAMES.iter().zip(arrays).zip(&expected) {
            if &array.shape != expected {
                return Err(format!("`{name}` has the shape {:?}, expected {expected:?}", array.shape));
            }
            // The root has no parent, so its number is arbitrary.
            if *name != "kintree_table" && !array.items.iter().all(|item| item.is_finite()) {
                return Err(format!("`{name}` has numbers that are not finite"));
            }
        }
        let vertex = |number: f64| {
            let index = number as usize;
            (index as f64 == number && index < num_vertices)
                .then_some(index)
                .ok_or("`f` has vertex indices out of range")
        };
        let face = |face: &[f64; 3]| Ok([vertex(face[0])?, vertex(face[1])?, vertex(face[2])?]);
        Ok(Self {
            template: template.items.as_chunks::<3>().0.iter().map(|&[x, y, z]| Vector3::new(x, y, z)).collect(),
            shape_directions: shape.items,
            num_betas,
            pose_directions: pose.items,
            weights: weights.items,
            regressor: regressor.items,
            parents: parents(&tree.items)?,
            faces: faces.items.as_chunks::<3>().0.iter().map(face).collect::<std::result::Result<_, String>>()?,
        })
    }

    /// Number of joints, including the root.
    pub fn num_joints(&self) -> usize {
        self.parents.len() + 1
    }

    /// The vertices of a body, by linear blend skinning. `pose` has a rotation vector in radians for each joint,
    /// relative to its parent. `betas` are shape parameters; there may be fewer than the model has.
    ///
    /// # Panics
    /// When `pose` has fewer vectors than the model has joints.
    pub fn vertices(&self, pose: &[Vector3<f64>], betas: &[f64]) -> Vec<Point3<f64>> {
        let rotations: Vec<Rotation3<f64>> = pose.iter().map(|&vector| Rotation3::new(vector)).collect();
        let shaped = self.displaced(&self.template, &self.shape_directions, self.num_betas, betas);
        // The rotation matrices of all joints except the root, row by row, minus the identity.
        let difference = |rotation: &Rotation3<f64>| rotation.matrix() - Matrix3::identity();
        let features: Vec<f64> = rotations[1..]
            .iter()
            .flat_map(|rotation| difference(rotation).transpose().iter().copied().collect::<Vec<_>>())
            .collect();
        let posed = self.displaced(&shaped, &self.pose_directions, features.len(), &features);
        let transforms = self.joint_transforms(&shaped, &rotations);
        let skinned = |(vertex, weights): (&Vector3<f64>, &[f64])| {
            let by_joint = transforms
                .iter()
                .zip(weights)
                .map(|(transform, weight)| (transform * Point3::from(*vertex)).coords * *weight);
            Point3::from(by_joint.sum::<Vector3<f64>>())
        };
        posed.iter().zip(self.weights.chunks_exact(self.num_joints())).map(skinned).collect()
    }

    /// Vertices displaced along `directions`, `(V, 3, stride)`. Only the first directions have amounts if there are
    /// fewer amounts than `stride`.
    fn displaced(
        &self,
        vertices: &[Vector3<f64>],
        directions: &[f64],
        stride: usize,
        amounts: &[f64],
    ) -> Vec<Vector3<f64>> {
        let along = |row: usize| -> f64 {
            directions[row * stride..][..stride].iter().zip(amounts).map(|(direction, amount)| direction * amount).sum()
        };
        let displaced = |(i, vertex): (usize, &Vector3<f64>)| vertex + Vector3::from_fn(|axis, _| along(3 * i + axis));
        vertices.iter().enumerate().map(displaced).collect()
    }

    /// The transform of each joint, from the body at rest to the posed body.
    fn joint_transforms(&self, shaped: &[Vector3<f64>], rotations: &[Rotation3<f64>]) -> Vec<Isometry3<f64>> {
        let joint = |weights: &[f64]| weights.iter().zip(shaped).map(|(weight, vertex)| vertex * *weight).sum();
        let joints: Vec<Vector3<f64>> = self.regressor.chunks_exact(shaped.len()).map(joint).collect();
        let local = |joint: usize, origin: Vector3<f64>| {
            Isometry3::from_parts(Translation3::from(origin), UnitQuaternion::from(rotations[joint]))
        };
        let mut poses = vec![local(0, joints[0])];
        for (joint, &parent) in (1..).zip(&self.parents) {
            poses.push(poses[parent] * local(joint, joints[joint] - joints[parent]));
        }
        poses.iter().zip(joints).map(|(pose, joint)| pose * Translation3::from(-joint)).collect()
    }
}

/// The index of the parent of each joint except the first. The two rows of `kintree_table` are the names of the parents
/// and the names of the joints.
fn parents(tree: &[f64]) -> std::result::Result<Vec<usize>, String> {
    let (parents, names) = tree.split_at(tree.len() / 2);
    let number = |joint: usize| {
        let parent = names[..joint].iter().position(|name| *name == parents[joint]);
        parent.ok_or_else(|| format!("`kintree_table`: joint {joint} has no parent before it"))
    };
    (1..parents.len()).map(number).collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn array(shape: &[usize], items: &[f64]) -> Array {
        assert_eq!(shape.iter().product::<usize>(), items.len());
        Array { shape: shape.into(), items: items.into() }
    }

    /// An arm along x with vertices at 0, 1 and 2. The root joint is at the first vertex, the elbow at the second. The
    /// first vertex follows the root, the third the elbow, and the second both.
    fn arm() -> Vec<Array> {
        let mut pose_directions = vec![0.0; 3 * 3 * 9];
        // Row 1, column 0 of the elbow's matrix, its sine, moves vertex 2 along z.
        pose_directions[(3 * 2 + 2) * 9 + 3] = 0.5;
        vec![
            array(&[3, 3], &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0]),
            // The first of two shape parameters makes the arm longer.
            array(&[3, 3, 2], &[[0.0; 6], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0, 0.0, 9.0]].concat()),
            array(&[3, 3, 9], &pose_directions),
            array(&[3, 2], &[1.0, 0.0, 0.5, 0.5, 0.0, 1.0]),
            array(&[2, 3], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
            array(&[2, 2], &[4_294_967_295.0, 7.0, 7.0, 8.0]),
            array(&[1, 3], &[0.0, 1.0, 2.0]),
        ]
    }

    fn assert_vertices(model: &BodyModel, pose: [[f64; 3]; 2], betas: &[f64], expected: [[f64; 3]; 3]) {
        let vertices = model.vertices(&pose.map(Vector3::from), betas);
        for (vertex, expected) in vertices.iter().zip(expected) {
            assert!((vertex - Point3::from(expected)).norm() < 1e-12, "{vertices:?}");
        }
    }

    #[test]
    fn an_arm_bends_by_hand() {
        let model = BodyModel::new(arm()).unwrap();
        let (rest, left) = ([0.0; 3], [0.0, 0.0, FRAC_PI_2]);
        assert_vertices(&model, [rest, rest], &[], [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
        // The shoulder rotates the whole arm to y.
        assert_vertices(&model, [left, rest], &[], [[0.0; 3], [0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]);
        // The elbow rotates the hand, and the pose moves it by half the sine along z.
        assert_vertices(&model, [rest, left], &[], [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5]]);
        // Both joints: the upper arm points along y, the lower arm along -x.
        assert_vertices(&model, [left, left], &[], [[0.0; 3], [0.0, 1.0, 0.0], [-1.0, 1.0, 0.5]]);
        // The arm has twice the length, and the elbow moves with it.
        assert_vertices(&model, [rest, left], &[1.0], [[0.0; 3], [2.0, 0.0, 0.0], [2.0, 2.0, 0.5]]);
        // A vertex with two joints is the average of both. Here the elbow is not at that vertex.
        let mut arrays = arm();
        arrays[4] = array(&[2, 3], &[1.0, 0.0, 0.0, 0.5, 0.5, 0.0]);
        let model = BodyModel::new(arrays).unwrap();
        assert_vertices(&model, [rest, left], &[], [[0.0; 3], [0.75, 0.25, 0.0], [0.5, 1.5, 0.5]]);
    }

    /// A file of `tests/data/smpl`.
    fn sample(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/smpl").join(name)
    }

    #[test]
    fn a_model_is_read_from_npz_and_a_pickle_names_its_converter() {
        let model = BodyModel::open(&sample("model.npz")).unwrap();
        assert_eq!((model.template.len(), model.faces.len(), model.num_betas), (16, 28, 10));
        assert_eq!(model.parents, [0, 1]);
        for name in ["model.pkl", "model"] {
            let error = BodyModel::open(&sample(name)).unwrap_err().to_string();
            assert!(error.contains(&format!("{name}: body models are read from .npz")), "{error}");
            assert!(error.contains("python -m snake_training.body_model FILE model.npz"), "{error}");
        }
    }

    #[test]
    fn a_posed_body_equals_the_reference() {
        let [pose, betas, vertices] =
            <[Array; 3]>::try_from(io::read_arrays(&sample("posed.npz"), &["pose", "betas", "vertices"]).unwrap())
                .unwrap();
        let pose: Vec<Vector3<f64>> = pose.items.as_chunks::<3>().0.iter().map(|&rotation| rotation.into()).collect();
        let posed = BodyModel::open(&sample("model.npz")).unwrap().vertices(&pose, &betas.items);
        assert_eq!(posed.len() * 3, vertices.items.len());
        for (vertex, &expected) in posed.iter().zip(vertices.items.as_chunks::<3>().0) {
            assert!((vertex - Point3::from(expected)).norm() < 1e-12, "{vertex} {expected:?}");
        }
    }

    #[test]
    fn models_that_do_not_fit_together_are_refused() {
        let refused = |change: &dyn Fn(&mut Vec<Array>), message: &str| {
            let mut arrays = arm();
            change(&mut arrays);
            let reason = BodyModel::new(arrays).err().unwrap();
            assert!(reason.contains(message), "{reason}");
        };
        refused(&|arrays| arrays[2].shape = vec![3, 9, 3], "`posedirs` has the shape [3, 9, 3], expected [3, 3, 9]");
        refused(&|arrays| arrays[0].items[4] = f64::NAN, "`v_template` has numbers that are not finite");
        refused(&|arrays| arrays[6].items[1] = 3.0, "`f` has vertex indices out of range");
        refused(&|arrays| arrays[6].items[1] = -1.0, "`f` has vertex indices out of range");
        refused(&|arrays| arrays[5].items[1] = 8.0, "joint 1 has no parent before it");
        refused(&|arrays| arrays[5] = array(&[2, 0], &[]), "no vertices, joints or faces");
        refused(&|arrays| arrays[4].shape.reverse(), "`J_regressor`");
    }
}
