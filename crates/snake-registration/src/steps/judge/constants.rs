//! Constants that several questions of the verdict share.

/// Smallest confidence of a reliable transform. Unit: probability. By the definition of the bias,
/// it corresponds to a probability of about 0.95.
pub(crate) const RELIABLE: f64 = 0.5;
/// Smallest distance between places at which a cloud can be self-similar, so that no place is
/// matched with itself. A shift up to this length is short. Unit: inlier distances.
pub(super) const ELSEWHERE: f64 = 4.0;
/// Number of places of each cloud on which two transforms are compared, at most. Set for time.
pub(super) const PLACES: usize = 1000;
/// Number of places that are compared pair by pair, at most: places that are matched within their
/// cloud, and places that contradict sensors at one place. Set for time.
pub(super) const FEW_PLACES: usize = 600;
/// Number of candidates that may be rivals of the best, of translations that are compared for a
/// rotation, and of shifts along one axis, at most. `refine` refines as many beside the best.
pub(super) const TRIES: usize = 2;
/// Width of the cells in which details repeat, step from one shift to the next, and spacing to which places
/// that contradict sensors at one place are thinned. Unit: inlier distances. Half and twice change no outcome.
pub(super) const DETAIL: f64 = 0.25;
/// If the sensors are at one place, a motion with a smaller rotation is a slide, which needs no
/// support. Unit: degrees. Half and twice change no outcome.
pub(super) const MAX_SLIDE_TURN: f64 = 12.0;
/// Two normals are parallel if their cosine is above this. Set by hand.
pub(super) const REPEAT_PARALLEL: f64 = 0.98;
/// Another try changes no verdict if a rival explains more than this of what the answer explains. Unit: share of the
/// places. Set by hand.
pub(crate) const REPEATED: f64 = 0.45;
/// Smallest displacement by a rival. Unit: inlier distances. Details of real rooms repeat after 1.4, 2.1 and 2.6.
pub(super) const MIN_SHIFT: f64 = 2.6;
/// Smallest number of agreeing matches, regardless of how well the surfaces fit. Half and twice change no outcome.
pub(super) const MIN_AGREEING: usize = 10;
/// Greatest confidence of a transform that is ambiguous, has few matches or leaves the surfaces apart. Unit:
/// probability. Just below `RELIABLE`.
pub(crate) const MAX_DOUBTFUL: f64 = 0.49;
