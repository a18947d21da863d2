//! The poses of many clouds: registrations of pairs, checked by loops, in a robust pose graph.

mod candidates;
mod graph;
mod loops;
mod pose_graph;
mod priors;
mod progress;
mod refine;
mod result;
mod solved;
#[cfg(test)]
mod tests;

use std::time::Instant;

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Point, try_in_parallel};

use crate::cloud::lower_median;
use crate::options::{AlignOptions, AlignPriors, RegisterOptions};
use crate::steps::PreparedCloud;
use crate::steps::describe::describe_cloud;
use crate::steps::judge::units_note;
use crate::steps::prepare::{Given, Pyramid};
use priors::Priors;
use progress::Progress;
pub use result::{Alignment, Contradiction, Edge, Pose};
use solved::Trial;

/// Number of clouds, at most: one dense matrix solves for all poses. Set by hand.
const MAX_CLOUDS: usize = 500;

/// Finds the poses of clouds `(N, 3)` that overlap in part, without initial guesses.
///
/// All clouds have the same units. Pairs with similar descriptors are registered as by
/// [`register`](crate::register()), whose verdict decides: a transform is used if it is reliable, or if it is not
/// ambiguous and loops of three transforms confirm it. The poses fit these transforms, each weighted by its
/// information matrix. Transforms that contradict the others lose their weight. Clouds that no chain of transforms
/// links are in different parts. [`align_with`] takes the model for a detector or descriptor that runs one.
///
/// ```
/// use snake_core::RigidTransform;
/// use snake_registration::{RegisterOptions, align, transform_points};
/// # let whole = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_second_first = RigidTransform::from_matrix(rows)?;
/// let first = whole[..2048].to_vec();
/// let second = transform_points(&t_second_first, &whole[2048..]);
/// let alignment = align(&[first, second], &RegisterOptions::default())?;
/// let (angle, distance) = alignment.poses[1].t_part_cloud.angle_and_distance_to(&t_second_first.inverse());
/// assert!(alignment.parts == [[0, 1]] && angle < 0.05 && distance < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`] for fewer than 2 or more than 500 clouds, and for a cloud without finite points
/// or without extent; [`Error::Option`] when an option is outside its range or needs a model.
/// Clouds that fit no other cloud are no error.
pub fn align(clouds: &[impl AsRef<[Point]> + Sync], options: &RegisterOptions) -> Result<Alignment> {
    align_with(clouds, &AlignPriors::default(), None, options, &AlignOptions::default(), &Control::default())
}

/// [`align`] with prior knowledge of the clouds, with the model for the detector `snake` or the
/// descriptor `field`, and with progress and cancellation.
///
/// # Errors
/// The errors of [`align`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn align_with(
    clouds: &[impl AsRef<[Point]> + Sync],
    known: &AlignPriors,
    model: Option<&Model>,
    options: &RegisterOptions,
    align_options: &AlignOptions,
    control: &Control,
) -> Result<Alignment> {
    let start = Instant::now();
    options.check_ranges()?;
    align_options.check_ranges()?;
    if !(2..=MAX_CLOUDS).contains(&clouds.len()) {
        let reason = format!("{} of them; needed are 2 to {MAX_CLOUDS}", clouds.len());
        return Err(Error::Input { what: "clouds", reason });
    }
    known.check(clouds.len())?;
    let inner = control.without_progress();
    control.begin("clouds", 0).check()?;
    let points = clouds.iter().map(AsRef::as_ref).collect();
    let given = Given { points, names: &[], viewpoints: known.viewpoints.clone(), model, options };
    let pyramid = Pyramid::new(&given, &inner)?;
    let priors = Priors::new(&known.initial_poses, align_options.pose_tolerance, &given, &pyramid)?;
    let clouds = pyramid.usual();
    describe_all(clouds, control)?;
    let count = align_options.max_partners;
    let pairs = priors.choose(candidates::pairs(clouds, count, &inner)?, count);
    let free: Vec<Trial> = pairs.into_iter().map(|pair| (pair, None)).collect();
    let mut progress = Progress::new(&given, &pyramid, &priors, control);
    let solved = progress.first_look(&free)?;
    let solved = progress.second_look(solved)?;
    let (solved, num_guided) = progress.by_poses(solved)?;
    Ok(Alignment {
        poses: solved.poses(),
        edges: solved.edges(),
        notes: progress.notes(&solved),
        contradictions: progress.contradictions(&solved),
        parts: solved.parts.into_iter().map(|part| part.clouds).collect(),
        num_pairs: free.len() + num_guided,
        num_skipped: clouds.iter().map(|cloud| cloud.num_skipped).collect(),
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Notes on missing returns, which were left out of the clouds.
fn missing_notes(clouds: &[PreparedCloud]) -> impl Iterator<Item = String> {
    let indexed = clouds.iter().enumerate();
    indexed.flat_map(|(index, cloud)| {
        cloud.missing.iter().map(move |words| format!("cloud {index} (from 0): {words}; they are left out"))
    })
}

/// A question about the units of each cloud whose size differs much from that of the median cloud.
fn units_notes(clouds: &[PreparedCloud]) -> Vec<String> {
    let median = lower_median(&clouds.iter().map(|cloud| cloud.diameter).collect::<Vec<_>>());
    let note = |(index, cloud): (usize, &PreparedCloud)| {
        Some(format!("cloud {index} (from 0): {}", units_note([cloud.diameter, median])?))
    };
    clouds.iter().enumerate().filter_map(note).collect()
}

/// Computes the descriptors of every cloud that its pairs will need.
fn describe_all(clouds: &[PreparedCloud], control: &Control) -> Result<()> {
    let counter = control.begin("descriptors", clouds.len());
    let inner = control.without_progress();
    let described = try_in_parallel(clouds.iter(), |cloud| {
        counter.check()?;
        describe_cloud(cloud, cloud.viewpoint.is_some(), &inner)?;
        counter.add(1);
        Ok(())
    });
    described.map(drop)
}
