//! Signs of a scene: how a cloud of a room, a street or terrain differs from one of a single object, in any unit.
//!
//! A scene is seen from within or from one side, and much of it is flat; an object is seen from all around. The signs are
//! measured on the mean points of the cells of a coarse grid, which do not depend on the density of near points,
//! after projection onto the plane of their surroundings: a noisy wall is flat too.
//! `python -m snake_training.cloud_kind` fits the weights in `choose/rule.rs`. By
//! them 99 % of the fragments and parts of fragments that chose nothing are taken for scenes, with noise of 2 cm 92 %, and
//! 16 % of the whole validation objects: an object taken for a scene costs little.

use nalgebra::Matrix3;

use super::samples::{drawn, quantile};
use snake_geometry::{Point, RadiusCells, Vector, eigen, vector};

/// The number of signs.
pub const NUM_SIGNS: usize = 8;

/// Points that are looked at, at most.
const POINTS: usize = 20_000;
/// Fewest points, and fewest cells, of a cloud with signs.
const MIN_POINTS: usize = 100;
/// Cells along the radius of the cloud.
const CELLS: f64 = 16.0;
/// Directions about the middle of the cloud.
const DIRECTIONS: usize = 100;
/// Points within this many sides of a cell give the plane onto which its mean is projected.
const PLANE_RADIUS: f64 = 1.6;
/// Fewest points that make a plane.
const MIN_PLANE_POINTS: usize = 6;
/// Cells whose surroundings are measured, at most.
const SAMPLES: usize = 150;

/// The signs of a cloud `(N, 3)` of finite points. `None` where the cells are too few, or the cloud has no extent.
///
/// In units of the root mean square distance of the cells from their mean: a tenth of the surroundings within 0.25 are flatter
/// than the first sign (the smallest eigenvalue's share); a quarter of those within 0.5 are broader than the second (the
/// middle one's). Then the largest skewness along a direction, the share of directions in which something lies, the logarithm
/// of the number of cells, the nearest and the farthest distance by direction (their 0.9 quantiles), and the share of pairs
/// of cells within 0.25.
pub fn scene_signs(points: &[Point]) -> Option<[f64; NUM_SIGNS]> {
    let drawn: Vec<Point> = drawn(points, POINTS).collect();
    let (cells, _) = cells(&laid_on_planes(&drawn)?)?;
    let number = cells.len() as f64;
    let mean: [f64; 3] = std::array::from_fn(|axis| cells.iter().map(|cell| cell[axis]).sum::<f64>() / number);
    let mut cells: Vec<[f64; 3]> =
        cells.iter().map(|cell| std::array::from_fn(|axis| cell[axis] - mean[axis])).collect();
    let scale = (cells.iter().map(|cell| dot(cell, cell)).sum::<f64>() / number).sqrt();
    cells.iter_mut().flatten().for_each(|v| *v /= scale);
    let [flat, _] = surroundings(&cells, 0.25, [0.1, 0.75])?;
    let [_, broad] = surroundings(&cells, 0.5, [0.1, 0.75])?;
    let directions: Vec<[f64; 3]> = directions().collect();
    let skewness = directions.iter().map(|direction| skewness(&cells, direction).abs()).fold(0.0, f64::max);
    let mut reach = [None::<[f64; 2]>; DIRECTIONS];
    for cell in &cells {
        let nearest =
            (0..DIRECTIONS).max_by(|&a, &b| dot(cell, &directions[a]).total_cmp(&dot(cell, &directions[b])))?;
        let distance = dot(cell, cell).sqrt();
        let [near, far] = reach[nearest].unwrap_or([distance; 2]);
        reach[nearest] = Some([near.min(distance), far.max(distance)]);
    }
    let seen = reach.iter().flatten().count() as f64 / DIRECTIONS as f64;
    let [near, far] = [0, 1].map(|end| quantile(reach.iter().flatten().map(|ends| ends[end]).collect(), 0.9));
    // Each cell with another one that is drawn for it.
    let partner = |i: usize| ((i as f64 * 0.618_033_988_75).fract() * number) as usize;
    let close = |(i, cell): (usize, &[f64; 3])| squared_distance(cell, &cells[partner(i)]) < 0.25 * 0.25;
    let pairs = cells.iter().enumerate().filter(|pair| close(*pair)).count() as f64 / number;
    Some([flat, broad, skewness, seen, number.ln(), near, far, pairs])
}

/// The mean of the points in each cell, moved onto the plane of the points about it.
fn laid_on_planes(points: &[Point]) -> Option<Vec<[f64; 3]>> {
    let vectors: Vec<[f64; 3]> = points.iter().map(|point| point.map(f64::from)).collect();
    let (mut cells, side) = cells(&vectors)?;
    let near = RadiusCells::new(points, (PLANE_RADIUS * side) as f32).ok()?;
    for cell in &mut cells {
        let mut about = Vec::new();
        near.within(&cell.map(|v| v as f32), near.radius(), |index| about.push(vector(points[index])));
        if about.len() >= MIN_PLANE_POINTS {
            let (point, mean) = (vector(*cell), about.iter().sum::<Vector>() / about.len() as f64);
            let (_, normal) = eigen(about.iter().map(|p| (p - mean) * (p - mean).transpose()).sum());
            *cell = (point - normal * normal.dot(&(point - mean))).into();
        }
    }
    Some(cells)
}

