//! Levels of instructions that round a multiplication with its addition once give the same bits: AVX2 and AVX-512, and on
//! aarch64 the portable code and NEON. The portable code of x86-64 rounds twice.

use chacha20::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use snake_kernels::{
    Conv3d, Corners, Epilogue, PackedConv3d, PackedLinear, SimdLevel, Source, conv3d, interpolate,
    interpolate_backward, linear,
};

/// So many numbers within ±1.
fn values(random: &mut ChaCha8Rng, number: usize) -> Vec<f32> {
    (0..number).map(|_| random.random_range(-1.0..1.0)).collect()
}

/// Asserts that a function gives the same for all levels that round once.
fn assert_equal<T: PartialEq + std::fmt::Debug>(name: &str, run: impl Fn(SimdLevel) -> T) {
    let rounds_once = |level: &SimdLevel| level.name() != "portable" || cfg!(target_arch = "aarch64");
    let levels: Vec<SimdLevel> = SimdLevel::available().into_iter().filter(rounds_once).collect();
    for level in levels.iter().skip(1) {
        assert_eq!(run(*level), run(levels[0]), "{name}: {} and {}", level.name(), levels[0].name());
    }
}

#[test]
fn levels_that_round_once_have_the_same_bits() {
    let random = &mut ChaCha8Rng::seed_from_u64(5);
    for (rows, inputs, outputs) in [(1, 1, 1), (13, 32, 16), (64, 96, 33)] {
        let layer = PackedLinear::new(inputs, outputs, &values(random, inputs * outputs), &values(random, outputs));
        let (input, start) = (values(random, rows * inputs), values(random, rows * outputs));
        assert_equal("linear", |level| {
            let mut output = start.clone();
            linear(level, &layer, &input, &mut output, Epilogue::Add);
            output
        });
    }
    for (size, channels, outputs, tile) in [([3, 5, 9], 17, 20, 2), ([8, 6, 17], 32, 16, 4)] {
        let layer = PackedConv3d::new(&[(channels, false)], outputs, &values(random, outputs * channels * 27), tile);
        let volume = values(random, size.iter().product::<usize>() * channels);
        let (scale, shift) = (values(random, channels), values(random, channels));
        let sources = [Source { values: &volume, channels, upsampled: false }];
        let conv = Conv3d { layer: &layer, size, sources: &sources, scale: &scale, shift: &shift, originals: &[] };
        assert_equal("conv3d", |level| {
            let mut output = vec![0.0; size.iter().product::<usize>() * outputs];
            let sums = conv3d(level, &conv, &|| false, &mut output);
            (output, sums)
        });
    }
    for channels in [5, 32] {
        let (volume, in_feature) = (values(random, 8 * channels), values(random, channels));
        let corners = [Corners { voxels: std::array::from_fn(|corner| corner as u32), fraction: [0.3, 0.6, 0.1] }];
        assert_equal("interpolate", |level| {
            let (mut features, mut gradients) = (vec![0.0; channels], [[0.0; 3]]);
            interpolate(level, &volume, channels, &corners, &mut features);
            interpolate_backward(level, &volume, channels, &corners, &in_feature, &mut gradients);
            (features, gradients)
        });
    }
}
