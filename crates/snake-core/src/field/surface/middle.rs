//! The middle of a shell: the ridge of the occupancy, where the surface of the cloud lies.

use crate::Result;
use crate::control::Counter;
use crate::network::layers::TILE;
use snake_geometry::{Point, try_chunks_in_parallel};

/// Distance between two samples of the occupancy, in voxels. On the objects used for tuning, half of it gives equally accurate
/// surfaces, and twice as much less accurate ones.
const STEP: f32 = 0.25;

/// Maximum number of steps from the level to the middle, enough for a shell of four voxels.
const MAX_STEPS: usize = 8;

/// Moves each vertex of a shell against its normal to the first maximum of `value`.
///
/// `voxel_size` is in the units of the vertices.
pub(super) fn move_to_middle(
    vertices: &mut [Point],
    normals: &[[f32; 3]],
    voxel_size: f32,
    value: impl Fn(&[Point]) -> Vec<f32> + Sync,
    counter: &Counter,
) -> Result<()> {
    let step = STEP * voxel_size;
    try_chunks_in_parallel(vertices, TILE, &|tile, vertices| {
        let normals = &normals[tile * TILE..][..vertices.len()];
        counter.check()?;
        counter.add(vertices.len());
        let inwards = |(vertex, normal): (&Point, &[f32; 3]), distance: f32| -> Point {
            std::array::from_fn(|axis| vertex[axis] - distance * normal[axis])
        };
        let values_at = |steps: usize| {
            let moved = vertices.iter().zip(normals).map(|pair| inwards(pair, steps as f32 * step));
            value(&moved.collect::<Vec<_>>())
        };
        let steps = first_maxima(vertices.len(), values_at);
        for ((vertex, normal), steps) in vertices.iter_mut().zip(normals).zip(steps) {
            *vertex = inwards((vertex, normal), steps * step);
        }
        Ok(())
    })
}

/// The step of the first maximum of each of `number` functions, refined by a parabola through three values. It is `MAX_STEPS`
/// for a function without a maximum.
fn first_maxima(number: usize, values_at: impl Fn(usize) -> Vec<f32>) -> Vec<f32> {
    let (mut before, mut last) = (vec![f32::NEG_INFINITY; number], values_at(0));
    let mut maxima: Vec<Option<f32>> = vec![None; number];
    for steps in 1..=MAX_STEPS {
        let next = values_at(steps);
        for (i, maximum) in maxima.iter_mut().enumerate() {
            if maximum.is_none() && next[i] < last[i] {
                let (rise, fall) = (last[i] - before[i], last[i] - next[i]);
                // The first value has no predecessor.
                let offset = if steps == 1 { 0.0 } else { 0.5 * (rise - fall) / (rise + fall) };
                *maximum = Some((steps - 1) as f32 + offset);
            }
        }
        if maxima.iter().all(Option::is_some) {
            break;
        }
        (before, last) = (last, next);
    }
    maxima.into_iter().map(|maximum| maximum.unwrap_or(MAX_STEPS as f32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maxima_are_the_first_ones_and_lie_between_steps() {
        let functions: [&dyn Fn(f32) -> f32; 5] = [
            &|x| -(x - 2.7_f32).powi(2),
            &|x| -x,
            &|x| x,
            &|x| -(x - 5.0_f32).abs(),
            // A second, higher shell lies behind the first.
            &|x| if x < 4.0 { -(x - 1.2_f32).powi(2) } else { x },
        ];
        let maxima = first_maxima(5, |steps| functions.iter().map(|f| f(steps as f32)).collect());
        for (maximum, expected) in maxima.into_iter().zip([2.7, 0.0, MAX_STEPS as f32, 5.0, 1.2]) {
            assert!((maximum - expected).abs() < 1e-5, "{maximum} {expected}");
        }
    }

    #[test]
    fn both_sides_of_a_round_shell_move_to_its_ridge() {
        let radius = |point: &Point| point.iter().map(|v| v * v).sum::<f32>().sqrt();
        let value = |points: &[Point]| points.iter().map(|point| -(radius(point) - 1.0).powi(2)).collect();
        let directions: Vec<Point> = (0..300)
            .map(|i| {
                let (height, angle) = (1.0 - (i as f32 + 0.5) / 150.0, i as f32 * 2.4);
                let across = (1.0 - height * height).sqrt();
                [across * angle.cos(), across * angle.sin(), height]
            })
            .collect();
        for (from, sign) in [(1.05, 1.0), (0.95, -1.0)] {
            let mut vertices: Vec<Point> = directions.iter().map(|d| d.map(|v| v * from)).collect();
            let normals: Vec<[f32; 3]> = directions.iter().map(|d| d.map(|v| v * sign)).collect();
            let control = crate::control::Control::default();
            move_to_middle(&mut vertices, &normals, 0.07, value, &control.begin("middle", 300)).unwrap();
            assert!(vertices.iter().all(|vertex| (radius(vertex) - 1.0).abs() < 1e-4), "{from}");
        }
    }
}
