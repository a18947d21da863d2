//! Clouds that share a few planes and nothing else: any corner of a room, a house or a cupboard looks like another.

use nalgebra::{IsometryMatrix3, Matrix3};

use crate::cloud::patches::{NEAR, Place, overlap};
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::{Vector, eigen};

/// Number of planes that look like others: a corner with the floor and the ceiling.
const PLANES: usize = 4;
/// Smallest share of the shared places that lie off these planes, given their thickness, and on the target. Corners of bare rooms, plain
/// houses, cartons and cupboards have 0 to 0.034; right and reliable answers in real rooms 0.043 and more.
const MIN_TELLING: f64 = 0.035;
/// A place on a plane has a normal at least this parallel to it. It is low because of noise.
const PARALLEL: f64 = 0.7;
/// Number of places that propose planes, and number of places that choose among them, at most.
const PROPOSED: usize = 100;
const CHOOSING: usize = 500;
/// Number of times that a plane is fitted to its places.
const FITS: usize = 3;

/// A plane: a point and the normal.
type Plane = (Vector, Vector);

/// A note if hardly any place that the clouds share lies off so few planes.
pub(super) fn corner_note(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<Option<String>> {
    let (fine, inlier_distance) = (pair.fine()?, pair.criteria().inlier_distance);
    let distance = NEAR * inlier_distance;
    let mut places = overlap(fine, transform, distance).places;
    let (count, step) = (places.len() as f64, places.len().div_ceil(PROPOSED).max(1));
    let plane = |(place, _): &(Place, f64)| Some((place.point, place.normal?));
    let proposed: Vec<Plane> = places.iter().step_by(step).filter_map(plane).collect();
    for _ in 0..PLANES {
        let Some(plane) = most_frequent(&places, &proposed, distance) else { return Ok(None) };
        places.retain(|(place, apart)| !is_on(place, &plane, *apart));
    }
    let lies_on = |(place, _): &&(Place, f64)| fine[1].lies_on(place, inlier_distance) == Some(true);
    let is_corner = (places.iter().filter(lies_on).count() as f64) < MIN_TELLING * count;
    let note = "ambiguous: the clouds share only a few planes, and any corner of a room or a house looks like that; scan more of \
                what stands there, or give `initial`";
    Ok(is_corner.then(|| note.into()))
}

fn is_on(place: &Place, (point, normal): &Plane, distance: f64) -> bool {
    let is_parallel = place.normal.is_none_or(|of| of.dot(normal).abs() > PARALLEL);
    is_parallel && normal.dot(&(place.point - point)).abs() < distance
}

/// The proposed plane with the most places, fitted to them; `None` without any.
fn most_frequent(places: &[(Place, f64)], proposed: &[Plane], distance: f64) -> Option<Plane> {
    let some = || places.iter().step_by(places.len().div_ceil(CHOOSING).max(1));
    let mut plane =
        *proposed.iter().max_by_key(|plane| some().filter(|(place, _)| is_on(place, plane, distance)).count())?;
    for _ in 0..FITS {
        let on: Vec<Vector> =
            places.iter().filter(|(place, _)| is_on(place, &plane, distance)).map(|(place, _)| place.point).collect();
        let mean = on.iter().sum::<Vector>() / on.len().max(1) as f64;
        let spread: Matrix3<f64> = on.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
        if on.len() > PLANES {
            plane = (mean, eigen(spread).1);
        }
    }
    Some(plane)
}
