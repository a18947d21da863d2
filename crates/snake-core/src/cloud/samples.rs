//! A sample of a cloud's points and quantiles, for the rules that measure whole clouds.

use snake_geometry::Point;

/// At most `most` points, one from each of as many equal parts of the cloud's order. A fixed step could equal the width of an
/// image and take a single column of it.
pub(crate) fn drawn(points: &[Point], most: usize) -> impl Iterator<Item = Point> {
    let step = points.len().div_ceil(most).max(1);
    let draw = move |i: usize| i * step + (i as f64 * 0.618_033_988_75 % 1.0 * step as f64) as usize;
    (0..points.len().div_ceil(step)).filter_map(move |i| points.get(draw(i)).copied())
}

/// The quantile of the values at a share in [0, 1]. There must be values.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    let rank = (share * (values.len() - 1) as f64) as usize;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}
