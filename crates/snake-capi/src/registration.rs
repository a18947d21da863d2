//! Registration of two clouds.

use std::ffi::c_char;

use snake_core::{Control, with_named_values};
use snake_registration::{PairOptions, RegisterOptions, Registration, register_with};

use crate::arguments::{SnakeCloud, check_output, optional, options as parse_options};
use crate::model::SnakeModel;
use crate::status::{SnakeStatus, guarded};
use crate::threads::run;

/// The rigid transform between two clouds.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SnakeRegistration {
    /// The 4x4 matrix, row by row. It maps a point of the source to the target: `p_target = R p_source + t`.
    pub t_target_source: [f64; 16],
    /// How likely the transform is right, 0 to 1.
    pub confidence: f64,
    /// Whether the transform can be relied on: `confidence` is at least 0.5.
    pub is_reliable: bool,
    /// Whether the clouds leave more than one answer, as a plane or a periodic structure does; then it is not reliable.
    pub is_ambiguous: bool,
    /// Number of matches.
    pub num_matches: usize,
    /// Number of matches on which the transform was built.
    pub num_inliers: usize,
    /// Share of the source on the target, 0 to 1.
    pub fitness: f64,
    /// Root mean square distance of that part, in cloud units.
    pub fitness_rmse: f64,
}

impl From<&Registration> for SnakeRegistration {
    fn from(registration: &Registration) -> Self {
        let Registration { verdict, fit, matches, .. } = registration;
        let mut t_target_source = [0.0; 16];
        t_target_source.copy_from_slice(registration.t_target_source.to_matrix().as_flattened());
        Self {
            t_target_source,
            confidence: verdict.confidence,
            is_reliable: verdict.is_reliable,
            is_ambiguous: verdict.is_ambiguous,
            num_matches: matches.num_matches,
            num_inliers: matches.num_inliers,
            fitness: fit.fitness,
            fitness_rmse: fit.rmse,
        }
    }
}

/// Finds the rigid transform from `source` to `target`, clouds of the same unit that may overlap in part, without an
/// initial guess. `model` runs only if the options ask for its keypoints or descriptors; else it may be null. Points are left out as in
/// `snake_detect`, and those that stand for missing returns, such as many at (0, 0, 0).
///
/// `options` is null for the defaults, or a JSON object such as `{"gravity": "z", "hypotheses": 5}`. After an error
/// `*registration` is unchanged.
///
/// # Safety
/// `model` is null or a model that is not freed yet; the clouds have as many points as they say; `options` is null or a
/// text that ends with a zero; `registration` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_register(
    model: *const SnakeModel,
    source: SnakeCloud,
    target: SnakeCloud,
    options: *const c_char,
    registration: *mut SnakeRegistration,
) -> SnakeStatus {
    guarded(|| {
        check_output("registration", registration)?;
        // SAFETY: the caller vouches for the clouds.
        let (source, target) = unsafe { (source.read("source")?, target.read("target")?) };
        // SAFETY: the caller vouches for the model.
        let model = unsafe { optional("model", model) }?;
        // SAFETY: the caller vouches for the text.
        let values = unsafe { parse_options(options) }?;
        let defaults = (RegisterOptions::default(), PairOptions::default());
        let (options, pair_options) = with_named_values(&defaults, &values)?;
        let is_used = |model: &&SnakeModel| options.needs_model() || model.chooser.is_named();
        let model = model.filter(is_used);
        let result = run(|| {
            let choose = |model: &SnakeModel| model.chooser.for_points(&target);
            let chosen = model.map(choose).transpose()?;
            let model = chosen.as_ref().map(|chosen| &chosen.model);
            Ok(register_with(&source, &target, model, &options, &pair_options, &Control::default())?)
        })?;
        let result = SnakeRegistration::from(&result);
        // SAFETY: the place is neither null nor misaligned; the caller vouches for the rest.
        unsafe { registration.write(result) };
        Ok(())
    })
}
