//! Farthest-point sampling.

use super::{Response, among_finite, index_cloud};
use snake_core::Point;
use snake_core::Result;
use snake_core::space::Vector;

/// At most `count` points; each is the farthest from all points before it.
///
/// The first is the farthest from the mean, so the selection rotates with the cloud. Among equally far points the
/// lowest index is taken. Fewer points are returned when the rest are duplicates.
///
/// The score is the distance to the nearest earlier point; the first point has the score of the second.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when the cloud has no finite points or is one point repeated.
pub fn farthest_points(points: &[Point], count: usize) -> Result<Vec<Response>> {
    among_finite(points, |points| find(points, count))
}

/// [`farthest_points`] of finite points.
fn find(points: &[Point], count: usize) -> Result<Vec<Response>> {
    let points = index_cloud(points)?.points;
    let mean = points.iter().sum::<Vector>() / points.len() as f64;
    let mut next = farthest(&points.iter().map(|p| (p - mean).norm()).collect::<Vec<_>>());
    let mut distances = vec![f64::INFINITY; points.len()];
    let mut chosen: Vec<Response> = Vec::new();
    while chosen.len() < count && next.score > 0.0 {
        chosen.push(Response { index: next.index, score: distances[next.index] });
        let last = points[next.index];
        distances.iter_mut().zip(&points).for_each(|(d, p)| *d = d.min((p - last).norm()));
        next = farthest(&distances);
        if let [first] = &mut chosen[..] {
            first.score = next.score;
        }
    }
    Ok(chosen)
}

/// The index of the first largest value.
fn farthest(distances: &[f64]) -> Response {
    let start = Response { index: 0, score: f64::NEG_INFINITY };
    let larger = |best: Response, (index, &score)| if score > best.score { Response { index, score } } else { best };
    distances.iter().enumerate().fold(start, larger)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_by_hand() {
        // The mean is 4.2; 10 is the farthest from it, then 0, then 4 (4 from 0, 6 from 10), then 6 (2 from 4), 1.
        let points = [0.0, 1.0, 4.0, 6.0, 10.0].map(|x| [x, 0.0, 0.0]);
        let found = farthest_points(&points, 99).unwrap();
        let expected = [(4, 10.0), (0, 10.0), (2, 4.0), (3, 2.0), (1, 1.0)];
        assert_eq!(found.iter().map(|r| (r.index, r.score)).collect::<Vec<_>>(), expected);
        assert_eq!(farthest_points(&points, 3).unwrap(), found[..3]);
    }

    #[test]
    fn duplicates_are_not_chosen_and_ties_go_to_the_first() {
        let points = [[1.0, 0.0, 0.0], [0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]];
        let found = farthest_points(&points, 9).unwrap();
        assert_eq!(found.iter().map(|r| (r.index, r.score)).collect::<Vec<_>>(), [(0, 1.0), (1, 1.0)]);
    }
}
