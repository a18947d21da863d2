//! Clouds that are reduced and described once for all pairs they are part of.

use std::borrow::Cow;
use std::sync::OnceLock;

use rayon::prelude::*;

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{FinitePoints, Neighbors, Normalization, NormalizationMethod, Outliers, Point, Vector};

use crate::FPFH_DIMENSION;
use crate::options::{Descriptor, RegisterOptions};
use crate::pair::fine::FineCloud;
use crate::pair::scan::{Scan, reduce};
use crate::pair::sentinels::without_sentinels;
use crate::pair::surface::Surface;
use crate::pair::viewpoint::viewpoint;
use crate::parts::cloud::Orientation;
use crate::parts::matching::hellinger;
use crate::parts::medians::{lower_median, upper_median};
use crate::result::ViewpointUsed;

/// Default number of voxels along the diameter of a cloud.
pub(crate) const VOXELS_PER_DIAMETER: f64 = 80.0;

/// Voxels are made larger for clouds whose neighbouring voxels are more than this many voxels apart.
const SPARSEST: f64 = 6.0;

/// Clouds with the same voxel size and radii.
pub(crate) struct PreparedClouds {
    pub(crate) clouds: Vec<Prepared>,
    pub(crate) inlier_distance: f64,
}

/// A cloud with what every pair needs of it.
pub(crate) struct Prepared {
    pub(crate) scan: Scan,
    pub(crate) diameter: f64,
    /// Number of points that are not finite or stand for missing returns, and what is said of the latter.
    pub(crate) num_skipped: usize,
    pub(crate) outliers: Option<Outliers>,
    pub(crate) sentinels: Vec<String>,
    /// The sensor's position, if it is known.
    pub(crate) viewpoint: Option<(Vector, ViewpointUsed)>,
    /// Keypoints, each with the index of the nearest voxel.
    pub(crate) keypoints: Vec<(Point, usize)>,
    descriptor: Descriptor,
    /// Length of a descriptor.
    pub(crate) dimension: usize,
    /// Descriptors of the keypoints, `(K, dimension)`: of normals without a sign, and with one.
    descriptors: [OnceLock<Vec<f32>>; 2],
    fine: OnceLock<FineCloud>,
}

