//! Clouds that are hard for k-d trees, with ties and repeated points, for tests.

use crate::Point;

/// Clouds of up to a thousand points. Their coordinates are whole numbers.
pub fn small() -> Vec<Vec<Point>> {
    let lattice = |i: u32, axis: u32| (i / 7_u32.pow(axis) % 7) as f32;
    vec![
        (0..700).map(|i| std::array::from_fn(|axis| lattice(i, axis as u32))).collect(),
        (0..1000).map(|i| std::array::from_fn(|axis| scattered(i, axis))).collect(),
        (0..500).map(|i| [(i % 100) as f32, 0.0, 5.0]).collect(),
        (0..500).map(|i| if i % 3 == 0 { [1.0; 3] } else { [scattered(i, 0), 2.0, scattered(i, 2)] }).collect(),
        vec![[3.0, 4.0, 5.0]; 300],
        vec![[3.0, 4.0, 5.0]],
        vec![],
    ]
}

/// A whole number below 10 007.
pub fn scattered(i: u32, axis: usize) -> f32 {
    (i.wrapping_mul([7919, 104_729, 1_299_709][axis]) % 10_007) as f32
}

/// Clouds of 200 000 points: at one place, on a line, on a plane, and half at one place.
pub fn large() -> impl Iterator<Item = Vec<Point>> {
    let unit = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1_u32 << 24) as f32;
    let clouds: [fn(f32, f32) -> Point; 4] = [
        |_, _| [1.0; 3],
        |u, _| [0.0, u, 0.0],
        |u, v| [u, v, 0.0],
        |u, v| if u < 0.5 { [0.0; 3] } else { [v, u, 1.0] },
    ];
    let point = move |i| [unit(i, 2_654_435_761), unit(i, 0x9e37_79b1 ^ 0x0f0f_0f0f)];
    clouds.into_iter().map(move |cloud| (0..200_000).map(point).map(|[u, v]| cloud(u, v)).collect())
}
