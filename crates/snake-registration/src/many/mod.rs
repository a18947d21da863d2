//! The poses of many clouds: registrations of pairs, checked by loops, in a robust pose graph.

mod alone;
mod candidates;
mod graph;
mod loops;
mod pose_graph;
mod priors;
mod refine;
mod result;
mod solved;
#[cfg(test)]
mod tests;

use std::time::Instant;

use rayon::prelude::*;

use snake_core::{Control, Error, Model, Result};
use snake_geometry::{Point, RigidTransform};

use crate::options::{AlignOptions, AlignPriors, PairOptions, RegisterOptions};
use crate::register::tries::{Effort, Search};
use crate::result::Registration;
use crate::steps::describe::describe_cloud;
use crate::steps::judge::less_confident;
use crate::steps::judge::units_note;
use crate::steps::prepare::{Given, Pyramid};
use crate::steps::{Pair, PreparedCloud};
use alone::registered_alone;
use priors::{Checked, Priors};
pub use result::{Alignment, Contradiction, Edge, Pose};
use solved::{Solved, believed, solve};

/// Number of clouds, at most: the poses are solved for in one dense matrix. Set by hand.
const MAX_CLOUDS: usize = 500;
/// Number of pairs without a reliable transform that get a second look, for each part that they would join to others.
/// Set for time.
const SECOND_LOOKS: usize = 3;

/// Finds the poses of clouds `(N, 3)` that overlap in part, without initial guesses.
///
/// All clouds have the same units. Pairs with similar descriptors are registered as by
/// [`register`](crate::register()), whose verdict decides: a transform counts if it is reliable, or if
/// it is not ambiguous and loops of three transforms prove it. The poses fit these transforms, each weighed by its information matrix;
/// those that contradict the others lose their weight. Clouds that no chain of transforms links are
/// in different parts. A detector or descriptor that runs a model gets it from [`align_with`].
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

