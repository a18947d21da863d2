//! Point clouds: the point type, input checks and normalisation.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::missing::{MAX_KINDS, missing_returns};
use crate::{Error, Outliers, Reach, Result};

/// One point, `[x, y, z]`.
pub type Point = [f32; 3];

/// The method that maps a cloud into the network's frame, the cube ±0.5.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NormalizationMethod {
    /// Subtract the mean, divide by twice the largest distance from it: the cloud touches the sphere of radius 0.5.
    #[default]
    UnitSphere,
    /// As [`NormalizationMethod::UnitSphere`], and encoded in the cloud's principal axes, so that the field and its
    /// keypoints hardly depend on the orientation of the cloud. Each axis points to the side of positive skewness.
    PrincipalAxes,
    /// Subtract the mean, divide by twice the largest absolute coordinate: the cloud touches the cube ±0.5.
    UnitCube,
    /// Divide by 2, for a cloud around the origin with radius 1, up to noise; the released code does so for ModelNet40.
    Half,
    /// The cloud is already in the network's frame.
    None,
}

impl NormalizationMethod {
    /// Whether the cloud stays within the volume in any orientation.
    pub fn allows_rotations(self) -> bool {
        matches!(self, Self::UnitSphere | Self::PrincipalAxes)
    }

    /// Whether the centre is the origin and the scale does not depend on the cloud.
    pub fn is_fixed(self) -> bool {
        matches!(self, Self::Half | Self::None)
    }
}

/// The map between cloud units and the network's frame: `network = (cloud - center) / scale`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Normalization {
    /// Subtracted from each point, in cloud units.
    pub center: Point,
    /// Cloud units per network unit; positive.
    pub scale: f32,
}

impl Normalization {
    /// The normalisation of a cloud `(N, 3)`, from its finite points without [`Outliers`].
    ///
    /// # Errors
    /// [`Error::Input`] when the cloud has no finite points, is one point repeated, or has an extent outside 1e-15 to
    /// 1e15: squared distances must neither vanish nor overflow in `f32`.
    pub fn of(points: &[Point], method: NormalizationMethod) -> Result<Self> {
        Self::from_finite(&FinitePoints::of("points", points)?.points, method)
    }

    /// [`Normalization::of`] for points that are all used, at least one.
    pub fn from_finite(points: &[Point], method: NormalizationMethod) -> Result<Self> {
        if method.is_fixed() {
            let largest = points.as_flattened().iter().fold(1.0, |m: f32, v| m.max(v.abs()));
            check_extent(f64::from(largest))?;
            let scale = if method == NormalizationMethod::Half { 2.0 } else { 1.0 };
            return Ok(Self { center: [0.0; 3], scale });
        }
        // The sums are in f64, so that a mean over millions of points far from the origin keeps its precision.
        let mean: [f64; 3] =
            std::array::from_fn(|axis| points.iter().map(|p| f64::from(p[axis])).sum::<f64>() / points.len() as f64);
        let extent = points
            .iter()
            .map(|p| {
                let offset: [f64; 3] = std::array::from_fn(|axis| f64::from(p[axis]) - mean[axis]);
                match method {
                    NormalizationMethod::UnitCube => offset.iter().fold(0.0, |m: f64, v| m.max(v.abs())),
                    _ => offset.iter().map(|v| v * v).sum::<f64>().sqrt(),
                }
            })
            .fold(0.0, f64::max);
        let (center, scale) = (mean.map(|v| v as f32), (2.0 * extent) as f32);
        check_extent(extent)?;
        Ok(Self { center, scale })
    }

    /// Maps a point from the cloud's frame to the network's frame.
    pub fn to_network(&self, point: Point) -> Point {
        std::array::from_fn(|axis| (point[axis] - self.center[axis]) / self.scale)
    }

    /// Maps a point from the network's frame to the cloud's frame.
    pub fn to_cloud(&self, point: Point) -> Point {
        std::array::from_fn(|axis| point[axis] * self.scale + self.center[axis])
    }
}

/// Checks that a cloud of this extent can be computed with.
///
/// # Errors
/// [`Error::Input`] outside 1e-15 to 1e15.
pub fn check_extent(extent: f64) -> Result<()> {
    let reason = match extent {
        1e-15..=1e15 => return Ok(()),
        0.0 => "all points are equal; a cloud needs at least two different points".into(),
        _ => format!("extent {extent:.1e}, allowed is 1e-15 to 1e15; use another unit or remove outliers"),
    };
    Err(Error::Input { what: "points", reason })
}

/// The points of a cloud that are used: finite points that are not [`Outliers`]. Depth cameras mark missing points by NaN.
#[derive(Debug, Clone)]
pub struct FinitePoints<'a> {
    /// The points that are used, in the given order.
    pub points: Cow<'a, [Point]>,
    /// The indices of these points in the whole cloud. Empty if no point was skipped.
    indices: Vec<usize>,
    /// The finite points that were left out.
    outliers: Option<Outliers>,
    /// Descriptions of the missing returns that were left out.
    missing: Vec<String>,
}

