//! Shifts of the source under which details of the target repeat, such as the windows of a wall.

use super::constants::{DETAIL, ELSEWHERE, MIN_SHIFT, TRIES};
use crate::cloud::patches::{self, FineCloud, Place};
use crate::cloud::upper_median;
use snake_geometry::Vector;

/// A place faces along an axis if the cosine between its normal and the axis is above this. Set by hand.
const SHIFT_COSINE: f64 = 0.8;
/// Length of the longest shift. Unit: share of the overlap's extent. Half and twice change no outcome.
const MAX_SHIFT: f64 = 0.5;
/// Smallest share of details that are in view after a shift and fit. Unit: share of the details
/// that fit at rest. Half and twice change no outcome.
const MIN_SHIFT_VIEW: f64 = 0.25;
/// Details repeat after a shift if their share of fits exceeds the median of all shifts by this. Unit: share of
/// the same excess one step from rest. Half and twice change no outcome; seen on a wall with windows every 1.5 m.
const SHIFT_FIT: f64 = 0.5;
/// Smallest share of details that fit after a short shift. Unit: share of the details in view. A
/// synthetic wall has 0.41 to 0.8, most real rooms 0.2 to 0.35.
const MIN_SHORT_FIT: f64 = 0.4;
/// Between rest and a shift, the details fit worse than this somewhere. Unit: share of the fit
/// after the shift. Half and twice change no outcome.
const SHIFT_VALLEY: f64 = 0.9;

/// The greatest number of bits of a relief.
const MAX_CELLS: f64 = 1e8;

/// The relief of a cloud over a plane: occupied cells along the two axes of the plane and, in
/// thinner layers, across it.
struct Relief {
    /// The axis across the plane, and the two along it.
    axes: [usize; 3],
    low: [f64; 3],
    sides: [f64; 3],
    counts: [usize; 3],
    cells: Vec<u64>,
    /// Columns across the plane that contain a point.
    columns: Vec<u64>,
}

fn set(bits: &mut [u64], index: usize) {
    bits[index / 64] |= 1 << (index % 64);
}

fn get(bits: &[u64], index: usize) -> bool {
    bits[index / 64] >> (index % 64) & 1 == 1
}

impl Relief {
    /// `points` are in the frame of the axes; `None` for a cloud of too many cells.
    fn new(points: &[Vector], across: usize, distance: f64) -> Option<Self> {
        let axes = [across, (across + 1) % 3, (across + 2) % 3];
        let sides = [patches::MAX_OFFSET, DETAIL, DETAIL].map(|side| side * distance);
        let low = points.iter().copied().reduce(|a, b| a.inf(&b))?;
        let extent = points.iter().copied().reduce(|a, b| a.sup(&b))? - low;
        let low = std::array::from_fn(|i| low[axes[i]] - sides[i]);
        let counts: [f64; 3] = std::array::from_fn(|i| (extent[axes[i]] / sides[i]).floor() + 4.0);
        if counts.iter().product::<f64>() > MAX_CELLS {
            return None;
        }
        let counts = counts.map(|count| count as usize);
        let size = |cells: usize| vec![0_u64; cells / 64 + 1];
        let (cells, columns) = (size(counts.iter().product()), size(counts[1] * counts[2]));
        let mut relief = Self { axes, low, sides, counts, cells, columns };
        for point in points {
            let Some([depth, row, column]) = relief.cell(point) else { continue };
            for depth in depth.saturating_sub(1)..=(depth + 1).min(counts[0] - 1) {
                let index = relief.index([depth, row, column]);
                set(&mut relief.cells, index);
            }
            set(&mut relief.columns, row * counts[2] + column);
        }
        Some(relief)
    }

    fn cell(&self, point: &Vector) -> Option<[usize; 3]> {
        let at: [f64; 3] = std::array::from_fn(|i| ((point[self.axes[i]] - self.low[i]) / self.sides[i]).floor());
        (0..3).all(|i| at[i] >= 0.0 && at[i] < self.counts[i] as f64).then(|| at.map(|v| v as usize))
    }

    fn index(&self, [depth, row, column]: [usize; 3]) -> usize {
        (depth * self.counts[1] + row) * self.counts[2] + column
    }

    /// Whether there is a surface at a place; `None` if its column is empty.
    fn has(&self, point: &Vector) -> Option<bool> {
        let at = self.cell(point)?;
        get(&self.columns, at[1] * self.counts[2] + at[2]).then(|| get(&self.cells, self.index(at)))
    }
}

/// A shift after which details of the target repeat.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shift {
    pub(super) by: Vector,
    /// Whether the details fit better there than at rest.
    pub(super) is_better: bool,
}

/// A place of the source on the target, in the axes of a frame.
#[derive(Clone, Copy)]
struct Detail {
    point: Vector,
    /// The axis of the frame along which its surface faces, if there is one.
    facing: Option<usize>,
}