/// [`align`] with what is known of the clouds, with the model of the detector `snake` or the
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
    check_count(clouds.len())?;
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
    let mut checked = Checked::default();
    let mut left_out = Vec::new();
    // What poses were given for is judged with them.
    let mut judged = |registered: Vec<Registered>| {
        let mut pairs = believed(&pyramid, &registered);
        pairs.retain(|pair| !priors.has(*pair));
        registered_alone(&given, registered, &pairs, &mut left_out, control)
    };
    let registered = priors.filter(register_pairs(&pyramid, &priors, &free, options, control)?, &mut checked);
    let mut solved = solve(&pyramid, judged(registered)?, options, control)?;
    let closer = priors.filter(look_again(&pyramid, &solved, options, control)?, &mut checked);
    let closer = judged(closer)?;
    solved = solved.with(closer, &pyramid, options, control)?;
    // The poses say which other clouds overlap, and where.
    let guided = solved.guesses(&pyramid);
    let more = register_pairs(&pyramid, &priors, &guided, options, control)?;
    solved = solved.with(priors.filter(more, &mut checked), &pyramid, options, control)?;
    let (edges, poses) = (solved.edges(), solved.poses());
    let poses_note = priors.note(&checked);
    let mut contradictions: Vec<Contradiction> = checked.contradictions.into_values().collect();
    contradictions.retain(|at| edges.iter().all(|edge| (edge.source, edge.target) != (at.source, at.target)));
    contradictions.sort_by_key(|contradiction| (contradiction.source, contradiction.target));
    left_out.retain(|(pair, _)| edges.iter().all(|edge| [edge.source, edge.target] != *pair));
    left_out.sort();
    let left_out = left_out.into_iter().map(|(_, note)| note);
    let notes =
        poses_note.into_iter().chain(missing_notes(clouds)).chain(units_notes(clouds)).chain(left_out).collect();
    Ok(Alignment {
        poses,
        parts: solved.parts.into_iter().map(|part| part.clouds).collect(),
        edges,
        contradictions,
        notes,
        num_pairs: free.len() + guided.len(),
        num_skipped: clouds.iter().map(|cloud| cloud.num_skipped).collect(),
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Refuses too few or too many clouds.
fn check_count(count: usize) -> Result<()> {
    if !(2..=MAX_CLOUDS).contains(&count) {
        return Err(Error::Input { what: "clouds", reason: format!("{count} of them; needed are 2 to {MAX_CLOUDS}") });
    }
    Ok(())
}

/// Notes on missing returns, which were left out of the clouds.
fn missing_notes(clouds: &[PreparedCloud]) -> impl Iterator<Item = String> {
    let indexed = clouds.iter().enumerate();
    indexed.flat_map(|(index, cloud)| {
        cloud.missing.iter().map(move |words| format!("cloud {index} (from 0): {words}; they are left out"))
    })
}

/// A question about the units of each cloud whose size differs much from that of the median one.
fn units_notes(clouds: &[PreparedCloud]) -> Vec<String> {
    let mut diameters: Vec<f64> = clouds.iter().map(|cloud| cloud.diameter).collect();
    diameters.sort_by(f64::total_cmp);
    let median = diameters[(diameters.len() - 1) / 2];
    let note = |(index, cloud): (usize, &PreparedCloud)| {
        Some(format!("cloud {index} (from 0): {}", units_note([cloud.diameter, median])?))
    };
    clouds.iter().enumerate().filter_map(note).collect()
}

/// Computes the descriptors of every cloud that its pairs will need.
fn describe_all(clouds: &[PreparedCloud], control: &Control) -> Result<()> {
    let counter = control.begin("descriptors", clouds.len());
    let inner = control.without_progress();
    clouds.par_iter().try_for_each(|cloud| {
        counter.check()?;
        describe_cloud(cloud, cloud.viewpoint.is_some(), &inner)?;
        counter.add(1);
        Ok(())
    })
}

/// Source and target with the transform to start from, if there is one.
type Trial = ([usize; 2], Option<RigidTransform>);
/// Source and target with their registration.
type Registered = ([usize; 2], Registration);

/// The registrations of all pairs for which there is a transform.
fn register_pairs(
    pyramid: &Pyramid,
    priors: &Priors,
    pairs: &[Trial],
    options: &RegisterOptions,
    control: &Control,
) -> Result<Vec<Registered>> {
    register_each("pairs", pairs, control, |([source, target], guess), control| {
        let scale = pyramid.common(&[*source, *target]);
        let [from, to] = [source, target].map(|&cloud| pyramid.cloud(cloud, scale));
        let pair = Pair::new(from, to, options.gravity);
        let registration = match guess {
            Some(_) => {
                let guessed = PairOptions::default().with_initial(*guess);
                Search::new(&pair, options, &guessed, Effort::Usual, control).register()
            }
            None => priors.register([*source, *target], &pair, options, control),
        };
        registration.map(|registration| Some(([*source, *target], registration)))
    })
}

/// Registers the most confident of the pairs that are not reliable and would join parts again: a few
/// for each part, of clouds that have finer voxels, with the cost of that try.
fn look_again(
    pyramid: &Pyramid,
    solved: &Solved,
    options: &RegisterOptions,
    control: &Control,
) -> Result<Vec<Registered>> {
    let joining = solved.joining(SECOND_LOOKS);
    register_each("finer voxels", &joining, control, |(clouds, first), control| {
        let scale = pyramid.common(clouds);
        let [Some(source), Some(target)] = clouds.map(|cloud| pyramid.finer(cloud, scale)) else { return Ok(None) };
        let (pair, free) = (Pair::new(source, target, options.gravity), PairOptions::default());
        let search = Search::new(&pair, options, &free, Effort::Usual, control);
        let finer = Search { guesses: &[first.t_target_source], ..search }.register()?;
        Ok(Some((*clouds, less_confident(finer))))
    })
}

/// The registrations of what is tried, without those for which there is no transform.
fn register_each<T: Sync>(
    stage: &'static str,
    trials: &[T],
    control: &Control,
    register: impl Fn(&T, &Control) -> Result<Option<Registered>> + Sync,
) -> Result<Vec<Registered>> {
    let counter = control.begin(stage, trials.len());
    let inner = control.without_progress();
    let one = |trial: &T| {
        counter.check()?;
        let registration = register(trial, &inner);
        counter.add(1);
        match registration {
            // No three matches agree: these clouds do not fit.
            Err(Error::NoTransform { .. }) => Ok(None),
            other => other,
        }
    };
    let registered: Vec<Option<Registered>> = trials.par_iter().map(one).collect::<Result<_>>()?;
    Ok(registered.into_iter().flatten().collect())
}
