//! Step 3: matches of descriptors.

mod nearest;

use crate::steps::describe::Rows;
use nearest::{NearestRow, nearest_both};
use snake_core::{Control, Error, Result};

/// At most `max_matches` matches `[source row, target row]`: rows and their nearest rows in the
/// other cloud, the most distinctive first.
///
/// Mutual nearest rows come first, then the others, each by rising ratio of the distances to the nearest and the
/// second nearest row: a match is distinctive if the second nearest row is much farther.
///
/// # Errors
/// [`Error::Input`] when the rows of source and target differ in length; [`Error::Cancelled`] and
/// [`Error::DeadlineExceeded`].
pub fn match_rows(source: &Rows, target: &Rows, max_matches: usize, control: &Control) -> Result<Vec<[usize; 2]>> {
    let [forth, back] = nearest(source, target, control)?;
    let source_matches = forth.iter().enumerate().map(|(row, nearest)| {
        let other = &back[nearest.row];
        let is_mutual = other.row == row;
        let ratio = if is_mutual { nearest.ratio().max(other.ratio()) } else { nearest.ratio() };
        (!is_mutual, ratio, [row, nearest.row])
    });
    let one_way = back.iter().enumerate().filter(|(row, nearest)| forth[nearest.row].row != *row);
    let target_matches = one_way.map(|(row, nearest)| (true, nearest.ratio(), [nearest.row, row]));
    let mut ranked: Vec<(bool, f32, [usize; 2])> = source_matches.chain(target_matches).collect();
    ranked.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    ranked.truncate(max_matches);
    Ok(ranked.into_iter().map(|(.., pair)| pair).collect())
}

/// Mutual nearest neighbours in descriptor space, by Euclidean distance: pairs
/// `[source row, target row]`, by rising source row.
///
/// Both arrays are `(N, dimension)`, flat. Among equally near rows the lowest is the nearest.
///
/// # Errors
/// [`Error::Input`] when an array's length is not a multiple of `dimension` or it has a number that is not finite.
pub fn mutual_nearest(source: &[f32], target: &[f32], dimension: usize) -> Result<Vec<[usize; 2]>> {
    let rows = |what, values| {
        Rows::new(values, dimension).map_err(|error| match error {
            Error::Input { reason, .. } => Error::Input { what, reason },
            other => other,
        })
    };
    let [forth, back] = nearest(&rows("source", source)?, &rows("target", target)?, &Control::default())?;
    let pairs = forth.iter().enumerate().map(|(row, nearest)| [row, nearest.row]);
    Ok(pairs.filter(|&[row, nearest]| back[nearest].row == row).collect())
}

/// The nearest row of the other cloud for each row of source and target.
fn nearest(source: &Rows, target: &Rows, control: &Control) -> Result<[Vec<NearestRow>; 2]> {
    let dimension = source.dimension();
    if dimension != target.dimension() {
        let reason = format!("rows of {} numbers, those of the source have {dimension}", target.dimension());
        return Err(Error::Input { what: "target", reason });
    }
    let counter = control.begin("matching", source.len());
    nearest_both(source.values(), target.values(), dimension, &counter)
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
        let same = [1.0; 12];
        assert_eq!(mutual_nearest(&same, &same, 2).unwrap(), [[0, 0]]);
    }

    #[test]
    fn mutual_pairs_come_first_each_by_ratio() {
        let (source, target) = ([0.0, 10.0, 4.0, 5.5], [9.0, 1.0, 5.0, 30.0]);
        let rows = |values: &'static [f32]| Rows::new(values, 1).unwrap();
        let progress = Progress::default();
        let control = Control::new().progress(&progress);
        let ranked = |count| {
            let rows = [&source, &target].map(|values| Rows::new(&values[..], 1).unwrap());
            match_rows(&rows[0], &rows[1], count, &control).unwrap()
        };
        // Ratios: 0→1 1/5; 5.5→5 0.5/3.5; 10→9 1/5. Then 4→5 1/3 and 30→10 20/24.5.
        let all = ranked(9);
        let stage = progress.stage().unwrap();
        assert_eq!((stage.done, stage.total), (4, 4));
        let mut mutual = all[..3].to_vec();
        mutual.sort_unstable();
        assert_eq!(mutual, mutual_nearest(&source, &target, 1).unwrap());
        assert_eq!(all[3..], [[2, 2], [1, 3]]);
        assert_eq!(ranked(2), all[..2]);
        assert!(match_rows(&rows(&[]), &rows(&[1.0]), 9, &control).unwrap().is_empty());
    }

    #[test]
    fn no_rows_have_no_pairs_and_bad_rows_are_refused() {
        assert!(mutual_nearest(&[], &[1.0, 2.0], 2).unwrap().is_empty());
        assert!(mutual_nearest(&[1.0, 2.0], &[], 2).unwrap().is_empty());
        assert!(mutual_nearest(&[1.0], &[1.0, 2.0], 2).unwrap_err().to_string().contains("rows of 2"));
        assert!(mutual_nearest(&[1.0], &[1.0], 0).is_err());
        let error = mutual_nearest(&[1.0, 2.0], &[0.0, 0.0, 0.0, f32::NAN], 2).unwrap_err().to_string();
        assert!(error.contains("target: descriptor 1"), "{error}");
        let [two, three] = [2, 3].map(|dimension| Rows::new(vec![0.0; 6], dimension).unwrap());
        let error = match_rows(&two, &three, 9, &Control::default()).unwrap_err().to_string();
        assert!(error.contains("target: rows of 3 numbers"), "{error}");
    }
}
