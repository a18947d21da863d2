//! Surfaces of functions that are known, and the surface of a field.

use std::collections::HashMap;
use std::f64::consts::PI;

use chacha20::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::*;

/// All samples of a function, or only those that are found without `likely` samples.
fn samples(resolution: usize, all: bool, value: impl Fn(Sample) -> f32 + Sync) -> Samples {
    let likely = every_sample(resolution).filter(|_| all);
    Samples::near_surface(
        resolution,
        0.0,
        |asked| asked.iter().map(|&sample| value(sample)).collect(),
        likely,
        &Control::default(),
    )
    .unwrap()
}

fn every_sample(resolution: usize) -> impl Iterator<Item = Sample> {
    let [columns, number] = [resolution, resolution.pow(3)];
    (0..number).map(move |i| [i % columns, i / columns % columns, i / (columns * columns)])
}

/// A mesh whose unit is the distance between two samples.
fn mesh(samples: &Samples, surface: &Surface) -> Mesh {
    let vertex = |crossing: &Crossing| {
        let (low, axis) = samples.ends(crossing.edge);
        let mut point = low.map(|i| i as f32);
        point[axis] += crossing.fraction;
        point
    };
    let vertices = surface.crossings.iter().map(vertex).collect();
    Mesh { vertices, triangles: surface.triangles.clone(), ..Mesh::default() }
}

/// The volume by the divergence theorem.
fn volume(mesh: &Mesh) -> f64 {
    let of = |&triangle: &[u32; 3]| {
        let corner = mesh.vertices[triangle[0] as usize].map(f64::from);
        mesh.area_vector(triangle).iter().zip(corner).map(|(c, p)| c * p).sum::<f64>() / 6.0
    };
    mesh.triangles.iter().map(of).sum()
}

/// Vertices minus edges plus triangles; fails unless each edge belongs to two triangles, in opposite directions.
fn euler_characteristic(mesh: &Mesh) -> i64 {
    let mut directed: HashMap<(u32, u32), usize> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        [(a, b), (b, c), (c, a)].into_iter().for_each(|edge| *directed.entry(edge).or_default() += 1);
    }
    for (&(a, b), &number) in &directed {
        assert!(number == 1 && directed.get(&(b, a)) == Some(&1), "edge {a} {b}");
    }
    let mut used = vec![false; mesh.vertices.len()];
    mesh.triangles.iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
    assert!(used.iter().all(|&used| used), "a vertex without a triangle");
    mesh.vertices.len() as i64 - directed.len() as i64 / 2 + mesh.triangles.len() as i64
}

fn distance(sample: Sample, from: [f32; 3]) -> f32 {
    (0..3).map(|axis| (sample[axis] as f32 - from[axis]).powi(2)).sum::<f32>().sqrt()
}

/// Positive between the two radii around the centre.
fn shell(sample: Sample, center: [f32; 3], radii: [f32; 2]) -> f32 {
    let distance = distance(sample, center);
    (distance - radii[0]).min(radii[1] - distance)
}

#[test]
fn noise_has_a_closed_surface_and_its_outer_part_is_what_a_flood_reaches() {
    let mut removed = 0;
    for (seed, share) in [0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95].into_iter().enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed as u64);
        let resolution = 13;
        let values: Vec<f32> = (0..resolution * resolution * resolution).map(|_| rng.random_range(0.0..1.0)).collect();
        let value = |[x, y, z]: Sample| values[x + resolution * (y + resolution * z)] - (1.0 - share);
        let samples = samples(resolution, true, value);
        let all = Surface::of(&samples);
        euler_characteristic(&mesh(&samples, &all));

        let reached = flood(&samples);
        let is_outer = |&vertex: &u32| {
            let (low, axis) = samples.ends(all.crossings[vertex as usize].edge);
            let mut high = low;
            high[axis] += 1;
            let empty = if samples.occupied(low) { high } else { low };
            reached[empty[0] + resolution * (empty[1] + resolution * empty[2])]
        };
        let edges = |surface: &Surface| -> Vec<[u32; 3]> {
            surface.triangles.iter().map(|t| t.map(|vertex| surface.crossings[vertex as usize].edge)).collect()
        };
        let expected: Vec<[u32; 3]> =
            all.triangles.iter().zip(edges(&all)).filter(|(t, _)| is_outer(&t[0])).map(|(_, e)| e).collect();
        let mut outer = all.clone();
        outer.retain_outer(&samples);
        assert_eq!(edges(&outer), expected);
        euler_characteristic(&mesh(&samples, &outer));
        removed += all.triangles.len() - outer.triangles.len();
    }
    assert!(removed > 100, "{removed}");
}

