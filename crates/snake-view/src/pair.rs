//! The alignment of the two clouds on a page.

use serde_json::{Value, json};
use snake_core::{Result, RigidTransform};
use snake_eval::repeated_keypoints;
use snake_registration::Registration;

use crate::shown_cloud::ShownCloud;

/// The alignment of two clouds and their repeated keypoints.
pub struct Pair {
    /// Maps a point of the second cloud to the first; the origins are included.
    pub t_first_second: RigidTransform,
    /// The registration that found the transform; `None` if the user gave it.
    pub registration: Option<Registration>,
    /// A keypoint repeats if a keypoint of the other cloud is nearer than this.
    pub epsilon: f64,
    /// For each keypoint of the first cloud: the index of the keypoint of the second that repeats it, and their
    /// distance.
    pub partners: Vec<Option<(usize, f64)>>,
}

impl Pair {
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
        let [of_first, of_second] = [first, second].map(ShownCloud::keypoint_positions);
        let partners = repeated_keypoints(&of_first, &of_second, near, epsilon)?;
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
            Some(Registration { num_inliers, num_correspondences, .. }) => {
                format!("{repeated}; {num_inliers} of {num_correspondences} matches agree")
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
            "registration": self.registration.as_ref().map(|found| [found.num_inliers, found.num_correspondences]),
            "epsilon": self.epsilon,
            "links": links.collect::<Vec<_>>(),
        })
    }
}
