//! Fast point feature histograms (Rusu, Blodow and Beetz 2009) as Open3D computes them, in `f32`.

use std::f32::consts::{FRAC_PI_2, PI};

use crate::cloud::near_grid::NearGrid;
use crate::cloud::normals::check_radius;
use snake_core::{Control, Error, Result};
use snake_geometry::{Neighbors, Point, Vector, check_points, try_in_parallel, vector};

/// Length of a descriptor: three histograms of 11 bins.
pub const FPFH_DIMENSION: usize = 3 * BINS;

const BINS: usize = 11;

type Histograms = [f32; FPFH_DIMENSION];

/// FPFH descriptors `(N, 33)`, flat, of points `(N, 3)` with unit normals `(N, 3)`.
///
/// A descriptor is three histograms of the angles between the normals of a point and of its neighbours closer than
/// `radius` (cloud units). It is invariant to rigid motion of the cloud with its normals.
///
/// Like Open3D and unlike the paper, this weights neighbours by inverse squared distances, and scales each of their
/// three histograms to 100 before it adds the point's own histogram. Points without neighbours have zeros. Angles are
/// computed in `f32`: a pair of points whose angle is next to the edge of a bin may be in the other bin.
///
/// # Errors
/// [`Error::Input`] when there are no points, a number is not finite, or the numbers of points and
/// normals differ; [`Error::Option`] when the radius is not positive.
pub fn fpfh(points: &[Point], normals: &[Point], radius: f64) -> Result<Vec<f32>> {
    fpfh_with(points, normals, radius, &Control::default())
}

/// Like [`fpfh`], under `control`.
///
/// # Errors
/// As [`fpfh`], and what `control` ends with.
pub fn fpfh_with(points: &[Point], normals: &[Point], radius: f64, control: &Control) -> Result<Vec<f32>> {
    check_points("points", points)?;
    check_points("normals", normals)?;
    if points.len() != normals.len() {
        let reason = format!("{} for {} points", normals.len(), points.len());
        return Err(Error::Input { what: "normals", reason });
    }
    check_radius("radius", radius)?;
    let cloud = Neighbors::new(points.iter().copied().map(vector).collect())?;
    cloud.check_density("radius", radius)?;
    let normals: Vec<Vector> = normals.iter().copied().map(vector).collect();
    descriptors(&cloud.points, &normals, true, radius, control)
}

/// [`fpfh`] of points that were checked.
///
/// Without `signed`, normals have no sign: the descriptors use the absolute cosines and the angle between two lines.
pub(crate) fn descriptors(
    points: &[Vector],
    normals: &[Vector],
    signed: bool,
    radius: f64,
    control: &Control,
) -> Result<Vec<f32>> {
    let counter = control.begin("FPFH", 2 * points.len());
    let grid = NearGrid::new(points, radius);
    let single: Vec<[f32; 3]> = normals.iter().map(|normal| normal.map(|v| v as f32).into()).collect();
    let simplified = |(point, normal): (&Vector, &[f32; 3])| {
        counter.add(1);
        counter.check().map(|()| simplified(&grid, &single, signed, point, normal))
    };
    let simplified: Vec<Histograms> = try_in_parallel(points.iter().zip(&single), simplified)?;
    let weighted = |(point, own): (&Vector, &Histograms)| {
        counter.add(1);
        counter.check().map(|()| weighted(&grid, &simplified, point, own))
    };
    let weighted: Vec<Histograms> = try_in_parallel(points.iter().zip(&simplified), weighted)?;
    Ok(weighted.into_flattened())
}

