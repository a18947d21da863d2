//! Relative repeatability, and the coverage of a surface by keypoints.

use super::{Coordinate, check_thresholds, moved};
use snake_core::Result;
use snake_geometry::{Neighbors, RigidTransform, Vector, check_points, eigen, vector};

/// Relative repeatability (SNAKE section 4.2, USIP): for each `epsilon`, the share of view 1's keypoints `(K, 3)` that
/// are closer than `epsilon` to a keypoint of view 2. `t_1_2` maps view 2 to the frame of view 1.
///
/// The measure is one-directional, it is not one-to-one, and it does not test for overlap. A distance equal to
/// `epsilon` does not count. A view without keypoints gives 0. The figure of a data set is the mean over its pairs.
///
/// ```
/// use snake_geometry::RigidTransform;
/// use snake_eval::relative_repeatability;
/// let rows = [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_1_2 = RigidTransform::from_matrix(rows)?;
/// let (view_1, view_2) = ([[5.0, 0.0, 0.0], [9.0, 0.0, 0.0]], [[0.0, 0.25, 0.0]]);
/// assert_eq!(relative_repeatability(&view_1, &view_2, &t_1_2, &[0.25, 0.5])?, [0.0, 0.5]);
/// # Ok::<(), snake_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) for coordinates that are not finite,
/// [`Error::Option`](snake_core::Error::Option) for a negative epsilon.
pub fn relative_repeatability<T: Coordinate>(
    keypoints_1: &[[T; 3]],
    keypoints_2: &[[T; 3]],
    t_1_2: &RigidTransform,
    epsilon: &[f64],
) -> Result<Vec<f64>> {
    let [first, second] = in_view_1(keypoints_1, keypoints_2, t_1_2, epsilon)?;
    shares_within(&first, second, epsilon)
}

/// For each keypoint of view 1 the nearest keypoint of view 2, as its index and distance, if it is closer than
/// `epsilon`. `t_1_2` maps view 2 to the frame of view 1. The share of `Some` is [`relative_repeatability`].
///
/// ```
/// use snake_geometry::RigidTransform;
/// use snake_eval::repeated_keypoints;
/// let rows = [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// let t_1_2 = RigidTransform::from_matrix(rows)?;
/// let (view_1, view_2) = ([[5.0, 0.0, 0.0], [9.0, 0.0, 0.0]], [[7.0, 0.0, 0.0], [0.0, 0.25, 0.0]]);
/// assert_eq!(repeated_keypoints(&view_1, &view_2, &t_1_2, 0.5)?, [Some((1, 0.25)), None]);
/// # Ok::<(), snake_core::Error>(())
/// ```
///
/// # Errors
/// The errors of [`relative_repeatability`].
pub fn repeated_keypoints<T: Coordinate>(
    keypoints_1: &[[T; 3]],
    keypoints_2: &[[T; 3]],
    t_1_2: &RigidTransform,
    epsilon: f64,
) -> Result<Vec<Option<(usize, f64)>>> {
    let [first, second] = in_view_1(keypoints_1, keypoints_2, t_1_2, &[epsilon])?;
    if second.is_empty() {
        return Ok(vec![None; first.len()]);
    }
    let neighbors = Neighbors::new(second)?;
    // The lower index wins among equal distances, because the tree returns them in no fixed order.
    let nearest = |keypoint: &Vector| {
        let within = neighbors.within(keypoint, epsilon).into_iter();
        let distances = within.map(|index| (index, (neighbors.points[index] - keypoint).norm()));
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    };
    Ok(first.iter().map(nearest).collect())
}

/// The mean of [`relative_repeatability`] from view 1 to view 2 and from view 2 to view 1.
///
/// # Errors
/// The errors of [`relative_repeatability`].
pub fn symmetric_repeatability<T: Coordinate>(
    keypoints_1: &[[T; 3]],
    keypoints_2: &[[T; 3]],
    t_1_2: &RigidTransform,
    epsilon: &[f64],
) -> Result<Vec<f64>> {
    let [first, second] = in_view_1(keypoints_1, keypoints_2, t_1_2, epsilon)?;
    let forward = shares_within(&first, second.clone(), epsilon)?;
    let backward = shares_within(&second, first, epsilon)?;
    Ok(forward.iter().zip(backward).map(|(a, b)| (a + b) / 2.0).collect())
}

