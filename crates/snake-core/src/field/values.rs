//! Values and gradients of a field at a tile of queries, for one rotated copy or averaged over several.

use std::borrow::Cow;

use super::Field;
use super::copies::RotatedCopy;
use crate::lattice::Lattice;
use crate::network::decoder::Decoder;
use crate::network::volume::Volume;
use snake_geometry::{
    Point,
    rotations::{Rotation, rotate, rotate_inverse},
};

/// One of the two decoders.
#[derive(Debug, Clone, Copy)]
pub enum Quantity {
    /// The probability of a surface.
    Occupancy,
    /// The saliency.
    Saliency,
}

impl Field {
    /// A decoder, and the lattice of a volume as this decoder reads it.
    fn decoder<'a>(&'a self, volume: &'a Volume, quantity: Quantity) -> (&'a Decoder, Cow<'a, Lattice>) {
        match quantity {
            Quantity::Occupancy => (&self.network.occupancy, Cow::Borrowed(&volume.lattice)),
            Quantity::Saliency => (&self.network.saliency, volume.lattice.for_saliency()),
        }
    }

    /// The values of one tile of queries in the network's frame, computed on the calling thread.
    pub(crate) fn tile_values(&self, quantity: Quantity, queries: &[Point]) -> Vec<f32> {
        if let [copy] = &self.copies[..] {
            return self.copy_values(copy, quantity, queries);
        }
        let mut sums = vec![0.0; queries.len()];
        for copy in &self.copies {
            let values = self.copy_values(copy, quantity, queries);
            sums.iter_mut().zip(values.iter()).for_each(|(sum, &value)| *sum += log_odds(value));
        }
        sums.iter_mut().for_each(|sum| *sum = probability(*sum / self.copies.len() as f32));
        sums
    }

    /// [`Field::tile_values`] with gradients, per network unit.
    pub(crate) fn tile_values_and_gradients(&self, quantity: Quantity, queries: &[Point]) -> (Vec<f32>, Vec<Point>) {
        if let [copy] = &self.copies[..] {
            return self.copy_values_and_gradients(copy, quantity, queries);
        }
        let (mut sums, mut gradients) = (vec![0.0; queries.len()], vec![[0.0; 3]; queries.len()]);
        for copy in &self.copies {
            let copy_values = self.copy_values_and_gradients(copy, quantity, queries);
            let copy_values = copy_values.0.iter().zip(copy_values.1.iter());
            for ((sum, gradient), (&value, &value_gradient)) in
                sums.iter_mut().zip(gradients.iter_mut()).zip(copy_values)
            {
                let value = value.clamp(MIN_PROBABILITY, 1.0 - MIN_PROBABILITY);
                let log_odds_gradient = value_gradient.map(|v| v / (value * (1.0 - value)));
                *sum += log_odds(value);
                *gradient = std::array::from_fn(|axis| gradient[axis] + log_odds_gradient[axis]);
            }
        }
        let number = self.copies.len() as f32;
        for (gradient, sum) in gradients.iter_mut().zip(sums.iter_mut()) {
            let value = probability(*sum / number);
            *gradient = gradient.map(|v| v * value * (1.0 - value) / number);
            *sum = value;
        }
        (sums, gradients)
    }

    /// Values of one copy.
    fn copy_values(&self, copy: &RotatedCopy, quantity: Quantity, queries: &[Point]) -> Vec<f32> {
        let (decoder, lattice) = self.decoder(&copy.volume, quantity);
        let queries = &rotated(&copy.rotation, queries);
        let mut features = vec![0.0; queries.len() * copy.volume.channels];
        copy.volume.interpolate(&lattice, queries, &mut features);
        decoder.values(queries, &features)
    }

    /// [`Field::copy_values`] with gradients: the decoder's derivative with respect to the query, plus the derivative
    /// through the interpolated feature.
    fn copy_values_and_gradients(
        &self,
        copy: &RotatedCopy,
        quantity: Quantity,
        queries: &[Point],
    ) -> (Vec<f32>, Vec<Point>) {
        let (decoder, lattice) = self.decoder(&copy.volume, quantity);
        let queries = &rotated(&copy.rotation, queries);
        let mut features = vec![0.0; queries.len() * copy.volume.channels];
        let corners = copy.volume.interpolate(&lattice, queries, &mut features);
        let decoded = decoder.values_and_gradients(queries, &features);
        let mut gradients = copy.volume.interpolate_backward(&corners, &decoded.in_feature);
        let (in_query, _) = decoded.in_query.as_chunks::<3>();
        for ((gradient, &query), in_query) in gradients.iter_mut().zip(queries.iter()).zip(in_query) {
            let voxels_per_unit = lattice.voxels_per_unit(query);
            let in_copy = std::array::from_fn(|axis| in_query[axis] + gradient[axis] * voxels_per_unit[axis]);
            *gradient = rotate_inverse(&copy.rotation, in_copy);
        }
        (decoded.values, gradients)
    }
}

/// Probabilities are clamped to this distance from 0 and 1 before they are averaged as log-odds.
const MIN_PROBABILITY: f32 = 1e-6;

pub(crate) fn log_odds(probability: f32) -> f32 {
    let probability = probability.clamp(MIN_PROBABILITY, 1.0 - MIN_PROBABILITY);
    (probability / (1.0 - probability)).ln()
}

