//! Points with their saliency in the data of the page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use snake_geometry::{Point, add_origin};

/// Quantised vertices. Positions have 16 bits within their bounding box, `low + (high - low) q / 65535`; saliency has
/// 8 bits within [0, 1]. The error is below a pixel of any screen, and the size is a third of that of floats.
#[derive(serde::Serialize)]
pub(crate) struct Vertices {
    count: usize,
    low: [f64; 3],
    high: [f64; 3],
    /// Little-endian, x y z of one vertex after another; base64.
    positions: String,
    /// One byte per vertex; base64.
    saliency: String,
}

impl Vertices {
    pub(crate) fn of(points: &[Point], origin: [f64; 3], saliency: &[f32]) -> Self {
        let along = |axis: usize, choose: fn(f64, f64) -> f64, start: f64| {
            points.iter().map(|point| add_origin(*point, origin)[axis]).fold(start, choose)
        };
        let low: [f64; 3] = std::array::from_fn(|axis| along(axis, f64::min, f64::INFINITY));
        let high: [f64; 3] = std::array::from_fn(|axis| along(axis, f64::max, f64::NEG_INFINITY));
        let quantised = |point: &Point| -> [[u8; 2]; 3] {
            std::array::from_fn(|axis| {
                let extent = (high[axis] - low[axis]).max(f64::MIN_POSITIVE);
                let share = (add_origin(*point, origin)[axis] - low[axis]) / extent;
                ((share * 65535.0).round() as u16).to_le_bytes()
            })
        };
        let positions: Vec<[[u8; 2]; 3]> = points.iter().map(quantised).collect();
        let saliency: Vec<u8> = saliency.iter().map(|s| (s * 255.0).round() as u8).collect();
        let positions = STANDARD.encode(positions.as_flattened().as_flattened());
        Self { count: points.len(), low, high, positions, saliency: STANDARD.encode(saliency) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_come_back_within_half_a_step() {
        let points = [[0.0, -5.0, 1e6], [1.0, 5.0, 1e6], [0.3, 0.1, 1e6]];
        let vertices = Vertices::of(&points, [0.0; 3], &[0.0, 1.0, 0.5]);
        let bytes = STANDARD.decode(&vertices.positions).unwrap();
        let (steps, _) = bytes.as_chunks::<2>();
        for (index, step) in steps.iter().enumerate() {
            let axis = index % 3;
            let extent = vertices.high[axis] - vertices.low[axis];
            let value = vertices.low[axis] + extent * f64::from(u16::from_le_bytes(*step)) / 65535.0;
            assert!((value - f64::from(points[index / 3][axis])).abs() <= extent / 65535.0, "{index}");
        }
        assert_eq!(STANDARD.decode(&vertices.saliency).unwrap(), [0, 255, 128]);
    }
}
