//! SMPL bodies: reads body models, poses them, and samples pairs of bodies by the protocol of UKPGAN and SNAKE (SNAKE
//! section 4.1).

mod body_model;

use std::path::{Path, PathBuf};

use nalgebra::{Point3, Vector3};
use rand::distr::Distribution;
use rand::distr::weighted::WeightedIndex;
use rand::{Rng, RngExt};
use snake_geometry::Point;
use snake_io::{self as io, Array};

use crate::error::{Error, Result};

pub use body_model::BodyModel;

/// Number of shape parameters that are used, from the first.
const BETAS: usize = 10;
/// Number of points on a body.
const SAMPLES: usize = 2048;
/// Number of pairs if no parameters are stored.
const PAIRS: usize = 100;
// Stored and random parameters lie between 0 and 1. They are mapped to ranges of these widths around 0.
/// Range of each component of a joint's rotation vector, in radians.
const POSE_RANGE: f64 = 0.4;
/// Range of a shape parameter.
const BETA_RANGE: f64 = 0.06;

/// A body model with the parameters of its pairs: stored numbers from 0 to 1, or `None` for random ones.
pub struct BodyPairs {
    model: BodyModel,
    stored: Option<[Array; 2]>,
    len: usize,
}

impl BodyPairs {
    /// Opens a model file of SMPL, SMPL+H or SMPL-X, or a folder with `model.npz`. Other folders give
    /// `None`. A folder may also hold the released code's parameters, `pose_test_100.npy` `(S, 2, K, 3)` and
    /// `beta_test_100.npy` `(S, 2, 10)`. Without them there are 100 pairs with random parameters.
    ///
    /// # Errors
    /// As [`BodyModel::open`]; [`Error::Layout`] when the parameters do not fit the model.
    pub fn open(data: &Path) -> Result<Option<Self>> {
        let named = |name: &str| data.join(name);
        let file = if data.is_file() {
            data.to_owned()
        } else {
            // A pickle is refused with the name of its converter.
            let known = ["model.npz", "model.pkl"].map(named);
            let Some(file) = known.into_iter().find(|file| file.is_file()) else { return Ok(None) };
            file
        };
        let model = BodyModel::open(&file)?;
        let [poses, betas] = ["pose_test_100.npy", "beta_test_100.npy"].map(named);
        let stored = if poses.is_file() && betas.is_file() { Some(parameters(&model, &poses, &betas)?) } else { None };
        let len = stored.as_ref().map_or(PAIRS, |[poses, _]| poses.shape[0]);
        Ok(Some(Self { model, stored, len }))
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no pairs.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The two bodies of a pair in metres, each `(2048, 3)`, sampled at the same random points, uniformly over the area
    /// of the first body.
    ///
    /// # Errors
    /// [`Error::Input`] when the body has no surface.
    ///
    /// # Panics
    /// When `pair` is not below [`len`](Self::len) and parameters are stored.
    pub fn bodies(&self, pair: usize, rng: &mut impl Rng) -> Result<[Vec<Point>; 2]> {
        let [first, second] = [0, 1].map(|body| self.vertices(pair, body, rng));
        let corners = |vertices: &[Point3<f64>], face: usize| self.model.faces[face].map(|vertex| vertices[vertex]);
        let area = |face| {
            let [a, b, c] = corners(&first, face);
            (b - a).cross(&(c - a)).norm() / 2.0
        };
        let faces = WeightedIndex::new((0..self.model.faces.len()).map(area));
        let faces = faces.map_err(|_| Error::Input { what: "body", reason: "it has no surface".into() })?;
        let mut bodies = [Vec::with_capacity(SAMPLES), Vec::with_capacity(SAMPLES)];
        for _ in 0..SAMPLES {
            let face = faces.sample(rng);
            let [mut u, mut v]: [f64; 2] = [rng.random(), rng.random()];
            // Reflects a sample in the other half of the parallelogram into the triangle.
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            for (body, vertices) in bodies.iter_mut().zip([&first, &second]) {
                let [a, b, c] = corners(vertices, face).map(|corner| corner.coords);
                let sample = a * u + b * v + c * (1.0 - u - v);
                body.push(sample.map(|v| v as f32).into());
            }
        }
        Ok(bodies)
    }

    /// The vertices of one body of a pair.
    fn vertices(&self, pair: usize, body: usize, rng: &mut impl Rng) -> Vec<Point3<f64>> {
        let joints = self.model.num_joints();
        let mut parameters = |kind: usize, count: usize| -> Vec<f64> {
            match &self.stored {
                Some(stored) => stored[kind].items[(2 * pair + body) * count..][..count].to_vec(),
                None => (0..count).map(|_| rng.random()).collect(),
            }
        };
        let (pose, betas) = (parameters(0, 3 * joints), parameters(1, BETAS));
        let rotation = |&[x, y, z]: &[f64; 3]| Vector3::new(x, y, z).map(|v| (v - 0.5) * POSE_RANGE);
        let pose: Vec<Vector3<f64>> = pose.as_chunks::<3>().0.iter().map(rotation).collect();
        self.model.vertices(&pose, &betas.iter().map(|beta| (beta - 0.5) * BETA_RANGE).collect::<Vec<_>>())
    }
}

/// Reads the released code's parameters: poses `(S, 2, K, 3)` and shapes `(S, 2, 10)`.
fn parameters(model: &BodyModel, poses: &PathBuf, betas: &PathBuf) -> Result<[Array; 2]> {
    let arrays = [io::read_array(poses)?, io::read_array(betas)?];
    let pairs = arrays[0].shape.first().copied().unwrap_or(0);
    for ((path, array), count) in [poses, betas].into_iter().zip(&arrays).zip([3 * model.num_joints(), BETAS]) {
        let has_pairs_shape = array.shape.starts_with(&[pairs, 2]) && array.items.len() == pairs * 2 * count;
        if pairs == 0 || !has_pairs_shape || !array.items.iter().all(|item| item.is_finite()) {
            let shape = &array.shape;
            let reason = format!("shape {shape:?}; expected {count} numbers for each of two bodies of each pair");
            return Err(Error::layout(path, reason));
        }
    }
    Ok(arrays)
}
