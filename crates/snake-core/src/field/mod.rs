//! The field of one cloud: encode once, query many times.

pub(crate) mod grid;
pub(crate) mod surface;

pub use self::grid::Grid;

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use crate::call::control::Control;
use crate::call::span::span;
use crate::detect::options::{EncodeOptions, Options};
use crate::network::config::ModelConfig;
use crate::network::decoder::Decoder;
use crate::network::encoder::EncoderMemory;
use crate::network::layers::TILE;
use crate::network::scene::SceneMemory;
use crate::network::scene::voxel_size;
use crate::network::volume::{Volume, VolumeFrame, VolumeGrid};
use crate::network::weights;
use crate::network::{Network, NetworkEncoder};
use crate::{Error, Result};
use snake_geometry::{
    FinitePoints, Normalization, NormalizationMethod, Outliers, Point, PointSource, check_points,
    rotations::{self, Rotation, rotate, rotate_inverse},
};
use snake_kernels::Scratch;

/// Occupancy and saliency of one cloud at any point of space. Queries and gradients are in the cloud's frame and units.
#[derive(Debug, Clone)]
pub struct Field {
    network: Arc<Network>,
    views: Vec<View>,
    normalization: Normalization,
    points: FinitePoints<'static>,
    num_skipped: usize,
    num_encoded: usize,
}

/// The feature volume of one rotated copy of the cloud.
#[derive(Debug, Clone)]
struct View {
    rotation: Rotation,
    volume: Volume,
}

impl View {
    fn all(
        network: &Network,
        points: &[Point],
        normalization: Normalization,
        orientation: &Rotation,
        rotations: usize,
        memory: &mut FieldMemory,
        control: &Control,
    ) -> Result<Vec<Self>> {
        check_number_of_points(points.len())?;
        let encoder = match &network.encoder {
            NetworkEncoder::Cube(encoder) => encoder,
            NetworkEncoder::Scene(encoder) => {
                let in_voxels: Vec<Point> = points.iter().map(|&point| normalization.to_network(point)).collect();
                let volume = encoder.encode(&in_voxels, &mut memory.scene, control)?;
                return Ok(vec![Self { rotation: rotations::IDENTITY, volume: finite(volume)? }]);
            }
        };
        let counter = control.begin("encoding", rotations * encoder.work(points.len()));
        let mut views = std::mem::take(&mut memory.views);
        for rotation in rotations::super_fibonacci(rotations) {
            let rotation = rotations::compose(&rotation, orientation);
            let point = |index: usize| rotate(&rotation, normalization.to_network(points[index]));
            let volume = encoder.encode(points.len(), point, &mut memory.encoder, &counter)?;
            counter.check()?;
            views.push(Self { rotation, volume: finite(volume)? });
        }
        Ok(views)
    }
}

/// Refuses features that are not finite.
fn finite(volume: Volume) -> Result<Volume> {
    match volume.values.par_iter().all(|value| value.is_finite()) {
        true => Ok(volume),
        false => Err(weights::error("encoder", "finite features", "weights so large that they overflow".into())),
    }
}

/// The memory of a field, which the next field uses again.
#[derive(Debug, Clone, Default)]
pub(crate) struct FieldMemory {
    points: Vec<Point>,
    indices: Vec<usize>,
    views: Vec<View>,
    encoder: EncoderMemory,
    scene: SceneMemory,
}

/// Refuses more points than 32-bit indices can count.
pub(crate) fn check_number_of_points(number: usize) -> Result<()> {
    match u32::try_from(number) {
        Ok(_) => Ok(()),
        Err(_) => {
            let reason = format!("{number} points, at most {} can be encoded; set max_points", u32::MAX);
            Err(Error::Input { what: "points", reason })
        }
    }
}

/// One of the two decoders.
#[derive(Debug, Clone, Copy)]
pub enum Quantity {
    /// The probability of a surface.
    Occupancy,
    /// The saliency.
    Saliency,
}

