//! A hint where a cloud is far from the scale that the options are for.

use std::ops::Range;

use crate::cloud::UsedCloud;
use crate::network::ModelConfig;
use crate::options::Options;
use snake_geometry::Point;

/// A few far points set the scale if the median distance from the centre is below this fraction of the radius. Whole objects and
/// rooms have 0.25 and more, a sweep of a spinning LiDAR about 0.1.
const CROWDED: f64 = 0.2;
/// Number of points and radii, in cloud units, of clouds that may be rooms in metres.
const ROOM_POINTS: usize = 10_000;
const ROOM_RADII: Range<f64> = 1.3..30.0;

/// A text for the user if detection with these options suits another scale than the cloud's: a room that
/// is detected as one object, or a LiDAR sweep. It also names
/// what was left out ([`UsedCloud::findings`]), a haze ([`UsedCloud::haze`]), and coordinates that were rounded to more than
/// a voxel. `None` if nothing is wrong. Clouds with the same fault have the same
/// text, so that a program can say it once.
///
/// ```
/// use snake_core::{Builtin, Model, UsedCloud, scale_hint};
/// let object: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()].map(|v| 0.2 * v) }).collect();
/// let model = Model::builtin(Builtin::Compact);
/// assert_eq!(scale_hint(&UsedCloud::new(&object)?, model.config(), model.recommended()), None);
/// # Ok::<(), snake_core::Error>(())
/// ```
pub fn scale_hint(cloud: &UsedCloud, config: &ModelConfig, options: &Options) -> Option<String> {
    let haze = cloud.haze().map(|share| {
        format!(
            "about {:.0} % of the points stand alone, far from their neighbours, as haze and floaters do: keypoints may lie \
             on them; remove them, for example by a statistical filter",
            100.0 * share
        )
    });
    let step = config.volume.coarse_step(cloud, &options.encode).map(|step| {
        format!(
            "the {} coordinates are multiples of {}, farther apart than the points, and no voxel is smaller: they were \
             rounded, as float32 does far from zero; store them in double precision or near zero",
            ["x", "y", "z"][step.axis],
            rounded(step.length)
        )
    });
    let hints = [haze, step, hint_without_outliers(cloud.points(), config, options)];
    cloud.findings().into_iter().chain(hints.into_iter().flatten()).reduce(|first, second| format!("{first}; {second}"))
}

/// A length with three digits.
fn rounded(length: f64) -> f64 {
    format!("{length:.2e}").parse().unwrap_or(length)
}

/// The hint for the points that are used.
fn hint_without_outliers(points: &[Point], config: &ModelConfig, options: &Options) -> Option<String> {
    let sphere = config.volume.scaled_sphere(points, options.encode.normalization)?;
    let radius = f64::from(sphere.scale) / 2.0;
    let half = median_distance(points, sphere.center);
    if half < CROWDED * radius {
        return Some(format!(
            "half of the points lie within {CROWDED} times the cloud's radius: the network sees most points in few \
             voxels; the model `scenes` sees all of it"
        ));
    }
    let may_be_room = points.len() >= ROOM_POINTS && ROOM_RADII.contains(&radius);
    may_be_room.then(|| {
        let Range { start, end } = ROOM_RADII;
        format!(
            "the cloud has a radius of {start} to {end}: if it is a room in metres, the model `scenes` sees more of it"
        )
    })
}

