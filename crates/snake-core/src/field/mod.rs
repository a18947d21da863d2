//! The field of one cloud: encode once, query many times.

pub(crate) mod grid;
pub(crate) mod surface;
mod values;
mod views;

pub use self::grid::Grid;
pub use self::values::Quantity;
pub(crate) use self::values::log_odds;
pub(crate) use self::views::FieldMemory;

use std::sync::Arc;

use rayon::prelude::*;

use self::values::rotated;
use self::views::View;
use crate::call::control::Control;
use crate::call::span::span;
use crate::detect::options::{EncodeOptions, Options};
use crate::network::Network;
use crate::network::budget::{most_blocks, volume_bytes};
use crate::network::config::ModelConfig;
use crate::network::layers::TILE;
use crate::network::scene::voxel_size;
use crate::network::volume::Volume;
use crate::{Error, Result};
use snake_geometry::{
    FinitePoints, Normalization, NormalizationMethod, Outliers, Point, PointSource, check_points, rotations,
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
        control.get_limits().check_volume_bytes(volume_bytes(&network.config, options.rotations))?;
        let points = &finite.points;
        let is_scene = network.config.frame().is_none();
        let normalization = match is_scene {
            true => Normalization {
                center: [0.0; 3],
                scale: voxel_size(options.voxel_size, points, most_blocks(network.config.c_dim))?,
            },
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

    /// The shape of the network that made this field.
    pub fn config(&self) -> &ModelConfig {
        &self.network.config
    }

    /// The recommended options of the network that made this field.
    pub fn recommended(&self) -> &Options {
        &self.network.recommended
    }
}
