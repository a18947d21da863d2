//! Refinement: queries climb the saliency field (SNAKE Algorithm 1).

use super::occupied::Occupied;
use crate::Result;
use crate::control::{Control, Counter};
use crate::field::{Field, Quantity};
use crate::lattice::Refined;
use crate::network::layers::TILE;
use crate::options::{DetectOptions, RefineMethod, Selection};
use snake_geometry::{Point, try_chunks_in_parallel};

/// Moves each query by `refine_steps` steps and selects a position and a score for it.
///
/// Queries are independent. Only Adam uses the gradient of the *mean* saliency, which is each query's
/// own gradient divided by the number of queries. Each tile therefore makes all its steps on one thread.
pub(crate) fn refine(
    field: &Field,
    queries: &Occupied,
    options: &DetectOptions,
    control: &Control,
) -> Result<Vec<Refined>> {
    let Occupied { positions, occupancy } = queries;
    let number = positions.len();
    let counter = control.begin("refinement", number * (options.refine_steps + 1));
    let mut refined = vec![Refined::default(); number];
    try_chunks_in_parallel(&mut refined, TILE, &|place, refined| {
        let positions = &positions[place * TILE..][..refined.len()];
        let occupancy = occupancy.get(place * TILE..).unwrap_or_default();
        let tile = Tile { positions, occupancy: &occupancy[..occupancy.len().min(positions.len())] };
        refine_tile(field, tile, number, options, &counter, refined)
    })?;
    Ok(refined)
}

/// The queries of a tile, with their occupancy if it is known.
struct Tile<'a> {
    positions: &'a [Point],
    occupancy: &'a [f32],
}

/// Positions of a tile's queries at successive steps, with their saliency.
struct Trajectory {
    /// Number of queries of the tile.
    num_queries: usize,
    /// Ordered by step: query q after s steps is at index `s * num_queries + q`.
    positions: Vec<Point>,
    saliency: Vec<f32>,
}

impl Trajectory {
    fn new(num_queries: usize, num_steps: usize) -> Self {
        let length = num_queries * num_steps;
        Self { num_queries, positions: Vec::with_capacity(length), saliency: Vec::with_capacity(length) }
    }

    fn push(&mut self, positions: &[Point], saliency: &[f32]) {
        self.positions.extend_from_slice(positions);
        self.saliency.extend_from_slice(saliency);
    }
}

fn refine_tile(
    field: &Field,
    Tile { positions: queries, occupancy }: Tile,
    num_queries: usize,
    options: &DetectOptions,
    counter: &Counter,
    refined: &mut [Refined],
) -> Result<()> {
    let mut positions = queries.to_vec();
    let mut trajectory = Trajectory::new(queries.len(), options.refine_steps + 1);
    let mut ascent = Ascent::new(queries.len(), num_queries, options);
    for _ in 0..options.refine_steps {
        counter.check()?;
        let (saliency, gradient) = field.tile_values_and_gradients(Quantity::Saliency, &positions);
        trajectory.push(&positions, &saliency);
        ascent.step(&mut positions, &gradient);
        counter.add(queries.len());
    }
    counter.check()?;
    match options.selection {
        Selection::ReferenceFinalPosition if options.refine_steps > 0 => {
            best_on_surface(field, &trajectory, occupancy, options, refined);
            refined.iter_mut().zip(positions.iter()).for_each(|(best, &position)| best.position = position);
        }
        _ => {
            trajectory.push(&positions, &field.tile_values(Quantity::Saliency, &positions));
            best_on_surface(field, &trajectory, occupancy, options, refined);
        }
    }
    counter.add(queries.len());
    Ok(())
}

