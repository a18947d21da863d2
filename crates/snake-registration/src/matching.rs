//! Correspondences: mutual nearest neighbours in descriptor space.

use rayon::prelude::*;

use snake_core::{Control, Counter};
use snake_core::{Error, Result};

/// Mutual nearest neighbours in descriptor space, by Euclidean distance: pairs `[source row, target row]`, by rising
/// source row.
///
/// Both arrays are `(N, dimension)`, flat. Among equally near rows the lowest is the nearest.
///
/// # Errors
/// [`Error::Input`] when an array's length is not a multiple of `dimension` or it has a number that is not finite.
pub fn mutual_nearest(source: &[f32], target: &[f32], dimension: usize) -> Result<Vec<[usize; 2]>> {
    matches(source, target, dimension, &Control::default())
}

/// [`mutual_nearest`] with progress and cancellation.
pub(super) fn matches(source: &[f32], target: &[f32], dimension: usize, control: &Control) -> Result<Vec<[usize; 2]>> {
    for (what, descriptors) in [("source", source), ("target", target)] {
        if dimension == 0 || descriptors.len() % dimension != 0 {
            let reason = format!("{} numbers are not rows of {dimension}", descriptors.len());
            return Err(Error::Input { what, reason });
        }
        if let Some(bad) = descriptors.iter().position(|v| !v.is_finite()) {
            return Err(Error::Input { what, reason: format!("descriptor {} is not finite", bad / dimension) });
        }
    }
    let counter = control.begin("matching", (source.len() + target.len()) / dimension);
    let nearest = |queries, rows| nearest_rows(queries, rows, dimension, &counter);
    let (to_target, to_source) = (nearest(source, target)?, nearest(target, source)?);
    let pairs = to_target.into_iter().enumerate().map(|(row, nearest)| [row, nearest]);
    Ok(pairs.filter(|&[row, nearest]| to_source[nearest] == row).collect())
}

/// For each row of `queries` the nearest row of `rows`; empty if `rows` is empty.
fn nearest_rows(queries: &[f32], rows: &[f32], dimension: usize, counter: &Counter) -> Result<Vec<usize>> {
    let squared_distance = |a: &[f32], b: &[f32]| -> f32 { a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum() };
    let nearest = |query: &[f32]| {
        counter.add(1);
        let distances = rows.chunks_exact(dimension).map(|row| squared_distance(query, row));
        let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        counter.check().map(|()| nearest.map(|(row, _)| row))
    };
    let nearest: Vec<Option<usize>> = queries.par_chunks_exact(dimension).map(nearest).collect::<Result<_>>()?;
    Ok(nearest.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use snake_core::Progress;

    #[test]
    fn only_mutual_pairs_are_kept_and_ties_go_to_the_lowest() {
        // On a line: 0 and 10 find each other's partners, 4 is nearest to 5 but 5 prefers 5.5.
        let (source, target) = ([0.0, 10.0, 4.0, 5.5], [9.0, 1.0, 5.0]);
        assert_eq!(mutual_nearest(&source, &target, 1).unwrap(), [[0, 1], [1, 0], [3, 2]]);
        let progress = Progress::default();
        let control = Control::new().progress(&progress);
        assert_eq!(matches(&source, &target, 1, &control).unwrap(), [[0, 1], [1, 0], [3, 2]]);
        let stage = progress.stage().unwrap();
        assert_eq!((stage.done, stage.total), (7, 7));
        let same = [1.0; 12];
        assert_eq!(mutual_nearest(&same, &same, 2).unwrap(), [[0, 0]]);
    }

    #[test]
    fn no_rows_have_no_pairs_and_bad_rows_are_refused() {
        assert!(mutual_nearest(&[], &[1.0, 2.0], 2).unwrap().is_empty());
        assert!(mutual_nearest(&[1.0, 2.0], &[], 2).unwrap().is_empty());
        assert!(mutual_nearest(&[1.0], &[1.0, 2.0], 2).unwrap_err().to_string().contains("rows of 2"));
        assert!(mutual_nearest(&[1.0], &[1.0], 0).is_err());
        let error = mutual_nearest(&[1.0, 2.0], &[0.0, 0.0, 0.0, f32::NAN], 2).unwrap_err().to_string();
        assert!(error.contains("target: descriptor 1"), "{error}");
    }
}
