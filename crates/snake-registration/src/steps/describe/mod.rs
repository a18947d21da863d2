//! Step 2: a descriptor for each keypoint.

pub(crate) mod fpfh;

use std::borrow::Cow;

use crate::cloud::normals::Orientation;
use crate::cloud::voxels::downsample;
use crate::options::Descriptor;
use crate::steps::pair::Pair;
use crate::steps::prepare::{Lengths, PreparedCloud, VoxelCloud, diameter, voxel_size};
use fpfh::FPFH_DIMENSION;
use snake_core::{Control, Error, Result};
use snake_geometry::{FinitePoints, Point, check_points};

/// Descriptors `(K, dimension)` of the keypoints of a cloud, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows<'a> {
    values: Cow<'a, [f32]>,
    dimension: usize,
}

impl<'a> Rows<'a> {
    /// Rows of `dimension` numbers, flat.
    ///
    /// # Errors
    /// [`Error::Input`] when the number of values is no multiple of `dimension`, or a value is not finite.
    pub fn new(values: impl Into<Cow<'a, [f32]>>, dimension: usize) -> Result<Self> {
        let values = values.into();
        let refused = |reason| Err(Error::Input { what: "descriptors", reason });
        if dimension == 0 || values.len() % dimension != 0 {
            return refused(format!("{} numbers are not rows of {dimension}", values.len()));
        }
        if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
            return refused(format!("descriptor {} is not finite", bad / dimension));
        }
        Ok(Self { values, dimension })
    }

    /// All numbers, row by row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Length of a row.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.values.len() / self.dimension
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }
}

/// The descriptors of the keypoints of source and target. The options with which a cloud was
/// prepared name its descriptor. FPFH is returned as the square roots of its histograms. A cloud is
/// described once, and a second time if some of its pairs have signed normals and others do not.
///
/// # Errors
/// [`Error::Weights`] when a model overflows; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn describe<'a>(pair: &Pair<'a>, control: &Control) -> Result<[Rows<'a>; 2]> {
    let [source, target] = pair.clouds();
    Ok([describe_cloud(source, pair.is_signed(), control)?, describe_cloud(target, pair.is_signed(), control)?])
}

/// The descriptors of a cloud's keypoints; with `signed`, from signed normals.
pub(crate) fn describe_cloud<'a>(cloud: &'a PreparedCloud, signed: bool, control: &Control) -> Result<Rows<'a>> {
    let dimension = cloud.voxels.dimension(cloud.descriptor)?;
    let slot = &cloud.rows[usize::from(signed)];
    if slot.get().is_none() {
        let values = match cloud.descriptor {
            Descriptor::Fpfh => {
                let voxels: Vec<usize> = cloud.keypoints.iter().map(|&(_, voxel)| voxel).collect();
                let mut histograms = cloud.voxels.fpfh_rows(&voxels, signed, control)?;
                hellinger(&mut histograms, FPFH_DIMENSION);
                histograms
            }
            Descriptor::Field => cloud.voxels.descriptors(&cloud.keypoints(), Descriptor::Field, control)?,
        };
        slot.get_or_init(|| values);
    }
    let values = slot.get().map(Vec::as_slice).unwrap_or_default();
    Ok(Rows { values: Cow::Borrowed(values), dimension })
}

impl VoxelCloud {
    /// Descriptors `(N, dimension)` of points `(N, 3)` in the cloud's frame, flat; see [`VoxelCloud::dimension`].
    ///
    /// # Errors
    /// [`Error::Input`] for coordinates that are not finite; [`Error::Option`] for descriptors of the field without a
    /// model; [`Error::Weights`] when the model overflows; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
    pub fn descriptors(&self, points: &[Point], descriptor: Descriptor, control: &Control) -> Result<Vec<f32>> {
        match descriptor {
            Descriptor::Fpfh => {
                if !points.is_empty() {
                    check_points("points", points)?;
                }
                let voxels: Vec<usize> = points.iter().map(|&point| self.nearest_voxel(point)).collect();
                self.fpfh_rows(&voxels, self.orientation != Orientation::Unsigned, control)
            }
            Descriptor::Field => self.field(control)?.descriptors(points),
        }
    }

    /// Length of a descriptor.
    ///
    /// # Errors
    /// [`Error::Option`] for descriptors of the field without a model.
    pub fn dimension(&self, descriptor: Descriptor) -> Result<usize> {
        match descriptor {
            Descriptor::Fpfh => Ok(FPFH_DIMENSION),
            Descriptor::Field => Ok(self.model()?.0.config().c_dim),
        }
    }

