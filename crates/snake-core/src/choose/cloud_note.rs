//! What a user should know of a cloud before its keypoints.

use super::few_voxels::{self, rounded};
use crate::cloud::UsedCloud;
use crate::network::ModelConfig;
use crate::options::Options;

/// What was left out of a cloud ([`UsedCloud::findings`]), a haze ([`UsedCloud::haze`]), and coordinates that were rounded to more
/// than a voxel, and a cloud of which one object's voxels show little; `None` if nothing is wrong.
pub(super) fn cloud_note(cloud: &UsedCloud, config: &ModelConfig, options: &Options) -> Option<String> {
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
    let few = config.frame().and_then(|_| few_voxels::note(cloud));
    cloud.findings().into_iter().chain(haze).chain(step).chain(few).reduce(|first, second| format!("{first}; {second}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::sphere;
    use crate::{Builtin, Model};
    use snake_geometry::Point;

    fn note(model: &Model, points: &[Point]) -> String {
        let cloud = UsedCloud::new(points).unwrap();
        cloud_note(&cloud, model.config(), model.recommended()).unwrap_or_default()
    }

    #[test]
    fn sky_about_an_object_is_named() {
        let compact = Model::builtin(Builtin::Compact);
        let mut splats = sphere(6000, 1.0);
        assert_eq!(note(&compact, &splats), "");
        splats.extend(sphere(1500, 100.0));
        let text = note(&compact, &splats);
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
            let text = format!("the y coordinates are multiples of {step},");
            assert_eq!(note(model, &points).contains(&text), is_named, "{step}");
        }
    }
}
