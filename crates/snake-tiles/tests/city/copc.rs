//! Writes COPC files for tests and the example.

use std::collections::VecDeque;
use std::io::{self, Cursor, Write};

use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::record::{LayeredPointRecordCompressor, RecordCompressor};
use laz::{LazItemRecordBuilder, LazItemType, LazVlrBuilder};

/// The side of the octree's cube is twice this, in millimetres.
const HALF: i32 = 1 << 16;

/// A node of the octree: level, key and points in millimetres from the lowest corner of the cube.
type Node = (i32, [i32; 3], Vec<[i32; 3]>);

/// Writes positions as COPC in millimetres, with `capacity` points a node, and UTM 32N (EPSG 25832). The positions must lie
/// within 131 m.
pub fn write_copc(
    out: &mut dyn Write,
    positions: impl Iterator<Item = [f64; 3]> + Clone,
    capacity: usize,
) -> io::Result<()> {
    let corner =
        positions.clone().fold([f64::INFINITY; 3], |low, p| std::array::from_fn(|axis| low[axis].min(p[axis])));
    let corner = corner.map(f64::floor);
    let millimetres = |p: [f64; 3]| std::array::from_fn(|axis| ((p[axis] - corner[axis]) * 1e3).round() as i32);
    let points: Vec<[i32; 3]> = positions.map(millimetres).collect();
    let bound = |axis: usize, pick: fn(i32, i32) -> i32| {
        let value = points.iter().map(|point| point[axis]).reduce(pick).unwrap_or_default();
        f64::from(value) * 0.001 + corner[axis]
    };
    let bounds: Vec<f64> = (0..3).flat_map(|axis| [bound(axis, i32::max), bound(axis, i32::min)]).collect();

    let mut vlr_items = LazItemRecordBuilder::new();
    let items = vlr_items.add_item(LazItemType::Point14).build();
    let vlr = LazVlrBuilder::new(items.clone()).with_variable_chunk_size().build();
    let mut laszip = Vec::new();
    vlr.write_to(&mut laszip).map_err(io::Error::other)?;
    let wkt = b"PROJCS[\"ETRS89 / UTM zone 32N\",UNIT[\"metre\",1],AUTHORITY[\"EPSG\",\"25832\"]]\0";
    let data_offset = 375 + (54 + 160) + (54 + laszip.len()) + (54 + wkt.len());

    let (mut chunks, mut table, mut entries) = (Vec::new(), ChunkTable::default(), Vec::new());
    for (level, key, points) in nodes(&points, capacity) {
        let mut compressor = LayeredPointRecordCompressor::new(Cursor::new(Vec::new()));
        compressor.set_fields_from(&items).map_err(io::Error::other)?;
        for point in &points {
            let mut record = [0; 30];
            (0..3).for_each(|axis| record[4 * axis..4 * axis + 4].copy_from_slice(&point[axis].to_le_bytes()));
            record[14] = 0x11;
            compressor.compress_next(&record)?;
        }
        compressor.done()?;
        let chunk = compressor.into_inner().into_inner();
        [level, key[0], key[1], key[2]].iter().for_each(|v| entries.extend(v.to_le_bytes()));
        entries.extend((data_offset as u64 + 8 + chunks.len() as u64).to_le_bytes());
        [chunk.len(), points.len()].iter().for_each(|&v| entries.extend((v as i32).to_le_bytes()));
        table.push(ChunkTableEntry { point_count: points.len() as u64, byte_count: chunk.len() as u64 });
        chunks.extend(chunk);
    }
    let mut end = Cursor::new(Vec::new());
    table.write_to(&mut end, &vlr)?;
    let (end, table_at) = (end.into_inner(), data_offset + 8 + chunks.len());
    let octree_at = table_at + end.len();

    let mut header = b"LASF".to_vec();
    header.resize(6, 0);
    header.extend(0x10_u16.to_le_bytes());
    header.resize(24, 0);
    header.extend([1, 4]);
    header.resize(94, 0);
    header.extend(375_u16.to_le_bytes());
    header.extend((data_offset as u32).to_le_bytes());
    header.extend(3_u32.to_le_bytes());
    header.push(6 | 0x80);
    header.extend(30_u16.to_le_bytes());
    header.resize(131, 0);
    header.extend([0.001; 3].iter().chain(&corner).chain(&bounds).flat_map(|v: &f64| v.to_le_bytes()));
    header.resize(235, 0);
    header.extend((octree_at as u64).to_le_bytes());
    header.extend(1_u32.to_le_bytes());
    header.extend((points.len() as u64).to_le_bytes());
    header.extend((points.len() as u64).to_le_bytes());
    header.resize(375, 0);
    let mut info: Vec<u8> = Vec::new();
    let half = f64::from(HALF) * 0.001;
    let [x, y, z] = corner.map(|v| v + half);
    info.extend([x, y, z, half, 1.0].iter().flat_map(|v| v.to_le_bytes()));
    info.extend((octree_at as u64 + 60).to_le_bytes());
    info.extend((entries.len() as u64).to_le_bytes());
    info.resize(160, 0);
    for (user, number, content) in
        [("copc", 1, &info[..]), ("laszip encoded", 22204, &laszip), ("LASF_Projection", 2112, wkt)]
    {
        header.extend(record_start(user, number, &(content.len() as u16).to_le_bytes()));
        header.extend(content);
    }
    header.extend((table_at as u64).to_le_bytes());
    let octree = record_start("copc", 1000, &(entries.len() as u64).to_le_bytes());
    [header, chunks, end, octree, entries].iter().try_for_each(|part| out.write_all(part))
}

fn record_start(user: &str, number: u16, length: &[u8]) -> Vec<u8> {
    let mut start = vec![0; 2];
    start.extend(user.as_bytes());
    start.resize(18, 0);
    start.extend(number.to_le_bytes());
    start.extend(length);
    start.resize(start.len() + 32, 0);
    start
}

/// The nodes of an octree, level by level. A node keeps points spread over its own, and its children get the others.
fn nodes(points: &[[i32; 3]], capacity: usize) -> Vec<Node> {
    let (mut open, mut done) = (VecDeque::from([(0, [0; 3], points.to_vec())]), Vec::new());
    while let Some((level, key, points)) = open.pop_front() {
        let stride = points.len().div_ceil(capacity);
        let (mut kept, mut children) = (Vec::new(), vec![Vec::new(); 8]);
        let side = (2 * HALF) >> (level + 1);
        for (index, point) in points.into_iter().enumerate() {
            match index % stride {
                0 => kept.push(point),
                _ => children[(0..3).map(|axis| (((point[axis] / side) & 1) as usize) << axis).sum::<usize>()]
                    .push(point),
            }
        }
        done.push((level, key, kept));
        for (octant, points) in children.into_iter().enumerate().filter(|(_, points)| !points.is_empty()) {
            let key = std::array::from_fn(|axis| 2 * key[axis] + (octant >> axis & 1) as i32);
            open.push_back((level + 1, key, points));
        }
    }
    done
}
