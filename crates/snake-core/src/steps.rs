//! The single steps from points to keypoints, as functions on arrays, for comparison with other implementations.
//!
//! Positions are in the network's frame, and features are flat `(rows, channels)`. These functions call the same code as
//! [`Model::encode`](crate::Model::encode) and [`Field::detect`](crate::Field::detect). They are not part of the stable
//! API.

use crate::detect::refine::Ascent;
use crate::lattice::{Lattice, VolumeFrame, VoxelGroups};
use crate::network::Volume;
use crate::network::encoder::aggregated;
use crate::network::layers::TILE;
use crate::{DetectOptions, Error, Model, Result};
use snake_geometry::{Point, check_points};
use snake_kernels::BufferPool;

pub use crate::field::Quantity;

/// Voxel aggregation: the volume `[z][y][x][channel]` from features `(N, C)` of points `(N, 3)`. By the model's
/// [`Scatter`](crate::Scatter), a voxel holds the mean of its points or a weighted mean of the points around it; 0 without any.
///
/// # Errors
/// [`Error::Input`] for a scene model, points that are not finite, or the wrong number of features.
pub fn aggregate(model: &Model, points: &[Point], features: &[f32]) -> Result<Vec<f32>> {
    let frame = model.config().volume.cube()?;
    check_points("points", points)?;
    let channels = channels("features", features.len(), points.len())?;
    let mut groups = VoxelGroups::default();
    groups.fill(points.len(), |index| points[index], &frame)?;
    let mut values = vec![0.0; num_voxels(&frame) * channels];
    let feature = |index: usize| &features[index * channels..][..channels];
    aggregated(model.config().scatter, &frame, &groups, |index| (points[index], feature(index)), &mut values)?;
    Ok(values)
}

/// Trilinear interpolation: the features `(Q, C)` of a volume `[z][y][x][channel]` at queries `(Q, 3)`.
///
/// # Errors
/// [`Error::Input`] for a scene model, queries that are not finite, or a volume of the wrong size.
pub fn interpolate(model: &Model, volume: &[f32], queries: &[Point]) -> Result<Vec<f32>> {
    let volume = given_volume(model, volume, queries)?;
    let mut features = vec![0.0; queries.len() * volume.channels];
    volume.interpolate(&volume.lattice, queries, &mut features);
    Ok(features)
}

/// The gradient of trilinear interpolation: derivatives `(Q, 3)`, per network unit, of the interpolated features'
/// weighted sum over the channels, with weights `in_features` `(Q, C)`.
///
/// # Errors
/// The errors of [`interpolate`]; [`Error::Input`] for the wrong number of `in_features`.
pub fn interpolate_gradient(
    model: &Model,
    volume: &[f32],
    queries: &[Point],
    in_features: &[f32],
) -> Result<Vec<Point>> {
    let volume = given_volume(model, volume, queries)?;
    if in_features.len() != queries.len() * volume.channels {
        return Err(wrong("in_features", format!("expected {} for each query", volume.channels)));
    }
    let mut features = vec![0.0; in_features.len()];
    let corners = volume.interpolate(&volume.lattice, queries, &mut features);
    let gradients = volume.interpolate_backward(&corners, in_features);
    let per_unit = queries.iter().map(|&query| volume.lattice.voxels_per_unit(query));
    let scaled = |(gradient, factor): (&Point, Point)| std::array::from_fn(|axis| gradient[axis] * factor[axis]);
    Ok(gradients.iter().zip(per_unit).map(scaled).collect())
}

/// The values of a decoder at queries `(Q, 3)` with their features `(Q, c_dim)`, and their derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// Probabilities `(Q,)`.
    pub values: Vec<f32>,
    /// Derivatives `(Q, 3)` with respect to the query at a constant feature, per network unit.
    pub in_queries: Vec<Point>,
    /// Derivatives `(Q, c_dim)` with respect to the feature.
    pub in_features: Vec<f32>,
}

