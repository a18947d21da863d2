//! The points of the tiles on disk.
//!
//! A file holds the points of a tile in the order of the cloud, each as x, y and z in `f32` and its index in the cloud in
//! `u64`, little-endian.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};

use snake_core::Point;

use crate::plan::Tile;
use crate::{Error, Result};

/// Bytes of a point.
const RECORD: usize = 20;

/// Bytes that wait in memory before they are appended to their files.
const BUFFERED: usize = 128 << 20;

fn path(folder: &Path, [x, y]: [i32; 2]) -> PathBuf {
    folder.join("points").join(format!("{x}_{y}.bin"))
}

/// Sorts points into the files of their tiles.
pub(crate) struct PointWriter<'a> {
    folder: &'a Path,
    buffers: HashMap<[i32; 2], Vec<u8>>,
    buffered: usize,
    numbers: HashMap<[i32; 2], u64>,
}

impl<'a> PointWriter<'a> {
    pub(crate) fn new(folder: &'a Path) -> Self {
        Self { folder, buffers: HashMap::new(), buffered: 0, numbers: HashMap::new() }
    }

    /// Adds a point to the tile at a place.
    pub(crate) fn add(&mut self, place: [i32; 2], point: Point, index: u64) -> Result<()> {
        let buffer = self.buffers.entry(place).or_default();
        point.iter().for_each(|v| buffer.extend(v.to_le_bytes()));
        buffer.extend(index.to_le_bytes());
        *self.numbers.entry(place).or_default() += 1;
        self.buffered += RECORD;
        if self.buffered >= BUFFERED { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        for (place, buffer) in self.buffers.drain() {
            let path = path(self.folder, place);
            let file = File::options().append(true).create(true).open(&path);
            file.and_then(|mut file| file.write_all(&buffer)).map_err(Error::file(&path))?;
        }
        self.buffered = 0;
        Ok(())
    }

    /// Writes what is left. Returns the number of points of each tile.
    pub(crate) fn finish(mut self) -> Result<HashMap<[i32; 2], u64>> {
        self.flush()?;
        Ok(self.numbers)
    }
}

/// Opens the points of a tile.
///
/// # Errors
/// [`Error::File`], and [`Error::Damaged`] for another length than that of the tile's points.
pub(crate) fn open(folder: &Path, tile: &Tile) -> Result<File> {
    let path = path(folder, tile.place);
    let file = File::open(&path).map_err(Error::file(&path))?;
    let length = file.metadata().map_err(Error::file(&path))?.len();
    if Some(length) != tile.num_points.checked_mul(RECORD as u64) {
        let reason = format!("has {length} bytes, not those of {} points", tile.num_points);
        return Err(Error::Damaged { path, reason });
    }
    Ok(file)
}

/// Calls `found` with each point of a tile and its index.
pub(crate) fn for_each_point(folder: &Path, tile: &Tile, mut found: impl FnMut(Point, u64)) -> Result<()> {
    let path = path(folder, tile.place);
    let mut file = BufReader::with_capacity(1 << 20, open(folder, tile)?);
    let mut record = [0; RECORD];
    for _ in 0..tile.num_points {
        file.read_exact(&mut record).map_err(Error::file(&path))?;
        let (axes, _) = record.as_chunks::<4>();
        let [low, high] = [axes[3], axes[4]].map(|half| u64::from(u32::from_le_bytes(half)));
        found(std::array::from_fn(|axis| f32::from_le_bytes(axes[axis])), high << 32 | low);
    }
    Ok(())
}
