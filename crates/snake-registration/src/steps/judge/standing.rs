//! Scans whose sensors a transform puts at one place, where the pattern of rays alone makes them coincide.

use super::constants::PLACES;
use nalgebra::{IsometryMatrix3, Point3};

use crate::cloud::depth_image::{DepthImage, FINE, SHARP, Sight};
use crate::cloud::patches::FineCloud;
use crate::steps::pair::Pair;
use snake_core::Result;

/// A cloud was seen from one place if this much of it is visible from there. Unit: share of the
/// fine voxels. Synthetic scans have 0.99 and more, fused fragments of rooms about 0.9.
const MIN_ONE_VIEW: f64 = 0.98;
/// Two sensors are at one place if they are at most this far apart. Unit: inlier distances. Of 19
/// synthetic facades and fences that were wrong and reliable, 18 have less; the last has 1.6.
const STANDING: f64 = 1.0;

/// The share of the places of one scan that the other scan contradicts (the larger of both
/// directions), if a transform puts their sensors at one place. `None` if the sensors are apart or
/// not known, or if a cloud was not seen from one place.
pub(super) fn contradicted_at_one_place(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<Option<f64>> {
    let distance = pair.criteria().inlier_distance;
    let places = pair.viewpoints().map(|viewpoint| viewpoint.map(|viewpoint| viewpoint.place()));
    let [Some(source), Some(target)] = places else { return Ok(None) };
    if (transform * Point3::from(source) - Point3::from(target)).norm() > STANDING * distance {
        return Ok(None);
    }
    let fine = pair.fine()?;
    let image =
        |cloud: usize, sharpness| DepthImage::new(fine[cloud].points(), [source, target][cloud], distance, sharpness);
    let is_one_view = |cloud: usize| image(cloud, SHARP).visible_share(fine[cloud].points()) >= MIN_ONE_VIEW;
    if !(is_one_view(0) && is_one_view(1)) {
        return Ok(None);
    }
    let shares = [(*transform, 0, 1), (transform.inverse(), 1, 0)]
        .map(|(transform, from, to)| contradicted(fine[from], &transform, fine[to], &image(to, FINE), distance));
    Ok(Some(shares[0].max(shares[1])))
}

/// The share of a cloud's places in view of another cloud's sensor that do not lie on that cloud.
fn contradicted(
    cloud: &FineCloud,
    transform: &IsometryMatrix3<f64>,
    other: &FineCloud,
    image: &DepthImage,
    distance: f64,
) -> f64 {
    let places = cloud.sample(PLACES).into_iter().map(|place| place.moved(transform));
    let in_view: Vec<bool> = places
        .filter(|place| image.sight(&place.point) != Sight::Unknown)
        .map(|place| other.lies_on(&place, distance) != Some(true))
        .collect();
    in_view.iter().filter(|apart| **apart).count() as f64 / in_view.len().max(1) as f64
}

/// A note on sensors at one place that see different things.
pub(super) fn standing_note(contradicted: f64) -> String {
    format!(
        "the sensors would stand at one place, but {:.0} % of what one of them sees the other does not: only the pattern \
         of their rays may coincide",
        100.0 * contradicted
    )
}

#[cfg(test)]
mod tests {
    use snake_core::{Control, Point};

    use super::*;
    use crate::options::RegisterOptions;
    use crate::steps::prepare;

    /// What a sensor in the middle of a room of 6 x 4 x 3 m sees, `columns` rays around; a third of the
    /// room is `nearness` times as far away.
    fn room(columns: u32, nearness: f32) -> Vec<Point> {
        let rays = (0..60 * columns).map(|ray| {
            let azimuth = (ray % columns) as f32 / columns as f32 * std::f32::consts::TAU;
            let elevation = (ray / columns) as f32 * 0.04 - 1.2;
            let [x, y, z] = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let range = (3.0 / x.abs()).min(2.0 / y.abs()).min(1.5 / z.abs());
            let range = if azimuth < 2.1 { nearness * range } else { range };
            [x, y, z].map(|v| v * range)
        });
        rays.collect()
    }

    #[test]
    fn what_one_of_two_sensors_at_one_place_sees_alone_is_contradicted() {
        let share = |other: &[Point], transform: IsometryMatrix3<f64>| {
            let (clouds, options) = ([&room(120, 1.0)[..], other], RegisterOptions::default());
            let prepared = prepare(&clouds, &[None, None], None, &options, &Control::default()).unwrap();
            let pair = Pair::new(&prepared.clouds[0], &prepared.clouds[1], None);
            contradicted_at_one_place(&pair, &transform).unwrap()
        };
        let rest = IsometryMatrix3::identity();
        assert!(share(&room(130, 1.0), rest).unwrap() < 0.1);
        assert!((0.2..0.6).contains(&share(&room(120, 0.6), rest).unwrap()));
        assert_eq!(share(&room(130, 1.0), IsometryMatrix3::translation(1.0, 0.0, 0.0)), None);
    }
}
