//! Whether a transform is better than its neighbours along the direction that the overlap fixes least.

use nalgebra::{IsometryMatrix3, Matrix3, Matrix6, Translation3};
use snake_geometry::in_parallel;

use crate::cloud::surface::{Agreement, Surface, coarse_step};

/// Distances by which the source slides to either side. Unit: inlier distances. Half and twice change no outcome.
const SLIDES: [f64; 6] = [2.0, 3.0, 4.0, 6.0, 9.0, 12.0];

/// The margin of a transform: its fit (overlap less free space, see [`Agreement::fit`]) less the
/// best fit of the slides of the source along the translation that the overlap fixes least. A wrong
/// transform along a wall has slides that fit better, and a margin below 0.
pub(super) fn slide_margin(
    [source, target]: &[Surface; 2],
    transform: &IsometryMatrix3<f64>,
    agreement: &Agreement,
    information: &Matrix6<f64>,
    inlier_distance: f64,
) -> f64 {
    let translations: Matrix3<f64> = information.fixed_view::<3, 3>(3, 3).into();
    let eigen = translations.symmetric_eigen();
    let direction = eigen.eigenvectors.column(eigen.eigenvalues.imin()) * inlier_distance;
    let step = coarse_step(source.points.len());
    let fit = |slide: f64| {
        let moved = Translation3::from(direction * slide) * transform;
        Surface::agreement(source, target, &moved, step).fit()
    };
    let slides = SLIDES.map(|slide| [slide, -slide]);
    let slides = in_parallel(slides.as_flattened().iter(), |&slide| fit(slide));
    agreement.fit() - slides.into_iter().fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;
    use snake_geometry::{Vector, vector};

    use super::*;
    use crate::cloud::planes::{information, plane_pairs};
    use crate::rigid::tests::random_points;

    /// A corridor along x with a step in its floor at x = 0, as points and normals.
    fn corridor() -> (Vec<Vector>, Vec<Vector>) {
        let on_wall = |(i, p): (usize, Vector)| match i % 4 {
            0 => (Vector::new(p.x * 3.0, p.y, if p.x > 0.0 { -0.5 } else { -1.0 }), Vector::z()),
            1 => (Vector::new(0.0, p.y, -0.75 + 0.25 * p.z), Vector::x()),
            2 => (Vector::new(p.x * 3.0, 1.0, p.z), Vector::y()),
            _ => (Vector::new(p.x * 3.0, -1.0, p.z), Vector::y()),
        };
        random_points(&mut ChaCha8Rng::seed_from_u64(3), 6000).into_iter().map(vector).enumerate().map(on_wall).unzip()
    }

    #[test]
    fn slides_along_a_corridor_have_a_margin_below_zero() {
        let (points, normals) = corridor();
        let surfaces = [(); 2].map(|()| Surface::new(&points, &normals, None, 0.1));
        let margin = |offset: f64| {
            let transform = IsometryMatrix3::translation(offset, 0.0, 0.0);
            let information = information(plane_pairs(&points, &surfaces[1], &transform).iter());
            let agreement = Surface::agreement(&surfaces[0], &surfaces[1], &transform, 1);
            slide_margin(&surfaces, &transform, &agreement, &information, 0.1)
        };
        assert!(margin(0.0) > 0.1, "{}", margin(0.0));
        for wrong in [-0.4, 0.3, 0.6] {
            assert!(margin(wrong) < -0.1, "{wrong}: {}", margin(wrong));
        }
    }
}
