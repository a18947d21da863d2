//! The dense core of a cloud surrounded by sky and floaters, as in splats and dense reconstructions from photographs.
//!
//! Such clouds have a scene in the middle. Many times as far away are sparse points that form no surface as seen from it: a
//! dome of sky, several shells, or tails of floaters at all distances. A sweep, terrain around a statue or a second building is
//! far, too, but it is as dense, or it is a surface: points in neighbouring directions have nearly the same distance.

/// Smallest share of the points in a core.
const MIN_SHARE: f64 = 0.3;
/// A cloud is examined if its farthest point is this many times as far from the middle of the core as [`MIN_SHARE`] of the
/// points. Objects, rooms and LiDAR sweeps have 7.7 and less.
const SUSPICIOUS: f64 = 8.0;
/// Smallest share of far points around a core. Fewer can be outliers by their distance alone.
const MIN_FAR_SHARE: f64 = 0.01;
/// The farthest point is at least this many radii of the core away.
const FAR: f64 = 6.0;
/// Sparse points are this many times as far from their nearest neighbours as the points of the core.
const SPARSE: f64 = 5.0;
/// The outer radius of a ring around the core, as a multiple of its inner radius.
const RING: f64 = 1.25;
/// Radius of the core's ball, as a multiple of the radius of its last dense ring. It keeps thin parts.
const MARGIN: f64 = 1.5;
/// Largest distance in a shell as a multiple of its smallest; and the smallest gap between two shells, as a ratio.
const SHELL: f64 = 1.6;
const BETWEEN_SHELLS: f64 = 1.5;
/// Smallest length of the mean direction of points on one side: they lie within a cone of about 30 degrees. An eighth of a dome has 0.87.
const ONE_SIDE: f64 = 0.93;
/// Points are scattered if, for more than this share of them, the neighbour in direction is farther or nearer by this factor.
/// In tails it is half and more, in a room around a statue 0.27, in sweeps and terrain 0.06 and less.
const SCATTERED_SHARE: f64 = 0.38;
const SCATTERED_FACTOR: f64 = 2.5;
/// Smallest number of points outside the largest shell that are tested for being scattered.
const MIN_REST: usize = 8;
/// Maximum number of candidates for the middle of the core. They fit on the stack.
const CANDIDATES: usize = 128;

/// The middle of the core, and the radius of a ball around it. `None` unless sparse points lie far beyond it that form shells
/// or are scattered.
pub(super) fn dense_core(points: &[[f64; 3]]) -> Option<([f64; 3], f64)> {
    let center = middle(points)?;
    let distance = |point: &[f64; 3]| squared_distance(point, &center).sqrt();
    let farthest = points.iter().map(distance).fold(0.0, f64::max);
    let within = |radius: f64| points.iter().filter(|point| distance(point) <= radius).count() as f64;
    if !farthest.is_finite() || within(farthest / SUSPICIOUS) < MIN_SHARE * points.len() as f64 {
        return None;
    }
    let distances: Vec<f64> = points.iter().map(distance).collect();
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    let inner = sorted[(MIN_SHARE * points.len() as f64).ceil() as usize - 1];
    let spacings: Vec<f64> = points.iter().map(|point| spacing(point, points)).collect();
    let typical = |from: f64, to: f64| {
        let ring = distances.iter().zip(&spacings).filter(|(distance, _)| (from..=to).contains(*distance));
        median(ring.map(|(_, spacing)| *spacing).collect())
    };
    let sparse = SPARSE * typical(0.0, inner)?;
    if !(inner > 0.0 && sparse > 0.0) {
        return None;
    }
    let mut radius = inner;
    while typical(radius.next_up(), radius * RING).is_some_and(|spacing| spacing <= sparse) {
        radius *= RING;
    }
    let far = sorted.partition_point(|distance| *distance <= MARGIN * radius);
    let is_sparse = typical((MARGIN * radius).next_up(), f64::INFINITY).is_some_and(|spacing| spacing > sparse);
    let are_many = (points.len() - far) as f64 >= MIN_FAR_SHARE * points.len() as f64;
    let is_far = farthest > FAR * radius && is_sparse && are_many;
    let offsets = || {
        let beyond = points.iter().filter(|point| distance(point) > MARGIN * radius);
        beyond.map(|point| std::array::from_fn(|axis| point[axis] - center[axis])).collect::<Vec<[f64; 3]>>()
    };
    let is_sky = is_far && !lie_on_one_side(&offsets()) && are_shells(&sorted[far..]);
    (is_sky || is_far && are_scattered(&offsets())).then_some((center, MARGIN * radius))
}

