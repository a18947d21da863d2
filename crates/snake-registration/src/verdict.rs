//! Whether a transform can be relied on.

use super::surface::Agreement;

/// What is known of the best transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    /// Number of matches that agreed before ICP.
    pub(super) num_inliers: usize,
    pub(super) agreement: Agreement,
    /// Score of the best other transform; 0 without one.
    pub(super) second_score: f64,
    /// See [`Registration::weakest_constraint`](crate::Registration::weakest_constraint).
    pub(super) weakest_constraint: f64,
}

/// The weights of a logistic regression on 260 pairs of indoor scans, half of them right. The bias is lowered so that
/// none of the wrong ones has a confidence of 0.5. The gap to the second transform and the overlap did not help.
const BIAS: f64 = -7.3;
const PER_LOG_INLIER: f64 = 3.5;
const PER_VIOLATION: f64 = -29.0;
const PER_LOG_CONSTRAINT: f64 = 1.9;
/// Keeps the logarithm of an open direction finite.
const LEAST_CONSTRAINT: f64 = 1e-4;

impl Evidence {
    fn score(&self) -> f64 {
        self.agreement.score(self.num_inliers)
    }

    /// The probability, 0 to 1, that the transform is right; 0.5 and more is reliable.
    pub(super) fn confidence(&self) -> f64 {
        let sum = BIAS
            + PER_LOG_INLIER * (1.0 + self.num_inliers as f64).ln()
            + PER_VIOLATION * self.agreement.violation
            + PER_LOG_CONSTRAINT * (LEAST_CONSTRAINT + self.weakest_constraint).ln();
        1.0 / (1.0 + (-sum).exp())
    }
}

/// What may be wrong with the clouds or the transform, in sentences.
pub(super) fn notes(evidence: &Evidence, open_directions: usize, diameters: [f64; 2]) -> Vec<String> {
    let mut notes = Vec::new();
    if open_directions > 0 {
        notes.push(format!(
            "ambiguous: the overlap lies on a surface such as a plane or a sphere, which leaves {open_directions} of 6 \
             directions of motion open"
        ));
    }
    if evidence.second_score > RIVAL * evidence.score() {
        notes.push("ambiguous: another transform fits about as well".into());
    }
    let ratio = diameters[0].max(diameters[1]) / diameters[0].min(diameters[1]);
    if ratio > UNIT_RATIO {
        notes.push(format!("one cloud is {ratio:.0} times as large as the other; are the units the same?"));
    }
    notes
}

/// A transform with more than this share of the best score is a rival.
const RIVAL: f64 = 0.9;
/// Clouds whose sizes differ by more are probably in different units.
const UNIT_RATIO: f64 = 100.0;

#[cfg(test)]
mod tests {
    use super::*;

    const EVIDENCE: Evidence = Evidence {
        num_inliers: 100,
        agreement: Agreement { overlap: 0.6, violation: 0.002 },
        second_score: 0.3,
        weakest_constraint: 0.04,
    };

    #[test]
    fn matches_free_space_and_constraint_make_a_transform_reliable() {
        assert!(EVIDENCE.confidence() > 0.8, "{}", EVIDENCE.confidence());
        for worse in [
            Evidence { num_inliers: 10, ..EVIDENCE },
            Evidence { agreement: Agreement { violation: 0.2, ..EVIDENCE.agreement }, ..EVIDENCE },
            Evidence { weakest_constraint: 0.0, ..EVIDENCE },
        ] {
            assert!(worse.confidence() < 0.5, "{worse:?}: {}", worse.confidence());
        }
    }

    #[test]
    fn notes_name_open_directions_rivals_and_units() {
        assert!(notes(&EVIDENCE, 0, [4.0, 3.0]).is_empty());
        assert!(notes(&EVIDENCE, 3, [4.0, 3.0])[0].contains("3 of 6"));
        let rival = Evidence { second_score: 1.05, ..EVIDENCE };
        assert!(notes(&rival, 0, [4.0, 3.0])[0].contains("another transform"));
        assert!(notes(&EVIDENCE, 0, [4000.0, 4.0])[0].contains("1000 times"));
    }
}
