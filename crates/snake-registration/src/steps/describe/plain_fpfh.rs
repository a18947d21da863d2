//! The textbook FPFH in `f64`, with which the fast one is compared.

use std::f64::consts::PI;

use super::fpfh::FPFH_DIMENSION;
use snake_geometry::{Neighbors, Point, Vector, vector};

const BINS: usize = FPFH_DIMENSION / 3;

type Histograms = [f64; FPFH_DIMENSION];

/// FPFH descriptors `(N, 33)`, flat, of points `(N, 3)` with unit normals `(N, 3)`.
pub(super) fn plain_fpfh(points: &[Point], normals: &[Point], radius: f64) -> Vec<f32> {
    let cloud = Neighbors::new(points.iter().copied().map(vector).collect()).unwrap();
    let normals: Vec<Vector> = normals.iter().copied().map(vector).collect();
    let neighbors =
        |i: usize| -> Vec<usize> { cloud.within(&cloud.points[i], radius).into_iter().filter(|&j| j != i).collect() };
    let indices = 0..points.len();
    let simplified: Vec<Histograms> = indices.clone().map(|i| simplified(&cloud, &normals, i, &neighbors(i))).collect();
    indices.flat_map(|i| weighted(&cloud, &simplified, i, &neighbors(i))).map(|v| v as f32).collect()
}

/// SPFH: histograms of the angles between a point and its neighbours; each has sum 100.
fn simplified(cloud: &Neighbors, normals: &[Vector], point: usize, neighbors: &[usize]) -> Histograms {
    let mut histograms = [0.0; FPFH_DIMENSION];
    let share = 100.0 / neighbors.len() as f64;
    for &other in neighbors {
        let offset = cloud.points[other] - cloud.points[point];
        let [theta, alpha, phi] = pair_angles(&offset, &normals[point], &normals[other]);
        let units = [(theta + PI) / (2.0 * PI), (alpha + 1.0) / 2.0, (phi + 1.0) / 2.0];
        for (histogram, unit) in units.into_iter().enumerate() {
            // The cast saturates: negative values become 0.
            let bin = ((BINS as f64 * unit).floor() as usize).min(BINS - 1);
            histograms[histogram * BINS + bin] += share;
        }
    }
    histograms
}

/// Darboux angles of a pair of points: θ in [-π, π], and the cosines α and φ. All are 0 where they
/// are undefined.
fn pair_angles(offset: &Vector, normal: &Vector, other_normal: &Vector) -> [f64; 3] {
    let distance = offset.norm();
    if distance == 0.0 {
        return [0.0; 3];
    }
    let cosines = [normal.dot(offset) / distance, other_normal.dot(offset) / distance];
    // The frame is at the point whose normal has the smaller angle to the connecting line. The
    // comparison uses angles and not cosines, because near a right angle different cosines round to
    // the same angle.
    let (first, second, offset, phi) = if cosines[0].abs().acos() > cosines[1].abs().acos() {
        (other_normal, normal, -offset, -cosines[1])
    } else {
        (normal, other_normal, *offset, cosines[0])
    };
    let v = offset.cross(first);
    let length = v.norm();
    if length == 0.0 {
        return [0.0; 3];
    }
    let v = v / length;
    let w = first.cross(&v);
    [w.dot(second).atan2(first.dot(second)), v.dot(second), phi]
}

/// Adds the weighted histograms of the neighbours to a point's own histograms.
fn weighted(cloud: &Neighbors, simplified: &[Histograms], point: usize, neighbors: &[usize]) -> Histograms {
    let mut around = [0.0; FPFH_DIMENSION];
    for &other in neighbors {
        let squared_distance = (cloud.points[other] - cloud.points[point]).norm_squared();
        if squared_distance > 0.0 {
            around.iter_mut().zip(&simplified[other]).for_each(|(sum, value)| *sum += value / squared_distance);
        }
    }
    let mut histograms = simplified[point];
    for (own, around) in histograms.chunks_exact_mut(BINS).zip(around.chunks_exact(BINS)) {
        let sum: f64 = around.iter().sum();
        if sum > 0.0 {
            own.iter_mut().zip(around).for_each(|(own, value)| *own += value * (100.0 / sum));
        }
    }
    histograms
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::normals::estimate_normals;

    /// Points, normals and FPFH of tests/data/fpfh/open3d.csv.
    fn open3d_case() -> (Vec<Point>, Vec<Point>, Vec<f32>) {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/fpfh/open3d.csv");
        let table = std::fs::read_to_string(path).unwrap();
        let (mut points, mut normals, mut features) = (vec![], vec![], vec![]);
        for line in table.lines() {
            let row: Vec<f32> = line.split(',').map(|v| v.parse().unwrap()).collect();
            points.push([row[0], row[1], row[2]]);
            normals.push([row[3], row[4], row[5]]);
            features.extend(&row[6..]);
        }
        (points, normals, features)
    }

    #[test]
    fn normals_and_descriptors_are_those_open3d_case() {
        let (points, normals, features) = open3d_case();
        assert_eq!((points.len(), features.len()), (150, 150 * FPFH_DIMENSION));
        let difference = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let ours = estimate_normals(&points, 0.5).unwrap();
        assert!(difference(ours.as_flattened(), normals.as_flattened()) < 1e-5);
        let ours = plain_fpfh(&points, &normals, 0.8);
        let difference = difference(&ours, &features);
        assert!(difference < 1e-3, "{difference}");
        assert_eq!(ours[149 * FPFH_DIMENSION..], [0.0; FPFH_DIMENSION]);
    }

    #[test]
    fn descriptors_are_invariant_to_rigid_motion() {
        let (points, _, _) = open3d_case();
        let points = &points[..140];
        let rotated: Vec<Point> = points.iter().map(|p| [p[1] + 2.0, p[2], p[0] - 7.0]).collect();
        let describe = |points: &[Point]| plain_fpfh(points, &estimate_normals(points, 0.5).unwrap(), 0.8);
        let (before, after) = (describe(points), describe(&rotated));
        // A pair at the edge of a bin may change bins by rounding: few do.
        let changed = before.iter().zip(&after).filter(|(a, b)| (**a - **b).abs() > 0.1).count();
        assert!(changed < before.len() / 100, "{changed}");
    }
}
