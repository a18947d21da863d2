//! Normals of points, with a sign or without.

use snake_core::{Control, Error, Result};
use snake_geometry::{Neighbors, Point, Vector, check_points, try_in_parallel, vector};

/// Unit normals `(N, 3)`: the directions of least variance among the points closer than `radius` (cloud units).
///
/// A normal points towards the side of the cloud's mean, so normals rotate and move with the cloud.
/// It is zero if fewer than three points are closer than `radius`.
///
/// # Errors
/// [`Error::Input`] when the cloud is empty or has a coordinate that is not finite;
/// [`Error::Option`] when the radius is not positive.
pub fn estimate_normals(points: &[Point], radius: f64) -> Result<Vec<Point>> {
    estimate_normals_with(points, radius, &Control::default())
}

/// [`estimate_normals`] with progress, cancellation and a deadline.
///
/// # Errors
/// The errors of [`estimate_normals`]; [`Error::Cancelled`] and [`Error::DeadlineExceeded`].
pub fn estimate_normals_with(points: &[Point], radius: f64, control: &Control) -> Result<Vec<Point>> {
    check_points("points", points)?;
    check_radius("radius", radius)?;
    let cloud = Neighbors::new(points.iter().copied().map(vector).collect())?;
    cloud.check_density("radius", radius)?;
    Ok(normals(&cloud, radius, Orientation::Mean, control)?
        .into_iter()
        .map(|normal| normal.map(|v| v as f32).into())
        .collect())
}

pub(crate) fn check_radius(name: &'static str, radius: f64) -> Result<()> {
    // The square of a radius must neither vanish nor overflow.
    if (1e-150..1e150).contains(&radius) {
        return Ok(());
    }
    Err(Error::Option { name, value: radius.to_string(), allowed: "above 0 (cloud units)" })
}

/// The signs of normals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Orientation {
    /// Normals point towards the side of the cloud's mean.
    Mean,
    /// Normals point towards the side of the sensor.
    Viewpoint(Vector),
    /// Normals have no sign.
    Unsigned,
}

/// The normals of an indexed cloud, see [`estimate_normals`].
pub(crate) fn normals(
    cloud: &Neighbors,
    radius: f64,
    orientation: Orientation,
    control: &Control,
) -> Result<Vec<Vector>> {
    let counter = control.begin("normals", cloud.points.len());
    let front = match orientation {
        Orientation::Mean => Some(cloud.points.iter().sum::<Vector>() / cloud.points.len() as f64),
        Orientation::Viewpoint(viewpoint) => Some(viewpoint),
        Orientation::Unsigned => None,
    };
    let normal = |point: &Vector| {
        counter.check()?;
        counter.add(1);
        let Some(normal) = cloud.normal(&cloud.within(point, radius)) else { return Ok(Vector::zeros()) };
        let is_behind = front.is_some_and(|front| normal.dot(&(front - point)) < 0.0);
        Ok(if is_behind { -normal } else { normal })
    };
    try_in_parallel(cloud.points.iter(), normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_input_is_refused() {
        assert!(estimate_normals(&[], 1.0).is_err());
        assert!(estimate_normals(&[[f32::NAN; 3]], 1.0).is_err());
        for radius in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(estimate_normals(&[[0.0; 3]], radius).unwrap_err().to_string().contains("radius"));
        }
        assert_eq!(estimate_normals(&[[1.0; 3]; 5], 1.0).unwrap().len(), 5);
    }
}
