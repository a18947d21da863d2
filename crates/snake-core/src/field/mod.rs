//! The field of one cloud: encode once, query many times.

use snake_geometry::{chunks_in_parallel, in_parallel};
mod copies;
mod grid;
mod surface;
mod values;

pub(crate) use self::copies::{FieldMemory, check_number_of_points};
pub use self::grid::Grid;
pub use self::values::Quantity;
pub(crate) use self::values::log_odds;

use std::sync::Arc;

use self::copies::{Placement, RotatedCopy, encode_rotated_copies};
use self::values::rotated;
use crate::Result;
use crate::cloud::UsedCloud;
use crate::control::Control;
use crate::lattice::{Lattice, Queries};
use crate::network::Network;
use crate::network::config::ModelConfig;
use crate::network::layers::TILE;
use crate::network::volume::Volume;
use crate::options::{DetectOptions, EncodeOptions, Options};
use snake_geometry::{
    FinitePoints, Normalization, Outliers, Point, PointSource, check_points,
    rotations::{self, rotate},
    sample,
};

/// Occupancy and saliency of one cloud at any point of space. Queries and gradients are in the cloud's frame and units.
#[derive(Debug, Clone)]
pub struct Field {
    network: Arc<Network>,
    copies: Vec<RotatedCopy>,
    normalization: Normalization,
    points: FinitePoints<'static>,
    num_skipped: usize,
    num_encoded: usize,
}

impl Field {
    /// Encodes a cloud, reusing the memory of an earlier field. The options must be valid for the network.
    pub(crate) fn new(
        network: Arc<Network>,
        cloud: UsedCloud<'_>,
        options: &EncodeOptions,
        memory: &mut FieldMemory,
        control: &Control,
    ) -> Result<Self> {
        let (normalization, orientation) = network.config.volume.place(&cloud, options, control)?;
        let placement = Placement { normalization, orientation, rotations: options.rotations };
        let points = cloud.points();
        let drawn = options.max_points.filter(|&number| number < points.len());
        let drawn = drawn.map(|number| sample(points, number, options.seed));
        let encoded = drawn.as_deref().unwrap_or(points);
        let mut copies = encode_rotated_copies(&network, encoded, &placement, memory, control)?;
        if drawn.is_some() {
            // Queries start at all points, including those that were not drawn.
            let in_network = points.iter().map(|&point| normalization.to_network(point));
            copies[0].volume.lattice.set_cells(in_network)?;
        }
        Ok(Self {
            copies,
            normalization,
            num_skipped: cloud.num_given() - points.len(),
            num_encoded: encoded.len(),
            points: cloud.into_finite().into_owned(),
            network,
        })
    }

    /// Encodes the points of a source, see [`Field::new`].
    pub(crate) fn from_source(
        network: Arc<Network>,
        source: &(impl PointSource + ?Sized),
        options: &EncodeOptions,
        memory: &mut FieldMemory,
        control: &Control,
    ) -> Result<Self> {
        let number = source.num_points();
        let buffers = (std::mem::take(&mut memory.points), std::mem::take(&mut memory.indices));
        let finite = FinitePoints::copied("points", (0..number).map(|index| source.point(index)), buffers)?;
        Self::new(network, UsedCloud::from_finite(finite, number), options, memory, control)
    }

    /// Encodes a cloud of finite points with a given normalisation and without rotation.
    pub(crate) fn normalized(
        network: Arc<Network>,
        points: Vec<Point>,
        normalization: Normalization,
        control: &Control,
    ) -> Result<Self> {
        let placement = Placement { normalization, orientation: rotations::IDENTITY, rotations: 1 };
        Ok(Self {
            copies: encode_rotated_copies(&network, &points, &placement, &mut FieldMemory::default(), control)?,
            normalization,
            num_skipped: 0,
            num_encoded: points.len(),
            points: FinitePoints::all(points.into()),
            network,
        })
    }

    /// Returns the buffers of the points to `memory`, for the next field.
    pub(crate) fn recycle_into(self, memory: &mut FieldMemory) {
        (memory.points, memory.indices) = self.points.into_buffers();
    }

    /// The queries from which detection starts.
    pub(crate) fn queries(&self, options: &DetectOptions) -> Queries {
        let in_volume = |&point: &Point| rotate(self.orientation(), self.normalization.to_network(point));
        self.lattice().queries(self.points().iter().map(in_volume), self.orientation(), options)
    }

    /// Where the voxels of [`Field::volume`] lie.
    pub(crate) fn lattice(&self) -> &Lattice {
        &self.volume().lattice
    }

    /// The normalisation in use: `network = (cloud - center) / scale`.
    pub fn normalization(&self) -> Normalization {
        self.normalization
    }

    /// The size of a voxel of the volume, in cloud units; the size along x if the axes differ.
    pub fn voxel_size(&self) -> f32 {
        self.lattice().voxel_size(self.normalization.scale)
    }

    /// The size of a voxel of the volume along an axis, in cloud units.
    pub fn voxel_size_along(&self, axis: usize) -> f32 {
        let ends = [0, 1].map(|end| self.corner(end)[axis]);
        self.lattice().voxel_size_along(axis, ends, self.normalization.scale)
    }

