//! The map from a keypoint's score and precision to the probability that another view finds it again, from the file's metadata.

use serde::Deserialize;

use crate::Result;
use crate::network::weights::{self, Weights};

/// Maximum number of knots.
const MAX_KNOTS: usize = 64;

/// Standard deviations are clamped to this range, in voxels.
const DEVIATIONS: [f32; 2] = [0.06, 0.6];

/// Least reach, in voxels.
const MIN_REACH: f32 = 0.25;

/// A piecewise linear, non-decreasing map from evidence to probabilities, fitted by `snake_training.confidence`.
#[derive(Debug, Clone, Deserialize)]
#[serde(from = "Map")]
pub(crate) struct ConfidenceMap {
    /// Evidence and probability, by rising evidence.
    knots: Vec<[f32; 2]>,
    /// Evidence that each halving of the standard deviation adds to the score, along each of the two least precise directions. The
    /// most precise direction, such as across a wall, adds nothing.
    precision: f32,
    /// Evidence that each doubling of the reach adds, within which another view finds the keypoint again.
    reach: f32,
}

/// [`ConfidenceMap`] in a file.
#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum Map {
    /// Only the score counts.
    Scores(Vec<[f32; 2]>),
    /// The score, the standard deviations and the reach count.
    Evidence {
        knots: Vec<[f32; 2]>,
        precision: f32,
        #[serde(default)]
        reach: f32,
    },
}

impl From<Map> for ConfidenceMap {
    fn from(map: Map) -> Self {
        match map {
            Map::Scores(knots) => Self { knots, precision: 0.0, reach: 0.0 },
            Map::Evidence { knots, precision, reach } => Self { knots, precision, reach },
        }
    }
}

impl ConfidenceMap {
    /// Reads the metadata key `confidence`, which is JSON: `[[score, probability], ..]`, or `{"knots": .., "precision": .., "reach": ..}`
    /// if the standard deviations and the reach count too. Returns `None` if the file has no such key.
    pub(crate) fn from_weights(file: &Weights) -> Result<Option<Self>> {
        let Some(json) = file.metadata.get("confidence") else { return Ok(None) };
        let refused = |found: String| {
            let expected = "2 to 64 pairs [score, probability], scores rising, probabilities in 0 to 1 and not falling";
            weights::error("confidence", expected, found)
        };
        let map: Self = serde_json::from_str(json).map_err(|error| refused(error.to_string()))?;
        let is_map = (2..=MAX_KNOTS).contains(&map.knots.len())
            && map.knots.iter().all(|[score, probability]| score.is_finite() && (0.0..=1.0).contains(probability))
            && map.knots.is_sorted_by(|a, b| a[0] < b[0] && a[1] <= b[1])
            && map.precision.is_finite()
            && map.reach.is_finite();
        if is_map { Ok(Some(map)) } else { Err(refused(json.clone())) }
    }

