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

use std::collections::HashMap;
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
use crate::tuning::tuning;
use alone::registered_alone;
use priors::Priors;
pub use result::{Alignment, Contradiction, Edge, Pose};
use solved::{Solved, believed, solve};

tuning! {
    /// Number of clouds, at most: the poses are solved for in one dense matrix.
    max_clouds: usize = 500, unit "clouds", from "set by hand in 595368d";
    /// Number of visual words: groups of similar descriptors.
    words: usize = 64, unit "words", from "set by hand in 595368d";
    /// Number of descriptors of all clouds from which the words are made, at most.
    samples: usize = 16_000, unit "descriptors", from "set by hand in 595368d";
    /// Number of rounds of k-means.
    word_rounds: usize = 10, unit "rounds", from "set by hand in 595368d";
    /// A loop of three transforms is closed if it moves points by less than this.
    loop_distance: f64 = 3.0, unit "inlier distances", from "set by hand in 595368d";
    /// Links that contradict the others are dropped at once if their error is above this share of
    /// the greatest.
    dropped: f64 = 0.5, unit "share of the greatest error", from "set by hand in c6a0685";
    /// Number of steps with one set of robust weights.
    pose_steps: usize = 8, unit "steps", from "set by hand in 595368d";
    /// A link with a larger squared error has no weight; it is also the widest kernel. The poses
    /// start from the most reliable links, and without the limit some wrong links that agree with
    /// each other outvote them.
    widest: f64 = 100.0, unit "squared thresholds", from "set by hand in c6a0685";
    /// Factor by which the kernel narrows from one round to the next.
    narrowing: f64 = 1.6, unit "ratio of widths", from "set by hand in 595368d";
    /// A smaller step ends the round.
    pose_tolerance: f64 = 1e-7, unit "radians, and inlier distances", from "set by hand in 595368d";
    /// Damping of directions that no link fixes.
    min_damping: f64 = 1e-9, unit "share of the diagonal", from "set by hand in 595368d";
    /// Number of rounds of the last refinement, at most; each measures every pair of clouds again.
    refine_rounds: usize = 30, unit "rounds", from "set by hand in c6a0685";
    /// The last refinement ends when no cloud moves by more than this.
    refine_tolerance: f64 = 0.01, unit "inlier distances", from "set by hand in c6a0685";
    /// Clouds are registered from their poses if this share of the probes is close to the other
    /// cloud.
    min_overlap: f64 = 0.2, unit "share of the probes", from "set by hand in f9a1dee";
    /// Clouds refine the poses if this share of the probes is close to the other cloud.
    min_common: f64 = 0.1, unit "share of the probes", from "set by hand in c6a0685";
    /// Number of pairs without a reliable transform that get a second look, for each part that they
    /// would join to others.
    second_looks: usize = 3, unit "pairs", from "set for time";
    /// A transform contradicts initial poses if it moves the source farther from where they put it.
    /// A thing has at least twice its standard deviation in height, so that a storey is higher.
    prior_tolerance: f64 = 1.5, unit "least standard deviations of a cloud", from "set by hand";
    /// Points are close if they are nearer than this.
    overlap_distance: f64 = 2.0, unit "inlier distances", from "set by hand in f9a1dee";
}

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
    let mut contradictions = HashMap::new();
    let mut left_out = Vec::new();
    // What poses were given for is judged with them.
    let mut judged = |registered: Vec<Registered>| {
        let mut pairs = believed(&pyramid, &registered);
        pairs.retain(|pair| !priors.has(*pair));
        registered_alone(&given, registered, &pairs, &mut left_out, control)
    };
    let registered = priors.filter(register_pairs(&pyramid, &priors, &free, options, control)?, &mut contradictions);
    let mut solved = solve(&pyramid, judged(registered)?, options, control)?;
    let closer = priors.filter(look_again(&pyramid, &solved, options, control)?, &mut contradictions);
    let closer = judged(closer)?;
    solved = solved.with(closer, &pyramid, options, control)?;
    // The poses say which other clouds overlap, and where.
    let guided = solved.guesses(&pyramid);
    let more = register_pairs(&pyramid, &priors, &guided, options, control)?;
    solved = solved.with(priors.filter(more, &mut contradictions), &pyramid, options, control)?;
    let (edges, poses) = (solved.edges(), solved.poses());
    let mut contradictions: Vec<Contradiction> = contradictions.into_values().collect();
    contradictions.retain(|at| edges.iter().all(|edge| (edge.source, edge.target) != (at.source, at.target)));
    contradictions.sort_by_key(|contradiction| (contradiction.source, contradiction.target));
    left_out.retain(|(pair, _)| edges.iter().all(|edge| [edge.source, edge.target] != *pair));
    left_out.sort();
    let notes =
        missing_notes(clouds).chain(units_notes(clouds)).chain(left_out.into_iter().map(|(_, note)| note)).collect();
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
    if !(2..=TUNING.max_clouds).contains(&count) {
        return Err(Error::Input {
            what: "clouds",
            reason: format!("{count} of them; needed are 2 to {}", TUNING.max_clouds),
        });
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
    let joining = solved.joining(TUNING.second_looks);
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
