//! Compares each stage with the authors' network: `tests/golden` (see its README), and `../shared/golden` if present.

use std::path::{Path, PathBuf};

use safetensors::SafeTensors;

use crate::control::{Control, Counter};
use crate::detect::occupied::Occupied;
use crate::detect::occupied::tests::occupied_queries;
use crate::detect::refine::refine;
use crate::lattice::VoxelGroups;
use crate::network::encoder::EncoderMemory;
use crate::options::{DetectOptions, RefineMethod, Selection};
use crate::{EncodeOptions, Field, Model, NormalizationMethod, Point};

struct Case {
    name: String,
    model: Model,
    io: Vec<u8>,
    query_resolution: usize,
}

/// All available cases; the committed ones must exist.
fn cases() -> Vec<Case> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut folders: Vec<PathBuf> =
        ["tiny", "odd", "anisotropic"].map(|name| root.join("tests/golden").join(name)).into();
    let full = root.join("../shared/golden/full");
    if full.exists() {
        folders.push(full);
    } else {
        eprintln!("SKIPPED: golden case `full` (the paper's 64³ network) is not part of the repository");
    }
    let case = |folder: PathBuf| {
        let io = std::fs::read(folder.join("io.safetensors")).unwrap();
        let (_, header) = SafeTensors::read_metadata(&io).unwrap();
        let query_resolution = header.metadata().as_ref().unwrap()["query_resolution"].parse().unwrap();
        let model = Model::load(folder.join("weights.safetensors")).unwrap();
        Case { name: folder.file_name().unwrap().to_string_lossy().into(), model, io, query_resolution }
    };
    folders.into_iter().map(case).collect()
}

impl Case {
    fn bytes(&self, tensor: &str) -> Vec<[u8; 4]> {
        SafeTensors::deserialize(&self.io).unwrap().tensor(tensor).unwrap().data().as_chunks().0.to_vec()
    }

    fn floats(&self, tensor: &str) -> Vec<f32> {
        self.bytes(tensor).into_iter().map(f32::from_le_bytes).collect()
    }

    fn indices(&self, tensor: &str) -> Vec<usize> {
        self.bytes(tensor).into_iter().map(|b| i32::from_le_bytes(b) as usize).collect()
    }

    fn points(&self, tensor: &str) -> Vec<Point> {
        self.floats(tensor).as_chunks().0.to_vec()
    }

    fn field(&self) -> Field {
        let options = EncodeOptions { normalization: NormalizationMethod::None, ..Default::default() };
        self.model.encode(&self.points("points"), &options).unwrap()
    }

    /// Each value must be within `tolerance` of the golden one, relative for golden values above 1.
    fn assert_close(&self, tensor: &str, found: &[f32], tolerance: f32) {
        let expected = self.floats(tensor);
        assert_eq!(found.len(), expected.len(), "{} {tensor}", self.name);
        for (i, (f, e)) in found.iter().zip(&expected).enumerate() {
            assert!(
                (f - e).abs() <= tolerance * e.abs().max(1.0),
                "{} {tensor}: value {i} is {f}, expected {e}",
                self.name
            );
        }
    }
}

/// The quantiles, at the given shares, of the distances between corresponding points.
fn distance_quantiles(found: &[Point], expected: &[Point], shares: [f32; 2]) -> [f32; 2] {
    assert_eq!(found.len(), expected.len());
    let distance = |(a, b): (&Point, &Point)| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f32>().sqrt();
    let mut distances: Vec<f32> = found.iter().zip(expected).map(distance).collect();
    distances.sort_by(f32::total_cmp);
    shares.map(|share| distances[(share * (distances.len() - 1) as f32) as usize])
}

#[test]
fn encoder_stages() {
    for case in cases() {
        let encoder = case.model.network().encoder.dense();
        let (points, frame) = (case.points("points"), case.model.config().frame().unwrap());
        let [features, means] = encoder.points.plain(&points, &frame);
        case.assert_close("point_features", &features, 1e-5);

        let (mut groups, mut found) = (VoxelGroups::default(), Vec::new());
        groups.fill(points.len(), |index| points[index], &frame).unwrap();
        encoder.points.voxel_means(&groups, |index| points[index], &mut found, &Counter::default()).unwrap();
        assert_eq!(found, means);
        let scattered = encoder.scatter(&means, &groups).values;
        let ([_, height, width], channels) = (frame.size(), features.len() / points.len());
        let mut expected = vec![0.0; scattered.len()];
        let values = case.floats("scatter_values");
        for (dhw, row) in case.indices("scatter_voxels_dhw").chunks(3).zip(values.chunks(channels)) {
            let voxel = (dhw[0] * height + dhw[1]) * width + dhw[2];
            expected[voxel * channels..][..channels].copy_from_slice(row);
        }
        assert!(scattered.iter().zip(&expected).all(|(f, e)| (f - e).abs() < 1e-5), "{}: scatter", case.name);

        let memory = &mut EncoderMemory::default();
        let volume = encoder.encode(points.len(), |index| points[index], memory, &Counter::default()).unwrap();
        let row = |voxel: usize| volume.values[voxel * volume.channels..][..volume.channels].to_vec();
        let sampled: Vec<f32> = case.indices("volume_sample_index").into_iter().flat_map(row).collect();
        // Eight to fourteen layers sum in float32 in another order.
        case.assert_close("volume_sample_values", &sampled, 5e-5);
    }
}

