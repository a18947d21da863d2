//! The motions of the source that the overlap leaves open.

use nalgebra::{Matrix6xX, Vector6};

use crate::cloud::patches::Overlap;
use crate::cloud::planes::{NormalEquations, PlanePair};
use snake_geometry::Vector;

/// A patch constrains a motion if the cosine between motion and normal is above this (about 75 degrees). Normals of
/// planar patches are better than that, normals of slopes below voxel size are not. Half and twice change no outcome.
const MIN_MOTION_COSINE: f64 = 0.25;
/// A direction of motion is open if patches resist at most this share of their squared motion. Unit: share of the
/// squared motion. Half and twice change no outcome; rooms and streets have 0.03 to 0.2.
const OPEN_DIRECTION: f64 = 5e-5;
/// If few points lie on patches, the overlap fixes all motions if slides fit worse by at least
/// this. Slides fit worse by up to 0.04 in corridors and tunnels whose patches are hidden by noise.
const FIXED_MARGIN: f64 = 0.07;

/// The motions of the source that planar patches of the overlap resist.
pub(super) struct Constraint {
    /// The directions that the patches leave open, as orthonormal columns; see [`names`](super::open_motions::names).
    pub(super) open: Matrix6xX<f64>,
    /// Fraction of the patches' squared motion that they resist, in the direction that they resist least.
    pub(super) weakest: f64,
}

impl Constraint {
    /// The constraint of an overlap. If less than half of it lies on planar patches, as on thin,
    /// rough or sparsely sampled surfaces, slides with a worse fit show that the rest of the
    /// surface fixes the motions that patches leave open.
    pub(super) fn from_overlap(overlap: &Overlap, slide_margin: f64) -> Self {
        if overlap.is_planar() || slide_margin < FIXED_MARGIN {
            Self::from_patches(&overlap.patches)
        } else {
            Self { open: Matrix6xX::zeros(0), weakest: slide_margin }
        }
    }

    /// `patches` must be planar: normals of other points, such as those of three neighbours, resist
    /// motions that the surface leaves open.
    pub(super) fn from_patches(patches: &[PlanePair]) -> Self {
        let Some(equations) = NormalEquations::new(patches) else {
            return Self { open: Matrix6xX::identity(6), weakest: 0.0 };
        };
        let eigen = equations.information.symmetric_eigen();
        let shares: Vec<f64> = eigen.eigenvectors.column_iter().map(|d| equations.share(patches, &d.into())).collect();
        let open: Vec<_> =
            (0..6).filter(|&i| shares[i] <= OPEN_DIRECTION).map(|i| eigen.eigenvectors.column(i)).collect();
        Self {
            open: Matrix6xX::from_fn(open.len(), |row, column| open[column][row]),
            weakest: shares.into_iter().fold(f64::INFINITY, f64::min),
        }
    }
}

impl NormalEquations {
    /// Fraction of the patches' squared motion in a direction that they resist.
    fn share(&self, patches: &[PlanePair], direction: &Vector6<f64>) -> f64 {
        let (turn, slide) = (direction.fixed_rows::<3>(0).into_owned(), direction.fixed_rows::<3>(3).into_owned());
        let (mut resisted, mut all) = (0.0, 0.0);
        for PlanePair { point, normal, .. } in patches {
            let motion: Vector = turn.cross(&((point - self.center) / self.extent)) + slide;
            let (along, squared) = (motion.dot(normal).powi(2), motion.norm_squared());
            all += squared;
            if along > MIN_MOTION_COSINE.powi(2) * squared {
                resisted += along;
            }
        }
        if all > 0.0 { resisted / all } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;

    use super::*;
    use crate::rigid::tests::random_points;
    use snake_geometry::vector;

    /// Patches on `sides` faces of the cube ±1, whose normals are off by up to `noise`.
    fn faces(sides: usize, noise: f64) -> Vec<PlanePair> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let offsets = random_points(&mut rng, 3000);
        let points = random_points(&mut rng, 3000).into_iter().zip(offsets).enumerate();
        let patch = |(i, (mut point, offset)): (usize, ([f32; 3], [f32; 3]))| {
            point[i % sides] = 1.0;
            let normal = Vector::ith(i % sides, 1.0) + noise * vector(offset);
            PlanePair { point: vector(point), normal: normal.normalize(), distance: 0.0 }
        };
        points.map(patch).collect()
    }

    #[test]
    fn noise_of_normals_constrains_nothing() {
        for noise in [0.0, 0.1] {
            let constraint = |sides| Constraint::from_patches(&faces(sides, noise));
            assert!(constraint(3).open.ncols() == 0 && constraint(3).weakest > 0.03, "{}", constraint(3).weakest);
            // Two faces leave a slide open, one leaves two slides and a turn.
            assert_eq!((constraint(2).open.ncols(), constraint(1).open.ncols()), (1, 3), "{noise}");
        }
        assert_eq!(Constraint::from_patches(&[]).open.ncols(), 6);
    }
}