/// Whether points, given relative to the centre, lie in nearly one direction: a thing before a sensor's own housing, no sky.
fn lie_on_one_side(offsets: &[[f64; 3]]) -> bool {
    let sum = |axis: usize| offsets.iter().map(|offset| Ray::new(offset).direction[axis]).sum::<f64>();
    squared_distance(&[0, 1, 2].map(sum), &[0.0; 3]).sqrt() > ONE_SIDE * offsets.len() as f64
}

pub(super) fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
}

/// The candidate that needs the smallest ball for [`MIN_SHARE`] of the candidates.
fn middle(points: &[[f64; 3]]) -> Option<[f64; 3]> {
    let step = points.len().div_ceil(CANDIDATES).max(1);
    let candidates = points.iter().step_by(step);
    let rank = (MIN_SHARE * candidates.len() as f64) as usize;
    let reach = |center: &[f64; 3]| {
        let mut squared = [0.0; CANDIDATES];
        let squared = &mut squared[..candidates.len()];
        squared
            .iter_mut()
            .zip(candidates.clone())
            .for_each(|(squared, point)| *squared = squared_distance(point, center));
        *squared.select_nth_unstable_by(rank, f64::total_cmp).1
    };
    let reaches = candidates.clone().map(|candidate| (reach(candidate), candidate));
    reaches.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, center)| *center)
}