#[test]
fn probabilities_and_gradients() {
    for case in cases() {
        let (field, queries) = (case.field(), case.points("queries"));
        // Both implementations round to about 1e-5 here.
        case.assert_close("occupancy", &field.occupancy(&queries).unwrap(), 2e-5);
        case.assert_close("saliency", &field.saliency(&queries).unwrap(), 2e-5);
        let gradients = [
            ("occupancy_grad", field.occupancy_and_gradient(&queries)),
            ("saliency_grad", field.saliency_and_gradient(&queries)),
        ];
        for (tensor, found) in gradients {
            let (found, expected) = (found.unwrap().1, case.points(tensor));
            // 1e-3 of each gradient's length, but at least of the typical length.
            let length = |g: &Point| g.iter().map(|v| v * v).sum::<f32>().sqrt();
            let typical = expected.iter().map(length).sum::<f32>() / expected.len() as f32;
            let wrong: Vec<_> = (0..)
                .zip(found.iter().zip(&expected))
                .filter(|(_, (f, e))| {
                    let error = length(&std::array::from_fn(|axis| f[axis] - e[axis]));
                    error > 1e-3 * length(e).max(typical)
                })
                .collect();
            // A gradient jumps where a ReLU switches; one query in 500 may be closer to such a place than rounding.
            assert!(wrong.len() <= expected.len() / 500, "{} {tensor}: {wrong:?}", case.name);
        }
    }
}

#[test]
fn the_query_grid_and_its_occupied_part() {
    for case in cases() {
        let field = case.field();
        let options = DetectOptions { query_resolution: case.query_resolution, ..Default::default() };
        let (occupied, expected) = (occupied_queries(&field, &options), case.points("refine_start"));
        assert_eq!(occupied.len(), expected.len(), "{}", case.name);
        assert!(distance_quantiles(&occupied, &expected, [0.5, 1.0])[1] < 1e-6, "{}", case.name);
    }
}

#[test]
fn refinement_by_both_methods() {
    for case in cases() {
        let (field, start) = (case.field(), Occupied::of(&case.points("refine_start")));
        let scores = case.floats("refine_adam_masked_score_per_step");
        let selection = Selection::ReferenceFinalPosition;
        let options = DetectOptions { selection, saliency_threshold: 0.0, ..Default::default() };
        let refined = refine(&field, &start, &options, &Control::default()).unwrap();
        let positions: Vec<Point> = refined.iter().map(|c| c.position).collect();
        // Adam divides by the gradient's size. Where that is near zero, rounding decides the direction.
        let [median, most] = distance_quantiles(&positions, &case.points("refine_adam_end"), [0.5, 0.99]);
        assert!(median < 1e-5 && most < 1e-3, "{}: Adam ends {median} (median), {most} (99 %) away", case.name);
        let best =
            |query: usize| scores.iter().skip(query).step_by(start.positions.len()).fold(0.0, |m: f32, s| m.max(*s));
        let mut errors: Vec<f32> = refined.iter().enumerate().map(|(i, c)| (c.score - best(i)).abs()).collect();
        errors.sort_by(f32::total_cmp);
        let [median, most] = [0.5, 0.99].map(|share| errors[(share * (errors.len() - 1) as f32) as usize]);
        assert!(median < 1e-5 && most < 1e-3, "{}: scores differ by {median} (median), {most} (99 %)", case.name);

        // Plain descent follows the gradient itself, which jumps where a ReLU switches.
        let options = DetectOptions { refine_method: RefineMethod::GradientDescent, ..options };
        let positions: Vec<Point> =
            refine(&field, &start, &options, &Control::default()).unwrap().iter().map(|c| c.position).collect();
        let [median, most] = distance_quantiles(&positions, &case.points("refine_gd_sum_end"), [0.5, 0.99]);
        assert!(median < 1e-6 && most < 1e-3, "{}: descent ends {median} (median), {most} (99 %) away", case.name);
    }
}

#[test]
fn the_best_position_scores_no_less_than_any_step() {
    for case in cases() {
        let (field, start) = (case.field(), Occupied::of(&case.points("refine_start")));
        let options = DetectOptions { saliency_threshold: 0.0, ..Default::default() };
        let reference = DetectOptions { selection: Selection::ReferenceFinalPosition, ..options };
        let best = refine(&field, &start, &options, &Control::default()).unwrap();
        let reference = refine(&field, &start, &reference, &Control::default()).unwrap();
        for (best, reference) in best.iter().zip(reference.iter()) {
            assert!(best.score >= reference.score, "{}", case.name);
        }
        // The best score is the field's value at its position; the reference's score is not.
        let positions: Vec<Point> = best.iter().map(|c| c.position).collect();
        let saliency = field.saliency(&positions).unwrap();
        assert!(best.iter().zip(saliency).all(|(c, s)| c.score == 0.0 || (c.score - s).abs() < 1e-6), "{}", case.name);
    }
}
