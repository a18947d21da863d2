use super::*;
use snake_geometry::Length;

#[test]
fn a_flat_plate_has_no_keypoints() {
    let at = |i: usize| (i % 30) as f32 * 0.1;
    let plate = |tilt: f32| (0..900).map(|i| [at(i), at(i / 30), tilt * at(i)]).collect::<Vec<Point>>();
    let level = plate(0.0);
    let keypoints = [
        harris3d(&level, &Harris3dOptions::default()).unwrap(),
        iss(&level, &IssOptions::default()).unwrap(),
        surface_variation(&level, &SurfaceVariationOptions::default()).unwrap(),
        sift3d(&level, &Sift3dOptions::default()).unwrap(),
    ];
    assert_eq!(keypoints.map(|responses| responses.len()), [0; 4]);
    // The coordinates of a tilted plate are rounded to f32; to ISS, surface variation and SIFT this
    // looks like its shape.
    assert_eq!(harris3d(&plate(0.3), &Harris3dOptions::default()).unwrap(), []);
}

/// The surface of a unit cube: `side`² points on each face. Faces share the points on their common edges.
pub(super) fn cube(side: usize) -> Vec<Point> {
    let at = |i: usize| i as f32 / (side - 1) as f32;
    let on_faces = (0..6 * side * side).map(|i| {
        let (face, row, column) = (i / (side * side), i / side % side, i % side);
        let mut point = [at(row), at(column), (face % 2) as f32];
        point.rotate_right(face / 2);
        point
    });
    let mut points: Vec<Point> = on_faces.collect();
    points.sort_by(|a, b| a.partial_cmp(b).unwrap());
    points.dedup();
    points
}

/// The index of the corner of [`cube`] near a point; its bits are x, y and z.
pub(super) fn corner(point: Point) -> Option<usize> {
    let near = point.iter().all(|v| !(0.25..=0.75).contains(v));
    near.then(|| point.iter().enumerate().map(|(axis, v)| usize::from(*v > 0.5) << axis).sum())
}

#[test]
fn a_detector_has_its_name_in_options_and_tables() {
    for &detector in Detector::CLASSICAL {
        assert_eq!(Detector::classical(detector.name()).unwrap(), detector);
    }
    for detector in [&[Detector::Voxels, Detector::Snake], Detector::CLASSICAL].concat() {
        assert_eq!(serde_json::to_value(detector).unwrap(), detector.name());
    }
    for name in ["orb", "voxels", "snake"] {
        let error = Detector::classical(name).unwrap_err().to_string();
        assert!(Detector::CLASSICAL.iter().all(|detector| error.contains(detector.name())), "{error}");
    }
    let error = Detector::Voxels.keypoints(&cube(4), 5, Protocol::Ranked, 0).unwrap_err().to_string();
    assert!(error.contains("`detector` is voxels"), "{error}");
}

#[test]
fn harris_of_the_paper_is_random_and_its_sift_is_of_y() {
    let points = cube(12);
    let paper = |detector: Detector| detector.keypoints(&points, 100, Protocol::Paper, 3).unwrap();
    let selected =
        |responses: Result<Vec<Response>>| select_keypoints(&points, |_| responses, 100, Protocol::Paper, 3).unwrap();
    let every = harris3d(&points, &Harris3dOptions::default().with_non_max(false));
    assert_eq!(paper(Detector::Harris3d), selected(every));
    let y = sift3d(&points, &Sift3dOptions::default().with_field(SiftField::Y));
    assert_eq!(paper(Detector::Sift3d), selected(y));
    assert_eq!(paper(Detector::Iss), selected(iss(&points, &IssOptions::default())));
}

#[test]
fn threads_do_not_matter() {
    let points = cube(12);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let all = || Detector::CLASSICAL.iter().map(|d| d.keypoints(&points, 50, Protocol::Paper, 3).unwrap());
        pool.install(|| all().collect::<Vec<_>>())
    };
    assert_eq!(run(1), run(5));
}

#[test]
fn clouds_that_cannot_be_used_are_refused() {
    let bad =
        [vec![], vec![[1.0; 3]], vec![[2.0; 3]; 40], vec![[0.0; 3], [f32::NAN; 3]], vec![[0.0; 3], [f32::INFINITY; 3]]];
    for (detector, points) in Detector::CLASSICAL.iter().flat_map(|d| bad.iter().map(move |points| (d, points))) {
        let keypoints = detector.keypoints(points, 5, Protocol::Ranked, 0);
        assert!(matches!(keypoints, Err(Error::Input { what: "points", .. })), "{detector:?} {points:?}");
    }
}