/// Coverage: the mean distance from each point of a cloud to its nearest keypoint. Clustered keypoints can have a high
/// repeatability; this measure tells them from evenly distributed keypoints.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when there are no points or no keypoints, or a coordinate is not finite.
pub fn mean_distance_to_keypoints<T: Coordinate>(points: &[[T; 3]], keypoints: &[[T; 3]]) -> Result<f64> {
    check_points("points", points)?;
    check_points("keypoints", keypoints)?;
    let neighbors = Neighbors::new(keypoints.iter().map(|&p| vector(p)).collect())?;
    Ok(points.iter().map(|&p| neighbors.distance(&vector(p))).sum::<f64>() / points.len() as f64)
}

/// Relative repeatability beyond chance, for each `epsilon`: of the keypoints of view 1 with a point of view 2 closer than
/// `epsilon`, the share that is closer than `epsilon` to a keypoint of view 2, as `(share - chance) / (1 - chance)`. Chance is
/// the expected share if view 2 had as many random points of its own, `points_2` `(N, 3)`, as keypoints. 1 is perfect, 0 is
/// chance. `None` when view 2 sees no keypoint of view 1, or chance finds every one.
///
/// # Errors
/// The errors of [`relative_repeatability`].
pub fn repeatability_beyond_chance<T: Coordinate>(
    keypoints_1: &[[T; 3]],
    keypoints_2: &[[T; 3]],
    points_2: &[[T; 3]],
    t_1_2: &RigidTransform,
    epsilon: &[f64],
) -> Result<Vec<Option<f64>>> {
    let [first, second] = in_view_1(keypoints_1, keypoints_2, t_1_2, epsilon)?;
    let points = moved("points_2", points_2, t_1_2)?;
    if points.is_empty() {
        return Ok(vec![None; epsilon.len()]);
    }
    let (num_points, num_drawn) = (points.len(), second.len().min(points.len()));
    let points = Neighbors::new(points)?;
    let partners = if second.is_empty() { None } else { Some(Neighbors::new(second)?) };
    // No random point is near if all are drawn from the points that are farther away.
    let chance = |near: usize| {
        let far = num_points - near;
        1.0 - (0..num_drawn).map(|i| far.saturating_sub(i) as f64 / (num_points - i) as f64).product::<f64>()
    };
    let beyond_chance = |limit: &f64| {
        let is_found =
            |keypoint: &Vector| partners.as_ref().is_some_and(|partners| partners.distance(keypoint) < *limit);
        let seen: Vec<(bool, f64)> = first
            .iter()
            .map(|keypoint| (keypoint, points.within(keypoint, *limit).len()))
            .filter(|(_, near)| *near > 0)
            .map(|(keypoint, near)| (is_found(keypoint), chance(near)))
            .collect();
        let share = seen.iter().filter(|(found, _)| *found).count() as f64 / seen.len() as f64;
        let chance = seen.iter().map(|(_, chance)| chance).sum::<f64>() / seen.len() as f64;
        (chance < 1.0).then(|| (share - chance) / (1.0 - chance))
    };
    Ok(epsilon.iter().map(beyond_chance).collect())
}

/// The least eigenvalue of a flat neighbourhood's covariance is at most this share of their sum.
const MAX_FLAT_VARIATION: f64 = 0.01;

/// The share of `keypoints` `(K, 3)` whose neighbours among `points` `(N, 3)`, within `radius`, are flat: the least eigenvalue
/// of their covariance is at most 1 % of the sum. `None` without keypoints.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when there are no points or a coordinate is not finite,
/// [`Error::Option`](snake_core::Error::Option) for a negative radius.
pub fn share_on_flat_places<T: Coordinate>(
    points: &[[T; 3]],
    keypoints: &[[T; 3]],
    radius: f64,
) -> Result<Option<f64>> {
    check_points("points", points)?;
    check_thresholds("radius", &[radius])?;
    let neighbors = Neighbors::new(points.iter().map(|&p| vector(p)).collect())?;
    let is_flat = |keypoint: &&Vector| {
        let indices = neighbors.within(keypoint, radius);
        // A plane passes through any three points.
        if indices.len() <= 3 {
            return true;
        }
        let ([least, middle, most], _) = eigen(neighbors.covariance(&indices));
        least <= MAX_FLAT_VARIATION * (least + middle + most)
    };
    let keypoints = moved("keypoints", keypoints, &RigidTransform::identity())?;
    let num_flat = keypoints.iter().filter(is_flat).count();
    Ok((!keypoints.is_empty()).then(|| num_flat as f64 / keypoints.len() as f64))
}