/// SPFH: histograms of the angles between a point and its neighbours; each has sum 100.
fn simplified(grid: &NearGrid, normals: &[[f32; 3]], signed: bool, point: &Vector, normal: &[f32; 3]) -> Histograms {
    let mut counts = [0_u32; FPFH_DIMENSION];
    let mut neighbors = 0;
    grid.within(point, |other, offset, squared| {
        if squared == 0.0 {
            return;
        }
        let offset = <[f32; 3]>::from(offset.map(|v| v as f32));
        let units = pair_units(offset, squared as f32, normal, &normals[other], signed);
        for (histogram, unit) in units.into_iter().enumerate() {
            // The cast saturates: negative values become 0.
            counts[histogram * BINS + ((BINS as f32 * unit) as usize).min(BINS - 1)] += 1;
        }
        neighbors += 1;
    });
    counts.map(|count| count as f32 * 100.0 / neighbors.max(1) as f32)
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: &[f32; 3], b: &[f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The Darboux angles θ, α and φ of a pair of points, scaled to 0..1.
///
/// With the unit vector u between the points, the normal n of the frame and the other normal m: `v = u × n / L`,
/// `w = n × v`, so `α = v·m = u·(n × m) / L` and `w·m = (u·m - (n·m)(u·n)) / L` with `L² = 1 - (u·n)²`.
#[inline]
fn pair_units(offset: [f32; 3], squared: f32, normal: &[f32; 3], other: &[f32; 3], signed: bool) -> [f32; 3] {
    let inverse = 1.0 / squared.sqrt();
    let (a, b) = (dot(normal, &offset) * inverse, dot(other, &offset) * inverse);
    // The frame is at the point whose normal has the smaller angle to the connecting line.
    let (phi, g) = if a.abs() < b.abs() { (-b, -a) } else { (a, b) };
    let between = dot(normal, other);
    let length = (1.0 - phi * phi).max(0.0).sqrt();
    if length == 0.0 {
        return [0.5; 3];
    }
    let alpha = dot(&offset, &cross(normal, other)) * inverse / length;
    let (sine, cosine) = ((g - between * phi) / length, between);
    if signed {
        [(atan2(sine, cosine) + PI) / (2.0 * PI), (alpha + 1.0) / 2.0, (phi + 1.0) / 2.0]
    } else {
        [atan2(sine.abs(), cosine.abs()) / FRAC_PI_2, alpha.abs(), phi.abs()]
    }
}

/// The angle, accurate to 2e-3 radians (a bin has 0.57), by a polynomial in the smaller of the two ratios.
#[inline]
fn atan2(y: f32, x: f32) -> f32 {
    let (lesser, greater) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    let ratio = lesser / greater.max(f32::MIN_POSITIVE);
    let squared = ratio * ratio;
    let angle = ((-0.046_496_474 * squared + 0.159_314_22) * squared - 0.327_622_76) * squared * ratio + ratio;
    let angle = if y.abs() > x.abs() { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

/// Adds the weighted histograms of the neighbours to a point's own histograms.
fn weighted(grid: &NearGrid, simplified: &[Histograms], point: &Vector, own: &Histograms) -> Histograms {
    let mut around = [0.0; FPFH_DIMENSION];
    grid.within(point, |other, _, squared| {
        if squared > 0.0 {
            let weight = (1.0 / squared) as f32;
            around.iter_mut().zip(&simplified[other]).for_each(|(sum, value)| *sum += weight * value);
        }
    });
    let mut histograms = *own;
    for (own, around) in histograms.chunks_exact_mut(BINS).zip(around.chunks_exact(BINS)) {
        let sum: f32 = around.iter().sum();
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

    /// The textbook FPFH of Rusu et al. 2009, in `f64`.
    fn plain(points: &[Point], normals: &[Point], radius: f64) -> Vec<f64> {
        let [points, normals]: [Vec<Vector>; 2] =
            [points, normals].map(|rows| rows.iter().map(|&row| vector(row)).collect());
        let near = |i: usize| {
            let points = &points;
            (0..points.len()).filter(move |&j| j != i && (points[j] - points[i]).norm() <= radius)
        };
        // The frame of a pair is at the point whose normal has the smaller angle to the line between them.
        let angles = |i: usize, j: usize| {
            let offset = points[j] - points[i];
            let cosines = [normals[i], normals[j]].map(|normal| normal.dot(&offset) / offset.norm());
            let is_turned = cosines[0].abs().acos() > cosines[1].abs().acos();
            let (i, j, offset, phi) = if is_turned { (j, i, -offset, -cosines[1]) } else { (i, j, offset, cosines[0]) };
            // Angles are 0 where they are undefined.
            let Some(v) = offset.cross(&normals[i]).try_normalize(0.0) else { return [0.5; 3] };
            let theta = normals[i].cross(&v).dot(&normals[j]).atan2(normals[i].dot(&normals[j]));
            [(theta / std::f64::consts::PI + 1.0) / 2.0, (v.dot(&normals[j]) + 1.0) / 2.0, (phi + 1.0) / 2.0]
        };
        let simplified = |i: usize| {
            let mut histograms = [0.0; FPFH_DIMENSION];
            for j in near(i) {
                for (histogram, unit) in angles(i, j).into_iter().enumerate() {
                    let bin = ((11.0 * unit) as usize).min(10);
                    histograms[histogram * 11 + bin] += 100.0 / near(i).count() as f64;
                }
            }
            histograms
        };
        let simplified: Vec<[f64; FPFH_DIMENSION]> = (0..points.len()).map(simplified).collect();
        let weighted = |i: usize| {
            let mut around = [0.0; FPFH_DIMENSION];
            for j in near(i).filter(|&j| points[j] != points[i]) {
                let weight = (points[j] - points[i]).norm_squared().recip();
                (0..FPFH_DIMENSION).for_each(|bin| around[bin] += weight * simplified[j][bin]);
            }
            let sums: Vec<f64> =
                around.chunks(11).map(|bins| bins.iter().sum::<f64>().max(f64::MIN_POSITIVE)).collect();
            std::array::from_fn::<_, FPFH_DIMENSION, _>(|bin| simplified[i][bin] + 100.0 * around[bin] / sums[bin / 11])
        };
        (0..points.len()).flat_map(weighted).collect()
    }

    #[test]
    fn normals_and_descriptors_are_those_of_open3d() {
        let (points, normals, features) = open3d_case();
        assert_eq!((points.len(), features.len()), (150, 150 * FPFH_DIMENSION));
        let ours = estimate_normals(&points, 0.5).unwrap();
        assert!(ours.as_flattened().iter().zip(normals.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-5));
        let ours = fpfh(&points, &normals, 0.8).unwrap();
        let plain = plain(&points, &normals, 0.8);
        assert!(plain.iter().zip(&features).all(|(a, b)| (a - f64::from(*b)).abs() < 1e-3));
        // A pair near the edge of a bin may change bins by rounding: in `f32` 9 of these numbers differ.
        let close = ours.iter().zip(&features).filter(|(a, b)| (**a - **b).abs() < 1.0).count();
        assert!(close as f64 > 0.995 * features.len() as f64, "{close} of {}", features.len());
        assert_eq!(ours[149 * FPFH_DIMENSION..], [0.0; FPFH_DIMENSION]);
        // Signs of normals do not matter where they have none.
        let vectors = |rows: &[Point]| rows.iter().map(|&row| vector(row)).collect::<Vec<_>>();
        let described = |normals: &[Point], signed| {
            descriptors(&vectors(&points), &vectors(normals), signed, 0.8, &Control::default()).unwrap()
        };
        let flipped: Vec<Point> =
            normals.iter().enumerate().map(|(i, n)| if i % 3 == 0 { n.map(|v| -v) } else { *n }).collect();
        assert!(described(&flipped, false).iter().zip(described(&normals, false)).all(|(a, b)| (a - b).abs() < 1e-3));
        assert!(described(&flipped, true) != ours);
    }

    #[test]
    fn angles_are_exact_enough_in_every_quadrant() {
        // At -π the sign of a rounding error decides.
        for i in 1..1000 {
            let angle = (i as f32 / 1000.0 - 0.5) * 2.0 * PI;
            assert!((atan2(3.0 * angle.sin(), 3.0 * angle.cos()) - angle).abs() < 2e-3, "{angle}");
        }
    }

    #[test]
    fn bad_input_is_refused() {
        let up = [[0.0, 0.0, 1.0]; 3];
        assert!(fpfh(&[], &[], 1.0).is_err());
        assert!(fpfh(&up, &up[..2], 1.0).unwrap_err().to_string().contains("2 for 3 points"));
        assert!(fpfh(&up, &[[f32::NAN; 3]; 3], 1.0).unwrap_err().to_string().contains("normals"));
        assert!(fpfh(&up, &up, -1.0).unwrap_err().to_string().contains("radius"));
        // One point repeated: every pair falls into the middle bins.
        assert!(fpfh(&up, &up, 1.0).unwrap().iter().all(|v| v.is_finite()));
    }
}
