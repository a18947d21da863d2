//! Finds the place of a cloud's sensor from its points.
//!
//! The rays of a sensor have about equal angles, so the number of its points per area of a surface is `k |cos| / r²`: it falls
//! with the squared distance r from the sensor and with the angle between ray and normal. A model is instead sampled evenly,
//! and merged or fused scans have the densities of several sensors. A place is the sensor's if it explains the densities much
//! better than even sampling does, and if its residuals are noise and not regions that another sensor also saw. Surfaces are
//! too coarse to give the exact place, so it is refined by counting rays in bundles of points that are neighbours in view.
//!
//! The beams of a LiDAR or a scanner rotate about an axis. Neighbours of one beam have the same elevation, which tells the place
//! to centimetres, however few the beams are.
//!
//! The frame's origin is taken if the densities lead to it. It is also taken, as the place of a camera whose images were fused, if
//! the densities do not tell, the cloud lies along its z axis, and most of the cloud is in view.

mod fit;
mod patches;

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use self::fit::{Fit, axes, cost_of_even, excess, search};
use self::patches::{Density, Lattice};
use crate::subset::mixed;
use crate::{Neighbors, Point, Vector, vector};

/// Maximum number of points among which neighbours are searched. With fewer, neighbourhoods are wider than furniture.
const MAX_POINTS: usize = 16_384;
/// Minimum number of densities; fewer do not tell anything.
const MIN_DENSITIES: usize = 100;
/// Largest ratio of the costs of bundles with and without a lattice that turns. Tripods on open ground have 0.64.
const BUNDLES_COST: f64 = 0.8;
/// Largest unexplained share with a sensor: of the cost of even sampling, and of that plus the share of hidden points.
/// Synthetic scans have up to 0.47, merged scans and models 0.53 and more.
const MAX_UNEXPLAINED: f64 = 0.5;
/// Largest standard deviation of a place that is not the origin, relative to the cloud's radius. Single objects, which do not
/// tell how far away the sensor was, have 0.1 to 30.
const MAX_DEVIATION: f64 = 0.1;
/// Beams are the sensor's only where it leaves less than this share of the cost of even sampling unexplained.
const MAX_UNEXPLAINED_BY_BEAMS: f64 = 0.8;
/// A place this close to the frame's origin is the origin. Unit: median distances of the points from the origin.
const AT_ORIGIN: f64 = 0.15;
/// Largest excess of residuals on surfaces, relative to the differences between neighbours; and largest product of it and the
/// excess in view. Merged scans, whose parts were seen by one sensor or by two, have 1.4 and 1.62 and more.
const MAX_EXCESS: f64 = 1.4;
const MAX_EXCESS_IN_VIEW: f64 = 1.6;
/// Added to the cost of a fit, because that of a perfect lattice is near 0.
const MIN_NOISE: f64 = 0.02;
/// Side of a pixel for visibility, as the tangent of an angle, for a sensor within the cloud.
const PIXEL: f64 = 0.05;
/// All points lie ahead of a camera, which looks along the z axis of its frame: the mean of the unit vectors to them has more of it.
/// Fused images have 0.84 and more.
const MIN_AHEAD: f64 = 0.75;
/// Nor are they far away: the median point is at most this many median distances from the camera. Fused images have 1.9 to 4.
const MAX_AWAY: f64 = 4.5;
/// Smallest visible share of fused images; the camera moved, so it does not see all. They have 0.59 and more. Merged scans, seen
/// from a corner of their room, have 0.52 and less.
const MIN_FUSED: f64 = 0.56;
/// No plane is closer than the points at this quantile of the inverse distance.
const NEAREST: f64 = 0.95;

/// The place of a cloud's sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// The position, in the cloud's frame and units.
    pub position: [f64; 3],
    /// Share of the points, 0 to 1, that nothing hides from the sensor.
    pub visible: f64,
}

