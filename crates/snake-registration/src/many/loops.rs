//! Loops of three transforms, as evidence about each of them.

use std::collections::HashMap;

use nalgebra::IsometryMatrix3;

use snake_geometry::Vector;

use crate::rigid::displacement;
use crate::steps::judge;

/// A transform between two clouds and the probability, 0 to 1, that it is right by its own evidence.
#[derive(Debug, Clone, Copy)]
pub(super) struct Witness {
    pub(super) source: usize,
    pub(super) target: usize,
    pub(super) t_target_source: IsometryMatrix3<f64>,
    pub(super) confidence: f64,
    /// Whether the clouds allow more than one answer; no loop outweighs that.
    pub(super) is_ambiguous: bool,
    /// A loop is closed if it moves points by less than this (root mean square), or that of another
    /// of its transforms.
    pub(super) distance: f64,
}

/// The probability that each transform is wrong, given its own evidence and the loops of three
/// transforms that it closes.
///
/// Two correct transforms confirm a third that closes their loop, because wrong transforms close a loop
/// only by chance. The probability is `(1 - own) Π (1 - a b)` over the closed loops, with the confidences
/// a and b of the other two transforms. Only loops count whose other two transforms are reliable by
/// themselves: two clouds of one object fit a third that lacks it in the same wrong way, which closes a
/// loop of doubtful transforms. A loop is closed if it moves the points of `probes[cloud]` little.
pub(super) fn doubts(witnesses: &[Witness], probes: &[Vec<Vector>]) -> Vec<f64> {
    let mut by_cloud: Vec<HashMap<usize, usize>> = vec![HashMap::new(); probes.len()];
    for (index, witness) in witnesses.iter().enumerate() {
        by_cloud[witness.source].insert(witness.target, index);
        by_cloud[witness.target].insert(witness.source, index);
    }
    // From one end of a transform to the other.
    let step = |index: usize, from: usize| {
        let Witness { source, t_target_source, .. } = &witnesses[index];
        if from == *source { *t_target_source } else { t_target_source.inverse() }
    };
    let doubt = |witness: &Witness| {
        let (source, target) = (witness.source, witness.target);
        let mut thirds: Vec<usize> = by_cloud[source].keys().copied().collect();
        thirds.sort_unstable();
        let mut doubt = 1.0 - witness.confidence;
        if witness.is_ambiguous {
            return doubt;
        }
        for third in thirds {
            let Some(&last) = by_cloud[target].get(&third) else { continue };
            let first = by_cloud[source][&third];
            let others = [&witnesses[first], &witnesses[last]];
            if others.iter().any(|other| other.confidence < judge::RELIABLE) {
                continue;
            }
            let distance = others.iter().map(|other| other.distance).fold(witness.distance, f64::max);
            let around = step(last, third) * step(first, source);
            if displacement(&around, &witness.t_target_source, &probes[source]) < distance {
                doubt *= 1.0 - witnesses[first].confidence * witnesses[last].confidence;
            }
        }
        doubt
    };
    witnesses.iter().map(doubt).collect()
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::SeedableRng;

    use super::*;
    use crate::rigid::tests::random_transform;

    #[test]
    fn closed_loops_lower_a_doubt_and_open_ones_leave_it() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let poses: Vec<_> = (0..4).map(|_| random_transform(&mut rng)).collect();
        let witness = |source: usize, target: usize, confidence: f64| Witness {
            source,
            target,
            t_target_source: poses[target].inverse() * poses[source],
            confidence,
            is_ambiguous: false,
            distance: 0.05,
        };
        let mut witnesses = vec![witness(0, 1, 0.9), witness(2, 1, 0.8), witness(0, 2, 0.1), witness(3, 0, 0.3)];
        let probes = vec![vec![Vector::x(), Vector::y(), Vector::zeros()]; 4];
        let doubtful = doubts(&witnesses, &probes);
        assert!((doubtful[2] - 0.9 * (1.0 - 0.72)).abs() < 1e-12, "{doubtful:?}");
        assert!(doubtful[0] < 0.1 && doubtful[1] < 0.2);
        assert_eq!(doubtful[3], 1.0 - 0.3);
        witnesses[2].is_ambiguous = true;
        assert_eq!(doubts(&witnesses, &probes)[2], 1.0 - 0.1);
        witnesses[2].is_ambiguous = false;
        // A wrong transform closes no loop.
        witnesses[2].t_target_source.translation.vector.x += 0.2;
        let doubtful = doubts(&witnesses, &probes);
        let is_own = |(doubt, own): (&f64, &Witness)| (1.0 - doubt - own.confidence).abs() < 1e-12;
        assert!(doubtful.iter().zip(&witnesses).all(is_own), "{doubtful:?}");
    }
}
