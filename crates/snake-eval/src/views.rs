//! Disturbed views of an object or of a scene, as in the paper's tables of repeatability (SNAKE section 4.2).

use nalgebra::{IsometryMatrix3, Point3, Quaternion, Translation3, UnitQuaternion};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use snake_geometry::{Normalization, NormalizationMethod, Point, RigidTransform};

use crate::error::{Error, Result};

/// A disturbance of both views, as in the paper's tables.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// Down-sampling rate: a rate of N keeps one point in N.
    pub downsample: usize,
    /// Standard deviation of the Gaussian noise on each coordinate, in units of the views.
    pub noise: f64,
}

impl Condition {
    /// A cloud under the condition, whose noise is in its units: one point in N, chosen at random, with noise. A cloud that is
    /// not thinned keeps its order.
    ///
    /// # Errors
    /// [`Error::Input`] when the cloud has no points, the down-sampling rate is 0, or the noise is negative or not finite.
    pub fn apply(self, points: &[Point], seed: u64) -> Result<Vec<Point>> {
        self.check(points.is_empty())?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let kept = match self.downsample {
            1 => points.to_vec(),
            rate => choose(points, (points.len() / rate).max(1), &mut rng),
        };
        Ok(self.noisy(kept, &mut rng))
    }

    fn noisy(self, points: Vec<Point>, rng: &mut impl Rng) -> Vec<Point> {
        let mut add_noise = |v: f32| (f64::from(v) + self.noise * rng.sample::<f64, _>(StandardNormal)) as f32;
        points.into_iter().map(|point| point.map(&mut add_noise)).collect()
    }

    /// Refuses conditions and clouds that no view can be drawn from.
    fn check(self, is_empty: bool) -> Result<()> {
        let refused = |what, reason: &str| Err(Error::Input { what, reason: reason.into() });
        match self {
            _ if is_empty => refused("clouds", "a cloud without points"),
            Self { downsample: 0, .. } => refused("downsample", "allowed is 1 or more"),
            Self { noise, .. } if !(0.0..=1e30).contains(&noise) => refused("noise", "allowed is 0 to 1e30"),
            _ => Ok(()),
        }
    }
}

/// The clouds that the views of a pair are drawn from, in the units of the figures.
#[derive(Debug, Clone, PartialEq)]
pub enum PairClouds {
    /// An object `(N, 3)`, of radius 1 or in the units of its file. Both views are samples of it, and the second view is rotated at random.
    Object(Vec<Point>),
    /// Two clouds of the same scene.
    Real {
        /// Clouds 1 `(N, 3)` and 2 `(M, 3)`, each in its own frame.
        clouds: [Vec<Point>; 2],
        /// Maps cloud 2 to the frame of cloud 1.
        t_1_2: RigidTransform,
        /// Offsets to add to the clouds, as they were read.
        origins: [[f64; 3]; 2],
    },
}

/// Two views of a pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Views {
    /// The points of the first view.
    pub view_1: Vec<Point>,
    /// The points of the second view, in a frame of its own.
    pub view_2: Vec<Point>,
    /// Maps the second view to the frame of the first.
    pub t_1_2: RigidTransform,
    /// A seed for the random choices of a detector on each view.
    pub seeds: [u64; 2],
    /// Offsets to add to the views for the frames of the clouds' files.
    pub origins: [[f64; 3]; 2],
}

impl PairClouds {
    /// Scales an object `(N, 3)` so that its radius about its mean is 1. The object is not centred.
    ///
    /// # Errors
    /// [`Error::Core`] when the points have no extent.
    pub fn object(points: &[Point]) -> Result<Self> {
        let radius = Normalization::of(points, NormalizationMethod::UnitSphere)?.scale / 2.0;
        Ok(Self::Object(points.iter().map(|point| point.map(|v| v / radius)).collect()))
    }

    /// Scales a real pair so that the radius of the first cloud about its mean is 1. The clouds are not centred.
    ///
    /// # Errors
    /// [`Error::Core`] when the points of the first cloud have no extent.
    pub fn with_unit_radius(self) -> Result<Self> {
        let Self::Real { clouds, t_1_2, origins } = self else { return Ok(self) };
        let radius = Normalization::of(&clouds[0], NormalizationMethod::UnitSphere)?.scale / 2.0;
        let clouds = clouds.map(|points| points.into_iter().map(|point| point.map(|v| v / radius)).collect());
        let origins = origins.map(|origin| origin.map(|v| v / f64::from(radius)));
        Ok(Self::Real { clouds, t_1_2: t_1_2.in_units_of(f64::from(radius)), origins })
    }

