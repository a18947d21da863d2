//! Registration of two clouds.

mod prepared_map;
mod scale;
#[cfg(test)]
mod tests;
pub(crate) mod tries;

use std::time::Instant;

use snake_core::{Control, Model, Result};
use snake_geometry::Point;

use crate::options::{PairOptions, RegisterOptions};
use crate::result::Registration;
use crate::steps::prepare::Given;
pub use prepared_map::PreparedMap;
use scale::register_at_scales;
use tries::{Effort, Search};

/// Finds the rigid transform from `source` `(N, 3)` to `target` `(M, 3)` without an initial guess.
///
/// Both clouds are in the same units; they may overlap only in part. [`register_with`] also takes
/// prior knowledge of the pair, such as a guess, and the model that a detector or descriptor runs.
///
/// ```
/// use snake_core::RigidTransform;
/// use snake_registration::{RegisterOptions, register, transform_points};
/// # let source = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_target_source = RigidTransform::from_matrix(rows)?;
/// let target = transform_points(&t_target_source, &source);
/// let registration = register(&source, &target, &RegisterOptions::default())?;
/// let (angle, distance) = registration.t_target_source.angle_and_distance_to(&t_target_source);
/// assert!(angle < 0.05 && distance < 0.05 && registration.verdict.is_reliable);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without extent;
/// [`Error::NoTransform`](snake_core::Error::NoTransform) when no three matches fit a rigid transform;
/// [`Error::Option`](snake_core::Error::Option) when an option is outside its range or needs a model.
pub fn register(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
    register_with(source, target, None, options, &PairOptions::default(), &Control::default())
}

/// [`register`] with prior knowledge of the pair, with the model of the detector `snake` or the
/// descriptor `field`, and with progress and cancellation.
///
/// # Errors
/// The errors of [`register`]; [`Error::Cancelled`](snake_core::Error::Cancelled) and
/// [`Error::DeadlineExceeded`](snake_core::Error::DeadlineExceeded).
pub fn register_with(
    source: &[Point],
    target: &[Point],
    model: Option<&Model>,
    options: &RegisterOptions,
    pair_options: &PairOptions,
    control: &Control,
) -> Result<Registration> {
    let start = Instant::now();
    options.check_ranges()?;
    pair_options.check()?;
    let (points, names) = (vec![source, target], &["source", "target"]);
    let given = Given { points, names, viewpoints: pair_options.viewpoints().to_vec(), model, options };
    let registration = if pair_options.estimate_scale {
        register_at_scales(&given, pair_options, control)?
    } else {
        let level = given.prepare(control)?;
        let pair = level.clouds.pair(options.gravity);
        let again = Some((&given, &level));
        Search { given: again, ..Search::new(&pair, options, pair_options, Effort::Thorough, control) }.register()?
    };
    Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..registration })
}
