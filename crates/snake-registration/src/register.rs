//! The steps of registration.

use std::time::Instant;

use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

use snake_core::space::{FinitePoints, Vector, vector};
use snake_core::{Control, Error, Model, Normalization, NormalizationMethod, Point, Result};

use super::consistency::{Criteria, Match, displacement, hypotheses};
use super::icp::{Constraint, icp};
use super::matching::{hellinger, ranked_matches};
use super::options::RegisterOptions;
use super::result::{Hypothesis, Registration, ViewpointUsed};
use super::scan::{Descriptor, Scan, reduce};
use super::surface::{Agreement, Surface, fitness};
use super::verdict::{Evidence, notes};
use super::viewpoint::viewpoints;
use super::{FPFH_DIMENSION, cloud::Orientation};

/// Default number of voxels along the diameter of the smaller cloud.
const VOXELS_PER_DIAMETER: f64 = 80.0;
/// Number of transforms that are compared on the voxels.
const CANDIDATES: usize = 20;
/// Number of the source's voxels that compare them.
const COARSE_VOXELS: usize = 700;
/// ICP steps before the comparison.
const COARSE_STEPS: usize = 5;
/// Number of transforms that are refined on all voxels, at least.
const REFINED: usize = 3;
/// A guess is first refined with pairs up to this many inlier distances apart.
const WIDE: f64 = 4.0;

/// Finds the rigid transform from `source` `(N, 3)` to `target` `(M, 3)` without an initial guess.
///
/// Both clouds are in the same units; they may overlap only in part. `model` runs only if the options ask for its
/// keypoints or descriptors.
///
/// ```
/// use snake_core::{Builtin, Model, RigidTransform};
/// use snake_registration::{RegisterOptions, register, transform_points};
/// # let source = snake_io::read_points(concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply").as_ref())?;
/// let rows = [[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_target_source = RigidTransform::from_matrix(rows)?;
/// let target = transform_points(&t_target_source, &source);
/// let found = register(&source, &target, &Model::builtin(Builtin::Compact), &RegisterOptions::default())?;
/// let (angle, distance) = found.t_target_source.angle_and_distance_to(&t_target_source);
/// assert!(angle < 0.05 && distance < 0.05 && found.is_reliable);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Input`] for a cloud without finite points or without extent, and when no three matches fit a rigid
/// transform; [`Error::Option`] when an option is outside its range.
pub fn register(source: &[Point], target: &[Point], model: &Model, options: &RegisterOptions) -> Result<Registration> {
    register_with(source, target, model, options, &Control::default())
}

