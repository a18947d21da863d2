//! What a sensor sees of a cloud: the distance to the first surface in every direction.

use std::collections::HashMap;

use snake_geometry::Vector;

/// The resolution and the tolerances of a depth image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sharpness {
    /// Width of a pixel in radians, for a viewpoint within the cloud.
    pixel: f64,
    /// Tangent of the greatest angle between a surface's normal and the line of sight. Within a
    /// pixel, the distance of a surface varies by up to this multiple of the pixel's width.
    slant: f64,
    /// A point also lowers the depth of pixels up to this many pixels away.
    reach: i32,
}

/// For comparing transforms: quick to make, and tolerant of a sensor that moved.
pub(crate) const COARSE: Sharpness = Sharpness { pixel: 0.05, slant: 4.0, reach: 0 };
/// For judging one transform: it shows smaller violations. At an edge, a pixel has the depth of the
/// nearer surface, so a small error of the sensor's position does not count.
pub(crate) const FINE: Sharpness = Sharpness { pixel: 0.03, slant: 2.0, reach: 1 };

/// Distinguishes points that one sensor saw from points seen from several places.
pub(crate) const SHARP: Sharpness = Sharpness { pixel: 0.01, slant: 2.0, reach: 0 };

/// The smallest distance from a viewpoint to a cloud in each direction.
pub(crate) struct DepthImage {
    pub(crate) viewpoint: Vector,
    pixel: f64,
    slant: f64,
    margin: f64,
    depths: HashMap<[i32; 2], f64>,
}

/// Where a point lies on its line of sight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sight {
    /// The cloud has no surface in this direction.
    Unknown,
    /// In front of the first surface: the sensor looked through this point.
    Free,
    /// On the first surface.
    Surface,
    /// Behind it.
    Hidden,
}

impl DepthImage {
    /// Distances are compared with a tolerance: `margin` (cloud units) plus the depth range of a
    /// slanted surface within a pixel.
    pub(crate) fn new(points: &[Vector], viewpoint: Vector, margin: f64, sharpness: Sharpness) -> Self {
        let center = points.iter().sum::<Vector>() / points.len().max(1) as f64;
        let radius = points.iter().map(|point| (point - center).norm()).fold(0.0, f64::max);
        // A cloud that is seen from afar appears small, so its pixels are smaller.
        let Sharpness { pixel, slant, reach } = sharpness;
        let pixel = pixel * (radius / (center - viewpoint).norm()).clamp(1e-6, 1.0);
        let mut image = Self { viewpoint, pixel, slant, margin, depths: HashMap::new() };
        for point in points {
            let (row, azimuth, depth) = image.direction(point);
            for row in row - reach..=row + reach {
                let column = image.column(row, azimuth);
                for column in column - reach..=column + reach {
                    image.depths.entry([row, column]).and_modify(|least| *least = least.min(depth)).or_insert(depth);
                }
            }
        }
        image
    }

    pub(crate) fn sight(&self, point: &Vector) -> Sight {
        let (row, azimuth, depth) = self.direction(point);
        let Some(&first) = self.depths.get(&[row, self.column(row, azimuth)]) else { return Sight::Unknown };
        let tolerance = |depth: f64| self.margin + self.slant * self.pixel * depth;
        if depth > first + tolerance(first) {
            Sight::Hidden
        } else if depth < first - tolerance(depth) {
            Sight::Free
        } else {
            Sight::Surface
        }
    }

    /// The share of the points, 0 to 1, that lie on the first surface.
    pub(crate) fn visible_share(&self, points: &[Vector]) -> f64 {
        let visible = points.iter().filter(|point| self.sight(point) == Sight::Surface).count();
        visible as f64 / points.len().max(1) as f64
    }

    /// The row of a point's pixel (elevation), its azimuth and its distance.
    fn direction(&self, point: &Vector) -> (i32, f64, f64) {
        let offset = point - self.viewpoint;
        let depth = offset.norm();
        let elevation = (offset.z / depth.max(f64::MIN_POSITIVE)).asin();
        ((elevation / self.pixel).floor() as i32, offset.y.atan2(offset.x), depth)
    }

    /// The column of an azimuth. Rows near the poles have fewer pixels, so all pixels have about the same area.
    fn column(&self, row: i32, azimuth: f64) -> i32 {
        (azimuth * ((f64::from(row) + 0.5) * self.pixel).cos().abs() / self.pixel).floor() as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall at x = 3 that ends at y = 0, before a wall at x = 5, seen from the origin.
    fn walls() -> Vec<Vector> {
        let grid = (-60..60).flat_map(|y| (-60..60).map(move |z| (0.05 * f64::from(y), 0.05 * f64::from(z))));
        grid.map(|(y, z)| Vector::new(if y < 0.0 { 3.0 } else { 5.0 }, y, z)).collect()
    }

    #[test]
    fn a_fine_image_sees_smaller_violations_but_none_at_edges() {
        let [coarse, fine] = [COARSE, FINE].map(|sharpness| DepthImage::new(&walls(), Vector::zeros(), 0.1, sharpness));
        let far = Vector::new(4.5, 1.0, 0.0);
        assert_eq!([coarse.sight(&far), fine.sight(&far)], [Sight::Surface, Sight::Free]);
        // Less than a pixel beside the edge of the front wall, and behind it.
        let edge = Vector::new(3.5, 0.03, 0.02);
        assert_eq!([coarse.sight(&edge), fine.sight(&edge)], [Sight::Free, Sight::Hidden]);
        assert!(walls().iter().all(|point| fine.sight(point) != Sight::Free));
    }
}
