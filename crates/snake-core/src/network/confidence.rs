//! The probability that another view finds a keypoint again, by a map of the weight file's metadata.

use serde::Deserialize;

use crate::Result;
use crate::detect::localize::Place;
use crate::network::weights::{self, Weights};

/// Knots, at most.
const MAX_KNOTS: usize = 64;

/// From a keypoint to a probability, fitted by `snake_training.confidence`.
#[derive(Debug, Clone)]
pub(crate) enum ConfidenceMap {
    /// A piecewise linear, non-decreasing map of scores: score and probability, by rising score.
    Knots(Vec<[f32; 2]>),
    /// The logistic function of a weighted sum of what is known of a keypoint.
    Logistic(Logistic),
}

/// Weights of the score and of the binary logarithm of the largest standard deviation in voxels, within [`DEVIATIONS`].
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Logistic {
    bias: f32,
    score: f32,
    deviation: f32,
}

/// Smaller and larger standard deviations count as these, in voxels.
const DEVIATIONS: [f32; 2] = [0.1, 0.6];

impl Logistic {
    fn at(&self, score: f32, place: &Place, voxel_size: f32) -> f32 {
        let [low, high] = DEVIATIONS;
        let deviation = (place.covariance.deviation() / voxel_size).clamp(low, high).log2();
        let sum = self.bias + self.score * score + self.deviation * deviation;
        1.0 / (1.0 + (-sum).exp())
    }
}

impl ConfidenceMap {
    /// The metadata key `confidence` as JSON, `[[score, probability], ..]` or an object of the weights; `None` where the file has
    /// none.
    pub(crate) fn from_weights(file: &Weights) -> Result<Option<Self>> {
        let Some(json) = file.metadata.get("confidence") else { return Ok(None) };
        let refused = |found: String| {
            let expected = "2 to 64 pairs [score, probability], scores rising, probabilities in 0 to 1 and not falling, or an \
                            object of finite numbers bias, score and deviation";
            weights::error("confidence", expected, found)
        };
        if json.trim_start().starts_with('{') {
            let map: Logistic = serde_json::from_str(json).map_err(|error| refused(error.to_string()))?;
            let is_finite = [map.bias, map.score, map.deviation].iter().all(|weight| weight.is_finite());
            return if is_finite { Ok(Some(Self::Logistic(map))) } else { Err(refused(json.clone())) };
        }
        let knots: Vec<[f32; 2]> = serde_json::from_str(json).map_err(|error| refused(error.to_string()))?;
        let is_map = (2..=MAX_KNOTS).contains(&knots.len())
            && knots.iter().all(|[score, probability]| score.is_finite() && (0.0..=1.0).contains(probability))
            && knots.is_sorted_by(|a, b| a[0] < b[0] && a[1] <= b[1]);
        if is_map { Ok(Some(Self::Knots(knots))) } else { Err(refused(json.clone())) }
    }

    /// The probability of a keypoint.
    pub(crate) fn at(&self, score: f32, place: &Place, voxel_size: f32) -> f32 {
        match self {
            Self::Knots(knots) => interpolated(knots, score),
            Self::Logistic(map) => map.at(score, place, voxel_size),
        }
    }
}

/// The probability of a score: linear between knots, that of the first or the last knot beyond them.
fn interpolated(knots: &[[f32; 2]], score: f32) -> f32 {
    let next = knots.partition_point(|knot| knot[0] <= score);
    match (next.checked_sub(1).map(|last| knots[last]), knots.get(next)) {
        (Some([low, from]), Some([high, to])) => from + (to - from) * ((score - low) / (high - low)),
        (Some([_, last]), None) => last,
        (None, Some([_, first])) => *first,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::Place;
    use crate::{Builtin, Error, Model};
    use safetensors::SafeTensors;
    use snake_geometry::Covariance;

    /// The model `compact` with another map; `None` is none.
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
        let place = Place::unknown([0.0; 3]);
        let scores = [-1.0, 0.0, 0.25, 0.4, 0.5, 0.625, 0.75, 0.9, f32::INFINITY];
        assert_eq!(scores.map(|score| map.at(score, &place, 1.0)), [0.5, 0.5, 0.5, 0.5, 0.5, 0.75, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn the_logistic_map_rises_with_the_score_and_with_what_the_points_determine() {
        let model = model(Some(r#"{"bias": -2.0, "score": 1.0, "deviation": -3.0}"#)).unwrap();
        let map = model.network().confidence.as_ref().unwrap();
        let place = |deviation: f32| {
            let variance = f64::from(deviation).powi(-2);
            let covariance = Covariance::from_information(&(nalgebra::Matrix3::identity() * variance), 0.0);
            Place { covariance, ..Place::unknown([0.0; 3]) }
        };
        let expected = |sum: f32| 1.0 / (1.0 + (-sum).exp());
        for (score, deviation, sum) in [(0.5, 1.0, -1.5), (0.5, 0.5, 1.5), (1.0, 9.0, -1.0)] {
            assert!((map.at(score, &place(deviation * 0.2), 0.2) - expected(sum)).abs() < 1e-5, "{score} {deviation}");
        }
        assert_eq!(map.at(0.5, &Place::unknown([0.0; 3]), 0.2), map.at(0.5, &place(0.2), 0.2));
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
            "{\"bias\": 1, \"score\": 1}",
            "{\"bias\": 1e99, \"score\": 1, \"deviation\": 1}",
            "{\"bias\": 1, \"score\": 1, \"deviation\": 1, \"other\": 1}",
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
