//! Farthest-point sampling.

use super::{Response, among_finite, check_distinct};
use snake_core::Result;
use snake_geometry::Point;

/// At most `count` points; each is the farthest from all points before it.
///
/// The first point is the farthest from the mean, so the selection rotates with the cloud. Among
/// equally far points, the lowest index is taken. If the rest are duplicates, there are fewer points.
///
/// The score is the distance to the nearest earlier point; the first point has the score of the second.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when the cloud has no finite points or is one point repeated.
pub fn farthest_points(points: &[Point], count: usize) -> Result<Vec<Response>> {
    among_finite(points, |points| find(points, count))
}

/// [`farthest_points`] for finite points.
fn find(points: &[Point], count: usize) -> Result<Vec<Response>> {
    check_distinct(points)?;
    // The first point has the score of the second.
    let keypoints = snake_geometry::farthest_points(points, count.max(2), || Result::Ok(()))?;
    let scores = keypoints.iter().map(|(_, squared)| squared.sqrt()).collect::<Vec<_>>();
    let response = |(place, &(index, _)): (usize, &(usize, f64))| Response { index, score: scores[place.max(1)] };
    Ok(keypoints.iter().enumerate().take(count).map(response).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_by_hand() {
        // The mean is 4.2; 10 is the farthest from it, then 0, then 4 (4 from 0, 6 from 10), then 6 (2 from 4), 1.
        let points = [0.0, 1.0, 4.0, 6.0, 10.0].map(|x| [x, 0.0, 0.0]);
        let keypoints = farthest_points(&points, 99).unwrap();
        let expected = [(4, 10.0), (0, 10.0), (2, 4.0), (3, 2.0), (1, 1.0)];
        assert_eq!(keypoints.iter().map(|r| (r.index, r.score)).collect::<Vec<_>>(), expected);
        assert_eq!(farthest_points(&points, 3).unwrap(), keypoints[..3]);
    }

    #[test]
    fn duplicates_are_not_chosen_and_ties_go_to_the_first() {
        let points = [[1.0, 0.0, 0.0], [0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]];
        let keypoints = farthest_points(&points, 9).unwrap();
        assert_eq!(keypoints.iter().map(|r| (r.index, r.score)).collect::<Vec<_>>(), [(0, 1.0), (1, 1.0)]);
    }
}
