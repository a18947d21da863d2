//! Refinement: queries climb the saliency field (SNAKE Algorithm 1).

use rayon::prelude::*;

use crate::Result;
use crate::control::{Control, Counter};
use crate::field::{Field, Quantity};
use crate::nn::TILE;
use crate::options::{DetectOptions, RefineMethod, Selection};
use crate::points::Point;

/// A refined query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Refined {
    /// In the network's frame.
    pub(crate) position: Point,
    /// Saliency. It is 0 unless saliency and occupancy are above their thresholds.
    pub(crate) score: f32,
}

/// Moves each query by `refine_steps` steps and selects a position and a score for it.
///
/// Queries are independent, except that Adam's gradient is that of the *mean* saliency: each query's own gradient divided
/// by their number. A tile therefore makes all its steps on one thread.
pub(crate) fn refine(
    field: &Field,
    queries: &[Point],
    options: &DetectOptions,
    control: &Control,
) -> Result<Vec<Refined>> {
    let counter = control.begin("refinement", queries.len() * (options.refine_steps + 1));
    let refined = |tile| refine_tile(field, tile, queries.len(), options, &counter);
    let tiles: Vec<Vec<Refined>> = queries.par_chunks(TILE).map(refined).collect::<Result<_>>()?;
    Ok(tiles.concat())
}

/// Positions of a tile's queries after some steps, with their saliency.
struct Step {
    positions: Vec<Point>,
    saliency: Vec<f32>,
}

fn refine_tile(
    field: &Field,
    queries: &[Point],
    num_queries: usize,
    options: &DetectOptions,
    counter: &Counter,
) -> Result<Vec<Refined>> {
    let mut positions = queries.to_vec();
    let mut trajectory = Vec::with_capacity(options.refine_steps + 1);
    let mut adam = Adam::new(queries.len(), options.refine_step_size);
    for _ in 0..options.refine_steps {
        counter.check()?;
        let (saliency, gradient) = field.tile_values_and_gradients(Quantity::Saliency, &positions);
        trajectory.push(Step { positions: positions.clone(), saliency });
        match options.refine_method {
            RefineMethod::Adam => adam.step(&mut positions, &gradient, -1.0 / num_queries as f32),
            RefineMethod::GradientDescent => {
                for (position, gradient) in positions.as_flattened_mut().iter_mut().zip(gradient.as_flattened()) {
                    *position += options.refine_step_size * gradient;
                }
            }
        }
        counter.add(queries.len());
    }
    counter.check()?;
    let selected = match options.selection {
        Selection::ReferenceFinalPosition if options.refine_steps > 0 => {
            let mut best = best_on_surface(field, &trajectory, options);
            best.iter_mut().zip(positions).for_each(|(best, position)| best.position = position);
            best
        }
        _ => {
            let saliency = field.tile_values(Quantity::Saliency, &positions);
            trajectory.push(Step { positions, saliency });
            best_on_surface(field, &trajectory, options)
        }
    };
    counter.add(queries.len());
    Ok(selected)
}

/// For each query of a tile, the most salient position of its trajectory that lies on the surface; the first of several.
///
/// Occupancy is evaluated by falling saliency, until a position lies on the surface or its saliency is too low for a
/// keypoint. The result is the same as with the occupancy of all positions, and most queries need none.
fn best_on_surface(field: &Field, trajectory: &[Step], options: &DetectOptions) -> Vec<Refined> {
    let mut best: Vec<Refined> =
        trajectory[0].positions.iter().map(|&position| Refined { position, score: 0.0 }).collect();
    // The queries without a result, each with its steps by falling saliency.
    let mut open: Vec<(usize, Vec<&Step>)> = (0..best.len())
        .map(|query| {
            let salient = |step: &&Step| step.saliency[query] > options.saliency_threshold;
            let mut steps: Vec<&Step> = trajectory.iter().filter(salient).collect();
            steps.sort_by(|a, b| b.saliency[query].total_cmp(&a.saliency[query]));
            (query, steps)
        })
        .collect();
    for rank in 0..trajectory.len() {
        open.retain(|(_, steps)| rank < steps.len());
        let positions: Vec<Point> = open.iter().map(|(query, steps)| steps[rank].positions[*query]).collect();
        let mut occupancy = field.tile_values(Quantity::Occupancy, &positions).into_iter();
        open.retain(|(query, steps)| {
            let on_surface = occupancy.next().is_some_and(|occupancy| occupancy > options.surface_threshold);
            if on_surface {
                let step = steps[rank];
                best[*query] = Refined { position: step.positions[*query], score: step.saliency[*query] };
            }
            !on_surface
        });
    }
    best
}

