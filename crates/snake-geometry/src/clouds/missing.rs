//! Missing returns that a sensor writes as points: all at one place, at one distance or at one depth.

use std::cell::OnceCell;

use super::housing::housing;
use super::sensor::median;
use crate::{Point, Sensor, Vector, eigen, vector};

/// Missing returns are at least this number of points, and this share of the cloud.
const MIN_POINTS: usize = 50;
const MIN_SHARE: f64 = 0.01;
/// Distances and depths that differ by less than this share are equal. No surface is so exactly a sphere around the sensor, and
/// text files round coordinates.
const TOLERANCE: f64 = 1e-4;
/// Points at one distance are on a surface, not around the sensor, if more than the first share of them lie on one plane, up to the
/// second share of the distance: a beam on a level floor draws a circle, and so does a rim, which is as thick as the tolerance lets it.
const CIRCLE: [f64; 2] = [0.9, 0.01];
/// The depth of a plane of missing returns is more than this many times the farthest other point's distance from the origin.
const MIN_DEPTH: f64 = 1.5;
/// Along the depth it has at most this share of its width: another thing far away has more.
const FLAT: f64 = 0.01;
/// A cloud keeps its points if a smaller share than this would be left.
const MIN_LEFT: f64 = 0.05;
/// It also keeps them if more than this share is at one distance or depth: a dome around the sensor, or a wall behind objects.
const MAX_AT_DISTANCE: f64 = 0.5;
/// A place of missing returns has at least this many times the mean number of copies of a point.
const MIN_COPIES: f64 = 5.0;
/// Maximum mean number of copies of the other points if the sensor is not known: a mesh repeats its vertices.
const MAX_OTHER_COPIES: f64 = 1.5;
/// Maximum number of kinds of missing returns in one cloud.
pub(super) const MAX_KINDS: usize = 4;
/// Number of counters for distances. They fit on the stack.
const COUNTERS: usize = 8192;

/// Which points are missing returns, and a description of where they are.
type Missing = (Vec<bool>, String);

/// The rules in order. Each finds one kind of missing returns.
const RULES: [fn(&Returns) -> Option<Missing>; 3] =
    [|returns| returns.at_one_place(), |returns| returns.at_one_distance(), |returns| returns.at_one_depth()];

/// Which of the finite points are missing returns of a sensor, and a description. A sensor that is not given is searched for if
/// the answer depends on it. If none is found, it may be at the origin; points at one distance must then be the farthest ones,
/// because a ball on a stand may surround the origin.
pub(super) fn missing_returns(points: &[Point], given: Option<[f64; 3]>) -> Option<Missing> {
    let returns = Returns::new(points, given)?;
    let (is_missing, place) = RULES
        .iter()
        .find_map(|rule| rule(&returns))
        .map(|(is_missing, place)| (is_missing, place + ", as missing returns are written"))
        .or_else(|| housing(points))?;
    if !leaves_enough(&is_missing) {
        return None;
    }
    let (count, number) = (number_of(&is_missing), points.len());
    let share = 100.0 * count as f64 / number as f64;
    Some((is_missing, format!("{count} of {number} points ({share:.0} %) are {place}")))
}

fn number_of(is_missing: &[bool]) -> usize {
    is_missing.iter().filter(|missing| **missing).count()
}

fn is_surface(is_at: &[bool]) -> bool {
    number_of(is_at) as f64 > MAX_AT_DISTANCE * is_at.len() as f64
}

fn leaves_enough(is_missing: &[bool]) -> bool {
    (is_missing.len() - number_of(is_missing)) as f64 >= MIN_LEFT * is_missing.len() as f64
}

/// The points of a cloud as the returns of a sensor.
struct Returns<'a> {
    points: &'a [Point],
    given: Option<[f64; 3]>,
    found: OnceCell<Option<Sensor>>,
    min_count: usize,
    /// Whether `min_count` points may have one distance.
    may_repeat: bool,
}

impl<'a> Returns<'a> {
    /// Returns `None` if there are fewer points than missing returns need.
    fn new(points: &'a [Point], given: Option<[f64; 3]>) -> Option<Self> {
        let min_count = MIN_POINTS.max((MIN_SHARE * points.len() as f64) as usize);
        let mut returns = Self { points, given, found: OnceCell::new(), min_count, may_repeat: false };
        returns.may_repeat = may_be_frequent(points.iter().map(|point| returns.distance(point)), min_count);
        (points.len() >= min_count).then_some(returns)
    }

