//! The motions of the source that the overlap leaves open.

use nalgebra::{Matrix6xX, Vector6};

use crate::pair::fine::Overlap;
use crate::pair::icp::{Normal, PlanePair};
use snake_geometry::Vector;

/// A patch constrains a motion that moves it at less than about 75 degrees to its normal. The normals of planar patches are
/// better than that, and those of slopes that a voxel does not show are not.
const LEAST_COSINE: f64 = 0.25;
/// The share of the squared motion against planar patches up to which a direction is open.
const OPEN_DIRECTION: f64 = 5e-5;
/// Where few points lie on patches, the overlap fixes all motions if slides fit worse by this. They do by up to 0.04 in corridors
/// and tunnels that noise hides the patches of.
const FIXED_MARGIN: f64 = 0.07;

/// What planar patches of the overlap say about the motions of the source.
pub(crate) struct Constraint {
    /// The directions that the patches leave open, as orthonormal columns; see [`names`](crate::verdict::open_motions::names).
    pub(crate) open: Matrix6xX<f64>,
    /// Of the patches' squared motion in the direction that they constrain least, the share against patches that constrain
    /// it.
    pub(crate) weakest: f64,
}

impl Constraint {
    /// The constraint of an overlap. Where less than half of it lies on planar patches, as on thin, rough or thinly sampled
    /// surfaces, slides that fit worse show that the rest fixes what the patches leave open.
    pub(crate) fn of(overlap: &Overlap, slide_margin: f64) -> Self {
        match overlap.is_planar() || slide_margin < FIXED_MARGIN {
            true => Self::new(&overlap.patches),
            false => Self { open: Matrix6xX::zeros(0), weakest: slide_margin },
        }
    }

    /// `patches` are planar: normals of other points, such as of three neighbours, are against motions that the surface
    /// leaves open.
    pub(crate) fn new(patches: &[PlanePair]) -> Self {
        let Some(normal) = Normal::new(patches) else {
            return Self { open: Matrix6xX::identity(6), weakest: 0.0 };
        };
        let eigen = normal.information.symmetric_eigen();
        let shares: Vec<f64> = eigen.eigenvectors.column_iter().map(|d| normal.share(patches, &d.into())).collect();
        let open: Vec<_> =
            (0..6).filter(|&i| shares[i] <= OPEN_DIRECTION).map(|i| eigen.eigenvectors.column(i)).collect();
        Self {
            open: Matrix6xX::from_fn(open.len(), |row, column| open[column][row]),
            weakest: shares.into_iter().fold(f64::INFINITY, f64::min),
        }
    }
}

impl Normal {
    /// The share of the patches' squared motion in a direction that is against patches that constrain it.
    fn share(&self, patches: &[PlanePair], direction: &Vector6<f64>) -> f64 {
        let (turn, slide) = (direction.fixed_rows::<3>(0).into_owned(), direction.fixed_rows::<3>(3).into_owned());
        let (mut against, mut all) = (0.0, 0.0);
        for PlanePair { point, normal, .. } in patches {
            let motion: Vector = turn.cross(&((point - self.center) / self.extent)) + slide;
            let (along, squared) = (motion.dot(normal).powi(2), motion.norm_squared());
            all += squared;
            if along > LEAST_COSINE.powi(2) * squared {
                against += along;
            }
        }
        if all > 0.0 { against / all } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::pair::icp::information;
    use crate::parts::rigid::tests::random_points;
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
            let of = |sides| Constraint::new(&faces(sides, noise));
            assert!(of(3).open.ncols() == 0 && of(3).weakest > 0.03, "{}", of(3).weakest);
            // Two faces leave a slide open, one leaves two slides and a turn.
            assert_eq!((of(2).open.ncols(), of(1).open.ncols()), (1, 3), "{noise}");
        }
        assert_eq!(Constraint::new(&[]).open.ncols(), 6);
    }

    #[test]
    fn information_is_the_sum_over_the_pairs() {
        let found = information(faces(3, 0.0).iter());
        assert!((3..6).all(|i| (found[(i, i)] - 1000.0).abs() < 1.0), "{found}");
        // A rotation about x moves a point of face y = 1 by its z, and one of face z = 1 by its y.
        let squared = |pair: &PlanePair| pair.point.cross(&pair.normal).x.powi(2);
        let expected: f64 = faces(3, 0.0).iter().map(squared).sum();
        assert!((found[(0, 0)] / expected - 1.0).abs() < 1e-9);
    }
}