impl Sensor {
    /// Finds the sensor of a cloud that was seen from one place. Returns `None` for models, merged scans and undecided cases.
    /// Points that are not finite do not count.
    pub fn find(all: &[Point]) -> Option<Self> {
        let points = sample(all);
        if points.len() < MIN_DENSITIES {
            return None;
        }
        let cloud = Neighbors::new(points).ok()?;
        let densities = Density::measure(&cloud);
        if densities.len() < MIN_DENSITIES {
            return None;
        }
        let best = search(&densities, &cloud.points).above(&densities, &cloud.points);
        let unexplained = (best.cost + MIN_NOISE) / cost_of_even(&densities);
        let has_beams = unexplained < MAX_UNEXPLAINED_BY_BEAMS;
        if let Some(place) = has_beams.then(|| best.by_beams(&axes(&densities), all, &cloud.points)).flatten() {
            return Some(Self { position: place.into(), visible: visible_share(&cloud.points, &place) });
        }
        if unexplained > MAX_UNEXPLAINED {
            return Self::before_fused(&cloud.points);
        }
        let distance = median(cloud.points.iter().map(Vector::norm).collect());
        let is_origin = best.place.norm() < AT_ORIGIN * distance;
        // Few densities do not show a lattice that many rays show.
        let turning = Fit { lattice: Lattice::Turning, axis: axes(&densities)[0], ..best };
        let by_bundles = |fit: Fit| if is_origin { None } else { fit.by_bundles(&cloud.points, &densities) };
        let turning = (best.lattice == Lattice::None).then_some(turning).and_then(by_bundles);
        let in_view = by_bundles(best);
        let is_turning = |(fit, _): &(Fit, f64)| in_view.is_none_or(|(none, _)| fit.cost < BUNDLES_COST * none.cost);
        let in_view = turning.filter(is_turning).or(in_view);
        let place = if is_origin { Vector::zeros() } else { in_view.map_or(best.place, |(fit, _)| fit.place) };
        let visible = visible_share(&cloud.points, &place);
        let is_certain = is_origin
            || best.deviation(&densities.iter().collect::<Vec<_>>()) < MAX_DEVIATION * middle(&cloud.points).1;
        if unexplained + 1.0 - visible > MAX_UNEXPLAINED || !is_certain {
            return None;
        }
        let on_surfaces = densities.iter().map(|density| (density.point, best.residual(&density))).collect();
        let on_surfaces = excess(on_surfaces, &best.place)?;
        let in_view = on_surfaces * in_view.map_or(1.0, |(_, excess)| excess);
        (on_surfaces <= MAX_EXCESS && in_view <= MAX_EXCESS_IN_VIEW).then(|| Self { position: place.into(), visible })
    }

    /// The frame's origin, if a camera there may have taken the fused images, whose densities do not tell.
    fn before_fused(points: &[Vector]) -> Option<Self> {
        let ahead = points.iter().filter_map(|point| point.try_normalize(0.0)).sum::<Vector>() / points.len() as f64;
        let (center, radius) = middle(points);
        let visible = visible_share(points, &Vector::zeros());
        let is_near = ahead.z.abs() > MIN_AHEAD && center.norm() < MAX_AWAY * radius;
        (is_near && visible > MIN_FUSED).then_some(Self { position: [0.0; 3], visible })
    }

    /// The distance from the middle of the cloud, in median distances of its points from there.
    pub fn radii_away(&self, points: &[Point]) -> f64 {
        let (center, radius) = middle(&sample(points));
        (Vector::from(self.position) - center).norm() / radius
    }

    /// A sensor whose position is known.
    pub fn at(position: [f64; 3], points: &[Point]) -> Self {
        let points = sample(points);
        let visible = if points.is_empty() { 0.0 } else { visible_share(&points, &position.into()) };
        Self { position, visible }
    }
}

/// One finite point of each of [`MAX_POINTS`] stretches of the cloud, at a random place in it. A fixed step would take the same
/// columns in each row of a scan.
fn sample(points: &[Point]) -> Vec<Vector> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let random = |(index, stretch): (usize, &[Point])| vector(stretch[mixed(index as u64) as usize % stretch.len()]);
    let finite = |point: &Vector| point.iter().all(|v| v.is_finite());
    points.chunks(step).enumerate().map(random).filter(finite).collect()
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The median of the points, and their median distance from it.
fn middle(points: &[Vector]) -> (Vector, f64) {
    let center = Vector::from_fn(|axis, _| median(points.iter().map(|point| point[axis]).collect()));
    (center, median(points.iter().map(|point| (point - center).norm()).collect()))
}