/// The queries of one tile, rotated into the orientation of a copy.
pub(super) fn rotated(rotation: &Rotation, queries: &[Point]) -> Vec<Point> {
    queries.iter().map(|&query| rotate(rotation, query)).collect()
}

fn probability(log_odds: f32) -> f32 {
    1.0 / (1.0 + (-log_odds).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builtin, DetectOptions, EncodeOptions, Model};
    use snake_geometry::{NormalizationMethod, rotations};

    #[test]
    fn several_rotations_are_averaged_as_log_odds_and_gradients_match_differences() {
        let points: Vec<Point> = (0..3000)
            .map(|i| {
                let angle = i as f32 * 0.1;
                [angle.cos() + 3.0, 2.0 * angle.sin(), (i % 40) as f32 * 0.02]
            })
            .collect();
        let model = Model::builtin(Builtin::Compact);
        let encode = |points: &[Point], rotations| {
            model.encode(points, &EncodeOptions { rotations, ..Default::default() }).unwrap()
        };
        let field = encode(&points, 4);
        let queries = &points[..50];
        // By hand: one field for each rotated cloud.
        let mut sums = vec![0.0; queries.len()];
        for rotation in rotations::super_fibonacci(4) {
            let rotated = |points: &[Point]| points.iter().map(|&p| rotate(&rotation, p)).collect::<Vec<_>>();
            let values = encode(&rotated(&points), 1).saliency(&rotated(queries)).unwrap();
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += log_odds(value));
        }
        let (values, gradients) = field.saliency_and_gradient(queries).unwrap();
        for ((value, sum), alone) in values.iter().zip(sums).zip(field.saliency(queries).unwrap()) {
            // Each rotated cloud is normalised again, with different rounding.
            assert!((value - probability(sum / 4.0)).abs() < 1e-3 && (value - alone).abs() < 1e-6, "{value} {alone}");
        }
        let mut errors: Vec<f32> = (0..queries.len() * 3)
            .map(|i| {
                let (query, axis, step) = (i / 3, i % 3, 1e-3);
                let ends = [-step, step].map(|step| {
                    let mut moved = queries[query];
                    moved[axis] += step;
                    field.saliency(&[moved]).unwrap()[0]
                });
                (gradients[query][axis] - (ends[1] - ends[0]) / (2.0 * step)).abs()
            })
            .collect();
        errors.sort_by(f32::total_cmp);
        let longest = gradients.as_flattened().iter().fold(0.0, |m: f32, v| m.max(v.abs()));
        assert!(errors[errors.len() / 2] < 0.01 * longest && longest > 0.1, "{errors:?} {longest}");
    }

    #[test]
    fn field_in_principal_axes_is_that_of_the_rotated_cloud() {
        let points: Vec<Point> = (0..3000)
            .map(|i| {
                let angle = i as f32 * 0.1;
                [0.5 * angle.cos(), angle.sin(), (i % 40) as f32 * 0.09]
            })
            .collect();
        let encode = |points: &[Point], normalization| {
            let options = EncodeOptions { normalization, ..Default::default() };
            Model::builtin(Builtin::Compact).encode(points, &options).unwrap()
        };
        let field = encode(&points, NormalizationMethod::PrincipalAxes);
        let turn = |point: &Point| rotate(field.orientation(), *point);
        let rotated = encode(&points.iter().map(turn).collect::<Vec<_>>(), NormalizationMethod::UnitSphere);
        assert_eq!(
            (rotated.orientation(), field.orientation() == rotated.orientation()),
            (&rotations::IDENTITY, false)
        );
        let keypoints =
            field.detect(&DetectOptions { saliency_threshold: 0.0, ..Default::default() }).unwrap().keypoints;
        let places: Vec<Point> = keypoints.iter().map(|keypoint| keypoint.position).collect();
        let saliency = field.saliency(&places).unwrap();
        assert!(places.len() > 5 && keypoints.iter().zip(saliency).all(|(k, s)| (k.saliency - s).abs() < 1e-4));
        let (values, gradients) = field.saliency_and_gradient(&points[..99]).unwrap();
        let expected = rotated.saliency_and_gradient(&points[..99].iter().map(turn).collect::<Vec<_>>()).unwrap();
        for ((value, gradient), (same, there)) in values.iter().zip(gradients).zip(expected.0.iter().zip(expected.1)) {
            let back = rotate_inverse(field.orientation(), there);
            assert!((value - same).abs() < 1e-4, "{value} {same}");
            assert!(gradient.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-2), "{gradient:?} {back:?}");
        }
    }

    #[test]
    fn rotations_need_a_sphere() {
        let points: Vec<Point> = (0..100).map(|i| [i as f32, (i * i % 7) as f32, 0.0]).collect();
        let encode = |normalization, rotations| {
            let options = EncodeOptions { normalization, rotations, ..Default::default() };
            Model::builtin(Builtin::Compact).encode(&points, &options).is_ok()
        };
        assert!(encode(NormalizationMethod::UnitSphere, 2) && encode(NormalizationMethod::UnitCube, 1));
        assert!(!encode(NormalizationMethod::UnitCube, 2) && !encode(NormalizationMethod::UnitSphere, 0));
        assert!(!encode(NormalizationMethod::UnitSphere, 65));
    }
}
