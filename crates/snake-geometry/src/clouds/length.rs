//! Lengths in cloud units, in multiples of a cloud's resolution, in per cent of its radius, or in voxels.

use std::cmp::Ordering;
use std::fmt;
use std::str::FromStr;

use rayon::prelude::*;
use serde::de::{self, Deserialize, Deserializer, Visitor};
use serde::{Serialize, Serializer};

use crate::{CellGroups, Error, FinitePoints, Normalization, NormalizationMethod, Point, PointTree, Result, floor};

/// A length in cloud units, in multiples of the cloud's resolution, in per cent of its radius, or in voxels. The resolution
/// is the mean distance of the distinct points to their nearest other point. The radius is the largest distance of a point
/// from their mean. Outliers do not count. The voxels are those of a field's volume (`Field::voxel_size` of snake-core). The text forms are
/// `0.05`, `6r`, `10%` and `4v`; the JSON form is a number or such a text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Length {
    /// In cloud units.
    Units(f64),
    /// In multiples of the cloud's resolution.
    Resolutions(f64),
    /// In per cent of the cloud's radius.
    Percent(f64),
    /// In voxels of the field's volume.
    Voxels(f64),
}

const FORMS: &str = "a number of cloud units such as `0.05`, a multiple of the cloud's resolution such as `6r`, per cent of its radius such as `10%`, or a number of voxels such as `4v`";

impl Length {
    /// The length in the units of a cloud `(N, 3)`. `name` is the option's name in error messages.
    ///
    /// ```
    /// use snake_geometry::Length;
    /// let cloud = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]];
    /// assert_eq!("3r".parse::<Length>()?.in_units("radius", &cloud)?, 1.5);
    /// # Ok::<(), snake_geometry::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Option`] when the length is not positive, or a multiple of a resolution of 0; [`Error::Input`] when a
    /// resolution or a radius is needed and the cloud is empty, or all points are equal.
    pub fn in_units(self, name: &'static str, points: &[Point]) -> Result<f64> {
        match self {
            Self::Units(_) => self.resolve(name, || 0.0),
            Self::Percent(share) => {
                let radius = f64::from(Normalization::of(points, NormalizationMethod::UnitSphere)?.scale) / 2.0;
                check(name, self, share / 100.0 * radius)
            }
            Self::Resolutions(_) => {
                let resolution = resolution("points", points)?;
                self.resolve(name, || resolution)
            }
            Self::Voxels(_) => {
                let allowed = "here a length that needs no volume: cloud units, as in `3r` resolutions or as in `10%`";
                Err(Error::Option { name, value: self.to_string(), allowed })
            }
        }
    }

    /// [`Length::in_units`] with a known resolution, which is computed only if needed. A percentage of the radius and a number of
    /// voxels are errors here.
    pub fn resolve(self, name: &'static str, resolution: impl FnOnce() -> f64) -> Result<f64> {
        match self {
            Self::Units(length) => check(name, self, length),
            Self::Resolutions(factor) => check(name, self, factor * resolution()),
            Self::Percent(_) | Self::Voxels(_) => check(name, self, f64::NAN),
        }
    }

    /// The number without its unit.
    pub fn number(self) -> f64 {
        let (Self::Units(number) | Self::Resolutions(number) | Self::Percent(number) | Self::Voxels(number)) = self;
        number
    }
}

/// A length in cloud units, if its square neither vanishes nor overflows.
fn check(name: &'static str, given: Length, length: f64) -> Result<f64> {
    if (1e-150..1e150).contains(&length) {
        return Ok(length);
    }
    let allowed = "a positive length in cloud units, or a positive multiple of the cloud's resolution such as `6r`; that resolution must not be 0";
    Err(Error::Option { name, value: given.to_string(), allowed })
}

/// Points within this many mean gaps are merged, to find out whether each was stored several times.
const MERGED: f64 = 16.0;

/// Points were stored several times if the merged points are more than this many cells apart. An even surface has 1 to 2.
const APART: f64 = 4.0;

