//! Descriptors of keypoints, for matching the keypoints of two clouds.

use std::num::NonZeroUsize;

use crate::FPFH_DIMENSION;
use crate::pair::prepared::{VOXELS_PER_DIAMETER, diameter};
use crate::pair::scan::reduce;
use crate::parts::cloud::{Orientation, normals};
use crate::parts::fast_fpfh;
use crate::parts::matching::hellinger;
use snake_core::{Control, Result};
use snake_geometry::{FinitePoints, Point, check_points, vector};

/// Descriptors `(K, FPFH_DIMENSION)`, flat, of keypoints `(K, 3)` of a cloud `(N, 3)`: the square roots of FPFH histograms, of
/// normals without a sign. They do not depend on how the cloud is turned, and [`mutual_nearest`](crate::mutual_nearest) matches
/// those of two clouds of about the same size: as in [`register`](crate::register), the neighbourhood is a part of the size.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without extent, and for keypoints that are
/// not finite.
pub fn describe(points: &[Point], keypoints: &[Point], control: &Control) -> Result<Vec<f32>> {
    if !keypoints.is_empty() {
        check_points("keypoints", keypoints)?;
    }
    let points = FinitePoints::of("points", points)?.points;
    let voxel_size = diameter(&points)? / VOXELS_PER_DIAMETER;
    let voxels = reduce(&points, voxel_size, control)?;
    let spacing = voxel_size.max(voxels.resolution());
    voxels.check_density("feature_radius", 5.0 * spacing)?;
    let normals = normals(&voxels, 2.0 * spacing, Orientation::Unsigned, control)?;
    let all = fast_fpfh::descriptors(&voxels.points, &normals, false, 5.0 * spacing, control)?;
    let row = |point: &Point| {
        let voxel = voxels.nearest(&vector(*point), NonZeroUsize::MIN)[0].0;
        &all[voxel * FPFH_DIMENSION..][..FPFH_DIMENSION]
    };
    let mut rows: Vec<f32> = keypoints.iter().flat_map(row).copied().collect();
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
    fn keypoints_of_a_turned_copy_have_their_own_as_nearest() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
        let points = snake_io::read_points(path.as_ref()).unwrap();
        let turn =
            RigidTransform::from(IsometryMatrix3::new(Vector3::new(3.0, 0.0, 1.0), Vector3::new(0.4, 1.0, -2.0)));
        let turned = transform_points(&turn, &points);
        let keypoints = |cloud: &[Point]| cloud.iter().step_by(200).copied().collect::<Vec<_>>();
        let rows = |cloud: &[Point]| describe(cloud, &keypoints(cloud), &Control::default()).unwrap();
        let matches = mutual_nearest(&rows(&points), &rows(&turned), FPFH_DIMENSION).unwrap();
        let right = matches.iter().filter(|[a, b]| a == b).count();
        assert!(matches.len() >= 10 && 2 * right > matches.len(), "{right} of {} are right", matches.len());
        assert!(describe(&points, &[], &Control::default()).unwrap().is_empty());
        assert!(describe(&points, &[[f32::NAN; 3]], &Control::default()).is_err());
    }
}
