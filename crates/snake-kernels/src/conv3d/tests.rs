use super::*;
use crate::{ConstantRegion, naive};

#[test]
fn every_level_equals_the_textbook() {
    let mut random = naive::Random::new(2);
    let dense = |channels| vec![(channels, false)];
    let cases = [
        ([1, 1, 1], dense(1), 1),
        ([2, 3, 5], dense(3), 7),
        ([2, 4, 6], vec![(5, false), (7, true)], 20),
        ([3, 2, 8], dense(16), 16),
        ([4, 5, 9], dense(17), 33),
        ([6, 6, 17], dense(48), 16),
        ([8, 4, 8], vec![(16, false), (33, true)], 32),
    ];
    for (size, sources, outputs) in naive::cases(cases, 3) {
        let inputs: usize = sources.iter().map(|s| s.0).sum();
        let weight = random.values(outputs * inputs * 27);
        let norm = [random.values(inputs), random.values(inputs)];
        let volumes: Vec<Vec<f32>> = sources
            .iter()
            .map(|&(channels, up)| random.values(size.iter().product::<usize>() * channels / if up { 8 } else { 1 }))
            .collect();
        let expected =
            naive::conv3d_relu(size, inputs, outputs, &weight, &naive::normalized(size, &sources, &volumes, &norm));
        let values = volumes.iter().zip(&sources);
        let volumes_: Vec<Source> =
            values.map(|(values, &(channels, upsampled))| Source { values, channels, upsampled }).collect();
        for (level, tile) in SimdLevel::available().into_iter().flat_map(|level| [(level, 2), (level, 4)]) {
            let mut output = vec![f32::NAN; expected.len()];
            let layer = PackedConv3d::new(&sources, outputs, &weight, tile);
            let [scale, shift] = &norm;
            let conv = Conv3d { layer: &layer, size, sources: &volumes_, scale, shift, originals: &[] };
            let sums = conv3d(level, &conv, &|| false, &mut output);
            let case = format!("{level:?} {tile} {size:?} {sources:?} {outputs}");
            // Sums of up to 1296 products of values below 2.
            naive::assert_close(&output, &expected, 4e-4, &case);
            for (channel, sums) in sums.iter().enumerate() {
                let values = output.iter().skip(channel).step_by(outputs).map(|&v| f64::from(v));
                let expected = [values.clone().sum::<f64>(), values.map(|v| v * v).sum::<f64>()];
                for (sum, expected) in sums.iter().zip(expected) {
                    assert!((sum - expected).abs() <= 1e-5 * expected.abs().max(1.0), "{case}: {sum} {expected}");
                }
            }
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "takes many minutes")]
fn copied_tiles_are_those_that_would_be_computed() {
    let mut random = naive::Random::new(3);
    for (size, occupied) in [([16, 20, 24], vec![3700]), ([9, 21, 23], vec![0, 600]), ([4, 4, 40], vec![])] {
        let (channels, outputs) = (3, 20);
        let mut volume = vec![0.0; size.iter().product::<usize>() * channels];
        for voxel in &occupied {
            volume[voxel * channels..][..channels].copy_from_slice(&random.values(channels));
        }
        let mut region = ConstantRegion::around(size, occupied.into_iter());
        let mut inputs = channels;
        for _ in 0..2 {
            region = region.convolved();
            let weight = random.values(outputs * inputs * 27);
            let [scale, shift] = [random.values(inputs), random.values(inputs)];
            let mut next = Vec::new();
            let sources = [Source { values: &volume, channels: inputs, upsampled: false }];
            for (level, tile) in SimdLevel::available().into_iter().flat_map(|level| [(level, 4), (level, 2)]) {
                let originals = region.originals(tile);
                assert!(originals.iter().enumerate().any(|(i, o)| o.is_some_and(|o| (o as usize) < i)), "{size:?}");
                let layer = PackedConv3d::new(&[(inputs, false)], outputs, &weight, tile);
                let run = |originals: &[_]| {
                    let mut output = vec![f32::NAN; size.iter().product::<usize>() * outputs];
                    let (scale, shift) = (&scale, &shift);
                    let conv = Conv3d { layer: &layer, size, sources: &sources, scale, shift, originals };
                    let sums = conv3d(level, &conv, &|| false, &mut output);
                    (output, sums)
                };
                let ((computed, sums), (copied, copied_sums)) = (run(&[]), run(&originals));
                assert_eq!(computed, copied, "{level:?} {tile} {size:?}");
                for (found, expected) in copied_sums.as_flattened().iter().zip(sums.as_flattened()) {
                    assert!((found - expected).abs() <= 1e-6 * expected.max(1.0), "{found} {expected}");
                }
                next = computed;
            }
            volume = next;
            inputs = outputs;
        }
    }
}