/// Finds the most salient position on the surface along each query's trajectory; the first of equally salient ones.
///
/// Occupancy is evaluated in order of falling saliency, until a position lies on the surface or its saliency
/// is too low for a keypoint. The result is the same as if the occupancy of all positions were known, but
/// most queries need no evaluation. `start_occupancy` is the occupancy of the first positions, or empty.
fn best_on_surface(
    field: &Field,
    trajectory: &Trajectory,
    start_occupancy: &[f32],
    options: &DetectOptions,
    best: &mut [Refined],
) {
    let &Trajectory { num_queries, ref positions, ref saliency } = trajectory;
    let num_steps = positions.len() / num_queries;
    // The number of salient steps of each query, and these steps in order of falling saliency.
    let (mut counts, mut ranked) = (vec![0; best.len()], vec![0; best.len() * num_steps]);
    for (query, (best, ranked)) in best.iter_mut().zip(ranked.chunks_exact_mut(num_steps)).enumerate() {
        *best = Refined { position: positions[query], score: 0.0 };
        let saliency = |step: usize| saliency[step * num_queries + query];
        let salient = (0..num_steps).filter(|&step| saliency(step) > options.saliency_threshold);
        counts[query] = ranked.iter_mut().zip(salient).map(|(rank, step)| *rank = step).count();
        ranked[..counts[query]].sort_unstable_by(|&a, &b| saliency(b).total_cmp(&saliency(a)).then(a.cmp(&b)));
    }
    // Positions are numbered as in the trajectory: the start positions come first.
    let is_unknown = |place: &usize| options.surface_threshold > 0.0 && *place >= start_occupancy.len();
    for rank in 0..num_steps {
        let is_open = |query: &usize| counts[*query] > rank;
        let open: Vec<usize> = (0..best.len()).filter(is_open).collect();
        let place = |query: usize| ranked[query * num_steps + rank] * num_queries + query;
        let unknown = open.iter().map(|&query| place(query)).filter(is_unknown);
        let unknown: Vec<Point> = unknown.map(|place| positions[place]).collect();
        let evaluated = field.tile_values(Quantity::Occupancy, &unknown);
        let mut evaluated = evaluated.iter();
        for query in open {
            let place = place(query);
            let occupancy = start_occupancy.get(place).or_else(|| evaluated.next());
            if occupancy.is_none_or(|occupancy| *occupancy > options.surface_threshold) {
                best[query] = Refined { position: positions[place], score: saliency[place] };
                counts[query] = 0;
            }
        }
    }
}

/// Gradient ascent of positions on the saliency.
pub(crate) struct Ascent {
    method: RefineMethod,
    step_size: f32,
    /// Number of queries of the cloud: Adam climbs their mean saliency.
    num_queries: usize,
    adam: Adam,
}

impl Ascent {
    /// The ascent of a tile of `num_positions` queries; the cloud has `num_queries`.
    pub(crate) fn new(num_positions: usize, num_queries: usize, options: &DetectOptions) -> Self {
        let step_size = options.refine_step_size;
        Self { method: options.refine_method, step_size, num_queries, adam: Adam::new(num_positions, step_size) }
    }

    /// Moves each position one step up the gradient of its saliency.
    pub(crate) fn step(&mut self, positions: &mut [Point], gradients: &[Point]) {
        match self.method {
            RefineMethod::Adam => self.adam.step(positions, gradients, -1.0 / self.num_queries as f32),
            RefineMethod::GradientDescent => {
                for (position, gradient) in positions.as_flattened_mut().iter_mut().zip(gradients.as_flattened()) {
                    *position += self.step_size * gradient;
                }
            }
        }
    }
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

    /// Moves the points one step down the gradient times `factor`.
    fn step(&mut self, points: &mut [Point], gradient: &[Point], factor: f32) {
        self.steps += 1;
        let (correct_mean, correct_variance) = (1.0 - 0.9_f64.powi(self.steps), 1.0 - 0.999_f64.powi(self.steps));
        let step = (f64::from(self.step_size) / correct_mean) as f32;
        let root = correct_variance.sqrt() as f32;
        let moments = self.mean.iter_mut().zip(self.variance.iter_mut());
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
