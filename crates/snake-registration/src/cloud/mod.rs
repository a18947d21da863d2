//! What a prepared cloud provides for the steps: voxels with normals, surfaces as a sensor saw
//! them, planar patches, and pairs of points and planes.

pub(crate) mod depth_image;
pub(crate) mod near_grid;
pub(crate) mod normals;
pub(crate) mod patches;
pub(crate) mod planes;
pub(crate) mod surface;
pub(crate) mod voxels;

/// The lower median of at least one number: for an even count, the lower of the middle two. For two
/// clouds, it is the value of the smaller one.
pub(crate) fn lower_median(values: &[f64]) -> f64 {
    sorted(values)[(values.len() - 1) / 2]
}

/// The upper median: for an even count, the upper of the middle two; 0 without numbers. For two clouds, it is the value of
/// the coarser one.
pub(crate) fn upper_median(values: &[f64]) -> f64 {
    sorted(values).get(values.len() / 2).copied().unwrap_or(0.0)
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}
