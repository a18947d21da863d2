//! The alignment of the two clouds on a page.

use serde_json::{Value, json};
use snake_core::{Control, Error, Point, Result};
use snake_geometry::{Length, Neighbors, Normalization, NormalizationMethod, RigidTransform, vector};
use snake_registration::{PairOptions, RegisterOptions, Registration, register_with};

use crate::shown_cloud::ShownCloud;

/// The alignment of two clouds and their repeated keypoints.
pub struct ShownPair {
    /// Maps a point of the second cloud to the first; the origins are included.
    pub t_first_second: RigidTransform,
    /// The registration that found the transform; `None` if the user gave it.
    pub registration: Option<Registration>,
    /// A keypoint repeats if a keypoint of the other cloud is closer than this.
    pub epsilon: f64,
    /// For each keypoint of the first cloud, the index and the distance of the keypoint of the second that repeats
    /// it.
    pub partners: Vec<Option<(usize, f64)>>,
}

/// The default `epsilon`, as a share of the first cloud's radius.
const EPSILON: f64 = 0.04;

impl ShownPair {
    /// Aligns the second cloud to the first, by registration if the transform is not given, and finds the keypoints that
    /// repeat. `t_first_second` includes the origins. The default of `epsilon` is 0.04 of the first cloud's radius.
    ///
    /// # Errors
    /// The errors of [`register_with`] and of [`ShownPair::new`].
    pub fn aligned(
        clouds: [&ShownCloud; 2],
        t_first_second: Option<RigidTransform>,
        epsilon: Option<Length>,
        control: &Control,
    ) -> Result<Self> {
        let [first, second] = clouds;
        let radius = Normalization::of(first.field.points(), NormalizationMethod::UnitSphere)?.scale / 2.0;
        let epsilon = epsilon.unwrap_or(Length::Units(EPSILON * f64::from(radius)));
        let epsilon = epsilon.in_units("epsilon", first.field.points())?;
        let (near, registration) = match t_first_second {
            Some(transform) => (transform.subtract_origins(second.origin, first.origin), None),
            None => {
                let (source, target) = (second.field.points(), first.field.points());
                let (options, pair_options) = (RegisterOptions::default(), PairOptions::default());
                let registration = register_with(source, target, None, &options, &pair_options, control)?;
                (registration.t_target_source, Some(registration))
            }
        };
        Self::new(first, second, &near, registration, epsilon)
    }

    /// Finds the keypoints that repeat within `epsilon`, in cloud units. `near` maps a point of the second cloud to the
    /// first, both relative to their origins.
    ///
    /// # Errors
    /// [`Error::Option`](snake_core::Error::Option) when `epsilon` is out of its range.
    pub fn new(
        first: &ShownCloud,
        second: &ShownCloud,
        near: &RigidTransform,
        registration: Option<Registration>,
        epsilon: f64,
    ) -> Result<Self> {
        let [first_positions, second_positions] = [first, second].map(ShownCloud::keypoint_positions);
        let partners = partners(&first_positions, &second_positions, near, epsilon)?;
        let t_first_second = near.add_origins(second.origin, first.origin);
        Ok(Self { t_first_second, registration, epsilon, partners })
    }

    /// Number of keypoints of the first cloud that repeat.
    fn repeated(&self) -> usize {
        self.partners.iter().flatten().count()
    }

    /// A line for the printed report.
    pub fn summary(&self) -> String {
        let repeated =
            format!("{} of {} keypoints repeat within {:.4}", self.repeated(), self.partners.len(), self.epsilon);
        match &self.registration {
            Some(Registration { matches, .. }) => {
                format!("{repeated}; {} of {} matches agree", matches.num_inliers, matches.num_matches)
            }
            None => repeated,
        }
    }

    pub(crate) fn data(&self) -> Value {
        let links = self.partners.iter().enumerate();
        let links =
            links.filter_map(|(first, partner)| partner.map(|(second, distance)| json!([first, second, distance])));
        json!({
            "t_first_second": self.t_first_second,
            "registration": self.registration.as_ref().map(|registration| {
                [registration.matches.num_inliers, registration.matches.num_matches]
            }),
            "epsilon": self.epsilon,
            "links": links.collect::<Vec<_>>(),
        })
    }
}

/// For each keypoint of the first cloud, the index and the distance of the nearest keypoint of the second, if it is
/// closer than `epsilon`. `near` maps the second cloud to the first.
fn partners(
    first: &[Point],
    second: &[Point],
    near: &RigidTransform,
    epsilon: f64,
) -> Result<Vec<Option<(usize, f64)>>> {
    if epsilon.is_nan() || epsilon < 0.0 {
        return Err(Error::Option { name: "epsilon", value: epsilon.to_string(), allowed: "0 or more (cloud units)" });
    }
    if second.is_empty() {
        return Ok(vec![None; first.len()]);
    }
    let second = Neighbors::new(second.iter().map(|&point| near.apply_vector(&vector(point))).collect())?;
    // The lower index wins at equal distances.
    let nearest = |&keypoint: &Point| {
        let keypoint = vector(keypoint);
        let within = second.within(&keypoint, epsilon).into_iter();
        let distances = within.map(|index| (index, (second.points[index] - keypoint).norm()));
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    };
    Ok(first.iter().map(nearest).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partners_are_the_nearest_within_epsilon() {
        let first = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0], [9.0, 9.0, 9.0]];
        let second = [[0.25, 0.0, 0.0], [1.0, 0.5, 0.0], [0.25, 0.0, 0.0]];
        let partners = |second: &[Point], epsilon| partners(&first, second, &RigidTransform::identity(), epsilon);
        assert_eq!(partners(&second, 0.51).unwrap(), [Some((0, 0.25)), Some((1, 0.5)), None, None]);
        assert_eq!(partners(&second, 0.25).unwrap(), [None; 4], "the boundary is outside");
        assert_eq!(partners(&[], 9.0).unwrap(), [None; 4]);
        assert!(partners(&second, -1.0).is_err());
    }
}
