//! Whether a transform can be relied on.

pub(crate) mod constraint;
pub(crate) mod open_motions;
pub(crate) mod repeats;
pub(crate) mod slide;

use crate::pair::surface::Agreement;

/// What is known of the best transform.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Evidence {
    /// See [`Registration::free_space_violation`](crate::Registration::free_space_violation).
    pub(crate) violation: f64,
    /// [`Registration::match_spread`](crate::Registration::match_spread) in inlier distances.
    pub(crate) match_spread: f64,
    /// See [`Registration::num_agreeing`](crate::Registration::num_agreeing).
    pub(crate) num_agreeing: usize,
    /// See [`Registration::num_rival_agreeing`](crate::Registration::num_rival_agreeing).
    pub(crate) num_rival_agreeing: usize,
    /// See [`Registration::slide_margin`](crate::Registration::slide_margin).
    pub(crate) slide_margin: f64,
    /// Number of directions of motion that the overlap leaves open, and their names.
    pub(crate) open_directions: (usize, String),
    /// See [`Registration::weakest_constraint`](crate::Registration::weakest_constraint).
    pub(crate) weakest_constraint: f64,
    /// See [`Registration::repeat_fit`](crate::Registration::repeat_fit).
    pub(crate) repeat_fit: f64,
    /// See [`Registration::fitness`](crate::Registration::fitness).
    pub(crate) fitness: f64,
    /// The share of the patches of both clouds that coincide, where the points are fine enough to show it.
    pub(crate) coinciding: Option<f64>,
    /// Whether another transform fits the surfaces and the matches about as well.
    pub(crate) has_rival: bool,
}

/// Another transform fits about as well if it has more than this share of the best fit of the surfaces,
const RIVAL_FIT: f64 = 0.9;
/// and this share of the matches that agree, each count raised by one.
const RIVAL_AGREEING: f64 = 0.4;

/// Whether a transform fits about as well as the best; each comes with the number of matches that agree.
pub(crate) fn is_rival(other: (&Agreement, usize), best: (&Agreement, usize)) -> bool {
    let matched = (1 + other.1) as f64 >= RIVAL_AGREEING * (1 + best.1) as f64;
    matched && other.0.fit() > RIVAL_FIT * best.0.fit()
}

/// The target looks alike elsewhere if more than this share of the patches agrees there,
const REPEATED: f64 = 0.45;
/// and the source may belong there if its fitness is more than this: with less overlap, a place with more would fit better.
pub(crate) const REPEATED_FITNESS: f64 = 0.8;
/// A constraint that is weaker than this share is doubtful, however many matches agree.
const DOUBTFUL_CONSTRAINT: f64 = 2e-4;
/// Fewer matches that agree are never enough, however well the surfaces fit.
const LEAST_AGREEING: usize = 10;
/// Matches on one plane or line do not fix a transform, however many agree. Their least spread is at least this.
const LEAST_MATCH_SPREAD: f64 = 0.25;
/// At least this share of the patches coincides under a right transform: 0.85 and more of sweeps, and 0.75 and less of wrong ones.
const LEAST_COINCIDING: f64 = 0.8;
/// The greatest confidence of a transform that is ambiguous, has few matches or leaves the surfaces apart.
const MOST_DOUBTFUL: f64 = 0.49;

/// The weights of a logistic regression (`tests/bench/fit_verdict.py`). Each kind of evidence counts between limits, so that
/// none outvotes the others. The bias is 3.2 below the fitted one: a confidence of 0.5 is a probability of about 0.95.
const BIAS: f64 = -8.5;
const PER_LOG_AGREEING: f64 = 1.88;
const PER_LOG_RATIO: f64 = 0.43;
const PER_SLIDE_MARGIN: f64 = 22.5;
const PER_MATCH_SPREAD: f64 = 3.0;
const PER_VIOLATION: f64 = -302.0;
/// The limits: more says no more.
const MOST_AGREEING: f64 = 200.0;
const MOST_LOG_RATIO: f64 = 1.5;
const MOST_SLIDE_MARGIN: f64 = 0.1;
const MOST_MATCH_SPREAD: f64 = 1.0;

impl Evidence {
    /// Whether other transforms fit as well or about as well.
    pub(crate) fn is_ambiguous(&self) -> bool {
        self.open_directions.0 > 0 || self.has_rival || self.is_repeated()
    }

    fn is_repeated(&self) -> bool {
        self.repeat_fit > REPEATED && self.fitness > REPEATED_FITNESS
    }

    fn has_few_matches(&self) -> bool {
        self.num_agreeing < LEAST_AGREEING
    }

    fn lies_apart(&self) -> bool {
        self.coinciding.is_some_and(|share| share < LEAST_COINCIDING)
    }

    fn has_flat_matches(&self) -> bool {
        self.match_spread < LEAST_MATCH_SPREAD
    }

    /// From 0 to 1; 0.5 and more is reliable. It is 0 where the overlap leaves a direction open, and falls towards it. Another
    /// transform that fits about as well halves it, and keeps it below 0.5.
    pub(crate) fn confidence(&self) -> f64 {
        if self.open_directions.0 > 0 {
            return 0.0;
        }
        let [agreeing, rival] = [self.num_agreeing, self.num_rival_agreeing].map(|count| (1.0 + count as f64).ln());
        let sum = BIAS
            + PER_LOG_AGREEING * agreeing.min(MOST_AGREEING.ln())
            + PER_LOG_RATIO * (agreeing - rival).clamp(-MOST_LOG_RATIO, MOST_LOG_RATIO)
            + PER_SLIDE_MARGIN * self.slide_margin.clamp(-MOST_SLIDE_MARGIN, MOST_SLIDE_MARGIN)
            + PER_MATCH_SPREAD * self.match_spread.min(MOST_MATCH_SPREAD)
            + PER_VIOLATION * self.violation;
        let of_one = (self.weakest_constraint / DOUBTFUL_CONSTRAINT).min(1.0) / (1.0 + (-sum).exp());
        match (
            self.has_rival || self.is_repeated(),
            self.has_few_matches() || self.has_flat_matches() || self.lies_apart(),
        ) {
            (true, _) => (of_one / 2.0).min(MOST_DOUBTFUL),
            (false, true) => of_one.min(MOST_DOUBTFUL),
            (false, false) => of_one,
        }
    }
}

