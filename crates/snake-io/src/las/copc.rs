//! Cloud-optimised point clouds (COPC): LAZ files whose chunks are the nodes of an octree, so that a part of the cloud can
//! be read by its bounds.
//!
//! The chunks are decoded like those of any LAZ file. The reader trusts neither the octree nor the bounds in the header: a
//! point outside them is an error, because a part of the cloud would miss it.

use std::fmt::Debug;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use laz::{LazItem, LazVlr};
use snake_geometry::Bounds;

use crate::crs::Crs;
use crate::las::{HEADER_SIZE, Header, check_items, field};
use crate::{Error, MAX_EXPANSION, Result};

/// The position of the octree's record, which comes first, and its size.
const INFO: Range<usize> = 375..375 + 54 + 160;

/// Bytes of an entry of the octree.
const ENTRY: usize = 32;

/// The deepest level of an octree.
const MAX_LEVEL: i32 = 30;

/// A file that is read by ranges of bytes, on disk or behind a server.
pub trait Ranges: Debug + Send + Sync {
    /// The name of the file for messages, which also identifies it.
    fn path(&self) -> &Path;

    /// Number of bytes.
    ///
    /// # Errors
    /// When the file is not available.
    fn length(&self) -> io::Result<u64>;

    /// A text that changes when the file changes.
    ///
    /// # Errors
    /// When the file is not available.
    fn version(&self) -> io::Result<String>;

    /// The bytes of a range.
    ///
    /// # Errors
    /// When not all of them can be read.
    fn read(&self, range: Range<u64>) -> io::Result<Vec<u8>>;
}

/// A file on disk.
#[derive(Debug)]
pub struct LocalFile {
    path: PathBuf,
}

impl LocalFile {
    /// The file at a path.
    ///
    /// # Errors
    /// When the file is not available.
    pub fn new(path: &Path) -> io::Result<Self> {
        Ok(Self { path: path.canonicalize()? })
    }
}

impl Ranges for LocalFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn length(&self) -> io::Result<u64> {
        Ok(self.path.metadata()?.len())
    }

    fn version(&self) -> io::Result<String> {
        Ok(format!("{:?}", self.path.metadata()?.modified()?))
    }

    fn read(&self, range: Range<u64>) -> io::Result<Vec<u8>> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(range.start))?;
        let mut bytes = Vec::new();
        file.take(range.end - range.start).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// An open COPC file.
#[derive(Debug, Clone)]
pub struct Copc {
    source: Arc<dyn Ranges>,
    header: Arc<Header>,
    items: Vec<LazItem>,
    /// In the order of the file.
    nodes: Vec<Node>,
    bounds: Bounds,
    crs: Option<Crs>,
}

/// A node of the octree that has points.
#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Bounds,
    /// Its chunk in the file.
    offset: u64,
    size: u64,
    num_points: u64,
    /// The index of its first point in the file.
    first: u64,
}

impl Copc {
    /// Opens a file; `None` when it is not a COPC file.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Format`] for a damaged COPC file.
    pub fn open(source: Arc<dyn Ranges>) -> Result<Option<Self>> {
        let length = source.length().map_err(io_error(&*source))?;
        let start = read(&*source, 0..length.min(INFO.end as u64))?;
        let is_copc = start.starts_with(b"LASF") && start.get(377..382) == Some(b"copc\0") && start.len() == INFO.end;
        if !is_copc {
            return Ok(None);
        }
        let header = Header::parse(&start[..HEADER_SIZE as usize]).map_err(format_error(&*source))?;
        let data_offset = header.data_offset as u64;
        if data_offset > length {
            return Err(format_error(&*source)("cut short before the points".into()));
        }
        let head = read(&*source, 0..data_offset)?;
        let items = items(&header, &head, length).map_err(format_error(&*source))?;
        let bounds =
            bounds(&start).ok_or("header: the bounds are not finite".into()).map_err(format_error(&*source))?;
        let nodes = nodes(&*source, &start[INFO][54..], length)?;
        let nodes = in_order(nodes, length, header.num_points as u64).map_err(format_error(&*source))?;
        let crs = header.crs(&head, &mut |range| read(&*source, range).ok());
        Ok(Some(Self { source, header: Arc::new(header), items, nodes, bounds, crs }))
    }

    /// The file.
    pub fn source(&self) -> &dyn Ranges {
        &*self.source
    }

    /// Number of points.
    pub fn num_points(&self) -> u64 {
        self.header.num_points as u64
    }

    /// The bounds of the points, in the units of the file.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The coordinate reference system.
    pub fn crs(&self) -> Option<&Crs> {
        self.crs.as_ref()
    }

    /// The bounds of each node of the octree, and its number of points.
    pub fn nodes(&self) -> impl Iterator<Item = (Bounds, u64)> {
        self.nodes.iter().map(|node| (node.bounds, node.num_points))
    }

