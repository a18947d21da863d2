//! Degenerate clouds, from one point to a hundred thousand equal points, in every function that takes a cloud: the
//! result is finite or an error of one line.

use snake_core::{Builtin, Length, Model, NormalizationMethod, Options, Point, Preset, Result, RigidTransform};
use snake_detectors::{Detector, Protocol};
use snake_eval::{Unreachable, relative_repeatability, semantic_counts};
use snake_registration::{RegisterOptions, estimate_normals, fpfh, register};

/// Clouds with their names, and whether the network can detect keypoints in them.
fn clouds() -> Vec<(&'static str, bool, Vec<Point>)> {
    let along = |step: Point| (0..100).map(|i| step.map(|v| v * i as f32)).collect::<Vec<Point>>();
    let plane = |scale: f32| (0..400).map(|i| [(i % 20) as f32 * scale, (i / 20) as f32 * scale, 0.0]).collect();
    let scaled = |scale: f32| (0..100).map(|i| [i, i * i % 17, i % 7].map(|v| v as f32 * scale)).collect();
    let mut missing = along([0.1, 0.2, 0.3]);
    missing[3] = [f32::NAN; 3];
    missing[7][1] = f32::INFINITY;
    // There are so many points that a search of all pairs would take hours.
    let mut nearly_one = vec![[0.5; 3]; 150_000];
    nearly_one.extend(along([1.0, 0.0, 0.0]));
    vec![
        ("no points", false, vec![]),
        ("one point", false, vec![[1.0, 2.0, 3.0]]),
        ("equal points", false, vec![[1.0, 2.0, 3.0]; 100]),
        ("no finite point", false, vec![[f32::NAN; 3]; 5]),
        ("coordinates of 1e38", false, scaled(1e36)),
        ("coordinates of 1e30", false, scaled(1e28)),
        ("denormal coordinates", false, scaled(1e-44)),
        ("coordinates of 1e-25", false, scaled(1e-27)),
        ("two points", true, vec![[0.0; 3], [1.0, 0.0, 0.0]]),
        ("points not finite among others", true, missing),
        ("a line along an axis", true, along([0.01, 0.0, 0.0])),
        ("a line", true, along([0.3, -0.1, 0.2])),
        ("a plane", true, plane(0.05)),
        ("a plane of extent 1e14", true, plane(1e13)),
        ("a plane of extent 1e-14", true, plane(1e-15)),
        ("points in pairs", true, scaled(0.1).repeat(2)),
        ("a far outlier", true, [scaled(0.1), vec![[1e10; 3]]].concat()),
        ("nearly all equal", true, nearly_one),
    ]
}

fn is_finite(points: &[Point]) -> bool {
    points.as_flattened().iter().all(|v| v.is_finite())
}

/// The result if it is not an error; an error must be one short line.
fn usable<T>(what: &str, result: Result<T>) -> Option<T> {
    result
        .map_err(|error| error.to_string())
        .inspect_err(|e| assert!(e.len() < 400 && !e.contains('\n'), "{what}: {e}"))
        .ok()
}

#[test]
fn keypoints_are_finite_or_refused() {
    let model = Model::builtin(Builtin::Compact);
    for (name, can_be_encoded, cloud) in clouds() {
        let named = |name| Preset::named(name).unwrap().options();
        for mut preset in [*model.recommended(), named("modelnet40"), named("redwood"), named("smpl")] {
            preset.detect.query_resolution = 32;
            // Cubes as well, and radii in proportion.
            let extent = cloud.as_flattened().iter().fold(0.0, |m: f32, v| m.max(v.abs())).min(1e20);
            preset.detect.nms_radius = Some(Length::Units(f64::from(extent) / 50.0));
            let detection = usable(name, model.detect(&cloud, &preset));
            assert_eq!(detection.is_some(), can_be_encoded, "{name}");
            for keypoint in detection.iter().flat_map(|detection| &detection.keypoints) {
                assert!(is_finite(&[keypoint.position]) && keypoint.saliency.is_finite(), "{name}: {keypoint:?}");
                let nearest = cloud[keypoint.nearest_index];
                let squared = |p: &Point| (0..3).map(|axis| (p[axis] - keypoint.position[axis]).powi(2)).sum::<f32>();
                assert!(
                    cloud.iter().all(|p| squared(p) >= squared(&nearest) || squared(p).is_nan()),
                    "{name}: {keypoint:?}"
                );
            }
        }
        let mut preset = Options::default();
        preset.encode.normalization = NormalizationMethod::None;
        preset.detect.query_resolution = 32;
        usable(name, model.detect(&cloud, &preset));
    }
}

#[test]
fn registrations_are_finite_or_refused() {
    let options = RegisterOptions::default().with_max_keypoints(50);
    for (name, can_be_encoded, cloud) in clouds() {
        let registration = usable(name, register(&cloud, &cloud, &options));
        assert!(can_be_encoded || registration.is_none(), "{name}");
        if let Some(registration) = registration {
            assert!(
                registration.t_target_source.to_matrix().as_flattened().iter().all(|v| v.is_finite())
                    && registration.matches.rmse.is_finite(),
                "{name}"
            );
        }
        for radius in [1e-3, 0.5] {
            let normals = usable(name, estimate_normals(&cloud, radius)).unwrap_or_default();
            let descriptors = usable(name, fpfh(&cloud, &normals, radius)).unwrap_or_default();
            assert!(is_finite(&normals) && descriptors.iter().all(|v| v.is_finite()), "{name}");
        }
    }
}

#[test]
fn classical_keypoints_are_points_of_the_cloud_or_refused() {
    for (name, _, cloud) in clouds() {
        let cases = Detector::CLASSICAL
            .iter()
            .flat_map(|&detector| [(detector, Protocol::Ranked), (detector, Protocol::Paper)]);
        for (detector, protocol) in cases {
            let what = format!("{}, {name}", detector.name());
            let responses = detector.keypoints(&cloud, 16, protocol, 0);
            let responses = usable(&what, responses).unwrap_or_default();
            assert!(responses.len() <= 16, "{what}");
            let is_usable = |index: usize, score: f64| is_finite(&[cloud[index]]) && score.is_finite();
            assert!(responses.iter().all(|response| is_usable(response.index, response.score)), "{what}");
        }
    }
}

#[test]
fn figures_are_finite_or_refused() {
    for (name, _, cloud) in clouds() {
        let few = &cloud[..cloud.len().min(500)];
        let shares =
            usable(name, relative_repeatability(few, few, &RigidTransform::identity(), &[0.1])).unwrap_or_default();
        assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)), "{name}");
        let counts = usable(name, semantic_counts(few, &[0], few, &[0.1], Unreachable::Strict)).unwrap_or_default();
        assert!(counts.iter().all(|counts| (0.0..=1.0).contains(&counts.iou())), "{name}");
    }
}
