//! `snake_rs.align`.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_registration as core;

use crate::model;
use crate::threads::{self, Watch};
use crate::{arrays, options, records, warn};

/// Finds the poses of many clouds that overlap in part, without initial poses.
///
/// `clouds` is a sequence of 2 to 500 clouds (N, 3) in the forms of `detect` and in the same units. Pairs with similar
/// descriptors are registered as by `register`, whose verdict decides: a transform counts if it is reliable, or if it is not
/// ambiguous and loops of three transforms prove it. The poses fit these transforms, and transforms that contradict the
/// others lose their weight. `notes` name what `register` does not rely on, and ask about units.
///
/// `viewpoints` has the sensor's position (3,) in the frame of each cloud, or None where it is not known. `initial_poses` has
/// an approximate pose (4, 4) of each cloud in one common frame, or None where it is not known: pairs start from them beside
/// the search, and a transform that contradicts them is left out (`contradictions`). The options are those of every registration (see `register`) and:
///
#[doc = include_str!("help/align.txt")]
///
/// Each of the `notes`, and clouds in several parts, give a UserWarning. `deadline` and `progress` are those of `detect`. Raises
/// ValueError for invalid arrays or values, TypeError for an unknown option.
#[pyfunction]
#[pyo3(signature = (clouds, model=None, *, viewpoints=None, initial_poses=None, deadline=None, progress=None, **options))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn align<'py>(
    py: Python<'py>,
    clouds: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, PyAny>>,
    viewpoints: Option<Vec<Option<[f64; 3]>>>,
    initial_poses: Option<Vec<Option<Bound<'_, PyAny>>>>,
    deadline: Option<f64>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let listed = "clouds: allowed is a list of clouds or of their paths, such as sorted(Path(folder).glob('*.ply'))";
    let clouds: Vec<Bound<'_, PyAny>> = clouds.extract().map_err(|_| PyTypeError::new_err(listed))?;
    let watch = Watch::new(deadline, progress)?;
    let (options, align_options): (core::RegisterOptions, core::AlignOptions) = options::of("align", options)?;
    let read = clouds.iter().map(|cloud| {
        let (cloud, _, notes) = arrays::cloud_with_notes("clouds", cloud)?;
        Ok((cloud, notes))
    });
    let (clouds, read): (Vec<snake_core::Cloud>, Vec<_>) = read.collect::<PyResult<Vec<_>>>()?.into_iter().unzip();
    let model = model::for_registration(py, model, &options, clouds.first())?;
    let pose = |pose: Option<Bound<'_, PyAny>>| pose.map(|pose| arrays::transform("initial_poses", &pose)).transpose();
    let initial_poses = initial_poses.into_iter().flatten().map(pose).collect::<PyResult<_>>()?;
    let origins: Vec<[f64; 3]> = clouds.iter().map(|cloud| cloud.origin).collect();
    let mut known = core::AlignPriors::default()
        .with_viewpoints(viewpoints.unwrap_or_else(|| vec![None; origins.len()]))
        .with_initial_poses(initial_poses);
    known.place(&origins);
    let points: Vec<_> = clouds.into_iter().map(|cloud| cloud.points).collect();
    let near = threads::run_watched(py, watch, |control| {
        core::align_with(&points, &known, model.as_ref(), &options, &align_options, control)
    })?;
    warn(py, near.warning().iter().chain(&near.notes))?;
    let alignment = near.between_origins(&origins).with_notes_on_clouds(&read);
    records::to_python(py, &alignment)
}