    /// Calls `found` with the index in the file and the position of all points in a rectangle along x and
    /// y, given by its lowest and its highest corner, in the units of the file. Because whole nodes are
    /// read, it also gets points outside. Points that are withheld or classified as noise are left out.
    ///
    /// # Errors
    /// [`Error::Io`] when a chunk cannot be read; [`Error::Format`] for a damaged chunk, and for points outside their node or
    /// the bounds of the file.
    pub fn for_each_position_in(&self, [low, high]: [[f64; 2]; 2], found: &mut dyn FnMut(u64, [f64; 3])) -> Result<()> {
        let all = self.widened(self.bounds);
        for node in &self.nodes {
            let bounds = self.widened(node.bounds);
            if !(0..2).all(|axis| bounds.low[axis] <= high[axis] && low[axis] <= bounds.high[axis]) {
                continue;
            }
            let chunk = read(&*self.source, node.offset..node.offset + node.size)?;
            let (mut index, mut outside) = (node.first, None);
            let (header, first) = (&*self.header, node.first as usize);
            let decoded = header.chunk(&self.items, first, chunk.len(), &mut &chunk[..], &mut |record| {
                let position = header.position(record);
                if !(contains(&bounds, position) && contains(&all, position)) {
                    outside = Some(position);
                }
                if !header.is_withheld(record) {
                    found(index, position);
                }
                index += 1;
            });
            let (count, _) = decoded.map_err(format_error(&*self.source))?;
            if count as u64 != node.num_points {
                return Err(format_error(&*self.source)(header.damaged(first)));
            }
            if let Some(position) = outside {
                let reason = format!("the point {position:?} lies outside of its node of the octree or of the bounds");
                return Err(format_error(&*self.source)(reason));
            }
        }
        Ok(())
    }

    /// Bounds with a margin of two steps of the coordinates, because writers round these after they sort points into nodes.
    fn widened(&self, Bounds { low, high }: Bounds) -> Bounds {
        let margin = |axis: usize| 2.0 * self.header.scale[axis].abs();
        Bounds {
            low: std::array::from_fn(|axis| low[axis] - margin(axis)),
            high: std::array::from_fn(|axis| high[axis] + margin(axis)),
        }
    }
}

fn contains(bounds: &Bounds, position: [f64; 3]) -> bool {
    (0..3).all(|axis| (bounds.low[axis]..=bounds.high[axis]).contains(&position[axis]))
}

fn io_error(source: &dyn Ranges) -> impl Fn(io::Error) -> Error {
    let path = source.path().to_owned();
    move |source| Error::Io { path: path.clone(), source }
}

fn format_error(source: &dyn Ranges) -> impl Fn(String) -> Error {
    let path = source.path().to_owned();
    move |reason| Error::Format { path: path.clone(), reason }
}

/// Reads a range that lies in the file.
fn read(source: &dyn Ranges, range: Range<u64>) -> Result<Vec<u8>> {
    let length = range.end - range.start;
    let bytes = source.read(range).map_err(io_error(source))?;
    if bytes.len() as u64 == length {
        Ok(bytes)
    } else {
        Err(format_error(source)(format!("{length} bytes were asked for and {} came", bytes.len())))
    }
}

/// The parts of a point.
fn items(header: &Header, head: &[u8], length: u64) -> std::result::Result<Vec<LazItem>, String> {
    let size = header.num_points.checked_mul(header.record_length);
    if !header.is_compressed || size.is_none_or(|size| (size / MAX_EXPANSION) as u64 > length) {
        return Err(format!("{} points of {} bytes in {length} bytes", header.num_points, header.record_length));
    }
    let record = header.laszip_record(head).ok_or("no record says how the points are compressed")?;
    let vlr = LazVlr::from_buffer(record).map_err(|e| format!("compression: {e}"))?;
    check_items(vlr.items(), header.record_length)?;
    if vlr.items()[0].version() >= 3 {
        Ok(vlr.items().clone())
    } else {
        Err("compression: the points are not in layers".into())
    }
}

/// The bounds in the header of a file: for each axis the highest and the lowest coordinate.
fn bounds(start: &[u8]) -> Option<Bounds> {
    let number = |index: usize| field(start, 179 + 8 * index).map(f64::from_le_bytes).filter(|v| v.is_finite());
    let mut bounds = Bounds::default();
    for axis in 0..3 {
        (bounds.high[axis], bounds.low[axis]) = (number(2 * axis)?, number(2 * axis + 1)?);
    }
    Some(bounds)
}