/// The share of the points that no other point hides from a place, in pixels on the faces of a cube around it.
fn visible_share(points: &[Vector], place: &Vector) -> f64 {
    let center = points.iter().sum::<Vector>() / points.len() as f64;
    let radius = points.iter().map(|point| (point - center).norm()).fold(0.0, f64::max);
    // A cloud that is seen from afar appears small, so its pixels are smaller.
    let side = PIXEL * (radius / (center - place).norm().max(f64::MIN_POSITIVE)).min(1.0);
    let pixel = |point: &Vector| {
        let offset = point - place;
        let face = offset.iamax();
        let depth = offset[face].abs().max(f64::MIN_POSITIVE);
        let at = |axis: usize| (offset[(face + axis) % 3] / depth / side).floor() as i64;
        (face, offset[face] < 0.0, at(1), at(2))
    };
    let nearness = |point: &Vector| (point - place).norm().max(f64::MIN_POSITIVE).recip();
    let seen: Vec<_> = points.iter().map(|point| (pixel(point), nearness(point))).collect();
    let mut nearest = HashMap::with_capacity(points.len());
    for (pixel, nearness) in &seen {
        nearest.entry(pixel).and_modify(|most: &mut f64| *most = nearness.max(*most)).or_insert(*nearness);
    }
    // Within a pixel, the inverse distance of a plane varies by the pixel's side divided by the plane's distance.
    let mut sorted: Vec<f64> = seen.iter().map(|(_, nearness)| *nearness).collect();
    let at = (NEAREST * (sorted.len() - 1) as f64) as usize;
    let tolerance = side * *sorted.select_nth_unstable_by(at, f64::total_cmp).1;
    let visible = seen.iter().filter(|(pixel, nearness)| *nearness >= nearest[pixel] - tolerance);
    visible.count() as f64 / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const EYES: [[f64; 3]; 2] = [[2.0, 1.5, 1.4], [4.5, 3.0, 1.2]];
    const SITE: Vector = Vector::new(30.0, -20.0, 5.0);

    /// What a scanner sees of a room of 6 x 4.5 x 2.6 m, in site coordinates.
    fn scan(eye: [f64; 3]) -> Vec<Point> {
        let seen = |index: u32| {
            let (elevation, azimuth) = (f64::from(index / 300) * 0.02 - 1.0, f64::from(index % 300) * 0.020_944);
            hit(eye, [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()])
        };
        (0..300 * 100).map(seen).collect()
    }

    /// Where a ray meets the room's walls.
    fn hit(eye: [f64; 3], ray: [f64; 3]) -> Point {
        let wall = |axis: usize| (if ray[axis] > 0.0 { [6.0, 4.5, 2.6][axis] } else { 0.0 } - eye[axis]) / ray[axis];
        let range = (0..3).map(wall).fold(f64::INFINITY, f64::min);
        (SITE + Vector::from(eye) + range * Vector::from(ray)).map(|v| v as f32).into()
    }

    #[test]
    fn the_sensor_of_a_scan_is_found_in_any_frame_and_that_of_merged_scans_is_not() {
        for eye in EYES {
            let sensor = Sensor::find(&scan(eye)).unwrap();
            let off = Vector::from(sensor.position) - Vector::from(eye) - SITE;
            assert!(off.norm() < 0.03 && sensor.visible > 0.95, "{sensor:?}");
        }
        assert_eq!(Sensor::find(&EYES.map(scan).concat()), None);
    }

    #[test]
    fn few_beams_tell_where_they_rotate() {
        let sweep = |eye| scan(eye).chunks(300).step_by(6).flatten().copied().collect::<Vec<Point>>();
        let sensor = Sensor::find(&sweep(EYES[0])).unwrap();
        let off = Vector::from(sensor.position) - Vector::from(EYES[0]) - SITE;
        assert!(off.norm() < 1e-3, "{sensor:?}");
        assert_eq!(Sensor::find(&EYES.map(sweep).concat()), None);
    }

    #[test]
    fn rows_of_an_image_are_no_beams() {
        // Pixels along x, closer to each other in a row than in a column.
        let pixel = |index: u32| [1.0, f64::from(index % 400) * 0.004 - 0.8, f64::from(index / 400) * 0.012 - 0.6];
        let image: Vec<Point> = (0..400 * 100).map(|index| hit(EYES[0], pixel(index))).collect();
        let off =
            Sensor::find(&image).map(|sensor| (Vector::from(sensor.position) - Vector::from(EYES[0]) - SITE).norm());
        assert!(off.is_none_or(|off| off < 0.1), "{off:?}");
    }

    #[test]
    fn a_sensor_stands_on_the_side_of_the_ground_from_which_it_sees_the_walls() {
        let is_open = |point: &Point| point[2] < 5.01 || (point[1] > -15.51 || point[0] > 35.99) && point[2] < 5.6;
        let open: Vec<Point> = scan(EYES[0]).into_iter().filter(is_open).collect();
        let off = Vector::from(Sensor::find(&open).unwrap().position) - Vector::from(EYES[0]) - SITE;
        assert!(off.norm() < 0.1, "{off:?}");
    }

    #[test]
    fn what_is_sampled_evenly_has_no_sensor_even_about_the_origin() {
        let unit = |index: usize, step: f64| (index as f64 * step).fract() as f32 - 0.5;
        let cube = |index: usize| {
            let mut point = [unit(index, 0.618_034), unit(index, 0.754_878), unit(index, 0.569_840)];
            point[index % 3] = point[index % 3].signum();
            point
        };
        let ball = |index: usize| {
            let (z, angle) = (2.0 * unit(index, 0.754_878), std::f32::consts::TAU * unit(index, 0.618_034));
            let ring = (1.0 - z * z).sqrt();
            [ring * angle.cos(), ring * angle.sin(), z]
        };
        let [cube, ball]: [Vec<Point>; 2] = [(0..20_000).map(cube).collect(), (0..20_000).map(ball).collect()];
        for points in [&cube[..], &ball, &[], &[[1.0; 3]; 500], &[[f32::NAN; 3]; 500]] {
            assert_eq!(Sensor::find(points), None);
        }
    }
}
