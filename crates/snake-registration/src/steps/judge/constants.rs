//! Constants that several questions of the verdict share.

/// A transform is reliable from this confidence on. Unit: probability. By the definition of the bias, a probability of
/// about 0.95.
pub(crate) const RELIABLE: f64 = 0.5;
/// A cloud looks like itself only at places that are this far apart; a shift up to this length is short. Unit: inlier
/// distances. So that no match is of a place with itself.
pub(super) const ELSEWHERE: f64 = 4.0;
/// Number of places of each cloud on which two transforms are compared, at most. Set for time.
pub(super) const PLACES: usize = 1000;
/// Number of places where pairs of them are compared: that are matched with others of their cloud, and that contradict
/// sensors at one place. Set for time.
pub(super) const FEW_PLACES: usize = 600;
/// Number of other candidates that may be rivals of the best, of moves that are compared for a turn, and of shifts
/// along one axis, at most. As many as `refine` refines beside the best.
pub(super) const TRIES: usize = 2;
/// Width of the cells in which details repeat, the step from one shift to the next, and the distance to which places
/// that contradict sensors at one place are thinned. Unit: inlier distances. Half and twice change no outcome.
pub(super) const DETAIL: f64 = 0.25;
/// Where the sensors are at one place, a motion that turns by less is a slide, which needs no support. Unit:
/// degrees. Half and twice change no outcome.
pub(super) const MAX_SLIDE_TURN: f64 = 12.0;
/// Two normals are parallel if their cosine is above this. Set by hand.
pub(super) const REPEAT_PARALLEL: f64 = 0.98;
/// Another try changes no verdict if a rival explains more than this of what the answer explains. Unit: share of the
/// places. Set by hand.
pub(crate) const REPEATED: f64 = 0.45;
/// A rival moves the source by more than this. Unit: inlier distances. Details of real rooms repeat after 1.4, 2.1 and 2.6.
pub(super) const MIN_SHIFT: f64 = 2.6;
/// Fewer matches that agree are never enough, however well the surfaces fit. Half and twice change no outcome.
pub(super) const MIN_AGREEING: usize = 10;
/// Greatest confidence of a transform that is ambiguous, has few matches or leaves the surfaces apart. Unit:
/// probability. Just below `RELIABLE`.
pub(crate) const MAX_DOUBTFUL: f64 = 0.49;
