//! Clouds of which the voxels of one object show little: a pipeline or a cable, or small things far apart.

use std::collections::BTreeSet;

use crate::cloud::{UsedCloud, quantile};
use snake_geometry::{Neighbors, Point, drawn, vector};

/// Voxels of an object's volume along the diagonal of a cloud.
const VOXELS: f64 = 32.0;
/// A cloud in so few voxels has hardly a shape: a straight tube has 32, whole objects have some hundreds.
const MAX_VOXELS: usize = 64;
/// Points that are looked at, and those about which the thickness is measured.
const POINTS: usize = 4096;
const CENTERS: usize = 64;
/// A bare curve is thinner than so many spacings of its points, among those within some more, and nothing stands on it.
const SPACINGS: f64 = 2.0;
const NEAR: f64 = 8.0;

/// A sentence for a user where a cloud lies in few voxels of an object's volume, and its points are dense enough to show more.
pub(super) fn note(cloud: &UsedCloud) -> Option<String> {
    let (number, voxel) = voxels(cloud)?;
    Some(format!(
        "the cloud lies in {number} voxels of {} if it is one object: too large for what is on it, which the model `scenes` \
         shows",
        rounded(voxel)
    ))
}

/// The number of these voxels, and their side.
fn voxels(cloud: &UsedCloud) -> Option<(usize, f64)> {
    let points: Vec<Point> = drawn(cloud.points(), POINTS);
    let range = |axis: usize| {
        let values = || points.iter().map(|point| f64::from(point[axis]));
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    let voxel = (0..3).map(|axis| range(axis).powi(2)).sum::<f64>().sqrt() / VOXELS;
    if voxel.is_nan() || voxel <= 0.0 {
        return None;
    }
    // About the middle, a straight tube along an axis lies in one row of voxels, wherever the cloud is.
    let middle = [0, 1, 2].map(|axis| quantile(points.iter().map(|point| f64::from(point[axis])).collect(), 0.5));
    let cell = |point: &Point| [0, 1, 2].map(|axis| ((f64::from(point[axis]) - middle[axis]) / voxel).round() as i64);
    let mut cells = BTreeSet::new();
    let are_many = points.iter().any(|point| cells.insert(cell(point)) && cells.len() > MAX_VOXELS);
    // Points that have voxels of their own show no more in smaller ones.
    if are_many || 2 * cells.len() > points.len() {
        return None;
    }
    let centers: Vec<Point> = drawn(&points, CENTERS);
    let median = |measure: &dyn Fn(&Point) -> f64| quantile(centers.iter().map(measure).collect(), 0.5);
    let squared = |a: &Point, b: &Point| (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum::<f64>();
    let spacing = median(&|center| {
        let others = cloud.points().iter().map(|point| squared(center, point)).filter(|squared| *squared > 0.0);
        others.fold(f64::INFINITY, f64::min).sqrt()
    });
    let thickness = median(&|center| {
        let is_near = |point: &&Point| squared(center, point) < (NEAR * spacing).powi(2);
        let near: Vec<_> = cloud.points().iter().filter(is_near).copied().map(vector).collect();
        let all: Vec<usize> = (0..near.len()).collect();
        let covariance = Neighbors::new(near).map(|near| near.covariance(&all)).unwrap_or_default();
        let mut variances: [f64; 3] = covariance.symmetric_eigenvalues().into();
        variances.sort_by(f64::total_cmp);
        // The diameter of a tube whose surface has the points.
        (8.0 * variances[1].max(0.0)).sqrt()
    });
    (thickness > SPACINGS * spacing).then_some((cells.len(), voxel))
}

/// A length with three digits.
pub(super) fn rounded(length: f64) -> f64 {
    format!("{length:.2e}").parse().unwrap_or(length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Builtin;

    /// Points on a tube of a length and a radius along a curve that bends by an angle, with flanges of twice the radius.
    fn tube(number: usize, length: f64, radius: f64, angle: f64) -> Vec<Point> {
        let point = |i: usize| {
            let [u, v] = [0.754_877_666, 0.569_840_291].map(|step: f64| (i as f64 * step).fract());
            let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
            let flange = if (u * 20.0).fract() < 0.01 { 2.0 } else { 1.0 };
            let (along, across) = (length * u, flange * radius * cos);
            let (bend, reach) = if angle > 0.0 { (angle * u, length / angle) } else { (0.0, 0.0) };
            let place = if angle > 0.0 {
                [(reach + across) * bend.sin(), (reach + across) * bend.cos()]
            } else {
                [along, across]
            };
            [place[0], place[1], flange * radius * sin].map(|v| v as f32)
        };
        (0..number).map(point).collect()
    }

    #[test]
    fn pipelines_and_cables_are_scenes_and_say_why_and_few_points_are_none() {
        assert!(voxels(&UsedCloud::new(&tube(30, 1.0, 0.3, 0.0)).unwrap()).is_none());
        for (number, length, radius, angle) in [
            (60_000, 200.0, 0.15, 0.0),
            (60_000, 100.0, 0.015, 0.0),
            (30_000, 300.0, 0.3, 1.5),
            (100_000, 1.0, 0.002, 0.0),
        ] {
            let points = tube(number, length, radius, angle);
            // Half a voxel of the volume to the side.
            let beside = points.iter().map(|p| p.map(|v| v + length as f32 / 64.0)).collect::<Vec<_>>();
            assert_eq!(Builtin::for_cloud(&beside), Builtin::Scenes, "{length} {radius}");
            assert_eq!(Builtin::for_cloud(&points), Builtin::Scenes, "{length} {radius}");
            let text = note(&UsedCloud::new(&points).unwrap()).unwrap();
            assert!(text.starts_with("the cloud lies in "), "{text}");
        }
    }

    #[test]
    fn two_things_far_apart_say_so_and_one_does_not() {
        let thing = tube(5000, 0.3, 0.1, 0.0);
        let far = thing.iter().map(|[x, y, z]| [x + 6.0, *y, *z]);
        let both = [&thing[..], &far.collect::<Vec<_>>()].concat();
        let [one, two] = [thing, both].map(|points| note(&UsedCloud::new(&points).unwrap()).is_some());
        assert_eq!([one, two], [false, true]);
    }

    #[test]
    fn objects_bare_curves_and_sparse_tubes_stay_objects() {
        for points in
            [tube(20_000, 1.0, 0.1, 0.0), tube(5000, 1.0, 0.0, 3.0), tube(500, 200.0, 0.15, 0.0), vec![[1.0; 3]; 100]]
        {
            let cloud = UsedCloud::new(&points).unwrap();
            assert_eq!((note(&cloud), Builtin::for_cloud(&points)), (None, Builtin::Compact));
        }
    }
}
