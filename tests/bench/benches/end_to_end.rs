//! Whole stages of a detection: `cargo bench -p snake-bench --bench end_to_end`.
//!
//! For the built-in model and for the paper's 64³ network with seeded random weights (no weights of that size come with
//! the crate, and speed does not depend on their values).

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use snake_core::{Builtin, DetectOptions, EncodeOptions, Field, MeshOptions, Model, Point};
use snake_io as io;

/// Queries along each axis, and how many of them refinement gets: as many as on a typical object.
const QUERY_RESOLUTION: usize = 64;
const OCCUPIED: usize = 12_000;

/// Names and shapes of the paper's network: 64³ voxels, U-Net of 4 levels from 32 channels, all other widths 32.
fn paper_tensors() -> Vec<(String, Vec<usize>)> {
    let mut tensors = Vec::new();
    let mut add = |name: String, shape: &[usize]| tensors.push((name, shape.to_vec()));
    let mut linear = |name: String, inputs: usize, outputs: usize| {
        add(format!("{name}.weight"), &[outputs, inputs]);
        add(format!("{name}.bias"), &[outputs]);
    };
    linear("encoder.fc_pos".into(), 3, 64);
    linear("encoder.fc_c".into(), 32, 32);
    for block in 0..5 {
        linear(format!("encoder.blocks.{block}.fc_0"), 64, 32);
        linear(format!("encoder.blocks.{block}.fc_1"), 32, 32);
    }
    for decoder in ["decoder_occup", "decoder_keypoint"] {
        linear(format!("{decoder}.fc_p"), 3, 32);
        linear(format!("{decoder}.fc_out"), 32, 1);
        for block in 0..5 {
            linear(format!("{decoder}.fc_c.{block}"), 32, 32);
            linear(format!("{decoder}.blocks.{block}.fc_0"), 32, 32);
            linear(format!("{decoder}.blocks.{block}.fc_1"), 32, 32);
        }
    }
    (0..5).for_each(|block| add(format!("encoder.blocks.{block}.shortcut.weight"), &[32, 64]));
    let mut convolution = |name: String, inputs: usize, outputs: usize| {
        add(format!("{name}.groupnorm.weight"), &[inputs]);
        add(format!("{name}.groupnorm.bias"), &[inputs]);
        add(format!("{name}.conv.weight"), &[outputs, inputs, 3, 3, 3]);
    };
    for (level, [inputs, middle, outputs]) in
        [[32, 32, 32], [32, 32, 64], [64, 64, 128], [128, 128, 256]].into_iter().enumerate()
    {
        convolution(format!("encoder.unet3d.encoders.{level}.basic_module.SingleConv1"), inputs, middle);
        convolution(format!("encoder.unet3d.encoders.{level}.basic_module.SingleConv2"), middle, outputs);
    }
    for (index, outputs) in [128, 64, 32].into_iter().enumerate() {
        convolution(format!("encoder.unet3d.decoders.{index}.basic_module.SingleConv1"), 3 * outputs, outputs);
        convolution(format!("encoder.unet3d.decoders.{index}.basic_module.SingleConv2"), outputs, outputs);
    }
    add("encoder.unet3d.final_conv.weight".into(), &[32, 32, 1, 1, 1]);
    add("encoder.unet3d.final_conv.bias".into(), &[32]);
    tensors
}

/// The paper's network with seeded weights, uniform within ±√(3 / inputs).
fn paper_model() -> Model {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = paper_tensors()
        .into_iter()
        .map(|(name, shape)| {
            let bound = (3.0 / shape[1..].iter().product::<usize>() as f32).sqrt();
            let number = shape.iter().product::<usize>();
            let bytes = (0..number).flat_map(|_| rng.random_range(-bound..bound).to_le_bytes()).collect();
            (name, shape, bytes)
        })
        .collect();
    let views = tensors.iter().map(|(name, shape, bytes)| {
        (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).expect("the bytes of the shape"))
    });
    let metadata = [
        ("format", "snake-field"),
        ("format_version", "1"),
        ("resolution", "[64, 64, 64]"),
        ("padding", "0.125"),
        ("z_min", "-0.5"),
        ("z_max", "0.5"),
        ("c_dim", "32"),
        ("hidden_dim", "32"),
        ("decoder_hidden_dim", "32"),
        ("resnet_blocks", "5"),
        ("unet_levels", "4"),
        ("unet_base_channels", "32"),
        ("group_norm_groups", "8"),
    ];
    let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into_iter().collect();
    let file = safetensors::serialize(views, Some(metadata)).expect("tensors of unique names");
    Model::from_bytes(&file).expect("the paper's network")
}

/// The starting grid in the cloud's frame.
fn query_grid(field: &Field) -> Vec<Point> {
    let along = |i: usize| i as f32 / (QUERY_RESOLUTION - 1) as f32 - 0.5;
    let axis = 0..QUERY_RESOLUTION;
    axis.clone()
        .flat_map(|x| axis.clone().flat_map(move |y| (0..QUERY_RESOLUTION).map(move |z| [x, y, z])))
        .map(|query| field.normalization().to_cloud(query.map(along)))
        .collect()
}

fn stages(criterion: &mut Criterion) {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/plane.ply");
    let points = io::read_points(&sample).expect("the sample of 4096 points");
    for (name, model) in [("built-in", Model::builtin(Builtin::Compact)), ("paper-64", paper_model())] {
        let mut group = criterion.benchmark_group(name);
        group.sample_size(10).warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(5));
        let encode = || model.encode(black_box(&points), &EncodeOptions::default()).expect("a cloud with extent");
        group.bench_function("encode", |bencher| bencher.iter(encode));
        let field = encode();
        let queries = query_grid(&field);
        let occupancy = || field.occupancy(black_box(&queries)).expect("finite queries");
        group.bench_function("occupancy", |bencher| bencher.iter(occupancy));
        let mut sorted = occupancy();
        sorted.sort_by(f32::total_cmp);
        let threshold = sorted[sorted.len() - OCCUPIED];
        for refine_steps in [0, 10] {
            let options = DetectOptions::default()
                .with_query_resolution(QUERY_RESOLUTION)
                .with_occupancy_threshold(threshold)
                .with_refine_steps(refine_steps);
            group.bench_function(format!("detect J={refine_steps}, without encode"), |bencher| {
                bencher.iter(|| black_box(&field).detect(&options).expect("options within range"));
            });
        }
        let resolution = 128;
        let options = MeshOptions::default().with_resolution(resolution).with_level(threshold.clamp(0.001, 0.999));
        let mesh = || field.mesh(black_box(&options)).expect("options within range");
        group.bench_function(format!("mesh {resolution}, without encode"), |bencher| bencher.iter(mesh));
        group.finish();
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
