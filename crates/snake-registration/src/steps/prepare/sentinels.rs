//! Missing returns that a sensor writes as points: all at one place, at one distance or at one
//! depth.

use std::borrow::Cow;
use std::collections::HashMap;

use snake_geometry::{Point, Vector, vector};

use super::TUNING;
use crate::cloud::spread::least_spread;

/// The points without missing returns, and a description of those that were left out.
pub(crate) fn without_sentinels<'a>(points: Cow<'a, [Point]>, sensor: [f64; 3]) -> (Cow<'a, [Point]>, Vec<String>) {
    let (mut kept, mut words) = (points, Vec::new());
    for _ in 0..TUNING.max_missing_kinds {
        let all = kept.len();
        let least = TUNING.min_missing_points.max((TUNING.min_missing_share * all as f64) as usize);
        let missing = one_place_or_distance(&kept, &sensor.into(), least).or_else(|| one_depth(&kept, least));
        let Some((is_missing, place)) = missing else { break };
        let left: Vec<Point> =
            kept.iter().zip(&is_missing).filter(|(_, missing)| !**missing).map(|(p, _)| *p).collect();
        if (left.len() as f64) < TUNING.min_left * all as f64 {
            break;
        }
        let count = all - left.len();
        let share = 100.0 * count as f64 / all as f64;
        words.push(format!("{count} of {all} points ({share:.0} %) are {place}, as missing returns are written"));
        kept = Cow::Owned(left);
    }
    (kept, words)
}

/// Which points are missing returns, and their place in words.
type Missing = (Vec<bool>, String);

/// Points at one place are at one distance, too.
fn one_place_or_distance(points: &[Point], sensor: &Vector, least: usize) -> Option<Missing> {
    let distances: Vec<f64> = points.iter().map(|point| (vector(*point) - sensor).norm()).collect();
    let frequent = frequent(&distances, least);
    if frequent.is_empty() {
        return None;
    }
    one_place(points, least).or_else(|| one_distance(points, &distances, &frequent))
}

/// Copies of one point, where points are not repeated otherwise.
fn one_place(points: &[Point], least: usize) -> Option<Missing> {
    let key = |point: &Point| point.map(|v| (v + 0.0).to_bits());
    let mut counts: HashMap<[u32; 3], usize> = HashMap::new();
    points.iter().for_each(|point| *counts.entry(key(point)).or_default() += 1);
    let (place, count) = counts.iter().max_by_key(|(place, count)| (**count, **place))?;
    let mean = points.len() as f64 / counts.len() as f64;
    if *count < least || (*count as f64) < 5.0 * mean {
        return None;
    }
    let [x, y, z] = place.map(f32::from_bits);
    Some((points.iter().map(|point| key(point) == *place).collect(), format!("at ({x}, {y}, {z})")))
}

/// Points at exactly one of the frequent distances from the sensor that face all ways.
fn one_distance(points: &[Point], distances: &[f64], frequent: &[f64]) -> Option<Missing> {
    frequent.iter().find_map(|&distance| {
        let is_missing = near(distances, distance);
        let shell: Vec<Vector> =
            points.iter().zip(&is_missing).filter(|(_, missing)| **missing).map(|(p, _)| vector(*p)).collect();
        let faces_all_ways = least_spread(&shell) > TUNING.min_missing_spread * distance;
        faces_all_ways.then(|| (is_missing, format!("exactly {distance:.6} from the sensor")))
    })
}