/// The mean of the points in each cell, in the order of the grid, and the side of a cell.
fn cells(points: &[[f64; 3]]) -> Option<(Vec<[f64; 3]>, f64)> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let center: [f64; 3] = std::array::from_fn(|axis| quantile(points.iter().map(|p| p[axis]).collect(), 0.5));
    let radius = quantile(points.iter().map(|p| squared_distance(p, &center)).collect(), 0.98).sqrt();
    let side = radius / CELLS;
    if !(side > 0.0 && side.is_finite()) {
        return None;
    }
    let key =
        |p: &[f64; 3]| -> [i64; 3] { std::array::from_fn(|axis| ((p[axis] - center[axis]) / side).floor() as i64) };
    let mut keyed: Vec<_> = points.iter().map(|p| (key(p), p)).collect();
    keyed.sort_by_key(|(key, _)| *key);
    let mean = |cell: &[([i64; 3], &[f64; 3])]| {
        std::array::from_fn(|axis| cell.iter().map(|(_, p)| p[axis]).sum::<f64>() / cell.len() as f64)
    };
    Some((keyed.chunk_by(|a, b| a.0 == b.0).map(mean).collect(), side))
}

/// Of the cells within a radius of a cell, the covariance's smallest and middle eigenvalue as shares of the sum; over the
/// cells, a quantile of each. `None` where all cells stand alone.
fn surroundings(cells: &[[f64; 3]], radius: f64, at: [f64; 2]) -> Option<[f64; 2]> {
    let shares = |index: usize| {
        let near: Vec<_> = cells.iter().filter(|c| squared_distance(c, &cells[index]) <= radius * radius).collect();
        let number = near.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|axis| near.iter().map(|c| c[axis]).sum::<f64>() / number);
        let entry = |i: usize, j: usize| near.iter().map(|c| (c[i] - mean[i]) * (c[j] - mean[j])).sum::<f64>();
        let mut values: [f64; 3] = Matrix3::from_fn(entry).symmetric_eigenvalues().into();
        values.sort_by(f64::total_cmp);
        let sum: f64 = values.iter().sum();
        (near.len() >= 6 && sum > 0.0).then(|| [values[0] / sum, values[1] / sum])
    };
    let samples = cells.len().min(SAMPLES);
    let shares: Vec<[f64; 2]> = (0..samples).filter_map(|i| shares(i * cells.len() / samples)).collect();
    let value = |index: usize| quantile(shares.iter().map(|shares| shares[index]).collect(), at[index]);
    (!shares.is_empty()).then(|| [value(0), value(1)])
}

/// Directions that cover the sphere evenly.
fn directions() -> impl Iterator<Item = [f64; 3]> {
    (0..DIRECTIONS).map(|i| {
        let z = 1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = (i as f64 * std::f64::consts::PI * (1.0 + 5_f64.sqrt())).sin_cos();
        let flat = (1.0 - z * z).sqrt();
        [flat * cos, flat * sin, z]
    })
}

/// The skewness of centred cells along a direction; 0 where they have no extent along it.
fn skewness(cells: &[[f64; 3]], direction: &[f64; 3]) -> f64 {
    let moment = |power| cells.iter().map(|cell| dot(cell, direction).powi(power)).sum::<f64>() / cells.len() as f64;
    let variance = moment(2);
    if variance > 1e-12 { moment(3) / variance.powf(1.5) } else { 0.0 }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|axis| a[axis] * b[axis]).sum()
}

fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A point of the walls, the floor and the ceiling of a room of 4 by 4 by 2.5, for each number.
    fn room(i: usize) -> Point {
        let at = |row: usize| ((i as f64 * 12.9898 + row as f64 * 78.233).sin() * 43_758.545).rem_euclid(1.0) as f32;
        let mut point = [4.0 * at(0), 4.0 * at(1), 2.5 * at(2)];
        let axis = (3.0 * at(3)) as usize;
        point[axis] = if at(4) < 0.5 { 0.0 } else { [4.0, 4.0, 2.5][axis] };
        point
    }

    #[test]
    fn noisy_walls_are_as_flat_as_walls() {
        let clean: Vec<Point> = (0..20_000).map(room).collect();
        let noise = |i: usize| ((i as f32 * 0.618_034).fract() - 0.5) * 0.07;
        let noisy: Vec<Point> =
            clean.iter().enumerate().map(|(i, p)| [0, 1, 2].map(|axis| p[axis] + noise(3 * i + axis))).collect();
        let [clean, noisy] = [clean, noisy].map(|points| scene_signs(&points).unwrap());
        assert!(clean[0] < 1e-3 && noisy[0] < 2e-3, "{clean:?} {noisy:?}");
    }

    #[test]
    fn clouds_without_extent_or_points_have_no_signs() {
        assert_eq!(scene_signs(&[[1.0; 3]; 500]), None);
        assert_eq!(
            scene_signs(&(0..50).map(|i| [i as f32, (i * i % 7) as f32, (i % 3) as f32]).collect::<Vec<_>>()),
            None
        );
        let line: Vec<Point> = (0..500).map(|i| [i as f32, 0.0, 0.0]).collect();
        assert!(scene_signs(&line).is_none_or(|signs| signs.iter().all(|sign| sign.is_finite())));
    }
}