impl Field {
    /// The field of a cloud. The options are valid for the network.
    pub(crate) fn new(
        network: Arc<Network>,
        points: &[Point],
        options: &EncodeOptions,
        control: &Control,
    ) -> Result<Self> {
        control.get_limits().check_points(points.len())?;
        let finite = FinitePoints::of("points", points)?;
        Self::of_finite(network, finite, points.len(), options, &mut FieldMemory::default(), control)
    }

    /// The field of a cloud in the memory of an earlier field. The options are valid for the network.
    pub(crate) fn of_source(
        network: Arc<Network>,
        source: &(impl PointSource + ?Sized),
        options: &EncodeOptions,
        memory: &mut FieldMemory,
        control: &Control,
    ) -> Result<Self> {
        let number = source.num_points();
        control.get_limits().check_points(number)?;
        let buffers = (std::mem::take(&mut memory.points), std::mem::take(&mut memory.indices));
        let finite = FinitePoints::copied("points", (0..number).map(|index| source.point(index)), buffers)?;
        Self::of_finite(network, finite, number, options, memory, control)
    }

    /// The field of the finite points of a cloud of `num_given` points.
    fn of_finite(
        network: Arc<Network>,
        finite: FinitePoints<'_>,
        num_given: usize,
        options: &EncodeOptions,
        memory: &mut FieldMemory,
        control: &Control,
    ) -> Result<Self> {
        span!("encode");
        control.get_limits().check_volumes(&network.config, options.rotations)?;
        let points = &finite.points;
        let is_scene = network.config.frame().is_none();
        let normalization = match is_scene {
            true => Normalization { center: [0.0; 3], scale: voxel_size(options.voxel_size, points)? },
            false => Normalization::of_finite(points, options.normalization)?,
        };
        let orientation = match options.normalization {
            NormalizationMethod::PrincipalAxes if !is_scene => rotations::principal_axes(points, normalization.center),
            _ => rotations::IDENTITY,
        };
        let sample = options.sample(points);
        let encoded = sample.as_deref().unwrap_or(points);
        Ok(Self {
            views: View::all(&network, encoded, normalization, &orientation, options.rotations, memory, control)?,
            normalization,
            num_skipped: num_given - points.len(),
            num_encoded: encoded.len(),
            points: finite.into_owned(),
            network,
        })
    }

    /// The field of a cloud of finite points as it lies, with a given normalisation.
    pub(crate) fn normalized(
        network: Arc<Network>,
        points: Vec<Point>,
        normalization: Normalization,
        rotations: usize,
        control: &Control,
    ) -> Result<Self> {
        let memory = &mut FieldMemory::default();
        Ok(Self {
            views: View::all(&network, &points, normalization, &rotations::IDENTITY, rotations, memory, control)?,
            normalization,
            num_skipped: 0,
            num_encoded: points.len(),
            points: FinitePoints::all(points.into()),
            network,
        })
    }

    /// Leaves its memory to the next field.
    pub(crate) fn leave_to(self, memory: &mut FieldMemory) {
        let Self { mut views, points, .. } = self;
        views.clear();
        memory.views = views;
        (memory.points, memory.indices) = points.into_buffers();
    }

    /// The normalisation in use: `network = (cloud - center) / scale`.
    pub fn normalization(&self) -> Normalization {
        self.normalization
    }

    /// The size of a voxel of the volume, in cloud units; along x, should the axes differ.
    pub fn voxel_size(&self) -> f32 {
        match self.volume().frame() {
            Some(frame) => frame.voxel_size(self.normalization.scale),
            None => self.normalization.scale,
        }
    }

    /// The points of the cloud that are used, in the order they were given: the finite ones without outliers.
    pub fn points(&self) -> &[Point] {
        &self.points.points
    }

