//! `snake_rs.align`.

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use snake_registration as core;

use crate::model;
use crate::part::{attributes, part};
use crate::registration::matrix;
use crate::threads::{self, Watch};
use crate::{arrays, options, warn};

/// The poses of many clouds. They can be pickled.
#[pyclass(frozen, get_all, module = "snake_rs")]
pub struct Alignment {
    /// The pose (4, 4) float64 of each cloud: `p_part = R p_cloud + t`. A part has the frame of its first cloud.
    poses: Vec<Py<PyArray2<f64>>>,
    /// The clouds that are linked to each other, as indices; the part with the most clouds comes first. Poses of different
    /// parts cannot be compared.
    parts: Vec<Vec<usize>>,
    /// The covariance (6, 6) float64 of each pose: of a small rotation (radians), then a small translation of the cloud in
    /// its own frame. Zeros for the first cloud of a part.
    covariances: Vec<Py<PyArray2<f64>>>,
    /// The registrations of pairs that the poses follow.
    edges: Vec<Py<AlignmentEdge>>,
    /// The reliable registrations that were left out because they contradict the initial poses: source, target, the distance
    /// of the source's points from where these put them, and the largest distance that does not contradict them.
    contradictions: Vec<(usize, usize, f64, f64)>,
    /// Clouds whose units may be others, and pairs that are left out because `register` of the two does not rely on them, in
    /// sentences.
    notes: Vec<String>,
    /// Number of pairs that were registered.
    num_pairs: usize,
    /// Number of points of each cloud that were skipped because they are not finite.
    num_skipped: Vec<usize>,
    /// Seconds that the alignment took.
    seconds: f64,
}

part! {
/// A registration of two clouds of an alignment. It can be pickled.
AlignmentEdge {
    /// Index of the source.
    source: usize,
    /// Index of the target.
    target: usize,
    /// The transform (4, 4) float64 of the pair alone: `p_target = R p_source + t`.
    t_target_source: Py<PyArray2<f64>>,
    /// How likely the transform is right by its own evidence, in [0, 1].
    confidence: f64,
    /// How likely it is right by its own evidence and the loops of three transforms that it closes, in [0, 1].
    belief: f64,
    /// Root mean square distance between tangent planes of the pair and of the poses, in cloud units.
    residual: f64,
    /// Information matrix (6, 6) float64, as that of `Fit`.
    information: Py<PyArray2<f64>>,
}
}

#[pymethods]
impl Alignment {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "what a pickle holds")]
    fn new(
        poses: Vec<Py<PyArray2<f64>>>,
        parts: Vec<Vec<usize>>,
        covariances: Vec<Py<PyArray2<f64>>>,
        edges: Vec<Py<AlignmentEdge>>,
        contradictions: Vec<(usize, usize, f64, f64)>,
        notes: Vec<String>,
        num_pairs: usize,
        num_skipped: Vec<usize>,
        seconds: f64,
    ) -> Self {
        Self { poses, parts, covariances, edges, contradictions, notes, num_pairs, num_skipped, seconds }
    }

    /// The content of a pickle: all attributes.
    fn __getnewargs__<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyTuple>> {
        let names = [
            "poses",
            "parts",
            "covariances",
            "edges",
            "contradictions",
            "notes",
            "num_pairs",
            "num_skipped",
            "seconds",
        ];
        attributes(this, names)
    }

    fn __repr__(&self) -> String {
        let Self { poses, parts, edges, num_pairs, seconds, .. } = self;
        let sizes: Vec<String> = parts.iter().map(|part| part.len().to_string()).collect();
        format!(
            "Alignment({} clouds in parts of {}; {} edges of {num_pairs} pairs; {seconds:.1} s)",
            poses.len(),
            sizes.join(" + "),
            edges.len()
        )
    }
}

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
pub fn align(
    py: Python<'_>,
    clouds: Vec<Bound<'_, PyAny>>,
    model: Option<&Bound<'_, PyAny>>,
    viewpoints: Option<Vec<Option<[f64; 3]>>>,
    initial_poses: Option<Vec<Option<Bound<'_, PyAny>>>>,
    deadline: Option<f64>,
    progress: Option<Py<PyAny>>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Alignment> {
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
    let edge = |edge: &core::Edge| {
        let t_target_source = matrix(py, edge.t_target_source.to_matrix())?;
        let information = matrix(py, edge.information)?;
        let core::Edge { source, target, confidence, belief, residual, .. } = *edge;
        Py::new(py, AlignmentEdge { source, target, t_target_source, confidence, belief, residual, information })
    };
    Ok(Alignment {
        poses: alignment.poses.iter().map(|pose| matrix(py, pose.t_part_cloud.to_matrix())).collect::<PyResult<_>>()?,
        parts: alignment.parts,
        covariances: alignment.poses.iter().map(|pose| matrix(py, pose.covariance)).collect::<PyResult<_>>()?,
        contradictions: alignment
            .contradictions
            .iter()
            .map(|at| (at.source, at.target, at.distance, at.tolerance))
            .collect(),
        notes: alignment.notes,
        edges: alignment.edges.iter().map(edge).collect::<PyResult<_>>()?,
        num_pairs: alignment.num_pairs,
        num_skipped: alignment.num_skipped,
        seconds: alignment.seconds,
    })
}