    /// FPFH of voxels, from signed or unsigned normals.
    fn fpfh_rows(&self, voxels: &[usize], signed: bool, control: &Control) -> Result<Vec<f32>> {
        let slot = &self.fpfh[usize::from(signed)];
        let all = match slot.get() {
            Some(all) => all,
            None => {
                let all = fpfh::descriptors(&self.voxels.points, &self.normals, signed, self.feature_radius, control)?;
                slot.get_or_init(|| all)
            }
        };
        let rows = voxels.iter().map(|voxel| &all[voxel * FPFH_DIMENSION..][..FPFH_DIMENSION]);
        Ok(rows.flatten().copied().collect())
    }
}

/// Divides histograms `(N, dimension)`, flat, by their sums and takes square roots. Euclidean
/// distances between rows are then proportional to the Hellinger distances of the histograms, in
/// which small bins count as well as large ones (RootSIFT, Arandjelović and Zisserman 2012).
fn hellinger(histograms: &mut [f32], dimension: usize) {
    for row in histograms.chunks_exact_mut(dimension) {
        let sum: f32 = row.iter().sum();
        if sum > 0.0 {
            row.iter_mut().for_each(|v| *v = (*v / sum).sqrt());
        }
    }
}

/// Descriptors `(K, FPFH_DIMENSION)`, flat, of keypoints `(K, 3)` of a cloud `(N, 3)`: the square roots
/// of FPFH histograms, from unsigned normals. They are invariant to rigid motion of the cloud.
/// [`mutual_nearest`](crate::mutual_nearest) matches those of two clouds of about the same size, because
/// the radius of the neighbourhood is a share of the size, as in [`register`](crate::register()).
///
/// # Errors
/// [`Error::Input`] for a cloud without finite points or without extent, and for keypoints that are not finite.
pub fn describe_keypoints(points: &[Point], keypoints: &[Point], control: &Control) -> Result<Vec<f32>> {
    if !keypoints.is_empty() {
        check_points("keypoints", keypoints)?;
    }
    let points = FinitePoints::clean("points", points, None)?.points;
    let voxel_size = voxel_size(diameter(&points)?);
    let voxels = downsample(&points, voxel_size, control)?;
    let lengths = Lengths::from_spacing(voxel_size, voxel_size.max(voxels.resolution()));
    let voxels = VoxelCloud::from_voxels(&points, voxels, &lengths, Orientation::Unsigned, control)?;
    let mut rows = voxels.descriptors(keypoints, Descriptor::Fpfh, control)?;
    hellinger(&mut rows, FPFH_DIMENSION);
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use nalgebra::{IsometryMatrix3, Vector3};
    use snake_geometry::RigidTransform;

    use super::*;
    use crate::{mutual_nearest, transform_points};

    #[test]
    fn keypoints_of_a_rotated_copy_have_their_own_as_nearest() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
        let points = snake_io::read_points(path.as_ref()).unwrap();
        let motion =
            RigidTransform::from(IsometryMatrix3::new(Vector3::new(3.0, 0.0, 1.0), Vector3::new(0.4, 1.0, -2.0)));
        let copy = transform_points(&motion, &points);
        let keypoints = |cloud: &[Point]| cloud.iter().step_by(200).copied().collect::<Vec<_>>();
        let rows = |cloud: &[Point]| describe_keypoints(cloud, &keypoints(cloud), &Control::default()).unwrap();
        let matches = mutual_nearest(&rows(&points), &rows(&copy), FPFH_DIMENSION).unwrap();
        let right = matches.iter().filter(|[a, b]| a == b).count();
        assert!(matches.len() >= 10 && 2 * right > matches.len(), "{right} of {} are right", matches.len());
        assert!(describe_keypoints(&points, &[], &Control::default()).unwrap().is_empty());
        assert!(describe_keypoints(&points, &[[f32::NAN; 3]], &Control::default()).is_err());
    }

    #[test]
    fn square_roots_of_histograms_have_length_one() {
        let mut histograms = [1.0, 3.0, 0.0, 0.0];
        hellinger(&mut histograms, 2);
        assert_eq!(histograms, [0.5, 0.75_f32.sqrt(), 0.0, 0.0]);
    }

    #[test]
    fn rows_that_are_not_whole_or_not_finite_are_refused() {
        let refused = |values: Vec<f32>, dimension| Rows::new(values, dimension).unwrap_err().to_string();
        assert!(refused(vec![1.0; 5], 2).contains("rows of 2"));
        assert!(refused(vec![1.0], 0).contains("rows of 0"));
        assert!(refused(vec![0.0, 0.0, 0.0, f32::NAN], 2).contains("descriptor 1"));
        let rows = Rows::new(vec![1.0, 2.0, 3.0, 4.0], 2).unwrap();
        assert_eq!((rows.len(), rows.dimension(), rows.is_empty()), (2, 2, false));
    }
}
