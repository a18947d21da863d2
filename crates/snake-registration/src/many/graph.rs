//! The parts of a graph of clouds, each with the poses that fit its links.

use std::collections::HashMap;

use nalgebra::{IsometryMatrix3, Matrix6};

use snake_core::{Counter, Result};

use super::pose_graph::{Link, covariances, optimize};

/// Contradicting links are dropped together if their error is above this share of the greatest
/// error. Unit: share of the greatest error. Set by hand.
const DROPPED: f64 = 0.5;

/// Clouds that links connect.
pub(super) struct Part {
    /// Indices of the clouds, in rising order.
    pub(super) clouds: Vec<usize>,
    /// Their poses in the frame of the first.
    pub(super) poses: Vec<IsometryMatrix3<f64>>,
    /// Indices of the links that the poses follow, each with its error in cloud units.
    pub(super) links: Vec<(usize, f64)>,
}

/// The parts of `count` clouds, those with the most clouds first. Links whose error exceeds the greatest of their
/// part's `thresholds` (cloud units) contradict the others and are dropped, the worst first: one outlier link can
/// pull a pose away from many inliers. Poses start from the links with the least `doubts`.
pub(super) fn split(
    count: usize,
    links: &[Link],
    doubts: &[f64],
    thresholds: &[f64],
    counter: &Counter,
) -> Result<Vec<Part>> {
    let threshold = |part: &Part| part.links.iter().map(|(link, _)| thresholds[*link]).fold(0.0, f64::max);
    let mut kept: Vec<usize> = (0..links.len()).collect();
    kept.sort_by(|&a, &b| doubts[a].total_cmp(&doubts[b]).then(a.cmp(&b)));
    loop {
        let parts = connected(count, links, &kept);
        let optimized = |part: Part| {
            let threshold = threshold(&part);
            part.optimized(links, threshold, counter)
        };
        let mut parts: Vec<Part> = parts.into_iter().map(optimized).collect::<Result<_>>()?;
        let relative = |part: &Part| {
            let threshold = threshold(part);
            part.links.iter().map(|(link, error)| (*link, error / threshold)).collect::<Vec<_>>()
        };
        let errors: HashMap<usize, f64> = parts.iter().flat_map(relative).collect();
        let worst = errors.values().copied().fold(0.0, f64::max);
        if worst <= 1.0 {
            parts.sort_by_key(|part| (usize::MAX - part.clouds.len(), part.clouds[0]));
            return Ok(parts);
        }
        let limit = f64::max(1.0, DROPPED * worst);
        kept.retain(|link| errors[link] <= limit);
    }
}

/// The connected parts, with poses from spanning trees. A tree takes the first links of `order` that connect clouds.
fn connected(count: usize, links: &[Link], order: &[usize]) -> Vec<Part> {
    let mut part_of: Vec<usize> = (0..count).collect();
    let mut poses = vec![IsometryMatrix3::identity(); count];
    for link in order.iter().map(|&index| &links[index]) {
        let (from, to) = (part_of[link.source], part_of[link.target]);
        if from == to {
            continue;
        }
        // The source's part moves into the target's frame.
        let motion = poses[link.target] * link.t_target_source * poses[link.source].inverse();
        for cloud in (0..count).filter(|&cloud| part_of[cloud] == from).collect::<Vec<_>>() {
            poses[cloud] = motion * poses[cloud];
            part_of[cloud] = to;
        }
    }
    let mut parts: Vec<Vec<usize>> = vec![Vec::new(); count];
    part_of.iter().enumerate().for_each(|(cloud, part)| parts[*part].push(cloud));
    let part = |clouds: Vec<usize>| {
        let to_first = poses[clouds[0]].inverse();
        let mut poses: Vec<_> = clouds.iter().map(|&cloud| to_first * poses[cloud]).collect();
        poses[0] = IsometryMatrix3::identity();
        let mut own: Vec<usize> =
            order.iter().copied().filter(|&l| part_of[links[l].source] == part_of[clouds[0]]).collect();
        own.sort_unstable();
        Part { clouds, poses, links: own.into_iter().map(|link| (link, 0.0)).collect() }
    };
    parts.into_iter().filter(|clouds| !clouds.is_empty()).map(part).collect()
}

impl Part {
    fn optimized(mut self, links: &[Link], threshold: f64, counter: &Counter) -> Result<Self> {
        let own = self.own_links(links);
        if !own.is_empty() {
            optimize(&mut self.poses, &own, threshold, counter)?;
        }
        self.measure_errors(links);
        Ok(self)
    }

    /// Sets the errors of the part's links by its poses.
    pub(super) fn measure_errors(&mut self, links: &[Link]) {
        for (at, link) in self.own_links(links).into_iter().enumerate() {
            self.links[at].1 = link.squared_error(&self.poses).sqrt();
        }
    }

    /// The covariance of each pose; see [`covariances`].
    pub(super) fn covariances(&self, links: &[Link], variance: f64) -> Vec<Matrix6<f64>> {
        if self.clouds.len() == 1 {
            return vec![Matrix6::zeros()];
        }
        covariances(&self.poses, &self.own_links(links), variance)
    }

    /// The links of the part, with the clouds numbered within the part.
    fn own_links(&self, links: &[Link]) -> Vec<Link> {
        let within: HashMap<usize, usize> = self.clouds.iter().enumerate().map(|(at, &cloud)| (cloud, at)).collect();
        let own = self.links.iter().map(|&(index, _)| {
            let link = &links[index];
            Link { source: within[&link.source], target: within[&link.target], ..link.clone() }
        });
        own.collect()
    }
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;

    use super::*;
    use crate::rigid::rotation_vector;
    use crate::rigid::tests::random_transform;

    #[test]
    fn wrong_links_cost_no_right_ones() {
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let truth: Vec<IsometryMatrix3<f64>> = (0..12).map(|_| random_transform(&mut rng)).collect();
            let mut links = Vec::new();
            for source in 1..12_usize {
                for target in source.saturating_sub(3)..source {
                    let t_target_source = truth[target].inverse() * truth[source];
                    links.push(Link { source, target, t_target_source, information: Matrix6::identity() });
                }
            }
            let right = links.len();
            for (source, target) in [(11, 0), (8, 1), (10, 3), (6, 0), (9, 2), (7, 3)] {
                let t_target_source = random_transform(&mut rng);
                links.push(Link { source, target, t_target_source, information: Matrix6::identity() });
            }
            let doubts: Vec<f64> = (0..links.len()).map(|i| if i < right { 1e-6 } else { 1e-3 }).collect();
            let parts = split(12, &links, &doubts, &vec![0.05; links.len()], &Counter::default()).unwrap();
            let used: Vec<usize> = parts[0].links.iter().map(|(link, _)| *link).collect();
            assert_eq!(used, (0..right).collect::<Vec<_>>(), "seed {seed}: {} parts", parts.len());
            for (pose, true_pose) in parts[0].poses.iter().zip(&truth) {
                let error = true_pose.inverse() * truth[0] * pose;
                assert!(rotation_vector(&error.rotation).norm() < 1e-6 && error.translation.vector.norm() < 1e-6);
            }
        }
    }
}