/// Which samples can be reached from the border through empty ones, along the axes.
fn flood(samples: &Samples) -> Vec<bool> {
    let n = samples.resolution;
    let mut reached = vec![false; n * n * n];
    let mut open = vec![[0, 0, 0]];
    while let Some(sample) = open.pop() {
        let [x, y, z] = sample;
        let seen = std::mem::replace(&mut reached[x + n * (y + n * z)], true);
        if !seen {
            let ways = (0..3).flat_map(|axis| [-1, 1].map(|step| (axis, step)));
            open.extend(ways.filter_map(|(axis, step)| {
                let mut next = sample;
                next[axis] = sample[axis].checked_add_signed(step).filter(|&i| i < n)?;
                (!samples.occupied(next)).then_some(next)
            }));
        }
    }
    reached
}

#[test]
fn the_outer_surface_is_without_cavities_and_what_is_in_them() {
    let area = |value: &(dyn Fn(Sample) -> f32 + Sync), outer: bool| {
        let samples = samples(48, true, value);
        let mut surface = Surface::of(&samples);
        if outer {
            surface.retain_outer(&samples);
        }
        let mesh = mesh(&samples, &surface);
        (mesh.area() / (4.0 * PI), euler_characteristic(&mesh))
    };
    let near = |(area, euler): (f64, i64), expected: f64, number: i64| {
        assert!((area / expected - 1.0).abs() < 0.02 && euler == 2 * number, "{area} {expected} {euler}");
    };
    let outside = |sample| shell(sample, [41.0, 41.0, 41.0], [-1.0, 4.0]);
    let nested = |sample| {
        let spheres = shell(sample, [20.0; 3], [15.0, 17.0]).max(shell(sample, [20.0; 3], [6.0, 9.0]));
        spheres.max(outside(sample))
    };
    near(area(&nested, false), 17.0_f64.powi(2) + 15.0_f64.powi(2) + 81.0 + 36.0 + 16.0, 5);
    near(area(&nested, true), 17.0_f64.powi(2) + 16.0, 2);
    let open = |sample: Sample| shell(sample, [20.0; 3], [15.0, 17.0]).min(30.3 - sample[2] as f32);
    assert_eq!(area(&open, false), area(&open, true));
    // From the island's last crossing along x, empty samples lead to another outer part.
    let before =
        |sample| shell(sample, [30.0, 24.0, 24.0], [-1.0, 6.0]).max(shell(sample, [8.0, 24.0, 24.0], [3.0, 5.0]));
    near(area(&before, true), 36.0 + 25.0, 2);
}

#[test]
fn samples_near_the_surface_give_the_surface_of_all_samples() {
    let two_sheets = |sample: Sample| {
        let wave = 16.0 + 5.0 * (sample[0] as f32 * 0.3).sin() + 4.0 * (sample[1] as f32 * 0.25).cos();
        0.7 - (sample[2] as f32 - wave).abs()
    };
    for resolution in [30, 33, 47] {
        let sphere = |sample| shell(sample, [14.0, 15.0, 13.2], [9.0, 11.5]);
        for value in [&sphere as &(dyn Fn(Sample) -> f32 + Sync), &two_sheets] {
            let (all, near) = (samples(resolution, true, value), samples(resolution, false, value));
            assert_eq!(Surface::of(&near), Surface::of(&all));
            assert!(near.known().len() < all.known().len() * 2 / 3, "{} of {}", near.known().len(), all.known().len());
            assert!(!Surface::of(&all).triangles.is_empty());
        }
    }
    // A speck in a block whose first sample misses it is found if the block is likely.
    let speck = |sample| if sample == [9, 9, 9] { 1.0 } else { -1.0 };
    assert!(samples(32, false, speck).known().is_empty());
    let likely = Samples::near_surface(
        32,
        0.0,
        |asked| asked.iter().map(|&s| speck(s)).collect(),
        [[8, 11, 10]],
        &Control::default(),
    )
    .unwrap();
    assert_eq!(Surface::of(&likely).crossings.len(), 6);
}

