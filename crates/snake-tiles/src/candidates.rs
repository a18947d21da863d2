//! The candidates of a tile on disk, as safetensors: `position` `(N, 3)`, `saliency`, `occupancy` and `cell` `(N, 3)`. The
//! metadata has the bounds of the positions along x and y, and the counts.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use snake_core::{Candidate, Counts, Point, TileCandidates};

use crate::{Error, Result};

/// What is known of a tile's candidates without them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Summary {
    /// The lowest and the highest x and y; `None` without candidates.
    pub(crate) bounds: Option<[[f32; 2]; 2]>,
    pub(crate) counts: Counts,
}

pub(crate) fn path(folder: &Path, [x, y]: [i32; 2]) -> PathBuf {
    folder.join("candidates").join(format!("{x}_{y}.safetensors"))
}

/// Writes the candidates of the tile at a place.
pub(crate) fn write(folder: &Path, place: [i32; 2], found: &TileCandidates) -> Result<()> {
    let path = path(folder, place);
    let candidates = &found.candidates;
    let widened = |bounds: Option<[[f32; 2]; 2]>, candidate: &Candidate| {
        let [x, y, _] = candidate.position;
        let [low, high] = bounds.unwrap_or([[x, y]; 2]);
        Some([[low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]])
    };
    let bounds = candidates.iter().fold(None, widened);
    let summary = Summary { bounds, counts: found.counts };
    let positions: Vec<u8> = candidates.iter().flat_map(|c| bytemuck::cast::<_, [u8; 12]>(c.position)).collect();
    let cells: Vec<u8> = candidates.iter().flat_map(|c| bytemuck::cast::<_, [u8; 12]>(c.cell)).collect();
    let of = |value: fn(&Candidate) -> f32| -> Vec<u8> {
        candidates.iter().flat_map(|candidate| value(candidate).to_ne_bytes()).collect()
    };
    let (saliency, occupancy) = (of(|c| c.saliency), of(|c| c.occupancy));
    let number = candidates.len();
    let tensors = [
        ("position", Dtype::F32, vec![number, 3], &positions),
        ("saliency", Dtype::F32, vec![number], &saliency),
        ("occupancy", Dtype::F32, vec![number], &occupancy),
        ("cell", Dtype::I32, vec![number, 3], &cells),
    ]
    .map(|(name, dtype, shape, bytes)| TensorView::new(dtype, shape, bytes).map(|view| (name, view)));
    let fill = |file: &mut dyn std::io::Write| {
        let tensors = tensors.into_iter().collect::<std::result::Result<Vec<_>, _>>().map_err(std::io::Error::other)?;
        let metadata = [("summary".to_owned(), serde_json::to_string(&summary)?)].into_iter().collect();
        file.write_all(&safetensors::serialize(tensors, Some(metadata)).map_err(std::io::Error::other)?)
    };
    snake_io::write_atomically(&path, fill).map_err(Error::file(&path))
}

/// Bytes that the header of a file may have.
const MAX_HEADER: u64 = 1 << 20;

/// Reads the summary of the tile at a place, without its candidates. A file of another length than its header says is an
/// error.
pub(crate) fn read_summary(folder: &Path, place: [i32; 2]) -> Result<Summary> {
    let path = path(folder, place);
    let mut file = File::open(&path).map_err(Error::file(&path))?;
    let mut summary = || {
        let mut length = [0; 8];
        file.read_exact(&mut length).map_err(|e| e.to_string())?;
        let mut header = Vec::new();
        let length = u64::from_le_bytes(length).min(MAX_HEADER);
        (&mut file).take(length).read_to_end(&mut header).map_err(|e| e.to_string())?;
        let header: HashMap<String, Value> = serde_json::from_slice(&header).map_err(|e| e.to_string())?;
        let ends = header.values().filter_map(|tensor| tensor["data_offsets"][1].as_u64());
        let end = 8 + length + ends.max().unwrap_or(0);
        let size = file.metadata().map_err(|e| e.to_string())?.len();
        if size != end {
            return Err(format!("has {size} bytes instead of {end}"));
        }
        let summary = header.get("__metadata__").and_then(|metadata| metadata["summary"].as_str());
        serde_json::from_str(summary.ok_or("no summary")?).map_err(|e| e.to_string())
    };
    summary().map_err(|reason| Error::Damaged { path: path.clone(), reason })
}

/// Reads the candidates of the tile at a place.
pub(crate) fn read(folder: &Path, place: [i32; 2]) -> Result<Vec<Candidate>> {
    let path = path(folder, place);
    let bytes = std::fs::read(&path).map_err(Error::file(&path))?;
    parse(&bytes).map_err(|reason| Error::Damaged { path, reason })
}

fn parse(bytes: &[u8]) -> std::result::Result<Vec<Candidate>, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
    let data = |name| file.tensor(name).map(|tensor| tensor.data()).map_err(|e| e.to_string());
    let positions: Vec<Point> = bytemuck::pod_collect_to_vec(data("position")?);
    let cells: Vec<[i32; 3]> = bytemuck::pod_collect_to_vec(data("cell")?);
    let saliency: Vec<f32> = bytemuck::pod_collect_to_vec(data("saliency")?);
    let occupancy: Vec<f32> = bytemuck::pod_collect_to_vec(data("occupancy")?);
    let values = positions.into_iter().zip(cells).zip(saliency.into_iter().zip(occupancy));
    let candidate = |((position, cell), (saliency, occupancy))| Candidate { position, saliency, occupancy, cell };
    Ok(values.map(candidate).collect())
}