    /// [`Field::points`] with their indices in the cloud as it was given.
    pub(crate) fn finite_points(&self) -> &FinitePoints<'static> {
        &self.points
    }

    /// Number of points of the cloud that were skipped because they are not finite, or are outliers.
    pub fn num_skipped(&self) -> usize {
        self.num_skipped
    }

    /// The points far beyond all others, which were left out, if there are any.
    pub fn outliers(&self) -> Option<Outliers> {
        self.points.outliers()
    }

    /// The index in the cloud as it was given of one of [`Field::points`].
    pub fn original_index(&self, index: usize) -> usize {
        self.points.original_index(index)
    }

    /// Number of points that were encoded.
    pub fn num_encoded(&self) -> usize {
        self.num_encoded
    }

    /// The network.
    pub(crate) fn network(&self) -> &Network {
        &self.network
    }

    /// Number of rotated copies of the cloud that were encoded.
    pub(crate) fn num_rotations(&self) -> usize {
        self.views.len()
    }

    /// The rotation of [`Field::volume`], row by row: `volume = R network`. It is the identity, save with
    /// [`NormalizationMethod::PrincipalAxes`].
    pub fn orientation(&self) -> &[Point; 3] {
        &self.views[0].rotation
    }

    /// The feature volume of the cloud in its [`Field::orientation`]. Each further rotation has a volume of its own.
    pub fn volume(&self) -> &Volume {
        &self.views[0].volume
    }

    /// Occupancy of each query `(Q, 3)`, in [0, 1]: the probability of a surface (SNAKE eq. 1).
    ///
    /// ```
    /// use snake_core::{Builtin, EncodeOptions, Model};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let field = Model::builtin(Builtin::Compact).encode(&points, &EncodeOptions::default())?;
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

    /// Saliency of each query `(Q, 3)`, in [0, 1) (SNAKE eq. 1).
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn saliency(&self, queries: &[Point]) -> Result<Vec<f32>> {
        self.values(Quantity::Saliency, queries)
    }

    /// Occupancy and its gradient `(Q, 3)`, per cloud unit.
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn occupancy_and_gradient(&self, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        self.values_and_gradients(Quantity::Occupancy, queries)
    }

    /// Saliency and its gradient `(Q, 3)`, per cloud unit.
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn saliency_and_gradient(&self, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        self.values_and_gradients(Quantity::Saliency, queries)
    }

    /// Descriptors `(Q, c_dim)`, flat: the interpolated feature of each query, averaged over
    /// [`EncodeOptions::rotations`] and then L2-normalised.
    ///
    /// # Errors
    /// [`Error::Input`] when a query is not finite.
    pub fn descriptors(&self, queries: &[Point]) -> Result<Vec<f32>> {
        let channels = self.volume().channels;
        let queries = self.to_network(queries)?;
        let mut features = vec![0.0; queries.len() * channels];
        features.par_chunks_mut(TILE * channels).zip(queries.par_chunks(TILE)).for_each(|(features, queries)| {
            let mut of_view = Scratch::zeros(features.len());
            for View { rotation, volume } in &self.views {
                let rotated = rotated(rotation, queries);
                volume.interpolate(&volume.grid, &rotated, &mut of_view);
                features.iter_mut().zip(of_view.iter()).for_each(|(sum, f)| *sum += f);
            }
            for feature in features.chunks_exact_mut(channels) {
                let norm = feature.iter().map(|f| f * f).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
                feature.iter_mut().for_each(|f| *f /= norm);
            }
        });
        Ok(features)
    }

    fn values(&self, quantity: Quantity, queries: &[Point]) -> Result<Vec<f32>> {
        let mut values = vec![0.0; queries.len()];
        self.values_into(quantity, queries, &mut values)?;
        Ok(values)
    }

    /// Writes the values of queries in the cloud's frame.
    pub(crate) fn values_into(&self, quantity: Quantity, queries: &[Point], values: &mut [f32]) -> Result<()> {
        let queries = self.to_network(queries)?;
        let tiles = values.par_chunks_mut(TILE).zip(queries.par_chunks(TILE));
        tiles.for_each(|(values, tile)| values.copy_from_slice(&self.tile_values(quantity, tile)));
        Ok(())
    }

    fn values_and_gradients(&self, quantity: Quantity, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        let per_cloud_unit = self.normalization.scale.recip();
        let queries = self.to_network(queries)?;
        let (mut values, mut gradients) = (vec![0.0; queries.len()], vec![[0.0; 3]; queries.len()]);
        let tiles = values.par_chunks_mut(TILE).zip(gradients.par_chunks_mut(TILE)).zip(queries.par_chunks(TILE));
        tiles.for_each(|((values, gradients), tile)| {
            let of_tile = self.tile_values_and_gradients(quantity, tile);
            values.copy_from_slice(&of_tile.0);
            gradients.iter_mut().zip(of_tile.1.iter()).for_each(|(to, g)| *to = g.map(|v| v * per_cloud_unit));
        });
        Ok((values, gradients))
    }

    fn to_network(&self, queries: &[Point]) -> Result<Scratch<Point>> {
        if !queries.is_empty() {
            check_points("queries", queries)?;
        }
        Ok(Scratch::collect(queries.len(), queries.iter().map(|&query| self.normalization.to_network(query))))
    }

    /// A decoder, and the voxels of a volume as it sees them.
    fn decoder<'a>(&'a self, volume: &'a Volume, quantity: Quantity) -> (&'a Decoder, Cow<'a, VolumeGrid>) {
        match (quantity, &volume.grid) {
            (Quantity::Occupancy, grid) => (&self.network.occupancy, Cow::Borrowed(grid)),
            // In the released code only the occupancy decoder uses the z bounds; the saliency decoder assumes ±0.5. All
            // published networks have these bounds.
            (Quantity::Saliency, VolumeGrid::Cube(frame)) => {
                let frame = VolumeFrame { z_bounds: [-0.5, 0.5], ..*frame };
                (&self.network.saliency, Cow::Owned(VolumeGrid::Cube(frame)))
            }
            (Quantity::Saliency, grid) => (&self.network.saliency, Cow::Borrowed(grid)),
        }
    }

    /// One tile of queries in the network's frame, on the calling thread.
    pub(crate) fn tile_values(&self, quantity: Quantity, queries: &[Point]) -> Scratch<f32> {
        if let [view] = &self.views[..] {
            return self.view_values(view, quantity, queries);
        }
        let mut sums = Scratch::zeros(queries.len());
        for view in &self.views {
            let values = self.view_values(view, quantity, queries);
            sums.iter_mut().zip(values.iter()).for_each(|(sum, &value)| *sum += log_odds(value));
        }
        sums.iter_mut().for_each(|sum| *sum = probability(*sum / self.views.len() as f32));
        sums
    }

    /// [`Field::tile_values`] with gradients, per network unit.
    pub(crate) fn tile_values_and_gradients(
        &self,
        quantity: Quantity,
        queries: &[Point],
    ) -> (Scratch<f32>, Scratch<Point>) {
        if let [view] = &self.views[..] {
            return self.view_values_and_gradients(view, quantity, queries);
        }
        let mut sums = Scratch::zeros(queries.len());
        let mut gradients = Scratch::<Point>::zeros(queries.len());
        for view in &self.views {
            let of_view = self.view_values_and_gradients(view, quantity, queries);
            let of_view = of_view.0.iter().zip(of_view.1.iter());
            for ((sum, gradient), (&value, &of_value)) in sums.iter_mut().zip(gradients.iter_mut()).zip(of_view) {
                let value = value.clamp(LEAST, 1.0 - LEAST);
                let of_log_odds = of_value.map(|v| v / (value * (1.0 - value)));
                *sum += log_odds(value);
                *gradient = std::array::from_fn(|axis| gradient[axis] + of_log_odds[axis]);
            }
        }
        let views = self.views.len() as f32;
        for (gradient, sum) in gradients.iter_mut().zip(sums.iter_mut()) {
            let value = probability(*sum / views);
            *gradient = gradient.map(|v| v * value * (1.0 - value) / views);
            *sum = value;
        }
        (sums, gradients)
    }

    /// Values of one view.
    fn view_values(&self, view: &View, quantity: Quantity, queries: &[Point]) -> Scratch<f32> {
        let (decoder, grid) = self.decoder(&view.volume, quantity);
        let queries = &rotated(&view.rotation, queries);
        let mut features = Scratch::arbitrary(queries.len() * view.volume.channels);
        view.volume.interpolate(&grid, queries, &mut features);
        decoder.values(queries, &features)
    }

    /// [`Field::view_values`] with gradients: the decoder's derivative with respect to the query, plus the derivative
    /// through the interpolated feature.
    fn view_values_and_gradients(
        &self,
        view: &View,
        quantity: Quantity,
        queries: &[Point],
    ) -> (Scratch<f32>, Scratch<Point>) {
        let (decoder, grid) = self.decoder(&view.volume, quantity);
        let queries = &rotated(&view.rotation, queries);
        let mut features = Scratch::arbitrary(queries.len() * view.volume.channels);
        let corners = view.volume.interpolate(&grid, queries, &mut features);
        let decoded = decoder.values_and_gradients(queries, &features);
        let mut gradients = view.volume.interpolate_backward(&corners, &decoded.in_feature);
        let (in_query, _) = decoded.in_query.as_chunks::<3>();
        for ((gradient, &query), in_query) in gradients.iter_mut().zip(queries.iter()).zip(in_query) {
            let voxels_per_unit = grid.voxels_per_unit(query);
            let turned = std::array::from_fn(|axis| in_query[axis] + gradient[axis] * voxels_per_unit[axis]);
            *gradient = rotate_inverse(&view.rotation, turned);
        }
        (decoded.values, gradients)
    }

    /// The shape of the network that made this field.
    pub fn config(&self) -> &ModelConfig {
        &self.network.config
    }

    /// The recommended options of the network that made this field.
    pub fn recommended(&self) -> &Options {
        &self.network.recommended
    }
}