impl<'a> FinitePoints<'a> {
    /// Selects the points that are used. The cloud is not copied if all of its points are used.
    ///
    /// # Errors
    /// [`Error::Input`] when there are no finite points.
    pub fn of(what: &'static str, points: &'a [Point]) -> Result<Self> {
        if points.is_empty() {
            return Err(none_finite(what, 0));
        }
        if points.iter().all(is_finite) {
            return Ok(Self::all(points.into()).without_outliers());
        }
        let indices: Vec<usize> = (0..points.len()).filter(|&index| is_finite(&points[index])).collect();
        if indices.is_empty() {
            return Err(none_finite(what, points.len()));
        }
        let kept: Vec<Point> = indices.iter().map(|&index| points[index]).collect();
        Ok(Self { indices, ..Self::all(kept.into()) }.without_outliers())
    }

    /// All points of a part of a cloud, which must be finite. A part has no outliers, because it need not be a whole cloud.
    pub fn all(points: Cow<'a, [Point]>) -> Self {
        Self { points, indices: Vec::new(), outliers: None, missing: Vec::new() }
    }

    /// [`FinitePoints::of`] for a cloud from a sensor or a file, also without missing returns: points at one place, at one
    /// distance from the sensor, or at one depth behind all others. A sensor that is not given is searched for in the points;
    /// without one, fewer points count as missing. [`FinitePoints::findings`] names what was left out.
    ///
    /// # Errors
    /// [`Error::Input`] when there are no finite points.
    pub fn clean(what: &'static str, points: &'a [Point], sensor: Option<[f64; 3]>) -> Result<Self> {
        Ok(Self::of(what, points)?.without_missing(sensor))
    }

    /// [`FinitePoints::clean`] for a source of points, which are copied into the memory of two vectors.
    pub fn copied(
        what: &'static str,
        cloud: impl ExactSizeIterator<Item = Point> + Clone,
        (mut points, mut indices): (Vec<Point>, Vec<usize>),
    ) -> Result<FinitePoints<'static>> {
        points.clear();
        indices.clear();
        let num_points = cloud.len();
        points.reserve(num_points);
        points.extend(cloud.clone().filter(is_finite));
        if points.is_empty() {
            return Err(none_finite(what, num_points));
        }
        if points.len() < num_points {
            indices.reserve(points.len());
            indices.extend(cloud.enumerate().filter(|(_, point)| is_finite(point)).map(|(index, _)| index));
        }
        Ok(FinitePoints { indices, ..FinitePoints::all(points.into()) }.without_outliers().without_missing(None))
    }

    fn without_outliers(mut self) -> Self {
        let Some(reach) = Reach::of(self.points.iter().map(|point| point.map(f64::from))) else { return self };
        self.outliers = reach.outliers(&self.points);
        if self.outliers.is_some() {
            self.retain(|_, point| reach.holds(point.map(f64::from)));
        }
        self
    }

    fn without_missing(mut self, sensor: Option<[f64; 3]>) -> Self {
        for _ in 0..MAX_KINDS {
            let Some((is_missing, words)) = missing_returns(&self.points, sensor) else { break };
            self.retain(|index, _| !is_missing[index]);
            self.missing.push(words);
        }
        self
    }

    /// Keeps some of the points.
    fn retain(&mut self, is_kept: impl Fn(usize, &Point) -> bool) {
        let kept: Vec<usize> = (0..self.points.len()).filter(|&index| is_kept(index, &self.points[index])).collect();
        let points: Vec<Point> = kept.iter().map(|&index| self.points[index]).collect();
        self.indices = kept.into_iter().map(|index| self.original_index(index)).collect();
        self.points = points.into();
    }

    /// The index of a used point in the whole cloud.
    pub fn original_index(&self, index: usize) -> usize {
        if self.indices.is_empty() { index } else { self.indices[index] }
    }

    /// The outliers that were left out, if there are any.
    pub fn outliers(&self) -> Option<Outliers> {
        self.outliers
    }

    /// The missing returns that were left out: a description of each kind.
    pub fn missing(&self) -> &[String] {
        &self.missing
    }

    /// One sentence for each kind of points that were left out: missing returns, then outliers.
    pub fn findings(&self) -> Vec<String> {
        let missing = self.missing.iter().map(|words| format!("{words}; they are left out"));
        missing.chain(self.outliers.map(|outliers| outliers.to_string())).collect()
    }

    /// The same points, copied if they are borrowed.
    pub fn into_owned(self) -> FinitePoints<'static> {
        FinitePoints { points: self.points.into_owned().into(), ..self }
    }

    /// The memory of the points and of their indices.
    pub fn into_buffers(self) -> (Vec<Point>, Vec<usize>) {
        (self.points.into_owned(), self.indices)
    }
}