/// The keypoints of both views in the frame of view 1.
fn in_view_1<T: Coordinate>(
    keypoints_1: &[[T; 3]],
    keypoints_2: &[[T; 3]],
    t_1_2: &RigidTransform,
    epsilon: &[f64],
) -> Result<[Vec<Vector>; 2]> {
    check_thresholds("epsilon", epsilon)?;
    let first = moved("keypoints_1", keypoints_1, &RigidTransform::identity())?;
    Ok([first, moved("keypoints_2", keypoints_2, t_1_2)?])
}

/// For each epsilon, the share of `of` that is closer than epsilon to a point of `to`.
fn shares_within(of: &[Vector], to: Vec<Vector>, epsilon: &[f64]) -> Result<Vec<f64>> {
    if of.is_empty() || to.is_empty() {
        return Ok(vec![0.0; epsilon.len()]);
    }
    let neighbors = Neighbors::new(to)?;
    let distances: Vec<f64> = of.iter().map(|p| neighbors.distance(p)).collect();
    let share = |limit: &f64| distances.iter().filter(|d| *d < limit).count() as f64 / of.len() as f64;
    Ok(epsilon.iter().map(share).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use snake_geometry::Point;

    const VIEW_1: [Point; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0], [9.0, 9.0, 9.0]];
    const VIEW_2: [Point; 2] = [[0.25, 0.0, 0.0], [1.0, 0.5, 0.0]];

    #[test]
    fn the_share_strictly_within_epsilon_by_hand() {
        let shares =
            relative_repeatability(&VIEW_1, &VIEW_2, &RigidTransform::identity(), &[0.25, 0.26, 0.5, 0.51, 100.0])
                .unwrap();
        assert_eq!(shares, [0.0, 0.25, 0.25, 0.5, 1.0]);
    }

    #[test]
    fn directions_differ_and_the_symmetric_variant_is_their_mean() {
        // Two keypoints of one view match the same keypoint of the other.
        let (one, other) = ([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], [[0.05, 0.0, 0.0], [3.0, 0.0, 0.0], [4.0, 0.0, 0.0]]);
        assert_eq!(relative_repeatability(&one, &other, &RigidTransform::identity(), &[0.06]).unwrap(), [1.0]);
        assert_eq!(relative_repeatability(&other, &one, &RigidTransform::identity(), &[0.06]).unwrap(), [1.0 / 3.0]);
        assert_eq!(symmetric_repeatability(&one, &other, &RigidTransform::identity(), &[0.06]).unwrap(), [2.0 / 3.0]);
        assert_eq!(symmetric_repeatability(&other, &one, &RigidTransform::identity(), &[0.06]).unwrap(), [2.0 / 3.0]);
    }

    #[test]
    fn the_transform_takes_view_2_to_view_1() {
        // A rotation of 90° about z, then a translation: (x, y) in view 2 is (2 - y, x) in view 1.
        let rows = [[0.0, -1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let t_1_2 = RigidTransform::from_matrix(rows).unwrap();
        let (view_1, view_2) = ([[-1.0, 7.0, 4.0]], [[7.0, 3.0, 4.0]]);
        assert_eq!(relative_repeatability(&view_1, &view_2, &t_1_2, &[1e-6]).unwrap(), [1.0]);
        assert_eq!(relative_repeatability(&view_2, &view_1, &t_1_2, &[1e-6]).unwrap(), [0.0]);
        assert_eq!(symmetric_repeatability(&view_1, &view_2, &t_1_2, &[1e-6]).unwrap(), [1.0]);
    }

    #[test]
    fn a_view_without_keypoints_repeats_nothing() {
        for (one, other) in [(&VIEW_1[..0], &VIEW_2[..]), (&VIEW_1[..], &[]), (&[], &[])] {
            assert_eq!(
                relative_repeatability(one, other, &RigidTransform::identity(), &[1.0, 2.0]).unwrap(),
                [0.0, 0.0]
            );
            assert_eq!(
                symmetric_repeatability(one, other, &RigidTransform::identity(), &[1.0, 2.0]).unwrap(),
                [0.0, 0.0]
            );
        }
    }

    #[test]
    fn partners_are_the_nearest_and_as_many_as_the_share_says() {
        let repeated = repeated_keypoints(&VIEW_1, &VIEW_2, &RigidTransform::identity(), 0.51).unwrap();
        assert_eq!(repeated, [Some((0, 0.25)), Some((1, 0.5)), None, None]);
        assert_eq!(
            repeated_keypoints(&VIEW_1, &VIEW_2, &RigidTransform::identity(), 0.25).unwrap(),
            [None; 4],
            "the boundary is outside"
        );
        let twice = [VIEW_2[1], VIEW_2[0], VIEW_2[0]];
        assert_eq!(
            repeated_keypoints(&VIEW_1[..1], &twice, &RigidTransform::identity(), 9.0).unwrap(),
            [Some((1, 0.25))]
        );
        assert_eq!(repeated_keypoints(&VIEW_1, &[], &RigidTransform::identity(), 9.0).unwrap(), [None; 4]);
        assert!(repeated_keypoints(&VIEW_1, &VIEW_2, &RigidTransform::identity(), -1.0).is_err());
    }

    #[test]
    fn chance_is_what_random_points_of_the_other_view_would_find() {
        // Ten points on a line; view 1's keypoints are at 0 and 4 and, unseen, at 90.
        let points: Vec<Point> = (0..10u8).map(|i| [f32::from(i), 0.0, 0.0]).collect();
        let beyond = |keypoints_1: &[Point], keypoints_2: &[Point], epsilon: &[f64]| {
            let same = RigidTransform::identity();
            repeatability_beyond_chance(keypoints_1, keypoints_2, &points, &same, epsilon).unwrap()
        };
        let first = [points[0], points[4], [90.0, 0.0, 0.0]];
        // Two of ten points: each is drawn with probability 1/5, and one of two neighbours, or of three, with 17/45 and 24/45.
        let chances = [0.2, (17.0 / 45.0 + 24.0 / 45.0) / 2.0];
        let expected = chances.map(|chance| (0.5 - chance) / (1.0 - chance));
        let shares = beyond(&first, &[points[0], points[8]], &[0.5, 1.5]);
        for (share, expected) in shares.iter().zip(expected) {
            assert!((share.unwrap() - expected).abs() < 1e-12, "{share:?} is not {expected}");
        }
        let none = beyond(&first, &[points[7], points[8]], &[0.5])[0].unwrap();
        assert!((none - (-0.25)).abs() < 1e-12, "worse than chance is below 0: {none}");
        assert_eq!(beyond(&first, &first[..2], &[0.5]), [Some(1.0)]);
        assert_eq!(beyond(&first, &[], &[0.5]), [Some(0.0)]);
        assert_eq!(beyond(&first[2..], &first, &[0.5, 1.5]), [None, None], "no keypoint is seen");
        assert_eq!(beyond(&first, &points, &[0.5]), [None], "chance finds all");
    }

    #[test]
    fn flat_places_have_no_thickness() {
        let grid = |i: u16| [f32::from(i % 30) / 10.0, f32::from(i / 30) / 10.0, 0.0];
        let mut points: Vec<Point> = (0..900).map(grid).collect();
        points.extend((0..900).map(|i| [0.0, grid(i)[0], grid(i)[1]]));
        let corner = [0.0, 1.5, 0.0];
        let (floor, away) = ([2.0, 1.5, 0.0], [9.0, 9.0, 9.0]);
        let flat = |keypoints: &[Point]| share_on_flat_places(&points, keypoints, 0.25).unwrap();
        assert_eq!(flat(&[floor, corner, away, corner]), Some(0.5));
        assert_eq!(flat(&[]), None);
    }

    #[test]
    fn coverage_is_the_mean_distance_to_the_nearest() {
        let keypoints = [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]];
        assert_eq!(mean_distance_to_keypoints(&VIEW_1[..3], &keypoints).unwrap(), 1.0 / 3.0);
        assert!(mean_distance_to_keypoints(&VIEW_1, &[]).is_err());
        assert!(mean_distance_to_keypoints(&[], &keypoints).is_err());
    }

    #[test]
    fn bad_numbers_are_refused() {
        let call = |bad: Point, epsilon: f64| {
            relative_repeatability(&[bad], &VIEW_2, &RigidTransform::identity(), &[epsilon]).map_err(|e| e.to_string())
        };
        assert!(call([f32::NAN, 0.0, 0.0], 1.0).unwrap_err().starts_with("keypoints_1: 1 of 1"));
        for epsilon in [-0.1, f64::NAN] {
            assert!(call([0.0; 3], epsilon).unwrap_err().starts_with("option `epsilon`"));
        }
    }
}
