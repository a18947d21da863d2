//! A made city: streets, houses with windows in their façades, and trees, on lots of 20 by 20 m.

pub mod copc;

use std::io::{self, Write};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The side of a lot in metres.
const LOT: f64 = 20.0;

/// Where the city lies: coordinates of UTM.
const PLACE: [f64; 3] = [691_000.0, 5_336_000.0, 512.0];

/// The points of a city of `lots` by `lots`, lot after lot, in UTM metres.
pub fn city(lots: u32, points_per_lot: u32) -> impl Iterator<Item = [f64; 3]> + Clone {
    (0..lots * lots).flat_map(move |lot| {
        let mut rng = ChaCha8Rng::seed_from_u64(lot.into());
        let height = 3.0 * f64::from(rng.random_range(2..6_u32));
        let corner = [f64::from(lot % lots) * LOT, f64::from(lot / lots) * LOT];
        (0..points_per_lot).map(move |_| {
            let [x, y, z] = point(&mut rng, height);
            // LAS stores millimetres.
            [x + corner[0] + PLACE[0], y + corner[1] + PLACE[1], z + PLACE[2]].map(|v| (v * 1e3).round() / 1e3)
        })
    })
}

/// A point of a lot with a house of this height, by area.
fn point(rng: &mut ChaCha8Rng, height: f64) -> [f64; 3] {
    let mut random = |high: f64| rng.random::<f64>() * high;
    let [house, facades] = [144.0, 48.0 * height];
    let place = random(256.0 + house + facades + 30.0);
    if place < house {
        let [x, y] = [4.0 + random(12.0), 4.0 + random(12.0)];
        let is_edge = [x, y].iter().any(|v| !(4.3..15.7).contains(v));
        return [x, y, height + if is_edge { 0.5 } else { 0.0 }];
    }
    if place < house + facades {
        let [along, z] = [random(12.0), random(height)];
        let is_window = (0.9..2.1).contains(&(along % 3.0)) && (1.0..2.4).contains(&(z % 3.0));
        let depth = if is_window { 0.2 } else { 0.0 };
        return match random(4.0) as u32 {
            0 => [4.0 + along, 4.0 + depth, z],
            1 => [4.0 + along, 16.0 - depth, z],
            2 => [4.0 + depth, 4.0 + along, z],
            _ => [16.0 - depth, 4.0 + along, z],
        };
    }
    if place < house + facades + 30.0 {
        let angle = random(std::f64::consts::TAU);
        let is_trunk = random(1.0) < 0.1;
        let (z, radius) = match random(2.0) - 1.0 {
            _ if is_trunk => (random(2.5), 0.15),
            up => (3.5 + 1.5 * up, 1.5 * (1.0 - up * up).sqrt()),
        };
        return [2.0 + radius * angle.cos(), 2.0 + radius * angle.sin(), z];
    }
    loop {
        let [x, y] = [random(LOT), random(LOT)];
        if ![x, y].iter().all(|v| (4.0..16.0).contains(v)) {
            let is_pavement = [x, y].iter().all(|v| (1.0..19.0).contains(v));
            return [x, y, if is_pavement { 0.15 } else { 0.0 }];
        }
    }
}

/// Writes positions as LAS 1.2 in millimetres, with UTM 32N (EPSG 25832) as coordinate reference system.
pub fn write_las(out: &mut dyn Write, positions: impl Iterator<Item = [f64; 3]> + Clone) -> io::Result<()> {
    let keys: [u16; 12] = [1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 25832];
    let (mut low, mut high, mut number) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], 0_u32);
    for position in positions.clone() {
        low = std::array::from_fn(|axis| low[axis].min(position[axis]));
        high = std::array::from_fn(|axis| high[axis].max(position[axis]));
        number += 1;
    }
    let mut header = b"LASF".to_vec();
    header.resize(24, 0);
    header.extend([1, 2]);
    header.resize(94, 0);
    header.extend(227_u16.to_le_bytes());
    header.extend((227 + 54 + 24_u32).to_le_bytes());
    header.extend(1_u32.to_le_bytes());
    header.push(0);
    header.extend(20_u16.to_le_bytes());
    header.extend(number.to_le_bytes());
    header.resize(131, 0);
    header.extend([0.001; 3].iter().flat_map(|v: &f64| v.to_le_bytes()));
    header.extend(PLACE.iter().flat_map(|v| v.to_le_bytes()));
    header.extend((0..3).flat_map(|axis| [high[axis], low[axis]]).flat_map(f64::to_le_bytes));
    header.extend([0; 2]);
    header.extend(b"LASF_Projection\0");
    header.extend([34735, 24].iter().flat_map(|v: &u16| v.to_le_bytes()));
    header.resize(227 + 54, 0);
    header.extend(keys.iter().flat_map(|v| v.to_le_bytes()));
    out.write_all(&header)?;
    for position in positions {
        let mut record = [0; 20];
        for axis in 0..3 {
            let millimetres = ((position[axis] - PLACE[axis]) * 1e3).round() as i32;
            record[4 * axis..4 * axis + 4].copy_from_slice(&millimetres.to_le_bytes());
        }
        out.write_all(&record)?;
    }
    Ok(())
}
