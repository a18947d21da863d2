//! The field of one cloud: encode once, query many times.

use rand::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::decoder::Decoder;
use crate::model::Model;
use crate::nn::TILE;
use crate::points::{Normalization, NormalizationMethod, Point, check_points};
use crate::volume::{Volume, VolumeFrame};
use crate::{Error, Result};

/// How a cloud becomes a field.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EncodeOptions {
    /// How the cloud is brought into the network's frame; its statistics are those of all points.
    pub normalization: NormalizationMethod,
    /// Encode at most this many points, drawn at random without replacement; `None`: all of them.
    pub max_points: Option<usize>,
    /// Seed of that draw.
    pub seed: u64,
}

/// Occupancy and saliency of one cloud at any point of space. Queries, gradients and results are in the cloud's frame
/// and units.
#[derive(Debug, Clone)]
pub struct Field {
    model: Model,
    volume: Volume,
    normalization: Normalization,
    points: Vec<Point>,
    num_encoded: usize,
}

/// Which of the two decoders a query asks.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Quantity {
    Occupancy,
    Saliency,
}

impl Field {
    pub(crate) fn new(model: Model, points: &[Point], options: &EncodeOptions) -> Result<Self> {
        let normalization = Normalization::of(points, options.normalization)?;
        let to_network = |&point: &Point| normalization.to_network(point);
        let network_points: Vec<Point> = match options.max_points {
            Some(0) => return Err(Error::Option { name: "max_points", value: "0".into(), allowed: "1 or more" }),
            Some(most) if most < points.len() => {
                let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
                let mut chosen = rand::seq::index::sample(&mut rng, points.len(), most).into_vec();
                chosen.sort_unstable();
                chosen.into_iter().map(|i| to_network(&points[i])).collect()
            }
            _ => points.iter().map(to_network).collect(),
        };
        let volume = model.network().encoder.encode(&network_points);
        Ok(Self { volume, normalization, points: points.to_vec(), num_encoded: network_points.len(), model })
    }

    /// The normalisation in use: `network = (cloud - center) / scale`.
    pub fn normalization(&self) -> Normalization {
        self.normalization
    }

    /// The cloud, all of its points in the order they were given.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// How many of the points were encoded.
    pub fn num_encoded(&self) -> usize {
        self.num_encoded
    }

    /// The feature volume.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// Probability that there is surface at each query (SNAKE eq. 1).
    ///
    /// ```
    /// use snake_core::{EncodeOptions, Model};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let field = Model::builtin()?.encode(&points, &EncodeOptions::default())?;
    /// let occupancy = field.occupancy(&[[0.0, 0.0, 0.0], points[0]])?;
    /// let (saliency, gradient) = field.saliency_and_gradient(&points)?;
    /// # assert_eq!((occupancy.len(), saliency.len(), gradient.len()), (2, 500, 500));
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn occupancy(&self, queries: &[Point]) -> Result<Vec<f32>> {
        self.values(Quantity::Occupancy, queries)
    }

    /// Saliency of each query, in [0, 1) (SNAKE eq. 1).
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn saliency(&self, queries: &[Point]) -> Result<Vec<f32>> {
        self.values(Quantity::Saliency, queries)
    }

    /// Occupancy and its gradient, per cloud unit.
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn occupancy_and_gradient(&self, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        self.values_and_gradients(Quantity::Occupancy, queries)
    }

    /// Saliency and its gradient, per cloud unit.
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn saliency_and_gradient(&self, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        self.values_and_gradients(Quantity::Saliency, queries)
    }

    /// Descriptors `(queries, c_dim)`, flat: the interpolated feature of each query, L2-normalised.
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn descriptors(&self, queries: &[Point]) -> Result<Vec<f32>> {
        let channels = self.volume.channels;
        let queries = self.to_network(queries)?;
        let mut features = vec![0.0; queries.len() * channels];
        features.par_chunks_mut(TILE * channels).zip(queries.par_chunks(TILE)).for_each(|(features, queries)| {
            self.volume.interpolate(&self.volume.frame, queries, features);
            for feature in features.chunks_exact_mut(channels) {
                let norm = feature.iter().map(|f| f * f).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
                feature.iter_mut().for_each(|f| *f /= norm);
            }
        });
        Ok(features)
    }

    fn values(&self, quantity: Quantity, queries: &[Point]) -> Result<Vec<f32>> {
        let queries = self.to_network(queries)?;
        Ok(queries.par_chunks(TILE).flat_map_iter(|tile| self.tile_values(quantity, tile)).collect())
    }

    fn values_and_gradients(&self, quantity: Quantity, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        let per_cloud_unit = self.normalization.scale.recip();
        let pairs = self.to_network(queries)?;
        let pairs = pairs.par_chunks(TILE).flat_map_iter(|tile| {
            let (values, gradients) = self.tile_values_and_gradients(quantity, tile);
            values.into_iter().zip(gradients.into_iter().map(|g| g.map(|v| v * per_cloud_unit)))
        });
        Ok(pairs.unzip())
    }

    fn to_network(&self, queries: &[Point]) -> Result<Vec<Point>> {
        if !queries.is_empty() {
            check_points("queries", queries)?;
        }
        Ok(queries.iter().map(|&query| self.normalization.to_network(query)).collect())
    }

    fn decoder(&self, quantity: Quantity) -> (&Decoder, VolumeFrame) {
        let network = self.model.network();
        match quantity {
            Quantity::Occupancy => (&network.occupancy, self.volume.frame),
            // The released network gives its z bounds to the occupancy decoder only: its saliency decoder reads every
            // volume as if it spanned ±0.5 in z. All published networks do span that.
            Quantity::Saliency => (&network.saliency, VolumeFrame { z_bounds: [-0.5, 0.5], ..self.volume.frame }),
        }
    }

    /// One tile of queries in the network's frame, on the calling thread.
    pub(crate) fn tile_values(&self, quantity: Quantity, queries: &[Point]) -> Vec<f32> {
        let (decoder, frame) = self.decoder(quantity);
        let mut features = vec![0.0; queries.len() * self.volume.channels];
        self.volume.interpolate(&frame, queries, &mut features);
        decoder.values(queries, &features)
    }

    /// The same with gradients, per network unit: the decoder's own derivative in the query plus that through the
    /// interpolated feature.
    pub(crate) fn tile_values_and_gradients(&self, quantity: Quantity, queries: &[Point]) -> (Vec<f32>, Vec<Point>) {
        let (decoder, frame) = self.decoder(quantity);
        let channels = self.volume.channels;
        let mut features = vec![0.0; queries.len() * channels];
        let corners = self.volume.interpolate(&frame, queries, &mut features);
        let decoded = decoder.values_and_gradients(queries, &features);
        let mut gradients = self.volume.interpolate_backward(&corners, &decoded.in_feature);
        let (in_query, _) = decoded.in_query.as_chunks::<3>();
        for ((gradient, &query), in_query) in gradients.iter_mut().zip(queries).zip(in_query) {
            let voxels_per_unit = frame.voxels_per_unit(query);
            *gradient = std::array::from_fn(|axis| in_query[axis] + gradient[axis] * voxels_per_unit[axis]);
        }
        (decoded.values, gradients)
    }

    /// The model that made this field.
    pub fn model(&self) -> &Model {
        &self.model
    }
}