/// [`register`] with progress and cancellation; a classical detector is not interrupted.
///
/// # Errors
/// The errors of [`register`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn register_with(
    source: &[Point],
    target: &[Point],
    model: &Model,
    options: &RegisterOptions,
    control: &Control,
) -> Result<Registration> {
    let start = Instant::now();
    options.check()?;
    let [all_source, all_target] = [source.len(), target.len()];
    let (source, target) = (FinitePoints::of("source", source)?.points, FinitePoints::of("target", target)?.points);
    let clouds = Clouds::new(&source, &target, model, options, control)?;
    let matches = clouds.matches(options, control)?;

    let guesses = match options.initial {
        Some(guess) => vec![clouds.refine_widely(guess.isometry(), options, control)?],
        None => hypotheses(&matches, &clouds.criteria(options), CANDIDATES, control)?,
    };
    let found = clouds.best(&guesses, &matches, options, control)?;
    let Some(best) = found.first() else { return Err(clouds.no_transform(matches.len())) };

    let surfaces = clouds.surfaces();
    let constraint = Constraint::new(surfaces[0].points, &surfaces[1], &best.refined);
    let evidence = Evidence {
        num_inliers: best.num_inliers,
        agreement: best.agreement,
        second_score: found.get(1).map_or(0.0, Candidate::score),
        weakest_constraint: constraint.weakest,
    };
    let confidence = evidence.confidence();
    let (fitness, fitness_rmse) = fitness(surfaces[0].points, &surfaces[1].grid, &best.refined);
    let hypothesis = |candidate: &Candidate| Hypothesis {
        t_target_source: candidate.refined.into(),
        score: candidate.score(),
        num_inliers: candidate.num_inliers,
        free_space_violation: candidate.agreement.violation,
    };
    Ok(Registration {
        t_target_source: best.refined.into(),
        confidence,
        is_reliable: confidence >= 0.5,
        num_inliers: best.num_inliers,
        num_correspondences: matches.len(),
        rmse: best.rmse,
        inlier_distance: clouds.inlier_distance,
        fitness,
        fitness_rmse,
        free_space_violation: best.agreement.violation,
        weakest_constraint: constraint.weakest,
        information: std::array::from_fn(|row| std::array::from_fn(|column| constraint.information[(row, column)])),
        hypotheses: found.iter().take(options.hypotheses).map(hypothesis).collect(),
        viewpoints: clouds.viewpoints_used,
        notes: notes(&evidence, constraint.open_directions, clouds.diameters),
        num_skipped: [all_source - source.len(), all_target - target.len()],
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Source and target, reduced and described.
struct Clouds {
    scans: [Scan; 2],
    viewpoints: Option<[Vector; 2]>,
    viewpoints_used: [ViewpointUsed; 2],
    diameters: [f64; 2],
    inlier_distance: f64,
}

/// A transform after ICP.
struct Candidate {
    refined: IsometryMatrix3<f64>,
    agreement: Agreement,
    /// Number of matches that agreed with the transform before ICP, and their root mean square distance.
    num_inliers: usize,
    rmse: f64,
}

impl Candidate {
    fn score(&self) -> f64 {
        self.agreement.score(self.num_inliers)
    }
}

impl Clouds {
    fn new(
        source: &[Point],
        target: &[Point],
        model: &Model,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Self> {
        let [voxel_size, normal_radius, feature_radius, inlier_distance] = options.lengths(source, target)?;
        let diameters = [diameter("source", source)?, diameter("target", target)?];
        let voxel_size = voxel_size.unwrap_or(diameters[0].min(diameters[1]) / VOXELS_PER_DIAMETER);
        let voxels = [reduce(source, voxel_size, control)?, reduce(target, voxel_size, control)?];
        // In a sparse cloud most voxels hold one point, and the voxel size is less than the distance between neighbours.
        let spacing = voxel_size.max(voxels[0].resolution()).max(voxels[1].resolution());
        let inlier_distance = inlier_distance.unwrap_or(1.5 * spacing);
        let (viewpoints, viewpoints_used) = viewpoints(&voxels, options, inlier_distance);
        let lengths = [voxel_size, normal_radius.unwrap_or(2.0 * spacing), feature_radius.unwrap_or(5.0 * spacing)];
        let orientation = |cloud: usize| match &viewpoints {
            Some(viewpoints) => Orientation::Viewpoint(viewpoints[cloud]),
            None => Orientation::Unsigned,
        };
        let [source_voxels, target_voxels] = voxels;
        let scans = [
            Scan::of(source, source_voxels, model, lengths, orientation(0), control)?,
            Scan::of(target, target_voxels, model, lengths, orientation(1), control)?,
        ];
        Ok(Self { scans, viewpoints, viewpoints_used, diameters, inlier_distance })
    }

    fn criteria(&self, options: &RegisterOptions) -> Criteria {
        let Self { inlier_distance, viewpoints, .. } = *self;
        Criteria { inlier_distance, signed: viewpoints.is_some(), gravity: options.gravity.map(|axis| axis.unit()) }
    }

    fn surfaces(&self) -> [Surface<'_>; 2] {
        self.surfaces_within(self.inlier_distance)
    }

    fn surfaces_within(&self, distance: f64) -> [Surface<'_>; 2] {
        [0, 1].map(|cloud| {
            let Scan { voxels, normals, .. } = &self.scans[cloud];
            Surface::new(&voxels.points, normals, self.viewpoints.map(|viewpoints| viewpoints[cloud]), distance)
        })
    }

    /// Matches of keypoints, the most distinctive first.
    fn matches(&self, options: &RegisterOptions, control: &Control) -> Result<Vec<Match>> {
        let describe = |scan: &Scan, keypoints: &[(Point, usize)]| -> Result<Vec<f32>> {
            Ok(match options.descriptor {
                Descriptor::Fpfh => {
                    let voxels: Vec<usize> = keypoints.iter().map(|&(_, voxel)| voxel).collect();
                    let mut histograms = scan.fpfh_of(&voxels, control)?;
                    hellinger(&mut histograms, FPFH_DIMENSION);
                    histograms
                }
                Descriptor::Field => {
                    let points: Vec<Point> = keypoints.iter().map(|&(point, _)| point).collect();
                    scan.descriptors_with(&points, Descriptor::Field, control)?
                }
            })
        };
        // The clouds get different random keypoints. With one seed, equal clouds would have a partner for every keypoint.
        let [source, target] = &self.scans;
        let keypoints =
            |scan: &Scan, seed| scan.anchored_keypoints(options.detector, options.max_keypoints, seed, control);
        let source_keypoints = keypoints(source, options.seed)?;
        let target_keypoints = keypoints(target, options.seed.wrapping_add(1))?;
        let source_descriptors = describe(source, &source_keypoints)?;
        let target_descriptors = describe(target, &target_keypoints)?;
        let dimension = source.dimension(options.descriptor);
        let count = options.max_matches;
        let ranked = ranked_matches(&source_descriptors, &target_descriptors, dimension, count, control)?;
        let matched = |[s, t]: [usize; 2]| Match {
            source: vector(source_keypoints[s].0),
            target: vector(target_keypoints[t].0),
            source_normal: source.normals[source_keypoints[s].1],
            target_normal: target.normals[target_keypoints[t].1],
        };
        Ok(ranked.into_iter().map(matched).collect())
    }

    /// The best of the transforms, refined, best first and distinct.
    fn best(
        &self,
        guesses: &[IsometryMatrix3<f64>],
        matches: &[Match],
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Vec<Candidate>> {
        let [source, target] = self.surfaces();
        let criteria = self.criteria(options);
        let counter = control.begin("ICP", guesses.len());
        let step = source.points.len().div_ceil(COARSE_VOXELS);
        let coarse: Vec<Vector> = source.points.iter().step_by(step).copied().collect();
        let candidates = guesses.par_iter().map(|rough| {
            counter.add(1);
            let steps = COARSE_STEPS.min(options.refine_steps);
            let refined = icp(&coarse, &target, *rough, criteria.gravity, steps, &counter)?;
            let agreement = Surface::agreement(&source, &target, &refined, step);
            let (num_inliers, rmse) = inliers(matches, rough, &criteria);
            Ok(Candidate { refined, agreement, num_inliers, rmse })
        });
        let mut candidates: Vec<Candidate> = candidates.collect::<Result<_>>()?;
        sort(&mut candidates);
        candidates.truncate(REFINED.max(options.hypotheses));
        for candidate in &mut candidates {
            let (rough, steps) = (candidate.refined, options.refine_steps);
            candidate.refined = icp(source.points, &target, rough, criteria.gravity, steps, &counter)?;
            candidate.agreement = Surface::agreement(&source, &target, &candidate.refined, 1);
        }
        sort(&mut candidates);
        let mut distinct: Vec<Candidate> = Vec::new();
        for candidate in candidates {
            let apart = |other: &Candidate| displacement(&candidate.refined, &other.refined, &coarse);
            if distinct.iter().all(|other| apart(other) > 2.0 * self.inlier_distance) {
                distinct.push(candidate);
            }
        }
        Ok(distinct)
    }

    /// A guess after ICP with distant pairs.
    fn refine_widely(
        &self,
        guess: &IsometryMatrix3<f64>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<IsometryMatrix3<f64>> {
        let mut transform = *guess;
        for factor in [WIDE, WIDE.sqrt()] {
            let [source, target] = self.surfaces_within(factor * self.inlier_distance);
            let counter = control.begin("ICP", 0);
            let gravity = options.gravity.map(|axis| axis.unit());
            transform = icp(source.points, &target, transform, gravity, options.refine_steps, &counter)?;
        }
        Ok(transform)
    }

    fn no_transform(&self, num_matches: usize) -> Error {
        let [source, target] = self.scans.each_ref().map(|scan| scan.voxels.points.len());
        let [source_diameter, target_diameter] = self.diameters;
        let reason = format!(
            "no three of the {num_matches} correspondences, of {source} and {target} voxels, fit a rigid transform; do \
             the clouds overlap, and in the same units? their diameters are {source_diameter:.4} and {target_diameter:.4}"
        );
        Error::Input { what: "source and target", reason }
    }
}

/// Best first; the order decides between equals.
fn sort(candidates: &mut [Candidate]) {
    candidates.sort_by(|a, b| b.score().total_cmp(&a.score()));
}

/// Number and root mean square distance of the matches that agree with a transform.
fn inliers(matches: &[Match], transform: &IsometryMatrix3<f64>, criteria: &Criteria) -> (usize, f64) {
    let squared = matches.iter().filter_map(|found| found.squared_residual(transform, criteria));
    let (count, sum) = squared.fold((0, 0.0), |(count, sum), squared| (count + 1, sum + squared));
    (count, (sum / count.max(1) as f64).sqrt())
}

/// Twice the largest distance from the mean.
fn diameter(what: &'static str, points: &[Point]) -> Result<f64> {
    let normalization = Normalization::of(points, NormalizationMethod::UnitSphere).map_err(|error| match error {
        Error::Input { reason, .. } => Error::Input { what, reason },
        other => other,
    })?;
    Ok(normalization.scale.into())
}

#[cfg(test)]
mod tests {
    use nalgebra::IsometryMatrix3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::rigid::tests::random_transform;
    use super::super::rigid::transform_points;
    use super::super::scan::KeypointDetector;
    use super::*;
    use snake_core::space::resolution;
    use snake_core::{Builtin, Length, RigidTransform};

    fn sample() -> Vec<Point> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../samples/plane.ply");
        snake_io::read_points(path.as_ref()).unwrap()
    }

    fn options() -> RegisterOptions {
        RegisterOptions { max_keypoints: 500, ..Default::default() }
    }

    fn run(source: &[Point], target: &[Point], options: &RegisterOptions) -> Result<Registration> {
        register(source, target, &Model::builtin(Builtin::Compact), options)
    }

    /// The largest coordinate difference between the points under two transforms.
    fn difference(points: &[Point], a: &RigidTransform, b: &RigidTransform) -> f32 {
        let (a, b) = (transform_points(a, points), transform_points(b, points));
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn two_samplings_are_registered_for_any_rotation() {
        let points = sample();
        // The second sampling lacks the end of a wing.
        let source = &points[..2048];
        let part: Vec<Point> = points[2048..].iter().copied().filter(|p| p[0] < 0.5).collect();
        for seed in 0..4 {
            let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(seed)));
            let found = run(source, &transform_points(&truth, &part), &options()).unwrap();
            assert!(difference(&points, &found.t_target_source, &truth) < 0.05, "seed {seed}: {found:?}");
            assert!(found.num_inliers >= 3 && found.num_correspondences > found.num_inliers, "{found:?}");
            assert!(found.hypotheses[0].t_target_source == found.t_target_source, "{found:?}");
            assert!(found.rmse > 0.0 && found.rmse < 0.1 && found.seconds > 0.0, "{found:?}");
        }
    }

    #[test]
    fn field_descriptors_and_refinement_do_their_part() {
        let points = sample();
        let truth = RigidTransform::from(IsometryMatrix3::translation(0.3, -4.0, 1.0));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        let options = RegisterOptions { descriptor: Descriptor::Field, ..options() };
        let error = |options: RegisterOptions| {
            difference(source, &run(source, &target, &options).unwrap().t_target_source, &truth)
        };
        let (refined, rough) = (error(options), error(RegisterOptions { refine_steps: 0, ..options }));
        assert!(refined < 0.02 && rough > refined, "{refined} {rough}");
    }

    #[test]
    fn inliers_are_those_before_icp_and_fitness_is_that_of_the_result() {
        let points = sample();
        let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(7)));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        let found = run(source, &target, &options()).unwrap();
        let rough = run(source, &target, &RegisterOptions { refine_steps: 0, ..options() }).unwrap();
        assert!(found.num_inliers >= 3 && found.rmse > 0.0 && found.rmse < found.inlier_distance, "{found:?}");
        assert_eq!(found.inlier_distance, rough.inlier_distance);
        // These are two samplings of one surface, and the rough transform puts a part of it out of reach.
        assert!(found.fitness > 0.95 && found.fitness > rough.fitness + 0.1, "{found:?} {rough:?}");
        assert!(found.fitness_rmse < rough.fitness_rmse, "{found:?} {rough:?}");
    }

    #[test]
    fn keypoints_of_other_detectors_register_too() {
        use KeypointDetector::{Fps, Random};
        let points = sample();
        let truth = RigidTransform::from(random_transform(&mut ChaCha8Rng::seed_from_u64(1)));
        let (source, target) = (&points[..2048], transform_points(&truth, &points[2048..]));
        for detector in [Fps, Random] {
            let found = run(source, &target, &RegisterOptions { detector, ..options() }).unwrap();
            assert!(difference(source, &found.t_target_source, &truth) < 0.05, "{detector:?}: {found:?}");
        }
        // The cloud is registered to itself: its random points are not those of the target.
        let few = RegisterOptions { detector: Random, max_keypoints: 200, ..options() };
        let twice = run(source, source, &few).unwrap();
        assert!(twice.rmse > 0.0, "{twice:?}");
        assert_ne!(
            twice,
            Registration {
                seconds: twice.seconds,
                ..run(source, source, &RegisterOptions { seed: 5, ..few }).unwrap()
            }
        );
    }

    #[test]
    fn threads_do_not_matter() {
        let points = sample();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let found = pool.install(|| run(&points[..2000], &points[2000..], &options()).unwrap());
            Registration { seconds: 0.0, ..found }
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn clouds_that_cannot_be_registered_are_refused() {
        let good = sample();
        let line: Vec<Point> = (0..500).map(|i| [0.01 * i as f32, 0.0, 0.0]).collect();
        let plane: Vec<Point> = (0..900).map(|i| [(i % 30) as f32, (i / 30) as f32, 0.0]).collect();
        for (bad, expected) in [
            (vec![], "no points"),
            (vec![[1.0; 3]], "two different"),
            (vec![[1.0; 3]; 99], "two different"),
            (vec![[f32::NAN; 3]; 9], "none of the 9 points is finite"),
        ] {
            let error = run(&bad, &good, &options()).unwrap_err().to_string();
            assert!(error.starts_with("source: ") && error.contains(expected), "{error}");
            let error = run(&good, &bad, &options()).unwrap_err().to_string();
            assert!(error.starts_with("target: ") && error.contains(expected), "{error}");
        }
        // Clouds that determine no rotation, or that do not match, give few inliers or an error, but never a panic.
        for poor in [line, plane, good[..2].to_vec(), good[..5].to_vec()] {
            for (source, target) in [(&poor, &good), (&good, &poor), (&poor, &poor)] {
                match run(source, target, &options()) {
                    Ok(found) => {
                        assert!(found.t_target_source.to_matrix().as_flattened().iter().all(|v| v.is_finite()))
                    }
                    Err(error) => assert!(error.to_string().contains("correspondences"), "{error}"),
                }
            }
        }
    }

    #[test]
    fn lengths_may_be_multiples_of_the_coarser_clouds_resolution() {
        let points = sample();
        let (fine, coarse) = (&points[..3000], &points[3000..]);
        let spacing = resolution("points", coarse).unwrap();
        assert!(spacing > resolution("points", fine).unwrap());
        let lengths = |unit: fn(f64) -> Length, scale: f64| RegisterOptions {
            voxel_size: Some(unit(scale)),
            normal_radius: Some(unit(3.0 * scale)),
            feature_radius: Some(unit(8.0 * scale)),
            inlier_distance: Some(unit(2.0 * scale)),
            ..options()
        };
        let found = |options| Registration { seconds: 0.0, ..run(fine, coarse, &options).unwrap() };
        assert_eq!(found(lengths(Length::Resolutions, 1.0)), found(lengths(Length::Units, spacing)));
    }

    #[test]
    fn points_that_are_not_finite_are_skipped() {
        let points = sample();
        let (source, target) = (&points[..1500], &points[1500..3000]);
        let nan = [source, &[[f32::NAN; 3]; 7], &[[0.0, 0.0, f32::INFINITY]]].concat();
        let (expected, found) = (run(source, target, &options()).unwrap(), run(&nan, target, &options()).unwrap());
        assert_eq!(found, Registration { num_skipped: [8, 0], seconds: found.seconds, ..expected });
    }

    #[test]
    fn options_outside_their_range_are_named() {
        let points = &sample()[..500];
        for (options, name) in [
            (RegisterOptions { max_keypoints: 2, ..options() }, "max_keypoints"),
            (RegisterOptions { voxel_size: Some(Length::Units(0.0)), ..options() }, "voxel_size"),
            (RegisterOptions { normal_radius: Some(Length::Resolutions(-1.0)), ..options() }, "normal_radius"),
            (RegisterOptions { feature_radius: Some(Length::Units(f64::NAN)), ..options() }, "feature_radius"),
            (RegisterOptions { inlier_distance: Some(Length::Units(f64::INFINITY)), ..options() }, "inlier_distance"),
            (RegisterOptions { max_matches: 2, ..options() }, "max_matches"),
            (RegisterOptions { hypotheses: 0, ..options() }, "hypotheses"),
            (RegisterOptions { source_viewpoint: Some([f64::NAN; 3]), ..options() }, "source_viewpoint"),
        ] {
            let error = run(points, points, &options).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
        // Each cloud is reduced to one voxel.
        let options = RegisterOptions { voxel_size: Some(Length::Units(1e3)), ..options() };
        assert!(run(points, points, &options).unwrap_err().to_string().contains("correspondences"));
    }
}