    /// The lower (0) or the upper (1) corner of the volume's box, in the cloud's frame.
    fn corner(&self, end: usize) -> Point {
        self.normalization.to_cloud(self.lattice().bounds().map(|ends| ends[end]))
    }

    /// The points of the cloud that are used, in the given order: finite points that are neither outliers nor missing returns.
    pub fn points(&self) -> &[Point] {
        &self.points.points
    }

    /// [`Field::points`] with their indices in the cloud as it was given.
    pub(crate) fn finite_points(&self) -> &FinitePoints<'static> {
        &self.points
    }

    /// Number of points of the cloud that were skipped because they are not finite, outliers or missing returns.
    pub fn num_skipped(&self) -> usize {
        self.num_skipped
    }

    /// The outliers that were left out, far beyond all other points; `None` for a cloud without outliers.
    pub fn outliers(&self) -> Option<Outliers> {
        self.points.outliers()
    }

    /// What is wrong with the cloud and was left out, each in a sentence: missing returns and outliers.
    pub fn findings(&self) -> Vec<String> {
        self.points.findings()
    }

    /// The index in the given cloud of the point `index` of [`Field::points`].
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
        self.copies.len()
    }

    /// The rotation of [`Field::volume`], row by row: `volume = R network`. It is the identity, except with
    /// [`NormalizationMethod::PrincipalAxes`](crate::NormalizationMethod::PrincipalAxes).
    pub fn orientation(&self) -> &[Point; 3] {
        &self.copies[0].rotation
    }

    /// The feature volume of the cloud in its [`Field::orientation`]. Each further rotation has a volume of its own.
    pub fn volume(&self) -> &Volume {
        &self.copies[0].volume
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
    /// [`Error::Input`](crate::Error::Input) when a query is not finite.
    pub fn occupancy(&self, queries: &[Point]) -> Result<Vec<f32>> {
        self.values(Quantity::Occupancy, queries)
    }

    /// Saliency of each query `(Q, 3)`, in [0, 1) (SNAKE eq. 1).
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when a query is not finite.
    pub fn saliency(&self, queries: &[Point]) -> Result<Vec<f32>> {
        self.values(Quantity::Saliency, queries)
    }

    /// Occupancy and its gradient `(Q, 3)`, per cloud unit.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when a query is not finite.
    pub fn occupancy_and_gradient(&self, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        self.values_and_gradients(Quantity::Occupancy, queries)
    }

    /// Saliency and its gradient `(Q, 3)`, per cloud unit.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when a query is not finite.
    pub fn saliency_and_gradient(&self, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        self.values_and_gradients(Quantity::Saliency, queries)
    }

    /// Descriptors `(Q, c_dim)`, flat: the interpolated feature of each query, averaged over
    /// [`EncodeOptions::rotations`] and then L2-normalised.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when a query is not finite.
    pub fn descriptors(&self, queries: &[Point]) -> Result<Vec<f32>> {
        let channels = self.volume().channels;
        let queries = self.to_network(queries)?;
        let mut features = vec![0.0; queries.len() * channels];
        chunks_in_parallel(&mut features, TILE * channels, &|tile, features| {
            let queries = &queries[tile * TILE..][..features.len() / channels];
            let mut copy_features = vec![0.0; features.len()];
            for RotatedCopy { rotation, volume } in &self.copies {
                let rotated = rotated(rotation, queries);
                volume.interpolate(&volume.lattice, &rotated, &mut copy_features);
                features.iter_mut().zip(copy_features.iter()).for_each(|(sum, f)| *sum += f);
            }
            for feature in features.chunks_exact_mut(channels) {
                let norm = feature.iter().map(|f| f * f).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
                feature.iter_mut().for_each(|f| *f /= norm);
            }
        });
        Ok(features)
    }

    fn values(&self, quantity: Quantity, queries: &[Point]) -> Result<Vec<f32>> {
        let queries = self.to_network(queries)?;
        let mut values = vec![0.0; queries.len()];
        chunks_in_parallel(&mut values, TILE, &|tile, values| {
            values.copy_from_slice(&self.tile_values(quantity, &queries[tile * TILE..][..values.len()]));
        });
        Ok(values)
    }

    fn values_and_gradients(&self, quantity: Quantity, queries: &[Point]) -> Result<(Vec<f32>, Vec<Point>)> {
        let per_cloud_unit = self.normalization.scale.recip();
        let queries = self.to_network(queries)?;
        let tiles = in_parallel(queries.chunks(TILE), |tile| self.tile_values_and_gradients(quantity, tile));
        let (values, gradients): (Vec<_>, Vec<_>) = tiles.into_iter().unzip();
        let gradients = gradients.concat().into_iter().map(|gradient| gradient.map(|v| v * per_cloud_unit)).collect();
        Ok((values.concat(), gradients))
    }

    fn to_network(&self, queries: &[Point]) -> Result<Vec<Point>> {
        if !queries.is_empty() {
            check_points("queries", queries)?;
        }
        Ok(queries.iter().map(|&query| self.normalization.to_network(query)).collect())
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
