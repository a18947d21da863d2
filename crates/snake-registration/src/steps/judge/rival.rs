//! A rival of the winner: whether it is as good or better, and the note about it.

use nalgebra::IsometryMatrix3;

use super::open_motions::axis_name;
use super::shifts::Shift;
use snake_geometry::Vector;

/// Largest contradiction of an equal rival. Unit: share of the places that the winner explains and that tell the two
/// apart. Rivals in stairs, ramps and stairwells have up to 0.05, those of correct answers in real rooms 0.075 and more.
const MAX_CONTRADICTED: f64 = 0.055;
/// The same limit for sensors at one place, where one pattern of rays coincides point by point.
/// Traffic has up to 0.25, rooms at rest 0.33 and more. Other repetitions: stairwells have up to 0.27, streets 0.31 and more.
const STANDING_CONTRADICTED: f64 = 0.28;
/// The same limit for repetitions after such a slide: stadiums have up to 0.33.
const TIERS_CONTRADICTED: f64 = 0.35;
/// The limit over all explained places, for shifts of sensors at one place or with a better fit of details. Pillars have up to 0.38.
const SHIFT_CONTRADICTED: f64 = 0.43;
/// A mirror image fits better if it leads by this. Unit: share of the places that the winner explains. Mirrored boxes
/// have 0.1 and more.
const MIRROR_LEAD: f64 = 0.06;
/// A difference of explained or absent places is significant above this many standard deviations. In rooms, absence
/// contradicts the truth by -5 to 2 if a half turn is the winner, and the half turn by 4 and more if the truth is the winner.
const MIN_DEVIATIONS: f64 = 3.0;

/// The kind of motion that leads from the winner to a rival.
#[derive(Debug, Clone, Copy)]
pub(super) enum Motion {
    Mirror,
    Shift(Shift),
    /// A rotation, a slide, or a motion under which one of the clouds is self-similar.
    Alike,
    /// One of the last after which the surfaces fit nearly as well: another storey, another tier of seats.
    Repetition,
}

/// A rival, compared with the winner place by place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rival {
    pub(super) transform: IsometryMatrix3<f64>,
    pub(super) motion: Motion,
    pub(super) counts: Counts,
    /// Whether the winner puts the sensors of both clouds at one place.
    pub(super) is_standing: bool,
    /// Root mean square distance between the source under the rival and under the winner.
    pub(super) moved: f64,
}

impl Rival {
    /// Whether the rival is a mirror image of the source, which no rigid motion gives.
    pub(super) fn is_mirrored(&self) -> bool {
        matches!(self.motion, Motion::Mirror)
    }

    /// The measure that must be small for an equal rival, and its limit. A mirror image only has to explain more places.
    fn limit(&self) -> (Measure, f64) {
        match (self.motion, self.is_standing) {
            (Motion::Mirror, _) => (Measure::Lead, -MIRROR_LEAD),
            (Motion::Shift(Shift { is_better: true, .. }), _) | (Motion::Shift(_), true) => {
                (Measure::OfAll, SHIFT_CONTRADICTED)
            }
            (Motion::Repetition, true) => (Measure::OfTelling, TIERS_CONTRADICTED),
            (Motion::Alike, true) | (Motion::Repetition, false) => (Measure::OfTelling, STANDING_CONTRADICTED),
            (Motion::Shift(_) | Motion::Alike, false) => (Measure::OfTelling, MAX_CONTRADICTED),
        }
    }

    /// Whether it explains significantly more places than the winner. A mirror image is never better: it is no rigid motion.
    pub(super) fn is_better(&self) -> bool {
        !self.is_mirrored() && self.counts.is_gain_significant()
    }

    /// Whether the rival is about as good as the winner: its measure is at most the limit.
    pub(super) fn is_equal(&self) -> bool {
        let (measure, limit) = self.limit();
        self.counts.measure(measure) <= limit
    }

    /// The share of the winner's explained places that the rival explains too. For
    /// [`Motion::Alike`], only places that tell the two apart count. It is 0 for a mirror image.
    pub(super) fn repeat_fit(&self) -> f64 {
        match self.motion {
            Motion::Shift(_) => self.counts.both_of_explained(),
            Motion::Alike | Motion::Repetition => 1.0 - self.counts.measure(Measure::OfTelling),
            Motion::Mirror => 0.0,
        }
    }