/// Probabilities are clamped to this distance from 0 and 1 before they are averaged as log-odds.
const LEAST: f32 = 1e-6;

pub(crate) fn log_odds(probability: f32) -> f32 {
    let probability = probability.clamp(LEAST, 1.0 - LEAST);
    (probability / (1.0 - probability)).ln()
}

/// Queries of one tile in the orientation of a view.
fn rotated(rotation: &Rotation, queries: &[Point]) -> Scratch<Point> {
    Scratch::collect(queries.len(), queries.iter().map(|&query| rotate(rotation, query)))
}

fn probability(log_odds: f32) -> f32 {
    1.0 / (1.0 + (-log_odds).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builtin, Model};

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
        // By hand: a field of each rotated cloud.
        let mut sums = vec![0.0; queries.len()];
        for rotation in rotations::super_fibonacci(4) {
            let rotated = |points: &[Point]| points.iter().map(|&p| rotate(&rotation, p)).collect::<Vec<_>>();
            let values = encode(&rotated(&points), 1).saliency(&rotated(queries)).unwrap();
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += log_odds(value));
        }
        let (values, gradients) = field.saliency_and_gradient(queries).unwrap();
        for ((value, sum), alone) in values.iter().zip(sums).zip(field.saliency(queries).unwrap()) {
            // The rotated clouds are normalised anew, with other rounding.
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
    fn a_field_in_principal_axes_is_that_of_the_turned_cloud() {
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
        let turned = encode(&points.iter().map(turn).collect::<Vec<_>>(), NormalizationMethod::UnitSphere);
        assert_eq!((turned.orientation(), field.orientation() == turned.orientation()), (&rotations::IDENTITY, false));
        let (values, gradients) = field.saliency_and_gradient(&points[..99]).unwrap();
        let expected = turned.saliency_and_gradient(&points[..99].iter().map(turn).collect::<Vec<_>>()).unwrap();
        for ((value, gradient), (same, turned)) in values.iter().zip(gradients).zip(expected.0.iter().zip(expected.1)) {
            let back = rotate_inverse(field.orientation(), turned);
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
