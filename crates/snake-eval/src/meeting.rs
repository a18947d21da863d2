//! Whether the clouds of a pair meet under their transform. Figures of pairs that do not are near zero for every method.

use rayon::prelude::*;
use snake_core::Result;
use snake_geometry::{Neighbors, Point, RigidTransform, check_points, vector};

/// A point meets a cloud within this many of its resolutions.
const REACH: f64 = 3.0;
/// The most source points that are looked at, evenly spaced.
const MAX_POINTS: usize = 500;
/// Clouds with shares below this do not meet. Of 97 pairs of rooms with overlaps from 0.11 on, the least share was 0.14
/// under the right transform, and the median 0.02 under its inverse and under that of another pair.
const MIN_SHARE: f64 = 0.05;
/// Under an inverse with this share, which is also twice that of the transform, the clouds meet: none of the 97 pairs had one.
const INVERSE_SHARE: f64 = 0.1;

/// How far two clouds meet: shares of the source points that lie near the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meeting {
    /// The share under the transform.
    pub share: f64,
    /// The share under the inverse of the transform.
    pub inverse_share: f64,
}

impl Meeting {
    /// How far a source `(N, 3)` and a target `(M, 3)` meet under `t_target_source`. A source point is near the target within
    /// three resolutions of the coarser cloud.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) for an empty cloud or coordinates that are not finite.
    pub fn of(source: &[Point], target: &[Point], t_target_source: &RigidTransform) -> Result<Self> {
        check_points("source", source)?;
        check_points("target", target)?;
        let [source, target] = [source, target].map(|points| points.iter().copied().map(vector).collect::<Vec<_>>());
        let [source, target] = [Neighbors::new(source)?, Neighbors::new(target)?];
        let reach = REACH * source.resolution().max(target.resolution());
        let step = source.points.len().div_ceil(MAX_POINTS);
        let some: Vec<_> = source.points.iter().step_by(step).collect();
        let share = |transform: &RigidTransform| {
            let near = some.par_iter().filter(|point| target.distance(&transform.apply_vector(point)) <= reach);
            near.count() as f64 / some.len() as f64
        };
        Ok(Self { share: share(t_target_source), inverse_share: share(&t_target_source.inverse()) })
    }

    fn is_inverse(&self) -> bool {
        self.inverse_share >= INVERSE_SHARE && self.inverse_share > 2.0 * self.share
    }

    fn is_apart(&self) -> bool {
        self.share < MIN_SHARE || self.is_inverse()
    }
}

/// One sentence that names the pairs whose clouds do not meet, if there are any, of the pairs that were looked at.
pub fn meeting_note(pairs: &[(String, Meeting)]) -> Option<String> {
    let apart: Vec<&(String, Meeting)> = pairs.iter().filter(|(_, meeting)| meeting.is_apart()).collect();
    let name = |(name, Meeting { share, inverse_share }): &&(String, Meeting)| {
        format!("{name} (share of points that meet {share:.2}, under the inverse {inverse_share:.2})")
    };
    let mut names: Vec<String> = apart.iter().take(3).map(name).collect();
    if apart.len() > names.len() {
        names.push(format!("and {} more", apart.len() - names.len()));
    }
    let inverse = apart.iter().filter(|(_, meeting)| meeting.is_inverse()).count();
    let advice = if 2 * inverse > apart.len() {
        "the transforms map the wrong way: they must map the source to the target, into the first view"
    } else {
        "are the transforms of these pairs, from the source to the target, and in the clouds' unit?"
    };
    (!apart.is_empty()).then(|| {
        format!(
            "the clouds of {} of {} pairs that were looked at do not overlap: {}; {advice}",
            apart.len(),
            pairs.len(),
            names.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{IsometryMatrix3, Vector3};

    use super::*;

    /// Points on three walls of a room.
    fn room(shift: f32) -> Vec<Point> {
        let place = |i: usize| [(i % 40) as f32 * 0.1, (i / 40) as f32 * 0.1];
        let wall = |wall: usize| {
            (0..1600).map(move |i| {
                let [u, v] = place(i);
                [[u, v, 0.0], [u, 0.0, v], [0.0, u, v]][wall].map(|v| v + shift)
            })
        };
        (0..3).flat_map(wall).collect()
    }

    fn moved(points: &[Point], t: &RigidTransform) -> Vec<Point> {
        points.iter().map(|&point| t.apply(point)).collect()
    }

    #[test]
    fn a_wrong_direction_unit_or_pair_is_named_and_a_right_transform_is_not() {
        let t: RigidTransform = IsometryMatrix3::new(Vector3::new(1.3, -0.7, 0.4), Vector3::new(0.2, 0.3, 1.4)).into();
        let (source, target) = (room(0.7), moved(&room(0.7), &t));
        let note = |t: &RigidTransform| meeting_note(&[("a to b".into(), Meeting::of(&source, &target, t).unwrap())]);
        assert_eq!(note(&t), None);
        let text = note(&t.inverse()).unwrap();
        assert!(text.contains("1 of 1 pairs") && text.contains("a to b (") && text.contains("wrong way"), "{text}");
        for wrong in [t.in_units_of(1e-3), IsometryMatrix3::translation(40.0, 0.0, 0.0).into()] {
            let text = note(&wrong).unwrap();
            assert!(text.contains("do not overlap") && text.contains("unit"), "{text}");
        }
    }

    #[test]
    fn a_symmetric_transform_is_its_inverse_and_many_pairs_are_counted() {
        let points = room(0.0);
        let meeting = Meeting::of(&points, &points, &RigidTransform::identity()).unwrap();
        assert_eq!((meeting.share, meeting.inverse_share), (1.0, 1.0));
        let apart = Meeting { share: 0.0, inverse_share: 0.0 };
        let pairs: Vec<_> = (0..9).map(|i| (format!("p{i}"), if i < 4 { meeting } else { apart })).collect();
        let text = meeting_note(&pairs).unwrap();
        assert!(text.contains("5 of 9") && text.contains("p6 (") && text.contains("and 2 more"), "{text}");
        assert!(!text.contains("p7") && Meeting::of(&[], &points, &RigidTransform::identity()).is_err());
    }
}