/// Decodes queries `(Q, 3)` with their features `(Q, c_dim)`.
///
/// # Errors
/// [`Error::Input`] for queries that are not finite, or the wrong number of features.
pub fn decode(model: &Model, quantity: Quantity, queries: &[Point], features: &[f32]) -> Result<Decoded> {
    check_points("queries", queries)?;
    let c_dim = model.config().c_dim;
    if features.len() != queries.len() * c_dim {
        return Err(wrong("features", format!("expected {c_dim} for each query")));
    }
    let network = model.network();
    let decoder = match quantity {
        Quantity::Occupancy => &network.occupancy,
        Quantity::Saliency => &network.saliency,
    };
    let mut all = Decoded { values: Vec::new(), in_queries: Vec::new(), in_features: Vec::new() };
    for (queries, features) in queries.chunks(TILE).zip(features.chunks(TILE * c_dim)) {
        let decoded = decoder.values_and_gradients(queries, features);
        all.values.extend_from_slice(&decoded.values);
        all.in_queries.extend_from_slice(decoded.in_query.as_chunks().0);
        all.in_features.extend_from_slice(&decoded.in_feature);
    }
    Ok(all)
}

/// Refinement: the positions of queries `(Q, 3)` after one ascent step for each of the given gradients of the saliency, each
/// `(Q, 3)`. It uses the options `refine_method` and `refine_step_size`.
///
/// # Errors
/// [`Error::Input`] for queries that are not finite, or the wrong number of gradients.
pub fn refine(queries: &[Point], gradients: &[Vec<Point>], options: &DetectOptions) -> Result<Vec<Point>> {
    check_points("queries", queries)?;
    if gradients.iter().any(|step_gradients| step_gradients.len() != queries.len()) {
        return Err(wrong("gradients", format!("expected one for each of {} queries", queries.len())));
    }
    let mut positions = queries.to_vec();
    let mut ascent = Ascent::new(queries.len(), queries.len(), options);
    gradients.iter().for_each(|step_gradients| ascent.step(&mut positions, step_gradients));
    Ok(positions)
}

fn wrong(what: &'static str, reason: String) -> Error {
    Error::Input { what, reason }
}

fn num_voxels(frame: &VolumeFrame) -> usize {
    frame.resolution.iter().product()
}

/// The number of channels if `length` values form `rows` rows.
fn channels(what: &'static str, length: usize, rows: usize) -> Result<usize> {
    match length / rows {
        channels if channels > 0 && channels * rows == length => Ok(channels),
        _ => Err(wrong(what, format!("{length} values in {rows} rows"))),
    }
}

/// The given values as a volume in the frame of a model; also checks the queries.
fn given_volume(model: &Model, values: &[f32], queries: &[Point]) -> Result<Volume> {
    let frame = model.config().volume.cube()?;
    check_points("queries", queries)?;
    let channels = channels("volume", values.len(), num_voxels(&frame))?;
    let mut buffer = BufferPool::default().take(values.len());
    buffer.copy_from_slice(values);
    Ok(Volume { lattice: Lattice::Cube(frame), channels, values: buffer })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Builtin;

    fn cloud() -> Vec<Point> {
        (0..300).map(|i| [(i as f32 * 0.7).sin() * 0.4, (i as f32 * 0.31).cos() * 0.4, (i % 7) as f32 * 0.1]).collect()
    }

    #[test]
    fn arrays_that_do_not_fit_are_refused() {
        let (compact, scenes) = (Model::builtin(Builtin::Compact), Model::builtin(Builtin::Scenes));
        let (points, options) = (cloud(), DetectOptions::default());
        let errors = [
            aggregate(&scenes, &points, &[0.0; 300]).unwrap_err(),
            aggregate(&compact, &points, &[0.0; 299]).unwrap_err(),
            aggregate(&compact, &[[f32::NAN; 3]], &[0.0]).unwrap_err(),
            interpolate(&compact, &[0.0; 9], &points).unwrap_err(),
            interpolate_gradient(&compact, &[0.0; 32768], &points, &[0.0; 9]).unwrap_err(),
            decode(&compact, Quantity::Saliency, &points, &[0.0; 9]).unwrap_err(),
            refine(&points, &[vec![[0.0; 3]; 9]], &options).unwrap_err(),
        ];
        let texts = errors.map(|error| error.to_string());
        let begin = ["model:", "features:", "points:", "volume:", "in_features:", "features:", "gradients:"];
        assert!(texts.iter().zip(begin).all(|(text, begin)| text.starts_with(begin)), "{texts:?}");
    }
}