/// The shifts along the axes of `frame` after which the details of `places` (the source on the target) fit the target
/// again. If both sensors would stand at one place, the places with a normal along an axis are also compared alone.
pub(super) fn shifts(
    places: &[Place],
    target: &FineCloud,
    frame: &[Vector; 3],
    distance: f64,
    is_standing: bool,
) -> Vec<Shift> {
    let into = |point: &Vector| Vector::from_fn(|axis, _| frame[axis].dot(point));
    let points: Vec<Vector> = target.points().iter().map(into).collect();
    let reliefs: Option<Vec<Relief>> = (0..3).map(|across| Relief::new(&points, across, distance)).collect();
    let Some(reliefs) = reliefs else { return Vec::new() };
    let detail = |Place { point, normal }: &Place| {
        let facing = normal.map(|normal| into(&normal)).filter(|n| n.amax() > SHIFT_COSINE);
        Detail { point: into(point), facing: facing.map(|normal| normal.iamax()) }
    };
    let all: Vec<Detail> = places.iter().map(detail).collect();
    // Places without a normal, such as on thin posts, coincide for sensors at one place by the pattern of rays alone.
    let facing = all.iter().filter(|detail| is_standing && detail.facing.is_some()).copied().collect();
    let (step, min) = (DETAIL * distance, (MIN_SHIFT / DETAIL).ceil() as i64);
    let mut shifts = Vec::new();
    for details in [all, facing] {
        for (axis, direction) in frame.iter().enumerate() {
            let Some(profile) = Profile::new(&details, &reliefs, axis, step, min) else { continue };
            shifts.extend(profile.peaks(min).into_iter().map(|at| Shift {
                by: at as f64 * step * direction,
                is_better: profile.share(at) > profile.at_rest(),
            }));
        }
    }
    shifts
}

/// Weighted numbers of details after each shift along an axis, from `-reach` to `reach` steps.
struct Profile {
    reach: i64,
    /// Details in view that fit.
    fits: Vec<f64>,
    /// Details in view.
    seen: Vec<f64>,
}

impl Profile {
    /// `None` if the details are too close together for a shift by `min` steps.
    fn new(details: &[Detail], reliefs: &[Relief], axis: usize, step: f64, min: i64) -> Option<Self> {
        let (low, high) = details.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), detail| {
            (low.min(detail.point[axis]), high.max(detail.point[axis]))
        });
        let reach = (MAX_SHIFT * (high - low) / step) as i64;
        if reach <= min {
            return None;
        }
        let shifts = -reach..=reach;
        let mut profile =
            Self { reach, fits: vec![0.0; shifts.clone().count()], seen: vec![0.0; shifts.clone().count()] };
        for Detail { point, facing } in details {
            let relief = &reliefs[facing.unwrap_or((axis + 1) % 3)];
            let after = |shift: i64| {
                let mut moved = *point;
                moved[axis] = point[axis] + step * shift as f64;
                relief.has(&moved)
            };
            let states: Vec<Option<bool>> = shifts.clone().map(after).collect();
            // A detail that lies on the target after every shift carries no information.
            let on = states.iter().filter(|state| **state == Some(true)).count();
            let in_view = states.iter().flatten().count();
            let weight = (1.0 - on as f64 / in_view.max(1) as f64).powi(2);
            for (index, fit) in states.into_iter().enumerate().filter_map(|(index, fit)| Some((index, fit?))) {
                profile.seen[index] += weight;
                profile.fits[index] += if fit { weight } else { 0.0 };
            }
        }
        Some(profile)
    }

    fn fit(&self, shift: i64) -> f64 {
        self.fits[(shift + self.reach) as usize]
    }

    /// The share of the details in view that fit.
    fn share(&self, shift: i64) -> f64 {
        let seen = self.seen[(shift + self.reach) as usize];
        if seen > 0.0 { self.fit(shift) / seen } else { 0.0 }
    }

    /// The share one step from rest. At rest, clouds of one pattern of rays coincide point by point.
    fn beside_rest(&self) -> f64 {
        self.share(-1).max(self.share(1))
    }

    fn at_rest(&self) -> f64 {
        self.share(0).max(self.beside_rest())
    }

    /// The median share over all shifts.
    fn usual(&self) -> f64 {
        upper_median(&(-self.reach..=self.reach).map(|shift| self.share(shift)).collect::<Vec<_>>())
    }

    /// The shifts by at least `min` steps at which the details fit about as well as beside rest,
    /// and worse in between. Of them, those with the most fitting details are kept.
    fn peaks(&self, min: i64) -> Vec<i64> {
        let usual = self.usual();
        let repeats = usual + SHIFT_FIT * (self.beside_rest() - usual);
        let min_share = |shift: i64| {
            let is_short = shift.abs() as f64 * DETAIL <= ELSEWHERE;
            if is_short { repeats.max(MIN_SHORT_FIT) } else { repeats }
        };
        let is_peak = |&shift: &i64| {
            let near = (shift - 2).max(-self.reach)..=(shift + 2).min(self.reach);
            let mut way = if shift > 0 { 1..shift } else { shift + 1..0 };
            shift.abs() >= min
                && self.fit(shift) >= MIN_SHIFT_VIEW * self.fit(0)
                && self.share(shift) >= min_share(shift)
                && near.into_iter().all(|other| self.fit(other) <= self.fit(shift))
                && way.any(|other| self.share(other) < SHIFT_VALLEY * self.share(shift))
        };
        let mut peaks: Vec<i64> = (-self.reach..=self.reach).filter(is_peak).collect();
        peaks.sort_by(|a, b| self.fit(*b).total_cmp(&self.fit(*a)).then(a.cmp(b)));
        peaks.truncate(TRIES);
        peaks
    }
}