/// What may be wrong with the clouds or the transform, in sentences.
pub(crate) fn notes(evidence: &Evidence, diameters: [f64; 2]) -> Vec<String> {
    let (mut notes, (count, names)) = (Vec::new(), &evidence.open_directions);
    if *count > 0 {
        notes.push(format!(
            "ambiguous: the overlap lies on a surface such as a plane, a cylinder or a sphere, which leaves {count} of 6 \
             directions of motion open: {names}"
        ));
    }
    if evidence.has_rival {
        notes.push("ambiguous: another transform fits about as well".into());
    }
    if evidence.is_repeated() {
        notes.push(
            "ambiguous: the target repeats itself, as a row of equal pillars does, and fits there as well".into(),
        );
    }
    if evidence.has_few_matches() {
        notes.push(format!(
            "only {} matches agree; fewer than {LEAST_AGREEING} are never reliable",
            evidence.num_agreeing
        ));
    }
    if evidence.has_flat_matches() && !evidence.has_few_matches() {
        notes.push("the matches that agree lie on one plane or line, which does not fix a transform".into());
    }
    if evidence.lies_apart() {
        notes.push("the surfaces lie apart: the points are finer than the distance between them".into());
    }
    notes.extend(units_note(diameters));
    notes
}

/// A question about the units, if the clouds' sizes differ much.
pub(crate) fn units_note(diameters: [f64; 2]) -> Option<String> {
    let ratio = diameters[0].max(diameters[1]) / diameters[0].min(diameters[1]);
    (ratio > UNIT_RATIO)
        .then(|| format!("one cloud is {ratio:.0} times as large as the other; are the units the same?"))
}

/// Clouds whose sizes differ by more are probably in different units.
const UNIT_RATIO: f64 = 30.0;

#[cfg(test)]
mod tests {
    use super::*;

    const EVIDENCE: Evidence = Evidence {
        violation: 0.002,
        match_spread: 2.0,
        num_agreeing: 100,
        num_rival_agreeing: 10,
        slide_margin: 0.1,
        open_directions: (0, String::new()),
        weakest_constraint: 0.03,
        repeat_fit: 0.0,
        fitness: 0.9,
        coinciding: None,
        has_rival: false,
    };

    #[test]
    fn matches_free_space_and_slides_make_a_transform_reliable() {
        assert!(EVIDENCE.confidence() > 0.9, "{}", EVIDENCE.confidence());
        for worse in [
            Evidence { num_agreeing: 9, slide_margin: 9.0, match_spread: 9.0, ..EVIDENCE },
            Evidence { num_agreeing: 9999, weakest_constraint: 8e-5, ..EVIDENCE },
            Evidence { num_agreeing: 9999, repeat_fit: 0.95, ..EVIDENCE },
            Evidence { num_agreeing: 9999, coinciding: Some(0.7), ..EVIDENCE },
            Evidence { num_agreeing: 20, num_rival_agreeing: 40, slide_margin: 0.0, ..EVIDENCE },
            Evidence { violation: 0.2, ..EVIDENCE },
            Evidence { slide_margin: -0.1, num_agreeing: 15, ..EVIDENCE },
            Evidence { open_directions: (1, "any".into()), ..EVIDENCE },
            Evidence { has_rival: true, slide_margin: 9.0, ..EVIDENCE },
        ] {
            assert!(worse.confidence() < 0.5, "{worse:?}: {}", worse.confidence());
        }
        assert!(Evidence { num_rival_agreeing: 99, ..EVIDENCE }.confidence() < EVIDENCE.confidence());
        assert!(Evidence { match_spread: 0.0, ..EVIDENCE }.confidence() < EVIDENCE.confidence());
    }

    #[test]
    fn rivals_fit_the_surfaces_and_the_matches() {
        let fit = |overlap: f64| Agreement { overlap, violation: 0.0 };
        assert!(is_rival((&fit(0.58), 60), (&fit(0.6), 100)));
        assert!(!is_rival((&fit(0.5), 60), (&fit(0.6), 100)));
        assert!(!is_rival((&fit(0.6), 20), (&fit(0.6), 100)));
    }

    #[test]
    fn notes_name_open_directions_rivals_and_units() {
        assert!(notes(&EVIDENCE, [4.0, 3.0]).is_empty());
        assert!(notes(&Evidence { open_directions: (3, "any".into()), ..EVIDENCE }, [4.0, 3.0])[0].contains("3 of 6"));
        assert!(notes(&Evidence { has_rival: true, ..EVIDENCE }, [4.0, 3.0])[0].contains("another transform"));
        assert!(notes(&Evidence { repeat_fit: 0.95, ..EVIDENCE }, [4.0, 3.0])[0].contains("repeats itself"));
        assert!(notes(&Evidence { num_agreeing: 9, ..EVIDENCE }, [4.0, 3.0])[0].contains("only 9 matches"));
        assert!(notes(&Evidence { match_spread: 0.1, ..EVIDENCE }, [4.0, 3.0])[0].contains("one plane or line"));
        assert!(notes(&EVIDENCE, [4000.0, 4.0])[0].contains("1000 times"));
    }
}
