//! The poses of many clouds: registrations of pairs, checked by loops, in a robust pose graph.

mod candidates;
mod loops;
mod parts;
mod pose_graph;
mod refine;
mod result;
mod scales;
mod solved;
#[cfg(test)]
mod tests;

use std::time::Instant;

use rayon::prelude::*;

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Point, RigidTransform};

use super::result::Registration;
use crate::pair::Pair;
use crate::pair::prepared::Prepared;
use parts::Part;
pub use result::{AlignOptions, Alignment, Edge, Pose};
use scales::Scales;
use solved::{Solved, solve};

/// Finds the poses of clouds `(N, 3)` that overlap in part, without initial guesses.
///
/// All clouds have the same units. Pairs with similar descriptors are registered as by [`register`](crate::register()). A
/// transform counts if it is reliable, or if loops of three transforms prove it. The poses fit these transforms, each
/// weighed by its information matrix; those that contradict the others lose their weight. Clouds that no chain of
/// transforms links are in different parts. A detector or descriptor that runs a model gets it from [`align_with`].
///
/// ```
/// use snake_core::RigidTransform;
/// use snake_registration::{AlignOptions, align, transform_points};
/// # let whole = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_second_first = RigidTransform::from_matrix(rows)?;
/// let first = whole[..2048].to_vec();
/// let second = transform_points(&t_second_first, &whole[2048..]);
/// let found = align(&[first, second], &AlignOptions::default())?;
/// let (angle, distance) = found.poses[1].t_part_cloud.angle_and_distance_to(&t_second_first.inverse());
/// assert!(found.parts == [[0, 1]] && angle < 0.05 && distance < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`] for fewer than 2 or more than 500 clouds, and for a cloud without finite points or without extent;
/// [`Error::Option`] when an option is outside its range or needs a model. Clouds that fit no other cloud are no error.
pub fn align(clouds: &[impl AsRef<[Point]> + Sync], options: &AlignOptions) -> Result<Alignment> {
    align_with(clouds, None, options, &Control::default())
}

/// [`align`] with the model of the detector `snake` or the descriptor `field`, progress and cancellation; a classical detector is not interrupted.
///
/// # Errors
/// The errors of [`align`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn align_with(
    clouds: &[impl AsRef<[Point]> + Sync],
    model: Option<&Model>,
    options: &AlignOptions,
    control: &Control,
) -> Result<Alignment> {
    let start = Instant::now();
    let viewpoints = options.checked_viewpoints(clouds.len())?;
    let inner = control.without_progress();
    control.begin("clouds", 0).check()?;
    let points: Vec<&[Point]> = clouds.iter().map(AsRef::as_ref).collect();
    let scales = Scales::new(&points, &viewpoints, model, &options.register, &inner)?;
    let clouds = scales.usual();
    describe(clouds, control)?;
    let pairs = candidates::pairs(clouds, options.max_partners, &inner)?;
    let free: Vec<Trial> = pairs.into_iter().map(|pair| (pair, None)).collect();
    let found = register_pairs(&scales, &free, options, control)?;
    let first = solve(&scales, found, options, control)?;
    // The poses say which other clouds overlap, and where.
    let guided = first.guesses(&scales);
    let more = register_pairs(&scales, &guided, options, control)?;
    let Solved { found, kept, doubts, links, parts } = match more.iter().any(|(_, found)| found.is_reliable) {
        true => solve(&scales, first.with_reliable(more), options, control)?,
        false => first,
    };

    let edge = |(at, residual): &(usize, f64)| {
        let ([source, target], registration) = &found[kept[*at]];
        Edge {
            source: *source,
            target: *target,
            t_target_source: registration.t_target_source,
            confidence: registration.confidence,
            belief: 1.0 - doubts[*at],
            residual: *residual,
            information: registration.information,
        }
    };
    let mut edges: Vec<Edge> = parts.iter().flat_map(|part| part.links.iter().map(edge)).collect();
    edges.sort_by_key(|edge| (edge.source, edge.target));
    let variance = |part: &Part| {
        let squared = part.links.iter().map(|(at, _)| found[kept[*at]].1.fitness_rmse.powi(2));
        squared.sum::<f64>() / part.links.len().max(1) as f64
    };
    let mut poses: Vec<Option<Pose>> = vec![None; clouds.len()];
    for (index, part) in parts.iter().enumerate() {
        let covariances = part.covariances(&links, variance(part));
        for ((&cloud, pose), covariance) in part.clouds.iter().zip(&part.poses).zip(covariances) {
            let covariance = std::array::from_fn(|row| std::array::from_fn(|column| covariance[(row, column)]));
            poses[cloud] = Some(Pose { part: index, t_part_cloud: (*pose).into(), covariance });
        }
    }
    Ok(Alignment {
        poses: poses.into_iter().flatten().collect(),
        parts: parts.into_iter().map(|part| part.clouds).collect(),
        edges,
        num_pairs: free.len() + guided.len(),
        num_skipped: clouds.iter().map(|cloud| cloud.num_skipped).collect(),
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Computes the descriptors of every cloud that its pairs will need.
fn describe(clouds: &[Prepared], control: &Control) -> Result<()> {
    let counter = control.begin("descriptors", clouds.len());
    let inner = control.without_progress();
    clouds.par_iter().try_for_each(|cloud| {
        counter.check()?;
        cloud.descriptors(cloud.viewpoint.is_some(), &inner)?;
        counter.add(1);
        Ok(())
    })
}

/// Source and target with the transform to start from, if there is one.
type Trial = ([usize; 2], Option<RigidTransform>);
type Found = ([usize; 2], Registration);

/// The registrations of all pairs for which there is a transform.
fn register_pairs(scales: &Scales, pairs: &[Trial], options: &AlignOptions, control: &Control) -> Result<Vec<Found>> {
    let counter = control.begin("pairs", pairs.len());
    let inner = control.without_progress();
    let register = |&([source, target], guess): &Trial| {
        counter.check()?;
        let scale = scales.common(&[source, target]);
        let [from, to] = [source, target].map(|cloud| scales.cloud(cloud, scale));
        let options = options.register.with_initial(guess);
        let found = Pair::new(from, to, scales.inlier_distance(scale)).register(&options, &inner);
        counter.add(1);
        match found {
            Ok(found) => Ok(Some(([source, target], found))),
            // No three matches agree: these clouds do not fit.
            Err(Error::NoTransform { .. }) => Ok(None),
            Err(other) => Err(other),
        }
    };
    let found: Vec<Option<Found>> = pairs.par_iter().map(register).collect::<Result<_>>()?;
    Ok(found.into_iter().flatten().collect())
}