    /// Draws views of at most `num_points` points under a condition. The number of the pair selects a random stream of
    /// the seed. The same seed and pair give the same rotation under every condition.
    ///
    /// # Errors
    /// [`Error::Input`] when a cloud has no points, the down-sampling rate is 0, or the noise is negative or not finite.
    pub fn views(&self, condition: Condition, num_points: usize, seed: u64, pair: usize) -> Result<Views> {
        condition.check(match self {
            Self::Object(points) => points.is_empty(),
            Self::Real { clouds, .. } => clouds.iter().any(Vec::is_empty),
        })?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(pair as u64);
        let share = |points: &[Point]| (num_points.min(points.len()) / condition.downsample).max(1);
        let ([first, second], t_1_2) = match self {
            Self::Object(points) => {
                // A unit quaternion in a uniform direction is a uniform rotation.
                let [w, x, y, z] = std::array::from_fn(|_| rng.sample::<f64, _>(StandardNormal));
                let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
                let rotate = |point: Point| -> Point {
                    (rotation * Point3::from(point.map(f64::from))).coords.map(|v| v as f32).into()
                };
                let first = choose(points, share(points), &mut rng);
                let second = choose(points, share(points), &mut rng).into_iter().map(rotate).collect();
                let inverse = rotation.inverse().to_rotation_matrix();
                ([first, second], IsometryMatrix3::from_parts(Translation3::identity(), inverse).into())
            }
            Self::Real { clouds, t_1_2, .. } => {
                (clouds.each_ref().map(|points| choose(points, share(points), &mut rng)), *t_1_2)
            }
        };
        let (view_1, view_2) = (condition.noisy(first, &mut rng), condition.noisy(second, &mut rng));
        let origins = match self {
            Self::Object(_) => [[0.0; 3]; 2],
            Self::Real { origins, .. } => *origins,
        };
        Ok(Views { view_1, view_2, t_1_2, seeds: [rng.random(), rng.random()], origins })
    }
}