    /// The distance from the given sensor, or from the origin: the position of a sensor that is found is not exact.
    fn distance(&self, point: &Point) -> f64 {
        (vector(*point) - Vector::from(self.given.unwrap_or_default())).norm()
    }

    fn sensor(&self) -> Option<[f64; 3]> {
        let found = || self.found.get_or_init(|| Sensor::find(self.points)).map(|sensor| sensor.position);
        self.given.or_else(found)
    }

    /// Copies of one point in a cloud whose other points are not repeated. Such copies also have one distance.
    fn at_one_place(&self) -> Option<Missing> {
        let points = self.points;
        let key = |point: &Point| point.map(|v| (v + 0.0).to_bits());
        // Four bytes per point: the cloud may have hundreds of millions.
        let number = u32::try_from(points.len()).ok().filter(|_| self.may_repeat)?;
        let mut order: Vec<u32> = (0..number).collect();
        order.sort_unstable_by_key(|&index| key(&points[index as usize]));
        let copies = || order.chunk_by(|&a, &b| key(&points[a as usize]) == key(&points[b as usize]));
        let most = copies().max_by_key(|copies| copies.len())?;
        let (place, count, distinct) = (key(&points[most[0] as usize]), most.len(), copies().count());
        let mean = points.len() as f64 / distinct as f64;
        let others = (points.len() - count) as f64 / (distinct - 1).max(1) as f64;
        let is_many = count >= self.min_count && count as f64 >= MIN_COPIES * mean;
        if !is_many || others > MAX_OTHER_COPIES && self.sensor().is_none() {
            return None;
        }
        let [x, y, z] = place.map(f32::from_bits);
        Some((points.iter().map(|point| key(point) == place).collect(), format!("at ({x}, {y}, {z})")))
    }

    /// Points at exactly one distance from the sensor that surround it.
    fn at_one_distance(&self) -> Option<Missing> {
        if !self.may_repeat {
            return None;
        }
        let distances = || self.points.iter().map(|point| self.distance(point));
        let farthest = distances().fold(0.0, f64::max);
        let can_be = |distance: f64| match self.sensor() {
            Some(place) => self.given.is_some() || place == [0.0; 3],
            None => distance >= (1.0 - TOLERANCE) * farthest,
        };
        frequent(distances().collect(), self.min_count).into_iter().find_map(|distance| {
            let is_at = |other: f64| (other - distance).abs() <= TOLERANCE * distance;
            let is_missing: Vec<bool> = distances().map(is_at).collect();
            let shell = self.points.iter().zip(&is_missing).filter(|(_, missing)| **missing);
            let shell: Vec<Vector> = shell.map(|(point, _)| vector(*point)).collect();
            let faces_all_ways = !is_surface(&is_missing) && !is_circle(shell, distance);
            (faces_all_ways && can_be(distance)).then(|| (is_missing, format!("exactly {distance:.6} from the sensor")))
        })
    }

    /// Points at exactly one depth along an axis, the smallest or the largest, that is far beyond all other points. Copies of a
    /// vertex, such as the tip of a cone, do not count as a plane.
    fn at_one_depth(&self) -> Option<Missing> {
        let points = self.points;
        let mut extremes = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
        for point in points {
            for (value, [low, high]) in point.iter().zip(&mut extremes) {
                (*low, *high) = (low.min(*value), high.max(*value));
            }
        }
        let ends = (0..3).flat_map(|axis| extremes[axis].map(|depth| (axis, f64::from(depth))));
        ends.into_iter().find_map(|(axis, depth)| {
            let is_at = |point: &Point| (f64::from(point[axis]) - depth).abs() <= TOLERANCE * depth.abs();
            let at_depth = || points.iter().filter(|point| is_at(point));
            let first = at_depth().next();
            if at_depth().count() < self.min_count {
                return None;
            }
            let is_missing: Vec<bool> = points.iter().map(is_at).collect();
            let others = points.iter().filter(|point| !is_at(point));
            let farthest = others.map(|point| vector(*point).norm()).fold(0.0, f64::max);
            let is_behind = depth.abs() > MIN_DEPTH * farthest && !is_surface(&is_missing);
            let extent = |axis: usize| {
                let values = || at_depth().map(|point| point[axis]);
                f64::from(values().fold(f32::MIN, f32::max)) - f64::from(values().fold(f32::MAX, f32::min))
            };
            let is_flat = || extent(axis) <= FLAT * extent((axis + 1) % 3).max(extent((axis + 2) % 3));
            let is_vertex = || at_depth().all(|point| Some(point) == first) && self.sensor().is_none();
            let place = format!("exactly at {} = {depth:.6}, far behind the others", ["x", "y", "z"][axis]);
            (is_behind && is_flat() && !is_vertex()).then_some((is_missing, place))
        })
    }
}

