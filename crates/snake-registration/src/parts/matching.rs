//! Correspondences: nearest neighbours in descriptor space.

use rayon::prelude::*;

use crate::parts::nearest::nearest_both;
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

/// The square roots of histograms `(N, dimension)` of sum 1, flat. Their Euclidean distance is the Hellinger distance of
/// the histograms, which small bins count in as well as large ones (RootSIFT, Arandjelović and Zisserman 2012).
pub(crate) fn hellinger(histograms: &mut [f32], dimension: usize) {
    for row in histograms.chunks_exact_mut(dimension) {
        let sum: f32 = row.iter().sum();
        if sum > 0.0 {
            row.iter_mut().for_each(|v| *v = (*v / sum).sqrt());
        }
    }
}

/// At most `count` pairs `[source row, target row]` of rows `(N, dimension)` and their nearest rows in the other array.
///
/// Mutual nearest rows come first, then the others, each by rising ratio of the distances to the nearest and the second
/// nearest row: a match is distinctive if the second nearest row is much farther.
pub(crate) fn ranked_matches(
    source: &[f32],
    target: &[f32],
    dimension: usize,
    count: usize,
    control: &Control,
) -> Result<Vec<[usize; 2]>> {
    let counter = control.begin("matching", source.len() / dimension);
    let [forth, back] = nearest_both(source, target, dimension, &counter)?;
    let of_source = forth.iter().enumerate().map(|(row, nearest)| {
        let other = &back[nearest.row];
        let is_mutual = other.row == row;
        let ratio = if is_mutual { nearest.ratio().max(other.ratio()) } else { nearest.ratio() };
        (!is_mutual, ratio, [row, nearest.row])
    });
    let of_target = back.iter().enumerate().filter(|(row, nearest)| forth[nearest.row].row != *row);
    let of_target = of_target.map(|(row, nearest)| (true, nearest.ratio(), [nearest.row, row]));
    let mut ranked: Vec<(bool, f32, [usize; 2])> = of_source.chain(of_target).collect();
    ranked.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    ranked.truncate(count);
    Ok(ranked.into_iter().map(|(.., pair)| pair).collect())
}

/// [`mutual_nearest`] with progress and cancellation.
pub(crate) fn matches(source: &[f32], target: &[f32], dimension: usize, control: &Control) -> Result<Vec<[usize; 2]>> {
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
    fn mutual_pairs_come_first_each_by_ratio() {
        let (source, target) = ([0.0, 10.0, 4.0, 5.5], [9.0, 1.0, 5.0, 30.0]);
        let ranked = |count| ranked_matches(&source, &target, 1, count, &Control::default()).unwrap();
        // Ratios: 0→1 1/5; 5.5→5 0.5/3.5; 10→9 1/5. Then 4→5 1/3 and 30→10 20/24.5.
        let all = ranked(9);
        let mut mutual = all[..3].to_vec();
        mutual.sort_unstable();
        assert_eq!(mutual, mutual_nearest(&source, &target, 1).unwrap());
        assert_eq!(all[3..], [[2, 2], [1, 3]]);
        assert_eq!(ranked(2), all[..2]);
        assert!(ranked_matches(&[], &target, 1, 9, &Control::default()).unwrap().is_empty());
        let mut histograms = [1.0, 3.0, 0.0, 0.0];
        hellinger(&mut histograms, 2);
        assert_eq!(histograms, [0.5, 0.75_f32.sqrt(), 0.0, 0.0]);
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