    /// The probability for a keypoint's score and its standard deviations along three directions, in a volume of this voxel size,
    /// where keypoints are found again within a reach. It is linear between knots and constant beyond the first and the last one.
    pub(crate) fn at(&self, score: f32, deviations: [f32; 3], voxel_size: f32, reach: f32) -> f32 {
        let [low, high] = DEVIATIONS;
        let mut halvings = deviations.map(|deviation| (high / (deviation / voxel_size).clamp(low, high)).log2());
        halvings.sort_by(f32::total_cmp);
        let doublings = (reach / voxel_size).max(MIN_REACH).log2();
        let evidence = score + self.precision * (halvings[0] + halvings[1]) + self.reach * doublings;
        let next = self.knots.partition_point(|knot| knot[0] <= evidence);
        match (next.checked_sub(1).map(|last| self.knots[last]), self.knots.get(next)) {
            (Some([low, from]), Some([high, to])) => from + (to - from) * ((evidence - low) / (high - low)),
            (Some([_, last]), None) => last,
            (None, Some([_, first])) => *first,
            (None, None) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Builtin, Error, Model};
    use safetensors::SafeTensors;

    /// The model `compact` with another map; without a map for `None`.
    fn model(map: Option<&str>) -> crate::Result<Model> {
        let bytes = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/models/compact.safetensors")).unwrap();
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let mut metadata = header.metadata().clone().unwrap();
        metadata.remove("confidence");
        metadata.extend(map.map(|map| ("confidence".into(), map.into())));
        let tensors = SafeTensors::deserialize(&bytes).unwrap();
        Model::from_bytes(&safetensors::serialize(tensors.iter(), Some(metadata)).unwrap())
    }

    fn cloud() -> Vec<[f32; 3]> {
        let at = |i: u32, k: u32| (i.wrapping_mul(k) % 997) as f32 / 997.0 - 0.5;
        (0..3000).map(|i| [at(i, 131), at(i, 577), if i % 2 == 0 { 0.5 } else { at(i, 883) }]).collect()
    }

    #[test]
    fn the_map_is_linear_between_its_knots_and_constant_beyond() {
        let model = model(Some("[[0.25, 0.5], [0.5, 0.5], [0.75, 1.0]]")).unwrap();
        let map = model.network().confidence.as_ref().unwrap();
        let scores = [-1.0, 0.0, 0.25, 0.4, 0.5, 0.625, 0.75, 0.9, f32::INFINITY];
        assert_eq!(
            scores.map(|score| map.at(score, [f32::INFINITY; 3], 1.0, 2.0)),
            [0.5, 0.5, 0.5, 0.5, 0.5, 0.75, 1.0, 1.0, 1.0]
        );
    }

    #[test]
    fn each_halving_of_the_deviation_counts_like_so_much_score() {
        let model = model(Some(r#"{"knots": [[0.0, 0.0], [2.0, 1.0]], "precision": 0.5}"#)).unwrap();
        let map = model.network().confidence.as_ref().unwrap();
        let of = |deviation: f32| [deviation, f32::INFINITY, 0.1 * deviation];
        for (score, deviation, evidence) in [(0.5, 0.6, 0.5), (0.5, 0.3, 1.0), (0.5, 0.15, 1.5), (0.25, 9.0, 0.25)] {
            assert!(
                (map.at(score, of(0.2 * deviation), 0.2, 0.1) - evidence / 2.0).abs() < 1e-5,
                "{score} {deviation}"
            );
        }
        assert_eq!(map.at(0.5, [f32::INFINITY; 3], 0.2, 0.1), 0.25);
        assert_eq!(map.at(0.5, of(1e-9), 0.2, 0.1), map.at(0.5, of(0.012), 0.2, 0.1));
    }

    #[test]
    fn each_doubling_of_the_reach_counts_like_so_much_score() {
        let model = model(Some(r#"{"knots": [[0.0, 0.0], [2.0, 1.0]], "precision": 0.5, "reach": 0.25}"#)).unwrap();
        let map = model.network().confidence.as_ref().unwrap();
        for (reach, evidence) in [(0.4, 1.25), (0.2, 1.0), (0.1, 0.75), (0.0, 0.5)] {
            assert_eq!(map.at(1.0, [f32::INFINITY; 3], 0.2, reach), evidence / 2.0, "{reach}");
        }
    }

    #[test]
    fn broken_maps_are_refused() {
        let many = format!("[{}]", (0..65).map(|i| format!("[{i}, 0.5]")).collect::<Vec<_>>().join(","));
        for broken in [
            "",
            "{}",
            "[]",
            "[[0.1, 0.5]]",
            "[[0.1], [0.2]]",
            "[[0.1, 0.5], [0.1, 0.6]]",
            "[[0.2, 0.5], [0.1, 0.6]]",
            "[[0.1, 0.6], [0.2, 0.5]]",
            "[[0.1, 0.5], [0.2, 1.5]]",
            "[[0.1, -0.5], [0.2, 0.5]]",
            "[[0.1, null], [0.2, 1]]",
            "[[1e99, 0.5], [2e99, 0.6]]",
            &many,
            r#"{"knots": [[0.1, 0.5], [0.2, 0.6]]}"#,
            r#"{"knots": [[0.1, 0.5], [0.2, 0.6]], "precision": 1e99}"#,
            r#"{"knots": [[0.1, 0.5], [0.2, 0.6]], "precision": 1, "other": 1}"#,
        ] {
            let error = model(Some(broken)).unwrap_err();
            assert!(matches!(&error, Error::Weights { tensor, .. } if tensor == "confidence"), "{broken}: {error}");
        }
    }

    #[test]
    fn min_confidence_keeps_the_good_keypoints_and_needs_a_map() {
        let (with, without) = (model(Some("[[0.07, 0.1], [0.6, 0.9]]")).unwrap(), model(None).unwrap());
        let options = *with.recommended();
        let all = with.detect(&cloud(), &options).unwrap().keypoints;
        let plain = without.detect(&cloud(), &options).unwrap().keypoints;
        assert!(plain.iter().all(|keypoint| keypoint.confidence.is_none()));
        let bare = |keypoint: &crate::Keypoint| crate::Keypoint { confidence: None, ..*keypoint };
        assert_eq!(all.iter().map(bare).collect::<Vec<_>>(), plain);
        let middle = all[all.len() / 2].confidence.unwrap();
        let mut strict = options;
        strict.detect.min_confidence = Some(middle);
        let kept = with.detect(&cloud(), &strict).unwrap();
        let good = all.iter().filter(|keypoint| keypoint.confidence >= Some(middle)).copied();
        assert_eq!(kept.keypoints, good.collect::<Vec<_>>());
        assert!(kept.keypoints.len() < all.len() && kept.counts.keypoints == kept.keypoints.len());
        let error = without.detect(&cloud(), &strict).unwrap_err().to_string();
        assert!(error.contains("min_confidence") && error.contains("snake_training.confidence"), "{error}");
        strict.detect.min_confidence = Some(1.5);
        assert!(with.detect(&cloud(), &strict).unwrap_err().to_string().contains("0 to 1"));
        assert!(Model::builtin(Builtin::Compact).detect(&cloud(), &options).is_ok());
    }
}
