//! Motions under which a cloud looks like itself: a step of spiral stairs, the pitch of a row, a storey,
//! a half turn of a room.

use nalgebra::{DMatrix, DMatrixView, DVectorView, IsometryMatrix3};

use super::TUNING;
use crate::steps::consensus::consensus;
use crate::steps::describe::{Rows, describe_cloud};
use crate::steps::pair::Pair;
use crate::steps::prepare::PreparedCloud;
use snake_core::{Control, Result};
use snake_geometry::{Vector, vector};

/// The motions of a cloud onto itself on which matches of its descriptors with its own places
/// elsewhere agree, the best supported first; `signed` as in [`describe_cloud`]. The cloud keeps them.
pub(super) fn self_motions(cloud: &PreparedCloud, signed: bool) -> Result<&[IsometryMatrix3<f64>]> {
    let slot = &cloud.self_motions[usize::from(signed)];
    if slot.get().is_none() {
        let (pair, control) = (Pair::new(cloud, cloud, None), Control::default());
        let pair = if signed { pair } else { pair.without_signs() };
        let indices = matches_elsewhere(cloud, &describe_cloud(cloud, signed, &control)?);
        let motions = consensus(&pair.matches(&indices)?, pair.criteria(), TUNING.self_motions, &control)?;
        slot.get_or_init(|| motions.iter().map(|motion| *motion.isometry()).collect());
    }
    Ok(slot.get().map(Vec::as_slice).unwrap_or_default())
}

/// Some of the keypoints, each with the keypoint of the nearest descriptor that is not near it.
fn matches_elsewhere(cloud: &PreparedCloud, rows: &Rows) -> Vec<[usize; 2]> {
    let points: Vec<Vector> = cloud.keypoints().into_iter().map(vector).collect();
    let squared_distance = (TUNING.elsewhere * cloud.lengths.inlier_distance).powi(2);
    let all = DMatrixView::from_slice(rows.values(), rows.dimension(), rows.len());
    // The row b nearest to a has the greatest a·b - |b|²/2.
    let half_norms: Vec<f32> = all.column_iter().map(|row| 0.5 * row.norm_squared()).collect();
    let chosen: Vec<usize> = (0..points.len()).step_by(points.len().div_ceil(TUNING.self_matches).max(1)).collect();
    let own = DMatrix::from_fn(rows.dimension(), chosen.len(), |axis, at| all[(axis, chosen[at])]);
    let products = all.tr_mul(&own);
    let nearest = |from: usize, products: DVectorView<f32>| {
        let mut best = (f32::NEG_INFINITY, None);
        for (to, (product, half_norm)) in products.iter().zip(&half_norms).enumerate() {
            let score = product - half_norm;
            if score > best.0 && (points[to] - points[from]).norm_squared() > squared_distance {
                best = (score, Some(to));
            }
        }
        best.1.map(|to| [from, to])
    };
    chosen.iter().zip(products.column_iter()).filter_map(|(&from, column)| nearest(from, column)).collect()
}
