//! Keypoints of consecutive clouds as tracks.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::Keypoint;
use crate::{Error, Result, RigidTransform};
use snake_geometry::{Neighbors, Point, options};

options! {
    /// Options of a [`Tracker`].
    pub struct TrackerOptions {
        /// Maximum distance of a keypoint from the position where its track is expected, in cloud units; above 0.
        max_distance, with_max_distance: f64 = 1.0, from 0 or more " (cloud units)";
        /// Minimum cosine of the angle between the descriptors of a keypoint and of its track.
        min_similarity, with_min_similarity: f32 = 0.8, from -1 to 1;
        /// Number of clouds without the keypoint after which a track ends.
        max_missed, with_max_missed: usize = 3;
    }
}

/// Gives keypoints ids that they keep from cloud to cloud.
///
/// A keypoint continues the track whose expected position is near and whose descriptor is similar; pairs are made in the
/// order of their similarity, one keypoint to a track. The expected position is the last one, moved by the sensor's motion
/// where the caller knows it.
///
/// ```
/// use snake_core::{Builtin, EncodeOptions, Model, Tracker, TrackerOptions};
/// # let sweep: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
/// # let sweeps = [sweep.clone(), sweep];
/// let model = Model::builtin(Builtin::Compact);
/// let mut tracker = Tracker::new(TrackerOptions::default().with_max_distance(0.2))?;
/// for sweep in &sweeps {
///     let field = model.encode(sweep, &EncodeOptions::default())?;
///     let keypoints = field.detect(&model.recommended().detect)?.keypoints;
///     let positions: Vec<_> = keypoints.iter().map(|keypoint| keypoint.position).collect();
///     let ids = tracker.update(&keypoints, &field.descriptors(&positions)?, None)?;
///     println!("{ids:?}");
/// }
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Tracker {
    options: TrackerOptions,
    tracks: Vec<Track>,
    next_id: u64,
}

#[derive(Debug, Clone)]
struct Track {
    id: u64,
    position: Point,
    descriptor: Vec<f32>,
    missed: usize,
}

impl Tracker {
    /// A tracker without tracks.
    ///
    /// # Errors
    /// [`Error::Option`] when an option is out of its range.
    pub fn new(options: TrackerOptions) -> Result<Self> {
        options.check_ranges()?;
        if options.max_distance == 0.0 {
            return Err(Error::Option { name: "max_distance", value: "0".into(), allowed: "above 0 (cloud units)" });
        }
        Ok(Self { options, tracks: Vec::new(), next_id: 0 })
    }

    /// The ids of the keypoints of the next cloud, in their order. `descriptors` `(K, D)` are flat, of length 1 each, as
    /// [`Field::descriptors`](crate::Field::descriptors) returns them. `motion` maps points of the last cloud to the frame of
    /// this one; `None`: the sensor moved by much less than [`TrackerOptions::max_distance`], or the clouds share a frame.
    ///
    /// # Errors
    /// [`Error::Input`] when the number of descriptors is not that of the keypoints, their width is not that of the tracks, or
    /// a position is not finite. The tracks then stay as they were.
    pub fn update(
        &mut self,
        keypoints: &[Keypoint],
        descriptors: &[f32],
        motion: Option<&RigidTransform>,
    ) -> Result<Vec<u64>> {
        let width = self.check(keypoints, descriptors)?;
        let expected: Vec<Point> = self.tracks.iter().map(|track| moved(track.position, motion)).collect();
        let rows: Vec<&[f32]> = if width == 0 { Vec::new() } else { descriptors.chunks_exact(width).collect() };
        let pairs = self.pairs(keypoints, &rows, &expected)?;
        let mut ids = vec![None; keypoints.len()];
        for (track, position) in self.tracks.iter_mut().zip(expected) {
            track.position = position;
            track.missed += 1;
        }
        for (keypoint, track) in pairs {
            let track = &mut self.tracks[track];
            ids[keypoint] = Some(track.id);
            let position = keypoints[keypoint].position;
            *track = Track { id: track.id, position, descriptor: rows[keypoint].to_vec(), missed: 0 };
        }
        self.tracks.retain(|track| track.missed <= self.options.max_missed);
        let started = |(index, id): (usize, Option<u64>)| {
            id.unwrap_or_else(|| {
                let (id, position) = (self.next_id, keypoints[index].position);
                self.tracks.push(Track { id, position, descriptor: rows[index].to_vec(), missed: 0 });
                self.next_id += 1;
                id
            })
        };
        Ok(ids.into_iter().enumerate().map(started).collect())
    }

    /// Number of tracks, those included whose keypoint was missed lately.
    pub fn num_tracks(&self) -> usize {
        self.tracks.len()
    }

