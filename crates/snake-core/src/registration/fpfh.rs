//! Fast point feature histograms (Rusu, Blodow and Beetz 2009), as Open3D computes them.

use std::f64::consts::PI;

use rayon::prelude::*;

use super::cloud::check_radius;
use crate::neighbors::{Neighbors, Vector, vector};
use crate::points::{Point, check_points};
use crate::{Error, Result};

/// Numbers per descriptor: three histograms of 11 bins.
pub const FPFH_DIMENSION: usize = 3 * BINS;

const BINS: usize = 11;

type Histograms = [f64; FPFH_DIMENSION];

/// Descriptors `(N, 33)`, flat, of points with unit normals: how the normals stand to each other among the points
/// nearer than `radius` (cloud units). They do not change when cloud and normals are moved or turned.
///
/// Where Open3D departs from the paper, so does this: weights are squared distances, and each of the three histograms of
/// the neighbours is scaled to 100 before the point's own is added. Points without neighbours have zeros.
///
/// # Errors
/// [`Error::Input`] when there are no points, a number is not finite, or not as many normals as points;
/// [`Error::Option`] when the radius is not positive.
pub fn fpfh(points: &[Point], normals: &[Point], radius: f64) -> Result<Vec<f32>> {
    check_points("points", points)?;
    check_points("normals", normals)?;
    if points.len() != normals.len() {
        let reason = format!("{} for {} points", normals.len(), points.len());
        return Err(Error::Input { what: "normals", reason });
    }
    check_radius("radius", radius)?;
    let cloud = Neighbors::new(points.iter().copied().map(vector).collect())?;
    let normals: Vec<Vector> = normals.iter().copied().map(vector).collect();
    Ok(descriptors(&cloud, &normals, radius))
}

/// [`fpfh`] of an indexed cloud.
pub(super) fn descriptors(cloud: &Neighbors, normals: &[Vector], radius: f64) -> Vec<f32> {
    let neighbors: Vec<Vec<usize>> = (0..cloud.points.len())
        .into_par_iter()
        .map(|i| cloud.within(&cloud.points[i], radius).into_iter().filter(|&j| j != i).collect())
        .collect();
    let simplified: Vec<Histograms> =
        (0..neighbors.len()).into_par_iter().map(|i| simplified(cloud, normals, i, &neighbors[i])).collect();
    let rows = (0..neighbors.len()).into_par_iter();
    rows.flat_map_iter(|i| weighted(cloud, &simplified, i, &neighbors[i])).map(|v| v as f32).collect()
}

/// SPFH: histograms of the angles between a point and its neighbours, each of sum 100.
fn simplified(cloud: &Neighbors, normals: &[Vector], point: usize, neighbors: &[usize]) -> Histograms {
    let mut histograms = [0.0; FPFH_DIMENSION];
    let share = 100.0 / neighbors.len() as f64;
    for &other in neighbors {
        let offset = cloud.points[other] - cloud.points[point];
        let [theta, alpha, phi] = pair_angles(&offset, &normals[point], &normals[other]);
        let units = [(theta + PI) / (2.0 * PI), (alpha + 1.0) / 2.0, (phi + 1.0) / 2.0];
        for (histogram, unit) in units.into_iter().enumerate() {
            // A cast takes what is below 0 to 0.
            let bin = ((BINS as f64 * unit).floor() as usize).min(BINS - 1);
            histograms[histogram * BINS + bin] += share;
        }
    }
    histograms
}

/// Darboux angles of a pair of points: θ in [-π, π], and the cosines α and φ. All 0 where they are not defined.
fn pair_angles(offset: &Vector, normal: &Vector, other_normal: &Vector) -> [f64; 3] {
    let distance = offset.norm();
    if distance == 0.0 {
        return [0.0; 3];
    }
    let cosines = [normal.dot(offset) / distance, other_normal.dot(offset) / distance];
    // The frame stands on the point whose normal is nearer to the line between the two. The angles are compared and not
    // their cosines, as near a right angle both round to the same.
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

/// A point's own histograms and those of its neighbours, the nearer the more.
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
