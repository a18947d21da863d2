//! Clouds that share a few planes and nothing else: any corner of a room, a house or a cupboard looks like another.

use nalgebra::{IsometryMatrix3, Matrix3};

use crate::cloud::patches::{NEAR, Place, overlap};
use crate::steps::pair::Pair;
use snake_core::Result;
use snake_geometry::{Vector, eigen};

/// Number of planes that look like others: a corner with the floor and the ceiling.
const PLANES: usize = 4;
/// Largest share of the shared places that lie on them, given their thickness. Corners of bare rooms, plain houses, cartons and cupboards
/// have 0.97 to 1; right and reliable answers in real rooms up to 0.90.
const MAX_ON_PLANES: f64 = 0.94;
/// A place on a plane has a normal at least this parallel to it. It is low because of noise.
const PARALLEL: f64 = 0.7;
/// Number of places that propose planes, and number of places that choose among them, at most.
const PROPOSED: usize = 100;
const CHOOSING: usize = 500;
/// Number of times that a plane is fitted to its places.
const FITS: usize = 3;

/// A plane: a point and the normal.
type Plane = (Vector, Vector);

/// A note if the places that the clouds share lie on so few planes.
pub(super) fn corner_note(pair: &Pair, transform: &IsometryMatrix3<f64>) -> Result<Option<String>> {
    let distance = NEAR * pair.criteria().inlier_distance;
    let mut places = overlap(pair.fine()?, transform, distance).places;
    let (count, step) = (places.len() as f64, places.len().div_ceil(PROPOSED).max(1));
    let plane = |(place, _): &(Place, f64)| Some((place.point, place.normal?));
    let proposed: Vec<Plane> = places.iter().step_by(step).filter_map(plane).collect();
    for _ in 0..PLANES {
        let Some(plane) = most_frequent(&places, &proposed, distance) else { return Ok(None) };
        places.retain(|(place, apart)| !is_on(place, &plane, *apart));
    }
    let is_corner = count * (1.0 - MAX_ON_PLANES) > places.len() as f64;
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
