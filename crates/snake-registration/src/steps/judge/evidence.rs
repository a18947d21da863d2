//! Evidence about a transform, and the confidence that follows from it.

use super::constants::{MAX_DOUBTFUL, MIN_AGREEING, RELIABLE};
use crate::cloud::surface::Agreement;
use crate::result::{Fit, Matches};

/// Another transform is a rival if its fit of the surfaces is above this share of the best fit. Set by hand.
const RIVAL_FIT: f64 = 0.9;
/// A rival has at least this share of the number of matches that agree with the best, each number
/// raised by one. Half and twice change no outcome.
const RIVAL_AGREEING: f64 = 0.4;
/// A weaker constraint is doubtful, however many matches agree. Unit: share of the squared motion. Half and twice
/// change no outcome.
const DOUBTFUL_CONSTRAINT: f64 = 2e-4;
/// Matches with a smaller spread lie on one plane or line and do not fix a transform, however many agree. Unit: inlier
/// distances. Half and twice change no outcome.
const MIN_MATCH_SPREAD: f64 = 0.25;
/// Bias of the logistic regression. Unit: log-odds. It is 3.2 below the fitted bias, so that a
/// confidence of 0.5 is a probability of about 0.95.
const BIAS: f64 = -8.5;
/// Weight of the logarithm of one more than the number of agreeing matches, and the limit up to which it counts, so
/// that no term outvotes the others. The next rows have the same form. Unit: log-odds; logarithm. Fitted on 785 pairs.
const LOG_AGREEING: [f64; 2] = [1.88, 5.3];
/// The weight of the log ratio of agreeing matches to those of the best rival. Unit: log-odds; logarithm. Fitted on 785 pairs.
const LOG_RATIO: [f64; 2] = [0.43, 1.5];
/// The weight of the slide margin. Unit: log-odds per overlap; overlap. Fitted on 785 pairs.
const SLIDE_MARGIN: [f64; 2] = [22.5, 0.1];
/// The weight of the spread of the matches that agree. Unit: log-odds per inlier distance; inlier distances. Fitted on 785 pairs.
const MATCH_SPREAD: [f64; 2] = [3.0, 1.0];
/// The weight of the violated free space. Unit: log-odds per share of the voxels; share. Fitted on 785 pairs.
const VIOLATION: [f64; 2] = [-302.0, 1.0];
/// The weight of the lead over the next transform, where single matches were compared. Unit: log-odds per overlap; overlap. Set by
/// hand on pairs of hotel_uc and redkitchen: 0.2 and more if right, 0.1 and less in most wrong ones.
const LEAD: [f64; 2] = [10.0, 0.25];

/// Evidence about the best transform in addition to [`Fit`] and [`Matches`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Evidence<'a> {
    pub(super) fit: &'a Fit,
    pub(super) matches: &'a Matches,
    /// See [`Verdict::free_space_violation`](crate::Verdict::free_space_violation).
    pub(super) violation: f64,
    /// See [`Verdict::slide_margin`](crate::Verdict::slide_margin).
    pub(super) slide_margin: f64,
    /// Number of directions of motion that the overlap leaves open.
    pub(super) num_open: usize,
    /// The open motions in words.
    pub(super) open_motions: String,
    /// See [`Verdict::weakest_constraint`](crate::Verdict::weakest_constraint).
    pub(super) weakest_constraint: f64,
    /// Whether surfaces lie apart, given their thickness.
    pub(super) lies_apart: bool,
    /// Whether another transform fits the surfaces and the matches about as well.
    pub(super) has_rival: bool,
    /// The lead of the transform's score over that of the next, if single matches were compared.
    pub(super) lead: Option<f64>,
}

/// A weighted term of the logistic regression.
struct Term {
    value: f64,
    /// Its greatest value.
    most: f64,
    /// The words of a note if the value is low.
    words: String,
}

/// Whether a transform fits about as well as the best; each comes with the number of matches that agree.
pub(super) fn is_rival(other: (&Agreement, usize), best: (&Agreement, usize)) -> bool {
    let matched = (1 + other.1) as f64 >= RIVAL_AGREEING * (1 + best.1) as f64;
    matched && other.0.fit() > RIVAL_FIT * best.0.fit()
}

