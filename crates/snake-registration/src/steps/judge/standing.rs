//! Scans whose sensors a transform puts at one place, where the pattern of rays alone makes them coincide.

use nalgebra::{IsometryMatrix3, Point3};

use crate::cloud::depth_image::{DepthImage, SHARP};
use crate::cloud::patches::FineCloud;
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::Vector;

/// A cloud was seen from one place if this much of it is visible from there. Unit: share of the
/// fine voxels. Synthetic scans have 0.99 and more, fused fragments of rooms about 0.9.
const MIN_ONE_VIEW: f64 = 0.98;
/// Two sensors are at one place if they are at most this far apart. Unit: inlier distances. Of 19
/// synthetic facades and fences that were wrong and reliable, 18 have less; the last has 1.6.
const STANDING: f64 = 1.0;

/// Whether a transform puts the sensors of both scans at one place. Not if they are unknown, or if a cloud was not seen
/// from one place.
pub(super) fn are_at_one_place(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<bool> {
    let distance = pair.criteria().inlier_distance;
    let places = pair.viewpoints().map(|viewpoint| viewpoint.map(|viewpoint| viewpoint.place()));
    let [Some(source), Some(target)] = places else { return Ok(false) };
    if (transform * Point3::from(source) - Point3::from(target)).norm() > STANDING * distance {
        return Ok(false);
    }
    let is_one_view = |(cloud, place): (&FineCloud, Vector)| {
        DepthImage::new(cloud.points(), place, distance, SHARP).visible_share(cloud.points()) >= MIN_ONE_VIEW
    };
    Ok(pair.fine()?.into_iter().zip([source, target]).all(is_one_view))
}

#[cfg(test)]
mod tests {
    use snake_core::{Control, Point};

    use super::*;
    use crate::options::RegisterOptions;
    use crate::steps::prepare;

    /// What a sensor in the middle of a room of 6 x 4 x 3 m sees, `columns` rays around.
    fn room(columns: u32) -> Vec<Point> {
        let rays = (0..60 * columns).map(|ray| {
            let azimuth = (ray % columns) as f32 / columns as f32 * std::f32::consts::TAU;
            let elevation = (ray / columns) as f32 * 0.04 - 1.2;
            let [x, y, z] = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let range = (3.0 / x.abs()).min(2.0 / y.abs()).min(1.5 / z.abs());
            [x, y, z].map(|v| v * range)
        });
        rays.collect()
    }

    #[test]
    fn scans_from_one_place_stand_there_and_after_a_step_do_not() {
        let clouds = [room(120), room(130)];
        let options = RegisterOptions::default();
        let prepared =
            prepare(&clouds.each_ref().map(|cloud| &cloud[..]), &[None, None], None, &options, &Control::default());
        let prepared = prepared.unwrap();
        let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], None);
        let are = |x| are_at_one_place(&pair, &IsometryMatrix3::translation(x, 0.0, 0.0)).unwrap();
        assert!(are(0.0) && !are(1.0));
    }
}