/// Whether most points at one distance lie on one plane. Those that do not, which tilt it, are left out in two rounds.
fn is_circle(mut shell: Vec<Vector>, distance: f64) -> bool {
    let most = (CIRCLE[0] * shell.len() as f64) as usize;
    let mut farthest = f64::INFINITY;
    for count in [shell.len(), most] {
        shell.truncate(count);
        let mean = shell.iter().sum::<Vector>() / count.max(1) as f64;
        let (_, normal) = eigen(shell.iter().map(|point| (point - mean) * (point - mean).transpose()).sum());
        let middle = median(shell.iter().map(|point| normal.dot(point)).collect());
        let height = |point: &Vector| (normal.dot(point) - middle).abs();
        shell.sort_by(|a, b| height(a).total_cmp(&height(b)));
        farthest = height(&shell[most - 1]);
    }
    farthest < CIRCLE[1] * distance
}

/// Whether `min_count` distances may be equal. This takes a tenth of the time of [`frequent`] and no memory.
fn may_be_frequent(distances: impl Iterator<Item = f64>, min_count: usize) -> bool {
    let mut counts = [0_u32; COUNTERS];
    // The upper 24 bits, with 12 of the mantissa: equal distances have the same number or two consecutive ones.
    distances.for_each(|distance| counts[(distance.to_bits() >> 40) as usize % COUNTERS] += 1);
    (0..COUNTERS).any(|at| (counts[at] + counts[(at + 1) % COUNTERS]) as usize >= min_count)
}