impl Evidence<'_> {
    /// Whether other transforms fit as well or about as well.
    pub(super) fn is_ambiguous(&self) -> bool {
        self.num_open > 0 || self.has_rival
    }

    fn has_few_matches(&self) -> bool {
        self.matches.num_agreeing < MIN_AGREEING
    }

    fn has_flat_matches(&self) -> bool {
        self.match_spread() < MIN_MATCH_SPREAD
    }

    /// The spread of the matches that agree, in inlier distances.
    fn match_spread(&self) -> f64 {
        self.matches.spread / self.fit.inlier_distance
    }

    /// The terms of the logistic regression.
    fn terms(&self) -> impl Iterator<Item = Term> {
        let log = |count: usize| (1.0 + count as f64).ln();
        let Matches { num_agreeing, num_rival_agreeing, .. } = *self.matches;
        let (agreeing, rival) = (log(num_agreeing), log(num_rival_agreeing));
        let term = |[weight, limit]: [f64; 2], value: f64, words: String| Term {
            value: weight * value.clamp(-limit, limit),
            most: (weight * limit).max(0.0),
            words,
        };
        let (violation, spread) = (self.violation, self.match_spread());
        let lead = self.lead.map(|lead| term(LEAD, lead, format!("the next transform is worse by only {lead:.3}")));
        let terms = [
            term(LOG_AGREEING, agreeing, format!("only {num_agreeing} matches agree")),
            term(LOG_RATIO, agreeing - rival, format!("{num_rival_agreeing} matches agree with another transform")),
            term(
                SLIDE_MARGIN,
                self.slide_margin,
                format!("the overlap falls by only {:.3} along the direction that is fixed least", self.slide_margin),
            ),
            term(MATCH_SPREAD, spread, format!("the matches that agree spread by only {spread:.2} inlier distances")),
            term(
                VIOLATION,
                violation,
                format!("{:.1} % of the voxels lie where the other sensor saw through", 100.0 * violation),
            ),
        ];
        terms.into_iter().chain(lead)
    }

    /// The confidence, 0 to 1; 0.5 and more is reliable. It is 0 if the overlap leaves a direction
    /// open, and falls as the weakest constraint approaches that. Another transform that fits about
    /// as well halves it, and keeps it below 0.5.
    pub(super) fn confidence(&self) -> f64 {
        if self.num_open > 0 {
            return 0.0;
        }
        let sum = self.terms().fold(BIAS, |sum, term| sum + term.value);
        let unrivalled = (self.weakest_constraint / DOUBTFUL_CONSTRAINT).min(1.0) / (1.0 + (-sum).exp());
        if self.has_rival {
            (unrivalled / 2.0).min(MAX_DOUBTFUL)
        } else if self.has_few_matches() || self.has_flat_matches() || self.lies_apart {
            unrivalled.min(MAX_DOUBTFUL)
        } else {
            unrivalled
        }
    }

    /// What may be wrong with the transform, in sentences.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.num_open > 0 {
            notes.push(format!(
                "ambiguous: the overlap lies on a surface such as a plane, a cylinder or a sphere, which leaves {} of 6 \
                 directions of motion open: {}",
                self.num_open, self.open_motions
            ));
        }
        if self.has_rival {
            notes.push("ambiguous: another transform fits about as well".into());
        }
        if self.has_few_matches() {
            notes.push(format!(
                "only {} matches agree; fewer than {} are never reliable",
                self.matches.num_agreeing, MIN_AGREEING
            ));
        }
        if self.has_flat_matches() && !self.has_few_matches() {
            notes.push("the matches that agree lie on one plane or line, which does not fix a transform".into());
        }
        if self.lies_apart {
            notes.push("the surfaces lie apart by more than they are thick: it is wrong, things changed, or a cloud is bent or scaled".into());
        }
        if notes.is_empty() && self.confidence() < RELIABLE {
            let worst = self.terms().max_by(|a, b| (a.most - a.value).total_cmp(&(b.most - b.value)));
            notes.extend(worst.map(|term| format!("not reliable, above all because {}", term.words)));
        }
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Changes the evidence of a transform that is reliable.
    fn changed(change: impl Fn(&mut Fit, &mut Matches, &mut Evidence)) -> (f64, Vec<String>) {
        let mut fit =
            Fit { fitness: 0.9, rmse: 0.01, inlier_distance: 0.1, voxel_size: 0.06, information: [[0.0; 6]; 6] };
        let mut matches = Matches {
            num_matches: 500,
            num_inliers: 90,
            rmse: 0.02,
            num_agreeing: 100,
            num_rival_agreeing: 10,
            spread: 0.2,
            pairs: Vec::new(),
        };
        let (same_fit, same_matches) = (fit, matches.clone());
        let mut evidence = Evidence {
            fit: &same_fit,
            matches: &same_matches,
            violation: 0.002,
            slide_margin: 0.1,
            num_open: 0,
            open_motions: String::new(),
            weakest_constraint: 0.03,
            lies_apart: false,
            has_rival: false,
            lead: None,
        };
        change(&mut fit, &mut matches, &mut evidence);
        let evidence = Evidence { fit: &fit, matches: &matches, ..evidence };
        (evidence.confidence(), evidence.notes())
    }

    #[test]
    fn matches_free_space_and_slides_make_a_transform_reliable() {
        let (usual, _) = changed(|_, _, _| ());
        assert!(usual > 0.9, "{usual}");
        type Change = fn(&mut Fit, &mut Matches, &mut Evidence);
        let worse: [(&str, Change); 8] = [
            ("few matches", |_, m, e| {
                (m.num_agreeing, m.spread, e.slide_margin) = (9, 0.9, 9.0);
            }),
            ("weak constraint", |_, m, e| (m.num_agreeing, e.weakest_constraint) = (9999, 8e-5)),
            ("a part apart", |_, m, e| (m.num_agreeing, e.lies_apart) = (9999, true)),
            ("rival matches", |_, m, e| (m.num_agreeing, m.num_rival_agreeing, e.slide_margin) = (20, 40, 0.0)),
            ("free space", |_, _, e| e.violation = 0.2),
            ("a better slide", |_, m, e| (m.num_agreeing, e.slide_margin) = (15, -0.1)),
            ("open", |_, _, e| e.num_open = 1),
            ("rival", |_, _, e| (e.has_rival, e.slide_margin) = (true, 9.0)),
        ];
        for (name, change) in worse {
            let (confidence, _) = changed(change);
            assert!(confidence < 0.5, "{name}: {confidence}");
        }
        assert!(changed(|_, _, e| e.lead = Some(0.2)).0 > usual && changed(|_, _, e| e.lead = Some(-0.2)).0 < usual);
        assert!(changed(|_, m, _| m.num_rival_agreeing = 99).0 < usual);
        assert!(changed(|_, m, _| m.spread = 0.0).0 < usual);
    }

    #[test]
    fn rivals_fit_the_surfaces_and_the_matches() {
        let fit = |overlap: f64| Agreement { overlap, violation: 0.0 };
        assert!(is_rival((&fit(0.58), 60), (&fit(0.6), 100)));
        assert!(!is_rival((&fit(0.5), 60), (&fit(0.6), 100)));
        assert!(!is_rival((&fit(0.6), 20), (&fit(0.6), 100)));
    }

    #[test]
    fn notes_name_open_directions_rivals_and_matches() {
        assert!(changed(|_, _, _| ()).1.is_empty());
        let note = |change: fn(&mut Fit, &mut Matches, &mut Evidence)| changed(change).1.remove(0);
        assert!(note(|_, _, e| e.num_open = 3).contains("3 of 6"));
        assert!(note(|_, _, e| e.has_rival = true).contains("another transform"));
        assert!(note(|_, m, _| m.num_agreeing = 9).contains("only 9 matches"));
        assert!(note(|_, m, _| m.spread = 0.01).contains("one plane or line"));
        assert!(note(|_, _, e| e.lies_apart = true).contains("lie apart"));
        assert!(note(|_, _, e| e.violation = 0.2).contains("above all because 20.0 % of the voxels"));
        assert!(note(|_, m, e| (m.num_agreeing, e.slide_margin) = (10, 0.0)).contains("because"));
    }
}