/// Reads the octree, page by page. `info` is the content of its record.
fn nodes(source: &dyn Ranges, info: &[u8], length: u64) -> Result<Vec<Node>> {
    let damaged = || format_error(source)("the octree is damaged".into());
    let number = |index: usize| field(info, 8 * index).map(f64::from_le_bytes).filter(|v| v.is_finite());
    let cube: Option<Vec<f64>> = (0..4).map(number).collect();
    let Some(&[x, y, z, half]) = cube.as_deref() else { return Err(damaged()) };
    let whole = |index: usize| field(info, 8 * index).map(u64::from_le_bytes);
    let mut pages = vec![whole(5).zip(whole(6)).ok_or_else(damaged)?];
    let (mut nodes, mut left) = (Vec::new(), length);
    while let Some((offset, size)) = pages.pop() {
        // All pages together are smaller than the file, so cyclic references end.
        left = left.checked_sub(size.max(1)).ok_or_else(damaged)?;
        let end = offset.checked_add(size).filter(|end| *end <= length).ok_or_else(damaged)?;
        for entry in read(source, offset..end)?.as_chunks::<ENTRY>().0 {
            let (words, _) = entry.as_chunks::<4>();
            let [level, key @ ..]: [i32; 4] = std::array::from_fn(|index| i32::from_le_bytes(words[index]));
            let [size, number] = [6, 7].map(|index| i32::from_le_bytes(words[index]));
            let at = u64::from_le_bytes(field(entry, 16).unwrap_or_default());
            let size = u64::try_from(size).map_err(|_| damaged())?;
            let is_key = (0..=MAX_LEVEL).contains(&level) && key.iter().all(|v| (0..1 << level).contains(v));
            match number {
                -1 => pages.push((at, size)),
                0 => {}
                1.. if is_key => {
                    let side = 2.0 * half / f64::from(1 << level);
                    let low = std::array::from_fn(|axis| [x, y, z][axis] - half + f64::from(key[axis]) * side);
                    let bounds = Bounds { low, high: low.map(|v| v + side) };
                    nodes.push(Node { bounds, offset: at, size, num_points: number as u64, first: 0 });
                }
                _ => return Err(damaged()),
            }
        }
    }
    Ok(nodes)
}

/// Sorts the nodes by their position in the file and counts their points.
fn in_order(mut nodes: Vec<Node>, length: u64, num_points: u64) -> std::result::Result<Vec<Node>, String> {
    nodes.sort_unstable_by_key(|node| node.offset);
    let (mut end, mut first) = (0, 0);
    for node in &mut nodes {
        let begin = node.offset;
        if begin < end || begin.checked_add(node.size).is_none_or(|end| end > length) {
            return Err(format!("the octree is damaged: a chunk begins at byte {begin} of {length}"));
        }
        end = begin + node.size;
        node.first = first;
        first += node.num_points;
    }
    if first == num_points {
        Ok(nodes)
    } else {
        Err(format!("the octree has {first} points and the header {num_points}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn damaged_copc_files_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let scan = folder.path().join("city.copc.laz");
        let bytes = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiles/city.copc.laz")).unwrap();
        let octree = u64::from_le_bytes(bytes[375 + 54 + 40..][..8].try_into().unwrap()) as usize;
        let outcome = |at: usize, replacement: &[u8]| -> String {
            let mut bytes = bytes.clone();
            bytes[at..at + replacement.len()].copy_from_slice(replacement);
            fs::write(&scan, bytes).unwrap();
            let source = Arc::new(LocalFile::new(&scan).unwrap());
            let outcome = Copc::open(source).and_then(|file| match file {
                Some(file) => file.for_each_position_in([[-1e9; 2], [1e9; 2]], &mut |_, _| ()).map(|()| "read"),
                None => Ok("not COPC"),
            });
            outcome.map_or_else(|error| error.to_string(), Into::into)
        };
        assert_eq!(outcome(0, b"LASF"), "read");
        assert_eq!(outcome(377, b"none"), "not COPC");
        let chunk = u64::from_le_bytes(bytes[octree + 16..][..8].try_into().unwrap()) as usize;
        for (at, replacement, expected) in [
            (375 + 54 + 40, &u64::MAX.to_le_bytes()[..], "the octree is damaged"),
            (375 + 54 + 24, &f64::NAN.to_le_bytes(), "the octree is damaged"),
            (octree, &77_i32.to_le_bytes(), "the octree is damaged"),
            (octree + 28, &(-7_i32).to_le_bytes(), "the octree is damaged"),
            (octree + 28, &7_i32.to_le_bytes(), "points and the header 12000"),
            (octree + 24, &(1_i32 << 30).to_le_bytes(), "a chunk begins"),
            (octree + 24, &40_i32.to_le_bytes(), "damaged or cut short"),
            (chunk + 30, &[0; 4], "damaged or cut short"),
            (chunk, &i32::MAX.to_le_bytes(), "outside of its node"),
            (179, &691_010.0_f64.to_le_bytes(), "outside of its node"),
            (179, &f64::INFINITY.to_le_bytes(), "not finite"),
        ] {
            let text = outcome(at, replacement);
            assert!(text.contains(expected), "{expected}: {text}");
        }

        // The first page of the octree refers to itself.
        let mut page = [0; 16];
        page[..8].copy_from_slice(&(octree as u64).to_le_bytes());
        page[8..12].copy_from_slice(&(32_i32).to_le_bytes());
        page[12..].copy_from_slice(&(-1_i32).to_le_bytes());
        assert!(outcome(octree + 16, &page).contains("the octree is damaged"));
    }
}