    /// Refuses descriptors that do not fit, and returns their width.
    fn check(&self, keypoints: &[Keypoint], descriptors: &[f32]) -> Result<usize> {
        if keypoints.iter().any(|keypoint| !keypoint.position.iter().all(|v| v.is_finite())) {
            return Err(Error::Input { what: "keypoints", reason: "a position is not finite".into() });
        }
        let width = descriptors.len().checked_div(keypoints.len()).unwrap_or(0);
        let known_width = self.tracks.first().map_or(width, |track| track.descriptor.len());
        if width * keypoints.len() != descriptors.len()
            || (!keypoints.is_empty() && (width == 0 || width != known_width))
        {
            let reason =
                format!("{} values for {} keypoints of width {known_width}", descriptors.len(), keypoints.len());
            return Err(Error::Input { what: "descriptors", reason });
        }
        Ok(width)
    }

    /// Pairs of a keypoint and a track, each in one pair at most: the most similar first.
    fn pairs(&self, keypoints: &[Keypoint], rows: &[&[f32]], expected: &[Point]) -> Result<Vec<(usize, usize)>> {
        let tree = Neighbors::new(expected.iter().map(|p| Vector3::from(p.map(f64::from))).collect())?;
        let mut candidates = Vec::new();
        for (keypoint, row) in rows.iter().enumerate() {
            let position = Vector3::from(keypoints[keypoint].position.map(f64::from));
            for track in tree.within(&position, self.options.max_distance) {
                let similarity: f32 = self.tracks[track].descriptor.iter().zip(*row).map(|(a, b)| a * b).sum();
                if similarity >= self.options.min_similarity {
                    candidates.push((similarity, keypoint, track));
                }
            }
        }
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let (mut is_paired, mut is_continued) = (vec![false; keypoints.len()], vec![false; expected.len()]);
        let mut pairs = Vec::new();
        for (_, keypoint, track) in candidates {
            if !is_paired[keypoint] && !is_continued[track] {
                (is_paired[keypoint], is_continued[track]) = (true, true);
                pairs.push((keypoint, track));
            }
        }
        Ok(pairs)
    }
}

fn moved(position: Point, motion: Option<&RigidTransform>) -> Point {
    motion.map_or(position, |motion| motion.apply(position))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keypoint(x: f32) -> Keypoint {
        let (confidence, covariance) = (None, snake_geometry::Covariance::UNKNOWN);
        Keypoint { position: [x, 0.0, 0.0], saliency: 1.0, occupancy: 1.0, nearest_index: 0, confidence, covariance }
    }

    #[test]
    fn ids_follow_position_and_descriptor_and_end_after_misses() {
        let mut tracker = Tracker::new(TrackerOptions::default().with_max_missed(1)).unwrap();
        let (east, north) = ([1.0, 0.0], [0.0, 1.0]);
        let both = [east, north].concat();
        assert_eq!(tracker.update(&[keypoint(0.0), keypoint(0.5)], &both, None).unwrap(), [0, 1]);
        // Nearer to the other track, but like its own.
        assert_eq!(tracker.update(&[keypoint(0.1), keypoint(0.4)], &[north, east].concat(), None).unwrap(), [1, 0]);
        // Too far, and unlike every track.
        assert_eq!(
            tracker.update(&[keypoint(5.0), keypoint(0.4)], &[east, [-1.0, 0.0]].concat(), None).unwrap(),
            [2, 3]
        );
        // One cloud was missed.
        assert_eq!(tracker.update(&[keypoint(0.4)], &east, None).unwrap(), [0]);
        assert_eq!(tracker.update(&[], &[], None).unwrap(), [0_u64; 0]);
        assert_eq!(tracker.update(&[], &[], None).unwrap(), [0_u64; 0]);
        assert_eq!((tracker.num_tracks(), tracker.update(&[keypoint(0.4)], &east, None).unwrap()), (0, vec![4]));
    }

    #[test]
    fn known_motion_moves_the_tracks() {
        let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
        tracker.update(&[keypoint(0.0)], &[1.0], None).unwrap();
        let motion = RigidTransform::from_matrix([
            [1.0, 0.0, 0.0, -20.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ])
        .unwrap();
        assert_eq!(tracker.update(&[keypoint(-20.3)], &[1.0], Some(&motion)).unwrap(), [0]);
    }

    #[test]
    fn wrong_options_and_descriptors_are_refused() {
        let options = TrackerOptions::default();
        assert!(Tracker::new(options.with_max_distance(0.0)).unwrap_err().to_string().contains("max_distance"));
        assert!(Tracker::new(options.with_min_similarity(2.0)).unwrap_err().to_string().contains("min_similarity"));
        let mut tracker = Tracker::new(options).unwrap();
        assert!(tracker.update(&[keypoint(0.0)], &[], None).is_err());
        assert!(tracker.update(&[keypoint(0.0), keypoint(1.0)], &[1.0; 3], None).is_err());
        assert!(tracker.update(&[keypoint(f32::NAN)], &[1.0], None).is_err());
        tracker.update(&[keypoint(0.0)], &[1.0, 0.0], None).unwrap();
        assert!(tracker.update(&[keypoint(0.0)], &[1.0, 0.0, 0.0], None).is_err());
    }
}
