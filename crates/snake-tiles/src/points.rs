//! The points of the tiles on disk.
//!
//! A file contains the points of a tile in the order of the cloud. Each point is stored as x, y and
//! z in `f32` and its index in the cloud in `u64`, little-endian.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};

use snake_geometry::Point;
use snake_io::sync_folder;

use crate::folder::RunFolder;
use crate::plan::{Tile, points_file};
use crate::{Error, Result};

/// Bytes of a point.
const RECORD: usize = 20;

/// Number of bytes that are buffered before they are written to their files.
const BUFFERED: usize = 128 << 20;

/// Number of bytes that are read at once: whole points.
const PART: u64 = 50_000 * RECORD as u64;

/// Sorts points into the files of their tiles.
pub(crate) struct PointWriter<'a> {
    folder: &'a RunFolder,
    /// For each tile, the number of its points and the bytes of its last points, which are not yet written.
    tiles: BTreeMap<[i32; 2], (u64, Vec<u8>)>,
    buffered: usize,
}

impl<'a> PointWriter<'a> {
    pub(crate) fn new(folder: &'a RunFolder) -> Self {
        Self { folder, tiles: BTreeMap::new(), buffered: 0 }
    }

    /// Adds a point to the tile at a place.
    pub(crate) fn add(&mut self, place: [i32; 2], point: Point, index: u64) -> Result<()> {
        let (number, buffer) = self.tiles.entry(place).or_default();
        point.iter().for_each(|v| buffer.extend(v.to_le_bytes()));
        buffer.extend(index.to_le_bytes());
        *number += 1;
        self.buffered += RECORD;
        if self.buffered >= BUFFERED { self.write() } else { Ok(()) }
    }

    /// Writes the buffered points, over those of a killed run.
    fn write(&mut self) -> Result<()> {
        for (&place, (number, buffer)) in &mut self.tiles {
            let path = self.folder.to_write(&points_file(place))?;
            let start = *number * RECORD as u64 - buffer.len() as u64;
            let write = || {
                let mut file = File::options().write(true).create(true).truncate(false).open(&path)?;
                file.seek(SeekFrom::Start(start))?;
                file.write_all(buffer)
            };
            write().map_err(Error::file(&path))?;
            *buffer = Vec::new();
        }
        self.buffered = 0;
        Ok(())
    }

    /// Writes the remaining points, and waits until all points are on the disk.
    pub(crate) fn finish(&mut self) -> Result<()> {
        self.write()?;
        for &place in self.tiles.keys() {
            let path = self.folder.to_write(&points_file(place))?;
            File::open(&path).and_then(|file| file.sync_all()).map_err(Error::file(&path))?;
        }
        sync_folder(&self.folder.path.join("points"));
        Ok(())
    }

    /// The tiles, ordered by place.
    pub(crate) fn tiles(&self) -> Vec<Tile> {
        self.tiles.iter().map(|(&place, &(num_points, _))| Tile { place, num_points }).collect()
    }
}

/// Calls `found` with each point of a tile and its index.
///
/// # Errors
/// [`Error::Core`]; [`Error::Damaged`], after the points, for a file whose number of points is not that of the tile.
pub(crate) fn for_each_point(folder: &RunFolder, tile: &Tile, mut found: impl FnMut(Point, u64)) -> Result<()> {
    let path = folder.path.join(points_file(tile.place));
    let mut file = File::open(&path).map_err(Error::file(&path))?;
    let (mut length, mut part) = (0, Vec::new());
    loop {
        part.clear();
        length += (&mut file).take(PART).read_to_end(&mut part).map_err(Error::file(&path))? as u64;
        for record in part.as_chunks::<RECORD>().0 {
            let (axes, _) = record.as_chunks::<4>();
            let [low, high] = [axes[3], axes[4]].map(|half| u64::from(u32::from_le_bytes(half)));
            found(std::array::from_fn(|axis| f32::from_le_bytes(axes[axis])), high << 32 | low);
        }
        if part.is_empty() {
            break;
        }
    }
    if length == tile.num_points * RECORD as u64 {
        Ok(())
    } else {
        Err(Error::damaged(&path, "its length is another one"))
    }
}