#[test]
fn the_border_closes_what_it_cuts() {
    let samples = samples(18, true, |sample| 9.25 - sample[0] as f32);
    let mesh = mesh(&samples, &Surface::of(&samples));
    assert_eq!(euler_characteristic(&mesh), 2);
    let ends = |axis: usize| {
        let along = mesh.vertices.iter().map(|vertex| vertex[axis]);
        [along.clone().fold(f32::INFINITY, f32::min), along.fold(f32::NEG_INFINITY, f32::max)]
    };
    assert_eq!([0, 1, 2].map(ends), [[0.0, 9.25], [0.0, 17.0], [0.0, 17.0]]);
    // A box of 9.25 × 17 × 17 whose edges on the border are cut off.
    assert!((0.96..1.0).contains(&(volume(&mesh) / (9.25 * 17.0 * 17.0))), "{}", volume(&mesh));
}

#[test]
fn the_middle_of_the_shell_lies_nearer_to_the_surface_than_the_level() {
    let (_, field) = crate::detect::tests::cylinder();
    let mesh = |surface| field.mesh(&MeshOptions { resolution: 64, surface, ..Default::default() }).unwrap();
    let (level, middle) = (mesh(MeshSurface::Level), mesh(MeshSurface::Middle));
    assert_eq!(level.triangles, middle.triangles);
    // No normal opposes the area-weighted mean normal of the triangles at its vertex.
    let mut around = vec![[0.0; 3]; middle.vertices.len()];
    for &triangle in &middle.triangles {
        let cross = middle.area_vector(triangle);
        triangle.iter().for_each(|&vertex| (0..3).for_each(|axis| around[vertex as usize][axis] += cross[axis]));
    }
    let dot = |(a, b): (&[f64; 3], &Point)| (0..3).map(|axis| a[axis] * f64::from(b[axis])).sum::<f64>();
    assert!(around.iter().zip(&middle.normals).map(dot).all(|dot| dot > -1e-12));
    let off = [&level, &middle].map(|mesh| {
        let wall: Vec<&Point> = mesh.vertices.iter().filter(|vertex| (0.1..0.7).contains(&vertex[2])).collect();
        let sum: f32 = wall.iter().map(|[x, y, _]| (x.hypot(*y) - 1.0).abs()).sum();
        sum / wall.len() as f32 / field.voxel_size()
    });
    assert!(off[0] > 0.5 && off[1] < 0.3, "{off:?} voxels");
    let threads = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    assert_eq!(middle, threads.install(|| mesh(MeshSurface::Middle)));
}

#[test]
fn an_open_shell_says_that_its_inner_side_is_left() {
    let hint = |value: &(dyn Fn(Sample) -> f32 + Sync)| {
        let samples = samples(40, true, value);
        let mut surface = Surface::of(&samples);
        let num_all = surface.triangles.len();
        surface.retain_outer(&samples);
        let num_removed = Some(num_all - surface.triangles.len());
        Mesh { num_removed, ..mesh(&samples, &surface) }.notes().pop()
    };
    let closed = |sample: Sample| shell(sample, [19.5; 3], [12.0, 15.0]);
    assert_eq!(hint(&closed), None);
    let text = hint(&|sample| if sample[2] > 28 { -1.0 } else { closed(sample) }).unwrap();
    assert!(text.starts_with("`outer` removed 0 of ") && text.contains("the shell is open"), "{text}");
    // A small bubble in the wall does not count as an inner side.
    let bubble = |sample: Sample| shell(sample, [19.5, 19.5, 6.0], [0.9, 40.0]);
    let text = hint(&|sample| if sample[2] > 28 { -1.0 } else { closed(sample).min(bubble(sample)) }).unwrap();
    assert!(text.contains("the shell is open"), "{text}");
    assert!(Mesh { triangles: vec![[0, 1, 2]], ..Mesh::default() }.notes().is_empty(), "`outer` was not asked for");
    assert!(Mesh::default().notes()[0].starts_with("no surface"));
}