/// The resolution of a cloud `(N, 3)`: the mean distance of its finite distinct points to their nearest other point, without
/// outliers. It is 0 for a single point. Points that were stored several times with hardly any noise count once.
pub fn resolution(what: &'static str, points: &[Point]) -> Result<f64> {
    let FinitePoints { points, .. } = FinitePoints::of(what, points)?;
    let gap = match mean_gap(&points)? {
        Some(gap) => gap,
        None => mean_gap(&distinct(&points))?.unwrap_or_default(),
    };
    if gap == 0.0 {
        return Ok(0.0);
    }
    // The second time, cells are shifted by half: few pairs lie on both sides of borders in both grids.
    let side = MERGED * gap;
    let merged = one_a_cell(&one_a_cell(&points, side, 0.0)?, side, 0.5)?;
    let apart: Vec<f64> = match merged.len() {
        0 | 1 => Vec::new(),
        _ => distances(&merged)?.into_iter().filter(|gap| *gap > side).collect(),
    };
    let mean = apart.iter().sum::<f64>() / apart.len() as f64;
    Ok(if mean > APART * side { mean } else { gap })
}

/// The first point in each cubic cell. The grid of cells is shifted by a share of their side.
///
/// # Errors
/// [`Error::Input`] for more points than [`u32::MAX`].
pub fn one_a_cell(points: &[Point], side: f64, shift: f64) -> Result<Vec<Point>> {
    let cell = |point: &Point| point.map(|v| floor(f64::from(v) / side + shift));
    Ok(CellGroups::new(points.iter().map(cell))?.firsts().map(|first| points[first]).collect())
}

/// The distinct points, each with its distance to the nearest other point, which is infinite if there is none.
///
/// # Errors
/// [`Error::Input`] for more points than [`u32::MAX`].
pub fn gaps(points: &[Point]) -> Result<Vec<(Point, f64)>> {
    let points = distinct(points);
    if points.len() < 2 {
        return Ok(points.into_iter().map(|point| (point, f64::INFINITY)).collect());
    }
    let distances = distances(&points)?;
    Ok(points.iter().copied().zip(distances.iter().copied()).collect())
}

/// The distinct points among finite ones, sorted.
fn distinct(points: &[Point]) -> Vec<Point> {
    let mut points = points.to_vec();
    points.par_sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
    points.dedup();
    points
}

/// The mean distance of points to their nearest other point; `None` if points are equal or if there is only one.
fn mean_gap(points: &[Point]) -> Result<Option<f64>> {
    if points.len() < 2 {
        return Ok(None);
    }
    let distances = distances(points)?;
    let are_distinct = distances.iter().all(|distance| *distance > 0.0);
    Ok(are_distinct.then(|| distances.iter().sum::<f64>() / points.len() as f64))
}

/// The distance of each point to the nearest other one. There must be at least two points.
fn distances(points: &[Point]) -> Result<Vec<f64>> {
    let mut distances = PointTree::new(points)?.nearest_others();
    distances.iter_mut().for_each(|distance| *distance = distance.sqrt());
    Ok(distances)
}

impl From<f64> for Length {
    fn from(length: f64) -> Self {
        Self::Units(length)
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Units(length) => write!(f, "{length}"),
            Self::Resolutions(factor) => write!(f, "{factor}r"),
            Self::Percent(share) => write!(f, "{share}%"),
            Self::Voxels(number) => write!(f, "{number}v"),
        }
    }
}

impl FromStr for Length {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let unit = |suffix, length: fn(f64) -> Self| text.strip_suffix(suffix).map(|number| number.parse().map(length));
        let with_unit =
            unit('r', Self::Resolutions).or_else(|| unit('%', Self::Percent)).or_else(|| unit('v', Self::Voxels));
        with_unit.unwrap_or_else(|| text.parse().map(Self::Units)).map_err(|_| Error::Option {
            name: "length",
            value: text.into(),
            allowed: FORMS,
        })
    }
}

impl Serialize for Length {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Self::Units(length) => serializer.serialize_f64(*length),
            Self::Resolutions(_) | Self::Percent(_) | Self::Voxels(_) => serializer.collect_str(self),
        }
    }
}

impl<'de> Deserialize<'de> for Length {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_any(LengthVisitor)
    }
}

struct LengthVisitor;