/// The distance from a point to the nearest other point.
fn spacing(point: &[f64; 3], points: &[[f64; 3]]) -> f64 {
    let others = points.iter().filter(|other| !std::ptr::eq(*other, point));
    others.map(|other| squared_distance(other, point)).fold(f64::INFINITY, f64::min).sqrt()
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Whether sorted distances form thin shells with nothing between them.
fn are_shells(distances: &[f64]) -> bool {
    let mut shells = distances.chunk_by(|near, far| *far <= BETWEEN_SHELLS * near);
    shells.all(|shell| shell[shell.len() - 1] <= SHELL * shell[0])
}

/// Whether points, given relative to the centre, lie at very different distances in nearly the same direction. It is enough if
/// they do so without the shell that holds most of them.
fn are_scattered(offsets: &[[f64; 3]]) -> bool {
    let rays: Vec<Ray> = offsets.iter().map(Ray::new).collect();
    let mut sorted: Vec<f64> = rays.iter().map(|ray| ray.length).collect();
    sorted.sort_by(f64::total_cmp);
    let held = |first: &usize| sorted.partition_point(|length| *length <= SHELL * sorted[*first]) - first;
    let shell = (0..sorted.len()).max_by_key(held).map_or(0.0, |first| sorted[first]);
    let rest: Vec<Ray> = rays.iter().filter(|ray| !(shell..=SHELL * shell).contains(&ray.length)).copied().collect();
    let is_more = |rays: &[Ray]| {
        let alone = rays.iter().filter(|ray| ray.is_alone(rays)).count();
        alone as f64 > SCATTERED_SHARE * rays.len() as f64
    };
    is_more(&rays) || rest.len() >= MIN_REST && is_more(&rest)
}

/// A point as a direction and a distance from the centre.
#[derive(Debug, Clone, Copy)]
struct Ray {
    direction: [f64; 3],
    length: f64,
}

impl Ray {
    fn new(offset: &[f64; 3]) -> Self {
        let length = squared_distance(offset, &[0.0; 3]).sqrt();
        Self { direction: offset.map(|v| v / length), length }
    }

    /// Whether the ray with the nearest direction is much longer or shorter.
    fn is_alone(&self, rays: &[Self]) -> bool {
        let others = rays.iter().filter(|other| !std::ptr::eq(*other, self));
        let apart = |other: &Self| squared_distance(&other.direction, &self.direction);
        let nearest = others.min_by(|a, b| apart(a).total_cmp(&apart(b)));
        nearest.is_none_or(|other| other.length.max(self.length) > SCATTERED_FACTOR * other.length.min(self.length))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Pseudo-random numbers from 0 to 1, one sequence per row.
    pub(in crate::clouds) fn drawn(i: usize, row: usize) -> f64 {
        ((i as f64 * 12.9898 + row as f64 * 78.233).sin() * 43_758.545).rem_euclid(1.0)
    }

    /// Directions that cover the sphere.
    fn direction(i: usize) -> [f64; 3] {
        let z = 1.0 - 2.0 * drawn(i, 0);
        let (sin, cos) = (drawn(i, 1) * std::f64::consts::TAU).sin_cos();
        [(1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z]
    }

    /// Points on the surface of a box with half sides 1, 0.6 and 0.4.
    fn scene(number: usize) -> Vec<[f64; 3]> {
        let point = |i: usize| {
            let at = |row| 2.0 * drawn(i, row) - 1.0;
            let mut point = [at(3), at(4), at(5)];
            point[i % 3] = if (i / 3).is_multiple_of(2) { 1.0 } else { -1.0 };
            [point[0], 0.6 * point[1], 0.4 * point[2]]
        };
        (0..number).map(point).collect()
    }

    /// A scene of `1024 - number` points and `number` points around it. `distance` maps numbers from 0 to 1 to distances.
    fn with(number: usize, keep: impl Fn(&[f64; 3]) -> bool, distance: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
        let directions = (0..).map(direction).filter(keep).take(number);
        let far = directions.enumerate().map(|(i, direction)| direction.map(|v| v * distance(drawn(i, 2))));
        scene(1024 - number).into_iter().chain(far).collect()
    }

    /// The shares of the scene and of the far points that lie in the core.
    fn held(points: &[[f64; 3]], far: usize) -> Option<[f64; 2]> {
        let (center, radius) = dense_core(points)?;
        let share = |points: &[[f64; 3]]| {
            let held = points.iter().filter(|point| squared_distance(point, &center) <= radius * radius).count();
            held as f64 / points.len() as f64
        };
        let (scene, far) = points.split_at(points.len() - far);
        Some([share(scene), share(far)])
    }

    #[test]
    fn domes_of_any_share_and_part_and_several_shells_are_left_out() {
        let all = |_: &[f64; 3]| true;
        let upper = |direction: &[f64; 3]| direction[2] > 0.0;
        let corner = |direction: &[f64; 3]| direction[0] > 0.3 && direction[1] > 0.0 && direction[2] > 0.0;
        for number in [60, 200, 400, 600] {
            for times in [20.0, 30.0, 100.0, 1e6] {
                let dome = |at: f64| times * (0.9 + 0.2 * at);
                for cloud in [with(number, all, dome), with(number, upper, dome), with(number, corner, dome)] {
                    assert_eq!(held(&cloud, number), Some([1.0, 0.0]), "{number} at {times}");
                }
            }
            let shells = |at: f64| [20.0, 60.0, 200.0][(3.0 * at) as usize];
            assert_eq!(held(&with(number, all, shells), number), Some([1.0, 0.0]), "{number} in shells");
        }
    }

    #[test]
    fn scattered_tails_of_any_law_are_left_out() {
        for number in [100, 200, 400] {
            let laws: [fn(f64) -> f64; 3] =
                [|at| (6.0 * at).exp(), |at| (at + 1e-3).powi(-2), |at| (at + 1e-3).powf(-1.6)];
            for (index, law) in laws.into_iter().enumerate() {
                let [scene, far] = held(&with(number, |_| true, law), number).unwrap_or_default();
                assert!(scene == 1.0 && far < 0.75, "{number} of law {index}: {scene} {far}");
            }
        }
        // A dome together with tails.
        let both = |at: f64| if at < 0.6 { 80.0 + 20.0 * at } else { (5.0 * (at - 0.6) / 0.4).exp() };
        assert!(held(&with(300, |_| true, both), 300).is_some_and(|[scene, _]| scene == 1.0));
    }

    #[test]
    fn surfaces_far_away_stay() {
        // A sensor's sweep: walls and a floor, with density falling with the distance; half of the points are at the sensor.
        let sweep = (0..512).map(|i| {
            let direction = direction(i);
            let range = (1.8 / direction[2].abs()).min(40.0 / direction[0].abs()).min(8.0 / direction[1].abs());
            direction.map(|v| v * range)
        });
        let statue = |scale: f64, number: usize| scene(number).into_iter().map(move |point| point.map(|v| v * scale));
        let terrain = (0..300).map(|i| [3, 4].map(|row| drawn(i, row) * 200.0 - 100.0));
        let terrain = terrain.map(|[x, y]| [x, y, 3.0 * (x / 20.0).sin()]);
        let twin = scene(300).into_iter().map(|[x, y, z]| [x + 30.0, y, z]);
        let clouds: [Vec<[f64; 3]>; 5] = [
            sweep.clone().collect(),
            sweep.chain(statue(1e-3, 512)).collect(),
            terrain.chain(statue(0.1, 724)).collect(),
            twin.chain(scene(700)).collect(),
            scene(1024),
        ];
        for (index, cloud) in clouds.iter().enumerate() {
            assert_eq!(dense_core(cloud), None, "cloud {index}");
        }
    }

    #[test]
    fn repeated_points_and_numbers_at_the_end_of_their_range_have_no_core() {
        let zeros = |number: usize| std::iter::repeat_n([0.0; 3], number);
        for points in [
            vec![],
            vec![[1.0; 3]; 500],
            zeros(500).chain((0..500).map(|i| direction(i).map(|v| v * 50.0))).collect(),
            scene(500).into_iter().chain([[f64::MAX, 0.0, f64::MIN], [1e200; 3]]).collect(),
            // The squares of their distances overflow.
            (0..500).map(|i| direction(i).map(|v| v * 1e200)).collect(),
        ] {
            assert_eq!(dense_core(&points), None, "{:?}", points.last());
        }
    }
}