#[test]
fn two_points_and_far_points_are_no_panic() {
    for points in [vec![[0.0; 3], [1.0, 0.0, 0.0]], vec![[3e38; 3], [-3e38; 3], [0.0; 3]], vec![[1e-40; 3], [0.0; 3]]] {
        for &detector in Detector::CLASSICAL {
            match detector.keypoints(&points, 5, Protocol::Paper, 0) {
                Ok(keypoints) => {
                    assert!(!keypoints.is_empty() && keypoints.len() <= points.len(), "{detector:?} {keypoints:?}")
                }
                // Its radius is a share of the cloud's radius, which must be within bounds.
                Err(error) => assert!(
                    detector == Detector::SurfaceVariation && error.to_string().contains("extent"),
                    "{detector:?} {error}"
                ),
            }
        }
    }
}

#[test]
fn points_that_are_not_finite_are_skipped() {
    let clean = cube(8);
    let mut whole = vec![[f32::NAN; 3]; 2];
    for &point in &clean {
        whole.extend([point, [0.0, f32::INFINITY, 0.0]]);
    }
    for &detector in Detector::CLASSICAL {
        for protocol in [Protocol::Ranked, Protocol::Paper] {
            let keypoints = detector.keypoints(&whole, 30, protocol, 1).unwrap();
            let expected = detector.keypoints(&clean, 30, protocol, 1).unwrap().into_iter();
            let expected = expected.map(|r| Response { index: 2 + 2 * r.index, ..r }).collect::<Vec<_>>();
            assert_eq!(keypoints, expected, "{detector:?}");
        }
    }
    // By themselves, too.
    let first = |keypoints: Result<Vec<Response>>| whole[keypoints.unwrap()[0].index][0];
    assert!(first(iss(&whole, &IssOptions::default())).is_finite());
    assert!(first(harris3d(&whole, &Harris3dOptions::default())).is_finite());
    assert!(first(sift3d(&whole, &Sift3dOptions::default())).is_finite());
    assert!(first(farthest_points(&whole, 1)).is_finite() && first(random_points(&whole, 1, 0)).is_finite());
}

#[test]
fn lengths_that_cannot_be_used_are_refused() {
    let points = cube(5);
    for length in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-200] {
        for length in [Length::Units(length), Length::Resolutions(length)] {
            let refused = [
                iss(&points, &IssOptions::default().with_salient_radius(length)),
                iss(&points, &IssOptions::default().with_non_max_radius(length)),
                harris3d(&points, &Harris3dOptions::default().with_radius(length)),
                sift3d(&points, &Sift3dOptions::default().with_min_scale(length)),
                sift3d(&points, &Sift3dOptions::default().with_curvature_radius(length)),
            ];
            for (place, keypoints) in refused.into_iter().enumerate() {
                assert!(matches!(keypoints, Err(Error::Option { .. })), "{place} {length:?}");
            }
        }
    }
    // Every point occurs twice and counts once.
    let doubled = [points.clone(), points.clone()].concat();
    let keypoints = |points: &[Point]| iss(points, &IssOptions::default()).unwrap();
    assert_eq!(keypoints(&doubled), keypoints(&points));
    let options =
        IssOptions { salient_radius: Length::Units(0.5), non_max_radius: Length::Units(0.3), ..Default::default() };
    assert!(iss(&doubled, &options).is_ok());
}

#[test]
fn the_paper_protocol_draws_and_fills_up() {
    let responses = |number| (0..number).map(|index| Response { index: index + 100, score: 1.0 }).collect::<Vec<_>>();
    let indices = |number, count, seed| -> Vec<usize> {
        random_subset(1000, responses(number), count, seed).into_iter().map(|r| r.index).collect()
    };
    // More than requested: a random subset, not the first ones.
    let drawn = indices(50, 10, 0);
    assert_eq!(drawn.len(), 10);
    assert!(drawn.iter().all(|i| (100..150).contains(i)) && drawn.iter().any(|&i| i >= 110));
    assert_ne!(drawn, indices(50, 10, 1));
    // Fewer: all of them, then random points. None: the first point, then random points.
    let filled = indices(3, 10, 0);
    assert_eq!((filled.len(), &filled[..3]), (10, &[100, 101, 102][..]));
    assert_ne!(filled, indices(3, 10, 1));
    assert_eq!((indices(0, 10, 0).len(), indices(0, 10, 0)[0]), (10, 0));
    assert_eq!(random_subset(4, responses(0), 10, 0).len(), 4);
}
