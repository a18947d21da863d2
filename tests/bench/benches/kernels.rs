//! Each kernel by itself, on one thread, at every level of instructions of this processor: `cargo bench -p snake-bench --bench kernels`.
//!
//! Throughput is in multiply-adds of the textbook, so a convolution's can exceed what the processor could do directly.

use std::hint::black_box;
use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use snake_kernels::{
    Conv3d, Corners, Epilogue, PackedConv3d, PackedLinear, SimdLevel, Source, conv3d, interpolate,
    interpolate_backward, linear,
};

fn random(number: usize) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    (0..number).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// A group that counts multiply-adds.
fn group<'a>(criterion: &'a mut Criterion, name: &str, multiply_adds: usize) -> BenchmarkGroup<'a, WallTime> {
    let mut group = criterion.benchmark_group(name);
    group.throughput(Throughput::Elements(multiply_adds as u64));
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2));
    group
}

/// The U-Net's convolutions at their sizes: channels of each source (upsampled or not) and of the output.
fn convolutions(criterion: &mut Criterion) {
    type Layer = (usize, &'static [(usize, bool)], usize);
    let layers: [Layer; 4] = [
        (64, &[(32, false)], 32),
        (64, &[(32, false), (64, true)], 32),
        (32, &[(64, false)], 64),
        (16, &[(128, false)], 128),
    ];
    for (resolution, channels, outputs) in layers {
        let voxels = resolution * resolution * resolution;
        let inputs: usize = channels.iter().map(|c| c.0).sum();
        let volumes: Vec<Vec<f32>> =
            channels.iter().map(|&(width, upsampled)| random(voxels * width / if upsampled { 8 } else { 1 })).collect();
        let sources: Vec<Source> = volumes
            .iter()
            .zip(channels)
            .map(|(values, &(channels, upsampled))| Source { values, channels, upsampled })
            .collect();
        let (weight, norm) = (random(outputs * inputs * 27), [random(inputs), random(inputs)]);
        let mut output = vec![0.0; voxels * outputs];
        let mut group = group(
            criterion,
            &format!("conv3d {resolution}³ {channels:?} to {outputs}"),
            voxels * inputs * outputs * 27,
        );
        for tile in [2, 4] {
            let layer = PackedConv3d::new(channels, outputs, &weight, tile);
            let size = [resolution; 3];
            let conv =
                Conv3d { layer: &layer, size, sources: &sources, scale: &norm[0], shift: &norm[1], originals: &[] };
            for level in SimdLevel::available() {
                group.bench_function(format!("tiles of {tile}, {}", level.name()), |bencher| {
                    bencher.iter(|| conv3d(level, black_box(&conv), &|| false, &mut output));
                });
            }
        }
    }
}

/// A decoder's layer and the gathering of its features, for one tile of queries.
fn decoder_parts(criterion: &mut Criterion) {
    const ROWS: usize = 64;
    const WIDTH: usize = 32;
    let layer = PackedLinear::new(WIDTH, WIDTH, &random(WIDTH * WIDTH), &random(WIDTH));
    let (input, mut output) = (random(ROWS * WIDTH), vec![0.0; ROWS * WIDTH]);
    let mut benches = group(criterion, "linear 64 rows, 32 to 32", ROWS * WIDTH * WIDTH);
    for level in SimdLevel::available() {
        benches.bench_function(level.name(), |bencher| {
            bencher.iter(|| linear(level, &layer, black_box(&input), &mut output, Epilogue::Relu));
        });
    }
    benches.finish();

    let resolution = 32;
    let volume = random(resolution * resolution * resolution * WIDTH);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let corners: Vec<Corners> = (0..ROWS)
        .map(|_| {
            let low: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..resolution - 1));
            let voxel = |corner: usize| {
                let [x, y, z] = std::array::from_fn(|axis| low[axis] + (corner >> axis & 1));
                ((z * resolution + y) * resolution + x) as u32
            };
            Corners { voxels: std::array::from_fn(voxel), fraction: std::array::from_fn(|_| rng.random()) }
        })
        .collect();
    let mut benches = group(criterion, "interpolate 64 rows of 32", ROWS * WIDTH * 8);
    let mut gradients = vec![[0.0; 3]; ROWS];
    for level in SimdLevel::available() {
        benches.bench_function(level.name(), |bencher| {
            bencher.iter(|| interpolate(level, &volume, WIDTH, black_box(&corners), &mut output));
        });
        benches.bench_function(format!("backward, {}", level.name()), |bencher| {
            bencher.iter(|| {
                interpolate_backward(level, &volume, WIDTH, black_box(&corners), &input, &mut gradients);
            });
        });
    }
}

fn on_one_thread(criterion: &mut Criterion) {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first use of the threads");
    convolutions(criterion);
    decoder_parts(criterion);
}

criterion_group!(benches, on_one_thread);
criterion_main!(benches);
