//! FPFH in `f32`, several times faster than the plain [`fpfh`](crate::fpfh()).

use std::f32::consts::{FRAC_PI_2, PI};

use rayon::prelude::*;

use crate::parts::fpfh::FPFH_DIMENSION;
use crate::parts::near_grid::NearGrid;
use snake_core::{Control, Result};
use snake_geometry::Vector;

const BINS: usize = FPFH_DIMENSION / 3;

type Histograms = [f32; FPFH_DIMENSION];

/// FPFH descriptors `(N, 33)`, flat, of points with unit normals.
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
    let simplified: Vec<Histograms> = points.par_iter().zip(&single).map(simplified).collect::<Result<_>>()?;
    let weighted = |(point, own): (&Vector, &Histograms)| {
        counter.add(1);
        counter.check().map(|()| weighted(&grid, &simplified, point, own))
    };
    let weighted: Vec<Histograms> = points.par_iter().zip(&simplified).map(weighted).collect::<Result<_>>()?;
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
/// With the unit vector u between the points, the normal n of the frame and the other normal m:
/// `v = u × n / L`, `w = n × v`, so `α = v·m = u·(n × m) / L` and `w·m = (u·m - (n·m)(u·n)) / L` with `L² = 1 - (u·n)²`.
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

/// The angle to within 2e-3 radians (a bin has 0.57), by a polynomial of the lesser ratio.
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
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::fpfh;
    use crate::parts::cloud::estimate_normals;
    use crate::parts::rigid::tests::random_points;
    use snake_geometry::vector;

    #[test]
    fn descriptors_are_those_of_the_plain_function() {
        let mut points = random_points(&mut ChaCha8Rng::seed_from_u64(5), 600);
        points.iter_mut().for_each(|p| p[2] = 0.3 * (3.0 * p[0]).sin() * p[1]);
        points.push([9.0; 3]);
        let normals = estimate_normals(&points, 0.3).unwrap();
        let plain = fpfh(&points, &normals, 0.5).unwrap();
        let vectors = |rows: &[[f32; 3]]| rows.iter().map(|&p| vector(p)).collect::<Vec<_>>();
        let of = |normals: &[[f32; 3]], signed| {
            descriptors(&vectors(&points), &vectors(normals), signed, 0.5, &Control::default()).unwrap()
        };
        let fast = of(&normals, true);
        assert_eq!(fast.len(), plain.len());
        // A pair near the edge of a bin may change bins by rounding; a bin holds up to 200.
        let close = fast.iter().zip(&plain).filter(|(a, b)| (**a - **b).abs() < 1.0).count();
        assert!(close as f64 > 0.999 * plain.len() as f64, "{close} of {}", plain.len());
        // Signs of normals do not matter where they have none.
        let flipped: Vec<_> =
            normals.iter().enumerate().map(|(i, n)| if i % 3 == 0 { n.map(|v| -v) } else { *n }).collect();
        assert!(of(&flipped, false).iter().zip(of(&normals, false)).all(|(a, b)| (a - b).abs() < 1e-3));
        assert!(of(&flipped, true) != fast);
    }

    #[test]
    fn angles_are_exact_enough_in_every_quadrant() {
        // At -π the sign of a rounding error decides.
        for i in 1..1000 {
            let angle = (i as f32 / 1000.0 - 0.5) * 2.0 * PI;
            assert!((atan2(3.0 * angle.sin(), 3.0 * angle.cos()) - angle).abs() < 2e-3, "{angle}");
        }
    }
}
