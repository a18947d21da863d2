//! Medians of a few values, which are values themselves.

/// The median of numbers, at least one; of an even count the lower of the middle two. Of two clouds the smaller counts.
pub(crate) fn lower_median(values: &[f64]) -> f64 {
    sorted(values)[(values.len() - 1) / 2]
}

/// [`lower_median`], but of an even count the upper of the middle two. Of two clouds the coarser counts.
pub(crate) fn upper_median(values: &[f64]) -> f64 {
    sorted(values)[values.len() / 2]
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}