/// Points at exactly one depth along an axis that are farther than all others: the least or the
/// greatest.
fn one_depth(points: &[Point], least: usize) -> Option<Missing> {
    let extremes = (0..3).flat_map(|axis| [f32::min, f32::max].map(|extreme| (axis, extreme)));
    extremes.into_iter().find_map(|(axis, extreme)| {
        let depth = f64::from(points.iter().map(|point| point[axis]).reduce(extreme)?);
        let is_missing: Vec<bool> = points
            .iter()
            .map(|point| (f64::from(point[axis]) - depth).abs() <= TUNING.missing_tolerance * depth.abs())
            .collect();
        if is_missing.iter().filter(|missing| **missing).count() < least {
            return None;
        }
        let others = points.iter().zip(&is_missing).filter(|(_, missing)| !**missing);
        let farthest = others.map(|(point, _)| vector(*point).norm()).fold(0.0, f64::max);
        let place = format!("exactly at {} = {depth:.6}, far behind the others", ["x", "y", "z"][axis]);
        (depth.abs() > TUNING.min_missing_depth * farthest).then_some((is_missing, place))
    })
}

/// The values that at least so many others equal within the tolerance.
fn frequent(values: &[f64], least: usize) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let mut groups = Vec::new();
    let (mut first, mut end) = (0, 0);
    while first < sorted.len() {
        end = end.max(first + 1);
        while end < sorted.len() && sorted[end] - sorted[first] <= TUNING.missing_tolerance * sorted[first].abs() {
            end += 1;
        }
        if end - first >= least {
            groups.push(sorted[(first + end) / 2]);
            first = end;
        } else {
            first += 1;
        }
    }
    groups
}

fn near(values: &[f64], value: f64) -> Vec<bool> {
    values.iter().map(|v| (v - value).abs() <= TUNING.missing_tolerance * value.abs()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of two walls as a sensor at the origin sees them, some of which are at `distance`
    /// instead.
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

    #[test]
    fn missing_returns_are_left_out_and_named() {
        for distance in [0.0, 20.0, 30.0, 65.535, 1e4] {
            let at_one_range = scan(|ray| distance * ray);
            let at_one_depth = scan(|ray| distance * ray / ray.x);
            for (points, count) in [at_one_range, at_one_depth] {
                let (kept, words) = without_sentinels(Cow::Borrowed(&points), [0.0; 3]);
                assert_eq!((kept.len(), words.len()), (4000 - count, 1), "{distance}: {words:?}");
                assert!(words[0].contains(&format!("{count} of 4000 points")), "{words:?}");
            }
        }
        let (points, _) = scan(|ray| ray * (3.0 / ray.x).min(2.0 / ray.y.abs()));
        assert_eq!(without_sentinels(Cow::Borrowed(&points), [0.0; 3]).0.len(), 4000);
    }

    #[test]
    fn distances_that_overflow_are_no_frequent_ones_and_end() {
        assert_eq!(frequent(&[1.0, f64::INFINITY, f64::INFINITY, f64::NAN], 2), Vec::<f64>::new());
        assert_eq!(frequent(&[2.0, 1.0, 2.0, 3.0], 2), [2.0]);
        assert_eq!(frequent(&[], 1), Vec::<f64>::new());
    }

    #[test]
    fn balls_floors_and_repeated_clouds_keep_their_points() {
        let ball: Vec<Point> = (0..2000)
            .map(|i| {
                let (z, angle) = (1.0 - (2 * i + 1) as f32 / 2000.0, i as f32 * 2.399_963);
                let ring = (1.0 - z * z).sqrt();
                [ring * angle.cos(), ring * angle.sin(), z]
            })
            .collect();
        let rings: Vec<Point> = (0..3000)
            .map(|i| {
                let (radius, angle) = ((2 + i / 300) as f32, (i % 300) as f32 / 47.0);
                [radius * angle.cos(), radius * angle.sin(), -1.5]
            })
            .collect();
        let repeated: Vec<Point> = (0..5000).map(|i| [(i % 50) as f32, (i % 7) as f32, (i % 3) as f32]).collect();
        for points in [ball, rings, repeated, vec![[1.0; 3]; 99], vec![]] {
            assert_eq!(without_sentinels(Cow::Borrowed(&points), [0.0; 3]).0.len(), points.len());
        }
    }
}