/// The values that at least `min_count` values equal within the tolerance.
fn frequent(mut sorted: Vec<f64>, min_count: usize) -> Vec<f64> {
    sorted.sort_unstable_by(f64::total_cmp);
    let mut groups = Vec::new();
    let (mut first, mut end) = (0, 0);
    while first < sorted.len() {
        end = end.max(first + 1);
        while end < sorted.len() && sorted[end] - sorted[first] <= TOLERANCE * sorted[first].abs() {
            end += 1;
        }
        if end - first >= min_count {
            groups.push(sorted[(first + end) / 2]);
            first = end;
        } else {
            first += 1;
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FinitePoints;

    /// Points on two walls as a sensor at the origin sees them. `missing` replaces some of them.
    fn scan(missing: impl Fn(Vector) -> Vector) -> (Vec<Point>, usize) {
        let mut count = 0;
        let points = (0..4000).map(|i| {
            let (azimuth, elevation) = (f64::from(i % 80) / 50.0 - 0.8, f64::from(i / 80) / 50.0 - 0.5);
            let ray = Vector::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
            let is_missing = (0.2..0.6).contains(&azimuth) && elevation > 0.0;
            count += usize::from(is_missing);
            let surface = ray * (3.0 / ray.x).min(2.0 / ray.y.abs());
            (if is_missing { missing(ray) } else { surface }).map(|v| v as f32).into()
        });
        let points: Vec<Point> = points.collect();
        (points, count)
    }

    /// The number of points that are kept, and the findings about the others.
    fn cleaned(points: &[Point], sensor: Option<[f64; 3]>) -> (usize, Vec<String>) {
        let used = FinitePoints::clean("points", points, sensor).unwrap();
        (used.points.len(), used.findings())
    }

    #[test]
    fn missing_returns_are_left_out_and_named() {
        for sensor in [Some([0.0; 3]), None] {
            for distance in [0.0, 20.0, 30.0, 65.535, 1e4] {
                let at_one_range = scan(|ray| distance * ray);
                let at_one_depth = scan(|ray| distance * ray / ray.x);
                for (points, count) in [at_one_range, at_one_depth] {
                    let (kept, words) = cleaned(&points, sensor);
                    assert_eq!((kept, words.len()), (4000 - count, 1), "{distance}: {words:?}");
                    assert!(words[0].contains(&format!("{count} of 4000 points")), "{words:?}");
                }
            }
            let (points, _) = scan(|ray| ray * (3.0 / ray.x).min(2.0 / ray.y.abs()));
            assert_eq!(cleaned(&points, sensor).0, 4000);
        }
    }

    #[test]
    fn the_sensor_of_a_scan_is_found_where_its_missing_returns_tell_nothing_else() {
        // A room around the sensor; the returns from a window are at one distance, within the room.
        let is_missing = |i: u32| (60..120).contains(&(i % 300)) && (40..90).contains(&(i / 300));
        let point = |i: u32| -> Point {
            let (azimuth, elevation) = (f64::from(i % 300) * 0.020_944, f64::from(i / 300) * 0.02 - 1.0);
            let ray = Vector::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
            let walls = ray.zip_map(&Vector::new(0.6, 0.4, 0.2), |along, off| (3.0 * along.signum() + off) / along);
            let noise = 1.0 + f64::from(i * 7919 % 1000) * 1e-5;
            (if is_missing(i) { 1.2 } else { walls.min() * noise } * ray).map(|v| v as f32).into()
        };
        let room: Vec<Point> = (0..30_000).map(point).collect();
        assert_eq!(cleaned(&room, None), cleaned(&room, Some([0.0; 3])));
        assert_eq!(cleaned(&room, None).0, 27_000);
        // The same room in site coordinates, where no sensor is at the origin.
        let moved: Vec<Point> = room.iter().map(|[x, y, z]| [x + 4.0, y + 3.0, z + 2.0]).collect();
        assert_eq!(cleaned(&moved, None).0, 30_000);
    }

    #[test]
    fn only_a_known_sensor_has_a_ball_or_repeated_vertices_for_missing_returns() {
        let ball: Vec<Point> =
            ball(400).into_iter().chain((0..600).map(|i| [0.0, 0.0, -1.1 - i as f32 * 1e-3])).collect();
        assert_eq!([None, Some([0.0; 3])].map(|sensor| cleaned(&ball, sensor).0), [1000, 600]);
        // A cone of triangles, each with its own copies of the corners.
        let rim = |i: usize| [(i as f32 * 0.05).cos(), (i as f32 * 0.05).sin(), 0.0];
        let cone: Vec<Point> = (0..120).flat_map(|i| [[0.0, 0.0, 2.0], rim(i), rim(i + 1)]).collect();
        assert_eq!(cleaned(&cone, None).0, 360);
    }

    fn ball(count: usize) -> Vec<Point> {
        let point = |i: usize| {
            let (z, angle) = (1.0 - (2 * i + 1) as f32 / count as f32, i as f32 * 2.399_963);
            let ring = (1.0 - z * z).sqrt();
            [ring * angle.cos(), ring * angle.sin(), z]
        };
        (0..count).map(point).collect()
    }

    #[test]
    fn distances_that_overflow_are_no_frequent_ones_and_end() {
        assert_eq!(frequent(vec![1.0, f64::INFINITY, f64::INFINITY, f64::NAN], 2), Vec::<f64>::new());
        assert_eq!(frequent(vec![2.0, 1.0, 2.0, 3.0], 2), [2.0]);
        assert_eq!(frequent(Vec::new(), 1), Vec::<f64>::new());
    }

    #[test]
    fn balls_floors_and_repeated_clouds_keep_their_points() {
        let rings: Vec<Point> = (0..3000)
            .map(|i| {
                let (radius, angle) = ((2 + i / 300) as f32, (i % 300) as f32 / 47.0);
                [radius * angle.cos(), radius * angle.sin(), -1.5]
            })
            .collect();
        let repeated: Vec<Point> = (0..5000).map(|i| [(i % 50) as f32, (i % 7) as f32, (i % 3) as f32]).collect();
        let away = |shift: f32| ball(2000).into_iter().map(move |[x, y, z]| [x + shift, y, z]);
        let two = away(3.0).chain(away(1e5)).collect();
        // A ring that some points of walls lengthen, and the outer rim of a torus.
        let on_walls = (0..8)
            .map(|i| [11.0, 0.0, i as f32 / 4.0].map(|v| v * 11.101_8 / (121.0 + 0.0625 * (i * i) as f32).sqrt()));
        let walled = rings.iter().copied().chain(on_walls).collect();
        let torus = |i: usize| {
            let (about, along) = (i as f32 * 2.399_963, i as f32 * 0.01);
            let radius = 1.0 + 0.12 * about.cos();
            [radius * along.cos(), radius * along.sin(), 0.12 * about.sin()]
        };
        for points in [ball(2000), two, walled, rings, (0..20_000).map(torus).collect(), repeated, vec![[1.0; 3]; 99]] {
            assert_eq!([None, Some([0.0; 3])].map(|sensor| cleaned(&points, sensor).0), [points.len(); 2]);
        }
    }
}