/// The median distance of the points from the center.
fn median_distance(points: &[Point], center: Point) -> f64 {
    let squared = |p: &Point| (0..3).map(|axis| f64::from(p[axis] - center[axis]).powi(2)).sum::<f64>();
    let mut distances: Vec<f64> = points.iter().map(squared).collect();
    let middle = distances.len() / 2;
    distances.select_nth_unstable_by(middle, f64::total_cmp).1.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builtin, Model};
    use snake_geometry::NormalizationMethod;

    /// Points on a sphere.
    fn sphere(number: usize, radius: f32) -> Vec<Point> {
        let point = |i: usize| {
            let z = 2.0 * (i as f32 + 0.5) / number as f32 - 1.0;
            let (sin, cos) = (i as f32 * 2.4).sin_cos();
            let flat = (1.0 - z * z).sqrt();
            [radius * flat * cos, radius * flat * sin, radius * z]
        };
        (0..number).map(point).collect()
    }

    fn hint(points: &[Point]) -> String {
        let options = *Model::builtin(Builtin::Compact).recommended();
        let cloud = UsedCloud::new(points).unwrap();
        scale_hint(&cloud, Model::builtin(Builtin::Compact).config(), &options).unwrap_or_default()
    }

    #[test]
    fn objects_have_no_hint_and_rooms_have_one() {
        assert_eq!(hint(&sphere(20_000, 1.0)), "");
        assert_eq!(hint(&sphere(2_000, 3.0)), "");
        assert_eq!(hint(&sphere(20_000, 300.0)), "");
        assert!(hint(&sphere(20_000, 3.0)).contains("the model `scenes`"));
    }

    #[test]
    fn far_points_and_sweeps_have_a_hint() {
        let mut sweep = sphere(900, 5.0);
        // So few that they also stand alone; at one distance they would be missing returns.
        sweep.extend(sphere(100, 30.0).into_iter().enumerate().map(|(i, p)| p.map(|v| v * (1.0 + 3e-4 * i as f32))));
        assert!(hint(&sweep).contains("; half of the points lie within 0.2"), "{}", hint(&sweep));
        sweep.push([31.0, 0.0, 0.0]);
        let mut other = sweep.clone();
        other.push([33.0, 0.0, 0.0]);
        assert_eq!(hint(&sweep), hint(&other));
    }

    #[test]
    fn sky_about_an_object_is_named() {
        let mut splats = sphere(6000, 1.0);
        splats.extend(sphere(1500, 100.0));
        let text = hint(&splats);
        assert!(text.starts_with("1500 of 7500 points are up to ") && text.contains("sky, floaters"), "{text}");
    }

    #[test]
    fn rounded_coordinates_are_named_if_they_are_coarser_than_voxels() {
        let scenes = Model::builtin(Builtin::Scenes);
        for (model, step, is_named) in [
            (&scenes, 0.5, true),
            (&scenes, 0.001, false),
            (&Model::builtin(Builtin::Compact), 0.5, true),
            (&Model::builtin(Builtin::Compact), 0.01, false),
        ] {
            let points: Vec<Point> =
                sphere(5000, 5.0).into_iter().map(|[x, y, z]| [x, (y / step).round() * step, z]).collect();
            let hint = scale_hint(&UsedCloud::new(&points).unwrap(), model.config(), model.recommended());
            let text = format!("the y coordinates are multiples of {step},");
            assert_eq!(hint.is_some_and(|hint| hint.contains(&text)), is_named, "{step}");
        }
    }

    #[test]
    fn outliers_are_named_beside_other_hints() {
        let with_one = |mut points: Vec<Point>| {
            points.push([1e4, 0.0, 0.0]);
            points
        };
        let object = hint(&with_one(sphere(6000, 1.0)));
        assert!(object.starts_with("1 of 6001 points is 10000 times as far") && !object.contains("; "), "{object}");
        let room = hint(&with_one(sphere(20_000, 3.0)));
        assert!(room.contains("left out; ") && room.contains("the model `scenes`"), "{room}");
    }

    #[test]
    fn bad_clouds_and_scene_models_have_no_hint() {
        assert_eq!(hint(&[[1.0; 3]; 9]), "");
        let options = *Model::builtin(Builtin::Compact).recommended();
        let room = sphere(20_000, 3.0);
        let cloud = UsedCloud::new(&room).unwrap();
        let unscaled = options.with_encode(options.encode.with_normalization(NormalizationMethod::None));
        assert_eq!(scale_hint(&cloud, Model::builtin(Builtin::Compact).config(), &unscaled), None);
        let scenes = Model::builtin(Builtin::Scenes);
        assert_eq!(scale_hint(&cloud, scenes.config(), scenes.recommended()), None);
    }
}
