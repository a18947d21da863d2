//! The motions of the source that the overlap leaves open.

use nalgebra::{Matrix6, Matrix6xX, Vector6};

use super::icp::{Normal, PlanePair, twist};
use snake_core::space::Vector;

/// A patch constrains a motion that moves it at less than about 75 degrees to its normal. The normals of planar patches are
/// better than that, and those of slopes that a voxel does not show are not.
const LEAST_COSINE: f64 = 0.25;
/// The share of the squared motion against planar patches up to which a direction is open.
const OPEN_DIRECTION: f64 = 5e-4;

/// What planar patches of the overlap say about the motions of the source.
pub(super) struct Constraint {
    /// The directions that the patches leave open, as orthonormal columns; see [`names`](super::open_motions::names).
    pub(super) open: Matrix6xX<f64>,
    /// Of the patches' squared motion in the direction that they constrain least, the share against patches that constrain
    /// it.
    pub(super) weakest: f64,
}

impl Constraint {
    /// `patches` are planar: normals of other points, such as of three neighbours, are against motions that the surface
    /// leaves open.
    pub(super) fn new(patches: &[PlanePair]) -> Self {
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

/// The sum of the pairs' information.
pub(super) fn information<'a>(pairs: impl Iterator<Item = &'a PlanePair>) -> Matrix6<f64> {
    let rows = pairs.map(|pair| twist(&pair.point, &pair.normal));
    rows.fold(Matrix6::zeros(), |sum, row| sum + row * row.transpose())
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