    /// A sentence on how this rival makes the winner ambiguous.
    pub(super) fn note(&self, winner: &IsometryMatrix3<f64>) -> String {
        match self.motion {
            Motion::Mirror => {
                "a mirror image of the source fits better: one of the clouds may have a flipped axis".into()
            }
            Motion::Alike | Motion::Repetition => {
                let angle = (self.transform.rotation * winner.rotation.inverse()).angle().to_degrees().round();
                let by = self.transform.translation.vector - winner.translation.vector;
                if angle == 0.0 {
                    return repeat_note("scene", &by);
                }
                format!(
                    "ambiguous: the scene looks like itself after a turn by {angle:.0} degrees that moves the source by {:.3}, \
                     and the source fits there about as well",
                    self.moved
                )
            }
            Motion::Shift(Shift { by, .. }) => repeat_note("target", &by),
        }
    }
}

/// A sentence on what repeats after a shift.
fn repeat_note(what: &str, by: &Vector) -> String {
    format!(
        "ambiguous: the {what} repeats itself every {:.3} along {}, and the source fits there about as well",
        by.norm(),
        axis_name(&by.normalize())
    )
}

/// The measures of a rival, as shares of places.
#[derive(Debug, Clone, Copy)]
pub(super) enum Measure {
    /// The lead of the winner, as a share of the places that it explains.
    Lead,
    /// The share of the winner's explained places that the rival does not explain.
    OfAll,
    /// The share of contradicted places among those that tell the two apart. Other places that only the winner
    /// explains do not count: clouds of one pattern of rays coincide point by point wherever they are a period apart.
    OfTelling,
}

/// Counts of places of both clouds.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// Places that both transforms bring onto the other cloud.
    pub(super) both: usize,
    /// Those of them that the two transforms bring to different places. A floor, for example, agrees with all slides along it.
    pub(super) telling: usize,
    /// Places that the winner brings onto the other cloud and the rival contradicts.
    pub(super) winner: usize,
    /// The reverse.
    pub(super) rival: usize,
    /// Places that the winner brings onto a cloud with an unknown sensor, and the rival to where that cloud has no surface.
    pub(super) absent: usize,
    /// The reverse.
    pub(super) gained: usize,
}

impl Counts {
    /// How many more places the rival explains than the winner does.
    pub(super) fn gain(&self) -> i64 {
        (self.rival + self.gained) as i64 - (self.winner + self.absent) as i64
    }

    /// Whether the rival explains significantly more places than the winner does.
    pub(super) fn is_gain_significant(&self) -> bool {
        is_significant(self.gain(), self.winner + self.absent + self.rival + self.gained)
    }

    pub(super) fn measure(&self, measure: Measure) -> f64 {
        match measure {
            Measure::Lead => -self.gain() as f64 / self.explained(),
            Measure::OfAll => (self.winner + self.absent) as f64 / self.explained(),
            Measure::OfTelling => {
                let contradicted = self.winner + if self.absence_tells() { self.absent } else { 0 };
                contradicted as f64 / (self.telling + contradicted).max(1) as f64
            }
        }
    }

    /// The share of the winner's explained places that the rival explains too.
    pub(super) fn both_of_explained(&self) -> f64 {
        self.both as f64 / self.explained()
    }

    /// Whether absent places contradict the rival. The view of an unknown sensor is not known, and
    /// a rival that explains as many other places instead is as good.
    fn absence_tells(&self) -> bool {
        is_significant(self.absent as i64 - self.gained as i64, self.absent + self.gained)
    }

    fn explained(&self) -> f64 {
        (self.both + self.winner + self.absent).max(1) as f64
    }
}

/// McNemar's test: whether one transform explains significantly more of the places that only one of the two explains.
fn is_significant(more: i64, differing: usize) -> bool {
    more as f64 > MIN_DEVIATIONS * (differing as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rival(motion: Motion, winner: usize, rival: usize) -> Rival {
        let counts = Counts { both: 200, telling: 200, winner, rival, absent: 0, gained: 0 };
        Rival { transform: IsometryMatrix3::identity(), motion, counts, is_standing: false, moved: 1.0 }
    }

    #[test]
    fn a_mirror_image_that_explains_more_is_a_rival_whatever_it_contradicts() {
        assert!(rival(Motion::Mirror, 180, 500).is_equal());
        assert!(!rival(Motion::Mirror, 180, 180).is_equal());
    }

    #[test]
    fn a_rival_that_explains_significantly_more_is_better_and_a_mirror_image_never() {
        assert!(rival(Motion::Alike, 20, 60).is_better());
        assert!(!rival(Motion::Alike, 20, 40).is_better());
        assert!(!rival(Motion::Mirror, 20, 60).is_better());
    }

    #[test]
    fn absence_before_an_unknown_sensor_contradicts_only_a_rival_that_explains_less() {
        let of_telling = |absent, gained| {
            let counts = Counts { both: 900, telling: 700, winner: 5, rival: 5, absent, gained };
            counts.measure(Measure::OfTelling)
        };
        assert!(of_telling(200, 190) < 0.01);
        assert!(of_telling(200, 100) > 0.2);
        assert!(of_telling(200, 300) < 0.01);
    }
}