impl Visitor<'_> for LengthVisitor {
    type Value = Length;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(FORMS)
    }

    fn visit_f64<E>(self, length: f64) -> std::result::Result<Length, E> {
        Ok(Length::Units(length))
    }

    fn visit_i64<E>(self, length: i64) -> std::result::Result<Length, E> {
        Ok(Length::Units(length as f64))
    }

    fn visit_u64<E>(self, length: u64) -> std::result::Result<Length, E> {
        Ok(Length::Units(length as f64))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> std::result::Result<Length, E> {
        text.parse().map_err(|_| E::invalid_value(de::Unexpected::Str(text), &self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Neighbors, vector};

    #[test]
    fn lengths_are_read_as_they_are_written() {
        for (text, json, length) in [
            ("0.05", "0.05", Length::Units(0.05)),
            ("6r", "\"6r\"", Length::Resolutions(6.0)),
            ("2.5r", "\"2.5r\"", Length::Resolutions(2.5)),
            ("10%", "\"10%\"", Length::Percent(10.0)),
            ("4v", "\"4v\"", Length::Voxels(4.0)),
        ] {
            assert_eq!(text.parse::<Length>().unwrap(), length);
            assert_eq!(length.to_string(), text);
            assert_eq!(serde_json::to_string(&length).unwrap(), json);
            assert_eq!(serde_json::from_str::<Length>(json).unwrap(), length);
        }
        assert_eq!(serde_json::from_str::<Length>("2").unwrap(), Length::Units(2.0));
        for text in ["", "r", "6R", "6x", "6 r", "wide"] {
            let error = text.parse::<Length>().unwrap_err().to_string();
            assert!(error.contains("such as `6r`"), "{error}");
            let error = serde_json::from_str::<Length>(&format!("\"{text}\"")).unwrap_err().to_string();
            assert!(error.contains("such as `6r`"), "{error}");
        }
        assert!(serde_json::from_str::<Length>("true").is_err());
    }

    #[test]
    fn the_resolution_has_the_bits_of_the_neighbours_of_all_points() {
        let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
        let cloud =
            |number: u32| -> Vec<Point> { (0..number).map(|i| [at(i, 2_654_435_761), at(i, 40_503), 0.1]).collect() };
        for points in [cloud(1), cloud(2), cloud(9000), cloud(50).repeat(3)] {
            let neighbors = Neighbors::new(points.iter().copied().map(vector).collect()).unwrap();
            assert_eq!(resolution("points", &points).unwrap(), neighbors.resolution());
        }
    }

    #[test]
    fn repeated_points_and_outliers_leave_the_resolution_as_it_is() {
        let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
        let clean: Vec<Point> = (0..500).map(|i| [at(i, 2_654_435_761), at(i, 40_503), 0.1]).collect();
        let of = |points: &[Point]| resolution("points", points).unwrap();
        let expected = of(&clean);
        let moved = |by: f32| clean.iter().enumerate().map(move |(i, p)| [p[0] + by * (i % 7) as f32, p[1] - by, p[2]]);
        let with_noise: Vec<Point> = clean.iter().copied().chain(moved(1e-6)).chain(moved(-1e-6)).collect();
        assert!((of(&with_noise) / expected - 1.0).abs() < 0.05, "{} {expected}", of(&with_noise));
        for repeated in [clean.repeat(2), [&clean[..], &clean[..300]].concat(), [&clean[..], &[clean[7]; 900]].concat()]
        {
            assert!((of(&repeated) / expected - 1.0).abs() < 1e-12);
        }
        assert_eq!(of(&[&clean[..], &[[1e4, 0.0, 0.0]]].concat()), expected);
        assert_eq!(of(&[clean[0]; 40]), 0.0);
    }

    #[test]
    fn multiples_are_of_the_mean_distance_to_the_nearest_other_point() {
        let cloud = [[0.0; 3], [1.0, 0.0, 0.0], [4.0, 0.0, 0.0]];
        let length = |length: Length| length.in_units("radius", &cloud).unwrap();
        assert_eq!(length(Length::Resolutions(3.0)), 5.0);
        assert_eq!(length(Length::Units(3.0)), 3.0);
        assert!((length(Length::Percent(30.0)) - 0.7).abs() < 1e-6); // 30 % of 4 - 5/3
        let refused = |length: Length, cloud: &[Point]| length.in_units("radius", cloud).unwrap_err().to_string();
        for length in [Length::Units(0.0), Length::Units(f64::NAN), Length::Resolutions(-1.0), Length::Percent(0.0)] {
            assert!(refused(length, &cloud).starts_with(&format!("option `radius` is {length}: ")));
        }
        assert!(refused(Length::Resolutions(3.0), &[[1.0; 3]; 2]).contains("must not be 0"));
        assert!(Length::Percent(3.0).resolve("radius", || 1.0).is_err());
        assert!(refused(Length::Percent(3.0), &[]).contains("no points"));
        assert!(refused(Length::Resolutions(3.0), &[]).contains("no points"));
        assert!(refused(Length::Resolutions(3.0), &[[f32::NAN; 3]]).contains("finite"));
    }
}
