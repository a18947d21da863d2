//! The points of the tiles on disk.
//!
//! A file holds the points of a tile in the order of the cloud, each as x, y and z in `f32` and its index in the cloud in
//! `u64`, little-endian.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Write};

use snake_geometry::Point;
use snake_io::sync_folder;

use crate::folder::RunFolder;
use crate::{Error, Result};

/// Bytes of a point.
const RECORD: usize = 20;

/// Bytes that wait in memory before they are appended to their files.
const BUFFERED: usize = 128 << 20;

/// Bytes that are read at once: whole points.
const PART: u64 = 50_000 * RECORD as u64;

/// The name of the file of the tile at a place.
pub(crate) fn name([x, y]: [i32; 2]) -> String {
    format!("points/{x}_{y}.bin")
}

/// The points of a tile that are collected.
#[derive(Default)]
struct Written {
    buffer: Vec<u8>,
    number: u64,
    digest: blake3::Hasher,
}

/// Sorts points into the files of their tiles.
pub(crate) struct PointWriter<'a> {
    folder: &'a RunFolder,
    tiles: BTreeMap<[i32; 2], Written>,
    buffered: usize,
}

impl<'a> PointWriter<'a> {
    pub(crate) fn new(folder: &'a RunFolder) -> Self {
        Self { folder, tiles: BTreeMap::new(), buffered: 0 }
    }

    /// Adds a point to the tile at a place.
    pub(crate) fn add(&mut self, place: [i32; 2], point: Point, index: u64) -> Result<()> {
        let tile = self.tiles.entry(place).or_default();
        point.iter().for_each(|v| tile.buffer.extend(v.to_le_bytes()));
        tile.buffer.extend(index.to_le_bytes());
        tile.number += 1;
        self.buffered += RECORD;
        if self.buffered >= BUFFERED { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        self.folder.list(self.tiles.keys().map(|&place| name(place)))?;
        for (&place, tile) in &mut self.tiles {
            let path = self.folder.own(&name(place))?;
            let file = File::options().append(true).create(true).open(&path);
            file.and_then(|mut file| file.write_all(&tile.buffer)).map_err(Error::file(&path))?;
            tile.digest.update(&tile.buffer);
            tile.buffer = Vec::new();
        }
        self.buffered = 0;
        Ok(())
    }

    /// Writes the remaining points, and waits until all are on the disk. Returns the number of points of each tile by place, and the
    /// digest of its file.
    pub(crate) fn finish(mut self) -> Result<Vec<([i32; 2], u64, String)>> {
        self.flush()?;
        for &place in self.tiles.keys() {
            let path = self.folder.own(&name(place))?;
            File::open(&path).and_then(|file| file.sync_all()).map_err(Error::file(&path))?;
        }
        sync_folder(&self.folder.path().join("points"));
        let tiles = self.tiles.into_iter();
        Ok(tiles.map(|(place, tile)| (place, tile.number, tile.digest.finalize().to_string())).collect())
    }
}

/// Calls `found` with each point of the tile at a place and its index.
///
/// # Errors
/// [`Error::File`], and [`Error::Damaged`] at the end of a file with another content than was written.
pub(crate) fn for_each_point(
    folder: &RunFolder,
    place: [i32; 2],
    digest: &str,
    mut found: impl FnMut(Point, u64),
) -> Result<()> {
    let path = folder.path().join(name(place));
    let mut file = File::open(&path).map_err(Error::file(&path))?;
    let (mut hasher, mut part) = (blake3::Hasher::new(), Vec::new());
    loop {
        part.clear();
        (&mut file).take(PART).read_to_end(&mut part).map_err(Error::file(&path))?;
        if part.is_empty() {
            break;
        }
        hasher.update(&part);
        for record in part.as_chunks::<RECORD>().0 {
            let (axes, _) = record.as_chunks::<4>();
            let [low, high] = [axes[3], axes[4]].map(|half| u64::from(u32::from_le_bytes(half)));
            found(std::array::from_fn(|axis| f32::from_le_bytes(axes[axis])), high << 32 | low);
        }
    }
    if hasher.finalize().to_string() == *digest { Ok(()) } else { Err(Error::damaged(&path)) }
}