impl PreparedClouds {
    /// Prepares clouds; `given` are the viewpoints that are known. An error names a cloud by `names`, or else by its
    /// index.
    pub(crate) fn new(
        clouds: &[&[Point]],
        given: &[Option<[f64; 3]>],
        names: &[&'static str],
        model: Option<&Model>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Self> {
        let model = options.model_of(model)?;
        let named = |index: usize| move |error| named(error, index, names);
        let used = |(index, points)| FinitePoints::of("points", points).map_err(|error| named(index)(error.into()));
        let used: Vec<FinitePoints> = clouds.iter().copied().enumerate().map(used).collect::<Result<_>>()?;
        let outliers: Vec<Option<Outliers>> = used.iter().map(FinitePoints::outliers).collect();
        let sensor = |index: usize| given[index].unwrap_or_default();
        let kept = used.into_par_iter().enumerate().map(|(index, used)| without_sentinels(used.points, sensor(index)));
        let (points, sentinels): (Vec<Cow<[Point]>>, Vec<Vec<String>>) = kept.unzip();
        let [voxel_size, normal_radius, feature_radius, inlier_distance] = options.lengths(&points)?;
        let each = || points.par_iter().enumerate();
        let diameters = each().map(|(index, points)| diameter(points).map_err(named(index)));
        let diameters: Vec<f64> = diameters.collect::<Result<_>>()?;
        let reduced = |voxel_size: f64| {
            let voxels = each().map(|(index, points)| reduce(points, voxel_size, control).map_err(named(index)));
            let voxels: Vec<Neighbors> = voxels.collect::<Result<_>>()?;
            // In a sparse cloud most voxels hold one point, and the voxel size is less than the distance between neighbours.
            let resolutions: Vec<f64> = voxels.par_iter().map(Neighbors::resolution).collect();
            Result::Ok((voxels, voxel_size.max(upper_median(&resolutions))))
        };
        let mut voxel_size = voxel_size.unwrap_or(lower_median(&diameters) / VOXELS_PER_DIAMETER);
        let (mut voxels, mut spacing) = reduced(voxel_size)?;
        // The radii follow from the spacing: in a cloud that is much denser, they would hold thousands of voxels.
        if spacing > SPARSEST * voxel_size {
            voxel_size = spacing / 2.0;
            (voxels, spacing) = reduced(voxel_size)?;
        }
        let inlier_distance = inlier_distance.unwrap_or(1.5 * spacing);
        let lengths = [voxel_size, normal_radius.unwrap_or(2.0 * spacing), feature_radius.unwrap_or(5.0 * spacing)];
        let prepare = |(index, voxels): (usize, Neighbors)| {
            let (points, original) = (&points[index], clouds[index].len());
            let viewpoint = viewpoint(&voxels.points, given[index], options, inlier_distance);
            let orientation = viewpoint.map_or(Orientation::Unsigned, |(at, _)| Orientation::Viewpoint(at));
            let scan = Scan::of(points, voxels, lengths, orientation, control).map_err(named(index))?;
            let scan = match model {
                Some(model) => scan.with_model(model, Scan::default_options(model, voxel_size)),
                None => scan,
            };
            // The clouds get different random keypoints. With one seed, equal clouds would have a partner for every keypoint.
            let seed = options.seed.wrapping_add(index as u64);
            let keypoints = scan.anchored_keypoints(options, seed, control)?;
            Ok(Prepared {
                dimension: scan.dimension(options.descriptor)?,
                scan,
                diameter: diameters[index],
                num_skipped: original - points.len(),
                outliers: outliers[index],
                sentinels: sentinels[index].clone(),
                viewpoint,
                keypoints,
                descriptor: options.descriptor,
                descriptors: Default::default(),
                fine: OnceLock::new(),
            })
        };
        let clouds = voxels.into_par_iter().enumerate().map(prepare).collect::<Result<_>>()?;
        Ok(Self { clouds, inlier_distance })
    }
}

impl Prepared {
    /// The voxel size for a pair of clouds of this size.
    pub(crate) fn default_voxel_size(&self) -> f64 {
        self.diameter / VOXELS_PER_DIAMETER
    }

    /// The voxels, for pairs closer than `distance`; `signed` normals point to the sensor.
    pub(crate) fn surface(&self, signed: bool, distance: f64) -> Surface<'_> {
        let viewpoint = self.viewpoint.filter(|_| signed).map(|(viewpoint, _)| viewpoint);
        Surface::new(&self.scan.voxels.points, &self.scan.normals, viewpoint, distance)
    }

    /// The points in fine voxels.
    pub(crate) fn fine(&self) -> Result<&FineCloud> {
        if let Some(made) = self.fine.get() {
            return Ok(made);
        }
        let Scan { points, voxel_size, voxels, .. } = &self.scan;
        let made = FineCloud::new(points, *voxel_size, voxels.points.len())?;
        Ok(self.fine.get_or_init(|| made))
    }

    /// Descriptors of the keypoints; FPFH as the square roots of histograms. Field descriptors need no normals.
    pub(crate) fn descriptors(&self, signed: bool, control: &Control) -> Result<&[f32]> {
        let slot = &self.descriptors[usize::from(signed)];
        if let Some(made) = slot.get() {
            return Ok(made);
        }
        let made = match self.descriptor {
            Descriptor::Fpfh => {
                let voxels: Vec<usize> = self.keypoints.iter().map(|&(_, voxel)| voxel).collect();
                let mut histograms = self.scan.fpfh_of(&voxels, signed, control)?;
                hellinger(&mut histograms, FPFH_DIMENSION);
                histograms
            }
            Descriptor::Field => {
                let points: Vec<Point> = self.keypoints.iter().map(|&(point, _)| point).collect();
                self.scan.descriptors_with(&points, Descriptor::Field, control)?
            }
        };
        Ok(slot.get_or_init(|| made))
    }
}

/// Twice the largest distance from the mean.
pub(crate) fn diameter(points: &[Point]) -> Result<f64> {
    Ok(Normalization::of(points, NormalizationMethod::UnitSphere)?.scale.into())
}

/// An error in a cloud says which cloud.
fn named(error: Error, index: usize, names: &[&'static str]) -> Error {
    match (error, names.get(index)) {
        (Error::Input { reason, .. }, Some(name)) => Error::Input { what: name, reason },
        (Error::Input { reason, .. }, None) => {
            Error::Input { what: "clouds", reason: format!("cloud {index} (from 0): {reason}") }
        }
        (other, _) => other,
    }
}