/// The error for a cloud without finite points.
fn none_finite(what: &'static str, number: usize) -> Error {
    let reason = match number {
        0 => "no points".into(),
        _ => format!("none of the {number} points is finite"),
    };
    Error::Input { what, reason }
}

fn is_finite(point: &Point) -> bool {
    point.iter().all(|v| v.is_finite())
}

/// Refuses an empty array of `f32` or `f64`, and coordinates that are not finite.
pub fn check_points<T: Copy + Into<f64>>(what: &'static str, points: &[[T; 3]]) -> Result<()> {
    let is_finite = |point: &[T; 3]| point.iter().all(|&v| v.into().is_finite());
    if points.is_empty() {
        return Err(Error::Input { what, reason: "no points".into() });
    }
    if let Some(first) = points.iter().position(|point| !is_finite(point)) {
        let count = points.iter().filter(|point| !is_finite(point)).count();
        let reason =
            format!("{count} of {} points are not finite, the first at index {first}; remove them", points.len());
        return Err(Error::Input { what, reason });
    }
    Ok(())
}

/// Refuses matched points that differ in number or have a coordinate that is not finite; empty arrays are accepted.
///
/// # Errors
/// [`Error::Input`] for the array at fault, `source` or `target`.
pub fn check_pairs<T: Copy + Into<f64>>(source: &[[T; 3]], target: &[[T; 3]]) -> Result<()> {
    if source.len() != target.len() {
        let reason = format!("{} points, but the source has {}; row i matches row i", target.len(), source.len());
        return Err(Error::Input { what: "target", reason });
    }
    if source.is_empty() {
        return Ok(());
    }
    check_points("source", source)?;
    check_points("target", target)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOUD: [Point; 4] = [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, -1.0, 4.0]];

    #[test]
    fn half_has_the_scale_of_the_clean_cloud_under_any_noise() {
        let noisy = [[1.4, 0.0, 0.0], [-1.2, 0.3, 0.0], [0.0, 1.0, -1.3]];
        let normalization = Normalization::of(&noisy, NormalizationMethod::Half).unwrap();
        assert_eq!(noisy.map(|point| normalization.to_network(point)), noisy.map(|point| point.map(|v| v / 2.0)));
    }

    #[test]
    fn clouds_without_extent_or_with_bad_numbers_are_refused() {
        for cloud in [
            vec![],
            vec![[1.0; 3]; 5],
            vec![[0.0; 3], [f32::NAN; 3]],
            vec![[-3e38; 3], [3e38; 3]],
            vec![[0.0; 3], [1e20; 3]],
            vec![[0.0; 3], [1e-20; 3]],
        ] {
            assert!(Normalization::of(&cloud, NormalizationMethod::UnitSphere).is_err(), "{cloud:?}");
        }
    }

    #[test]
    fn outliers_are_left_out_of_the_frame_and_of_the_indices() {
        let ring = |i: usize| [(i as f32 * 0.1).cos(), (i as f32 * 0.1).sin(), 0.0];
        let clean: Vec<Point> = (0..100).map(ring).collect();
        let mut whole = clean.clone();
        whole.insert(40, [1e4, 0.0, 0.0]);
        whole.insert(0, [f32::NAN; 3]);
        let used = FinitePoints::of("points", &whole).unwrap();
        assert_eq!((&used.points[..], [0, 39, 40, 99].map(|i| used.original_index(i))), (&clean[..], [1, 40, 42, 101]));
        assert_eq!(used.outliers().map(|found| (found.number, found.num_points)), Some((1, 101)));
        let copied = FinitePoints::copied("points", whole.iter().copied(), Default::default()).unwrap();
        assert_eq!((copied.points, copied.indices), (used.points, used.indices));
        for method in [NormalizationMethod::UnitSphere, NormalizationMethod::UnitCube] {
            assert_eq!(Normalization::of(&whole, method).unwrap(), Normalization::of(&clean, method).unwrap());
        }
    }

    #[test]
    fn finite_points_know_where_they_were() {
        let nan = [0.0, f32::NAN, 0.0];
        let clean = FinitePoints::of("points", &CLOUD).unwrap();
        assert!(matches!(clean.points, Cow::Borrowed(_)) && clean.original_index(3) == 3);
        let mixed = [nan, CLOUD[0], [f32::INFINITY; 3], CLOUD[1]];
        let finite = FinitePoints::of("points", &mixed).unwrap();
        assert_eq!((&finite.points[..], [0, 1].map(|i| finite.original_index(i))), (&CLOUD[..2], [1, 3]));
        assert_eq!(
            Normalization::of(&mixed, NormalizationMethod::UnitCube).unwrap(),
            Normalization::of(&CLOUD[..2], NormalizationMethod::UnitCube).unwrap()
        );
        let reason = FinitePoints::of("points", &[nan; 2]).err().unwrap().to_string();
        assert_eq!(reason, "points: none of the 2 points is finite");
    }
}
