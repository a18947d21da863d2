//! The candidates of a tile on disk, as safetensors: `position` `(N, 3)`, `saliency`, `occupancy`, `start`, `rank`, `confidence`,
//! `covariance` `(N, 3, 3)` and `cell` `(N, 3)`. The metadata has the bounds of the positions along x and y, and the counts.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use snake_core::{Candidate, Counts, TileCandidates};
use snake_geometry::Point;

use crate::folder::RunFolder;
use crate::{Error, Result};

/// A summary of a tile's candidates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Summary {
    /// The lowest and the highest x and y; `None` if there are no candidates.
    pub(crate) bounds: Option<[[f32; 2]; 2]>,
    pub(crate) counts: Counts,
}

/// The file name for the tile at a place.
pub(crate) fn name([x, y]: [i32; 2]) -> String {
    format!("candidates/{x}_{y}.safetensors")
}

/// Writes the candidates of the tile at a place.
pub(crate) fn write(folder: &RunFolder, place: [i32; 2], found: &TileCandidates) -> Result<()> {
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
    let covariances: Vec<u8> =
        candidates.iter().flat_map(|c| c.covariance.rows()).flatten().flat_map(f32::to_ne_bytes).collect();
    let (saliency, occupancy, start) = (of(|c| c.saliency), of(|c| c.occupancy), of(|c| c.start));
    let (rank, confidence) = (of(|c| c.rank), of(|c| c.confidence.unwrap_or(f32::NAN)));
    let number = candidates.len();
    let tensors = [
        ("position", Dtype::F32, vec![number, 3], &positions),
        ("saliency", Dtype::F32, vec![number], &saliency),
        ("occupancy", Dtype::F32, vec![number], &occupancy),
        ("start", Dtype::F32, vec![number], &start),
        ("rank", Dtype::F32, vec![number], &rank),
        ("confidence", Dtype::F32, vec![number], &confidence),
        ("covariance", Dtype::F32, vec![number, 3, 3], &covariances),
        ("cell", Dtype::I32, vec![number, 3], &cells),
    ]
    .map(|(name, dtype, shape, bytes)| TensorView::new(dtype, shape, bytes).map(|view| (name, view)));
    let serialized = || -> std::io::Result<Vec<u8>> {
        let tensors = tensors.into_iter().collect::<std::result::Result<Vec<_>, _>>().map_err(std::io::Error::other)?;
        let metadata = [("summary".to_owned(), serde_json::to_string(&summary)?)].into_iter().collect();
        safetensors::serialize(tensors, Some(metadata)).map_err(std::io::Error::other)
    };
    let name = name(place);
    folder.write(&name, &serialized().map_err(Error::file(&folder.path.join(&name)))?)
}

/// Reads the summary of the candidates of the tile at a place.
pub(crate) fn read_summary(folder: &RunFolder, place: [i32; 2]) -> Result<Summary> {
    let name = name(place);
    let bytes = folder.read(&name)?;
    let summary = || {
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| e.to_string())?;
        let summary = header.metadata().as_ref().and_then(|metadata| metadata.get("summary"));
        serde_json::from_str(summary.ok_or("no summary")?).map_err(|e| e.to_string())
    };
    summary().map_err(|reason: String| Error::damaged(&folder.path.join(name), &reason))
}

/// Reads the candidates of the tile at a place.
pub(crate) fn read(folder: &RunFolder, place: [i32; 2]) -> Result<Vec<Candidate>> {
    let name = name(place);
    parse(&folder.read(&name)?).map_err(|reason| Error::damaged(&folder.path.join(&name), &reason))
}

fn parse(bytes: &[u8]) -> std::result::Result<Vec<Candidate>, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| e.to_string())?;
    let data = |name| file.tensor(name).map(|tensor| tensor.data()).map_err(|e| e.to_string());
    let positions: Vec<Point> = bytemuck::pod_collect_to_vec(data("position")?);
    let cells: Vec<[i32; 3]> = bytemuck::pod_collect_to_vec(data("cell")?);
    let of = |name| data(name).map(bytemuck::pod_collect_to_vec::<u8, f32>);
    let covariances: Vec<[[f32; 3]; 3]> = bytemuck::pod_collect_to_vec(data("covariance")?);
    let [saliency, occupancy, start] = [of("saliency")?, of("occupancy")?, of("start")?];
    let [rank, confidence] = [of("rank")?, of("confidence")?];
    let candidate = |i: usize| {
        Some(Candidate {
            position: *positions.get(i)?,
            saliency: *saliency.get(i)?,
            occupancy: *occupancy.get(i)?,
            confidence: Some(*confidence.get(i)?).filter(|confidence| !confidence.is_nan()),
            covariance: (*covariances.get(i)?).into(),
            rank: *rank.get(i)?,
            start: *start.get(i)?,
            cell: *cells.get(i)?,
        })
    };
    (0..positions.len()).map(candidate).collect::<Option<_>>().ok_or_else(|| "tensors of different lengths".into())
}