/// `number` random points without replacement.
fn choose(points: &[Point], number: usize, rng: &mut impl Rng) -> Vec<Point> {
    let chosen = rand::seq::index::sample(rng, points.len(), number);
    chosen.into_iter().map(|index| points[index]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(number: usize) -> Vec<Point> {
        (0..number).map(|i| [(i as f32).sin() * 3.0 + 5.0, (i as f32 * 1.7).cos(), (i % 7) as f32]).collect()
    }

    fn distance(a: Point, b: Point) -> f64 {
        (0..3).map(|axis| (f64::from(a[axis]) - f64::from(b[axis])).powi(2)).sum::<f64>().sqrt()
    }

    const CLEAN: Condition = Condition { downsample: 1, noise: 0.0 };

    #[test]
    fn an_object_has_radius_1_and_the_transform_aligns_its_second_view() {
        let clouds = PairClouds::object(&ball(300)).unwrap();
        let PairClouds::Object(points) = &clouds else { unreachable!() };
        let mean: Point = std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f32>() / 300.0);
        let radius = points.iter().map(|&p| distance(p, mean)).fold(0.0, f64::max);
        assert!((radius - 1.0).abs() < 1e-5);
        let views = clouds.views(CLEAN, 200, 0, 3).unwrap();
        assert_eq!((views.view_1.len(), views.view_2.len()), (200, 200));
        let on_cloud = |p: Point| points.iter().any(|&q| distance(p, q) < 1e-5);
        assert!(views.view_1.iter().all(|&p| on_cloud(p)));
        assert!(views.view_2.iter().all(|&p| on_cloud(views.t_1_2.apply(p))));
        assert!(views.view_2.iter().filter(|&&p| on_cloud(p)).count() < 100);
    }

    #[test]
    fn views_are_seeded_by_pair_and_every_condition_has_the_same_rotation() {
        let clouds = PairClouds::object(&ball(300)).unwrap();
        let views = |condition, seed, pair| clouds.views(condition, 200, seed, pair).unwrap();
        let usual = views(CLEAN, 0, 0);
        assert_eq!(views(CLEAN, 0, 0).view_2, usual.view_2);
        for other in [views(CLEAN, 0, 1), views(CLEAN, 1, 0)] {
            assert!(other.view_1 != usual.view_1 && other.t_1_2 != usual.t_1_2 && other.seeds != usual.seeds);
        }
        let few = views(Condition { downsample: 16, noise: 0.0 }, 0, 0);
        assert_eq!((few.view_1.len(), few.t_1_2), (12, usual.t_1_2));
        let noisy = views(Condition { downsample: 1, noise: 0.1 }, 0, 0);
        assert_eq!(noisy.t_1_2, usual.t_1_2);
        for (noisy, clean) in [(noisy.view_1, usual.view_1), (noisy.view_2, usual.view_2)] {
            let squared: f64 = noisy.iter().zip(clean).map(|(&a, b)| distance(a, b).powi(2)).sum::<f64>() / 600.0;
            assert!((squared.sqrt() - 0.1).abs() < 0.01, "{squared}");
        }
    }

    #[test]
    fn a_cloud_under_a_condition_is_a_part_of_itself_with_noise() {
        let points = ball(300);
        assert_eq!(CLEAN.apply(&points, 1).unwrap(), points);
        let thinned = Condition { downsample: 8, ..CLEAN }.apply(&points, 1).unwrap();
        assert!(thinned.len() == 37 && thinned.iter().all(|point| points.contains(point)));
        assert_ne!(thinned, Condition { downsample: 8, ..CLEAN }.apply(&points, 2).unwrap());
        let noisy = Condition { noise: 0.1, ..CLEAN }.apply(&points, 1).unwrap();
        let squared: f64 = noisy.iter().zip(&points).map(|(&a, &b)| distance(a, b).powi(2)).sum::<f64>() / 900.0;
        assert!((squared.sqrt() - 0.1).abs() < 0.01, "{squared}");
        assert!(CLEAN.apply(&[], 1).is_err() && Condition { downsample: 0, ..CLEAN }.apply(&points, 1).is_err());
    }

    #[test]
    fn real_pairs_keep_their_units_and_transform() {
        let t_1_2 = RigidTransform::from(IsometryMatrix3::translation(2.0, 0.0, 0.0));
        let clouds = PairClouds::Real { clouds: [ball(50), ball(80)], t_1_2, origins: [[0.0; 3]; 2] };
        let views = clouds.views(CLEAN, 60, 0, 0).unwrap();
        assert_eq!((views.view_1.len(), views.view_2.len(), views.t_1_2), (50, 60, t_1_2));
        assert!(views.view_1.iter().all(|p| ball(50).contains(p)));
        let Ok(PairClouds::Real { clouds: [first, second], t_1_2: scaled, .. }) =
            PairClouds::Real { clouds: [ball(300), ball(80)], t_1_2, origins: [[0.0; 3]; 2] }.with_unit_radius()
        else {
            panic!("a real pair")
        };
        let PairClouds::Object(object) = PairClouds::object(&ball(300)).unwrap() else { panic!("an object") };
        let radius = f64::from(ball(300)[0][0] / first[0][0]);
        assert_eq!((&first, &second), (&object, &object[..80].to_vec()));
        let (angle, distance) = scaled.angle_and_distance_to(&RigidTransform::identity());
        assert!((distance - 2.0 / radius).abs() < 1e-6 && angle == 0.0);
        for (condition, message) in [
            (Condition { downsample: 0, noise: 0.0 }, "downsample"),
            (Condition { downsample: 1, noise: f64::NAN }, "noise"),
            (Condition { downsample: 1, noise: -0.1 }, "noise"),
        ] {
            assert!(clouds.views(condition, 60, 0, 0).unwrap_err().to_string().starts_with(message));
        }
        let empty = PairClouds::Object(Vec::new()).views(CLEAN, 60, 0, 0).unwrap_err();
        assert_eq!(empty.to_string(), "clouds: a cloud without points");
        // Down-sampling also applies to a cloud with fewer points than requested.
        let views = clouds.views(Condition { downsample: 4, noise: 0.0 }, 60, 0, 0).unwrap();
        assert_eq!((views.view_1.len(), views.view_2.len()), (12, 15));
    }
}