/// Adam (β 0.9 and 0.999, ε 1e-8) on a tile of points, in the order of operations of the reference.
struct Adam {
    step_size: f32,
    steps: i32,
    mean: Vec<f32>,
    variance: Vec<f32>,
}

impl Adam {
    fn new(num_points: usize, step_size: f32) -> Self {
        Self { step_size, steps: 0, mean: vec![0.0; 3 * num_points], variance: vec![0.0; 3 * num_points] }
    }

    /// One step down the gradient times `factor`.
    fn step(&mut self, points: &mut [Point], gradient: &[Point], factor: f32) {
        self.steps += 1;
        let (correct_mean, correct_variance) = (1.0 - 0.9_f64.powi(self.steps), 1.0 - 0.999_f64.powi(self.steps));
        let step = (f64::from(self.step_size) / correct_mean) as f32;
        let root = correct_variance.sqrt() as f32;
        let moments = self.mean.iter_mut().zip(&mut self.variance);
        for ((value, gradient), (mean, variance)) in
            points.as_flattened_mut().iter_mut().zip(gradient.as_flattened()).zip(moments)
        {
            let gradient = gradient * factor;
            *mean += (gradient - *mean) * 0.1;
            *variance = *variance * 0.999 + gradient * gradient * 0.001;
            *value -= step * (*mean / (variance.sqrt() / root + 1e-8));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Algorithm 1 as printed: saliency and occupancy of every position.
    fn textbook(field: &Field, queries: &[Point], options: &DetectOptions) -> Vec<Refined> {
        let mut best: Vec<Refined> = queries.iter().map(|&position| Refined { position, score: -1.0 }).collect();
        let mut positions = queries.to_vec();
        let mut adam = Adam::new(queries.len(), options.refine_step_size);
        for step in 0..=options.refine_steps {
            let (saliency, gradient) = field.tile_values_and_gradients(Quantity::Saliency, &positions);
            let occupancy = field.tile_values(Quantity::Occupancy, &positions);
            for (i, best) in best.iter_mut().enumerate() {
                let kept = saliency[i] > options.saliency_threshold && occupancy[i] > options.surface_threshold;
                let score = if kept { saliency[i] } else { 0.0 };
                if score > best.score {
                    *best = Refined { position: positions[i], score };
                }
            }
            if step < options.refine_steps {
                adam.step(&mut positions, &gradient, -1.0 / queries.len() as f32);
            }
        }
        best
    }

    #[test]
    fn refinement_equals_algorithm_1() {
        let (points, field) = crate::detect::tests::cylinder();
        let queries: Vec<Point> = points[..TILE].iter().map(|p| p.map(|v| 0.45 * v)).collect();
        let mut outcomes = [0; 2];
        for (refine_steps, saliency_threshold) in [(0, 0.0), (6, 0.0), (6, 0.3), (3, 0.6)] {
            let options =
                DetectOptions { refine_steps, saliency_threshold, refine_step_size: 0.01, ..Default::default() };
            let found = refine(&field, &queries, &options, &Control::default()).unwrap();
            assert_eq!(found, textbook(&field, &queries, &options), "{refine_steps} {saliency_threshold}");
            found.iter().for_each(|refined| outcomes[usize::from(refined.score > 0.0)] += 1);
        }
        assert!(outcomes.iter().all(|&number| number > 10), "{outcomes:?}");
    }
}
