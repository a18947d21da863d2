//! Scans that a transform puts at one place, where the pattern of rays alone makes them coincide.

use nalgebra::{IsometryMatrix3, Point3};

use super::TUNING;
use crate::cloud::depth_image::{DepthImage, FINE, SHARP, Sight};
use crate::cloud::patches::FineCloud;
use crate::steps::pair::Pair;
use snake_core::Result;

/// If a transform puts the sensors of two scans at one place, the share of the places that each
/// sensor would have seen elsewhere. `None` if the sensors are apart or not known, or if a cloud
/// was not seen from one place.
pub(super) fn contradicted_at_one_place(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<Option<f64>> {
    let distance = pair.criteria().inlier_distance;
    let [Some((source, _)), Some((target, _))] = pair.clouds().map(|cloud| cloud.viewpoint) else { return Ok(None) };
    if (transform * Point3::from(source) - Point3::from(target)).norm() > TUNING.standing * distance {
        return Ok(None);
    }
    let fine = pair.fine()?;
    let image =
        |cloud: usize, sharpness| DepthImage::new(fine[cloud].points(), [source, target][cloud], distance, sharpness);
    let is_one_view = |cloud: usize| image(cloud, SHARP).visible_share(fine[cloud].points()) >= TUNING.min_one_view;
    if !(is_one_view(0) && is_one_view(1)) {
        return Ok(None);
    }
    let shares = [(*transform, 0, 1), (transform.inverse(), 1, 0)]
        .map(|(transform, from, to)| contradicted(fine[from], &transform, fine[to], &image(to, FINE), distance));
    Ok(Some(shares[0].max(shares[1])))
}

/// The share of a cloud's places in view of another that do not lie on it.
fn contradicted(
    cloud: &FineCloud,
    transform: &IsometryMatrix3<f64>,
    other: &FineCloud,
    image: &DepthImage,
    distance: f64,
) -> f64 {
    let places = cloud.sample(TUNING.rival_places).into_iter().map(|place| place.moved(transform));
    let in_view: Vec<bool> = places
        .filter(|place| image.sight(&place.point) != Sight::Unknown)
        .map(|place| other.lies_on(&place, distance) != Some(true))
        .collect();
    in_view.iter().filter(|apart| **apart).count() as f64 / in_view.len().max(1) as f64
}
