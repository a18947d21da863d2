//! What a sensor sees of a cloud: the distance to the first surface in every direction.

use std::collections::HashMap;

use snake_core::space::Vector;

/// Width of a pixel in radians, for a viewpoint within the cloud.
const PIXEL: f64 = 0.05;
/// Tangent of the greatest angle between a surface's normal and the line of sight. Within a pixel, a surface's distance
/// varies by up to this share of the pixel's width.
const SLANT: f64 = 4.0;

/// The least distance from a viewpoint to a cloud in each direction.
pub(super) struct DepthImage {
    viewpoint: Vector,
    pixel: f64,
    margin: f64,
    depths: HashMap<[i32; 2], f64>,
}

/// Where a point lies on its line of sight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sight {
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
    /// Distances are compared with a tolerance of `margin` (cloud units) and the slant of a surface within a pixel.
    pub(super) fn new(points: &[Vector], viewpoint: Vector, margin: f64) -> Self {
        let center = points.iter().sum::<Vector>() / points.len().max(1) as f64;
        let radius = points.iter().map(|point| (point - center).norm()).fold(0.0, f64::max);
        // From afar the cloud is small, and so are its pixels.
        let pixel = PIXEL * (radius / (center - viewpoint).norm()).clamp(1e-6, 1.0);
        let mut image = Self { viewpoint, pixel, margin, depths: HashMap::new() };
        for point in points {
            let (pixel, depth) = image.project(point);
            image.depths.entry(pixel).and_modify(|least| *least = least.min(depth)).or_insert(depth);
        }
        image
    }

    pub(super) fn sight(&self, point: &Vector) -> Sight {
        let (pixel, depth) = self.project(point);
        let Some(&first) = self.depths.get(&pixel) else { return Sight::Unknown };
        let tolerance = |depth: f64| self.margin + SLANT * self.pixel * depth;
        if depth > first + tolerance(first) {
            Sight::Hidden
        } else if depth < first - tolerance(depth) {
            Sight::Free
        } else {
            Sight::Surface
        }
    }

    /// The share of the points, 0 to 1, that no surface hides.
    pub(super) fn visible_share(&self, points: &[Vector]) -> f64 {
        let visible = points.iter().filter(|point| self.sight(point) == Sight::Surface).count();
        visible as f64 / points.len().max(1) as f64
    }

    /// The pixel of a point (elevation and azimuth) and its distance.
    fn project(&self, point: &Vector) -> ([i32; 2], f64) {
        let offset = point - self.viewpoint;
        let depth = offset.norm();
        let elevation = (offset.z / depth.max(f64::MIN_POSITIVE)).asin();
        let azimuth = offset.y.atan2(offset.x);
        let row = (elevation / self.pixel).floor();
        // Rows near the poles have fewer pixels, so that all have about the same area.
        let column = (azimuth * ((row + 0.5) * self.pixel).cos().abs() / self.pixel).floor();
        ([row as i32, column as i32], depth)
    }
}
