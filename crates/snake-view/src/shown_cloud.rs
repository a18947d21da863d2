//! A cloud on the page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use snake_core::{Chosen, Control, Detection, Field, MeshOptions, Result};
use snake_geometry::{Mesh, Normalization, Point, add_origin};
use snake_io as io;

use crate::vertices::Vertices;

/// Maximum number of points of a cloud on the page. Larger clouds are subsampled to keep the file small.
const MAX_SHOWN: usize = 400_000;
/// Numbers of samples of the surface along each axis, tried in this order until the mesh has few enough triangles.
const SURFACE_RESOLUTIONS: [usize; 4] = [96, 64, 48, 32];
/// Maximum number of triangles of a surface on the page.
const MAX_TRIANGLES: usize = 100_000;

/// A cloud with its field, surface and keypoints.
pub struct ShownCloud {
    /// The name on the page.
    pub name: String,
    /// Offset to add to all positions of the cloud.
    pub origin: [f64; 3],
    /// The field of the whole cloud.
    pub field: Field,
    /// The points that the page shows.
    pub shown: Vec<Point>,
    /// The outer surface.
    pub surface: Mesh,
    /// Saliency of the shown points and of the surface's vertices.
    pub saliency: [Vec<f32>; 2],
    /// Its keypoints.
    pub detection: Detection,
    /// Why there are few keypoints.
    pub note: Option<String>,
    /// Annotated keypoints to show beside the detected ones, relative to the origin.
    pub annotations: Vec<Point>,
}

impl ShownCloud {
    /// Encodes a cloud with its model, detects its keypoints and computes everything that the page shows.
    ///
    /// # Errors
    /// The errors of [`Chosen::detect`].
    pub fn detect(chosen: &Chosen, name: String, control: &Control) -> Result<Self> {
        let field = chosen.encode(control)?;
        let detection = field.detect_with(&chosen.options.detect, control)?;
        let note = detection.note(&chosen.options.detect);
        let points = field.points();
        let shown = subsample(points);
        let surface = surface(&field, control)?;
        let saliency = [field.saliency(&shown)?, field.saliency(&surface.vertices)?];
        let (origin, annotations) = (chosen.origin, Vec::new());
        Ok(Self { name, origin, field, shown, surface, saliency, detection, note, annotations })
    }

    /// The positions of the keypoints, relative to the origin.
    pub fn keypoint_positions(&self) -> Vec<Point> {
        self.detection.keypoints.iter().map(|keypoint| keypoint.position).collect()
    }

    /// A text if points were left out or if there are few keypoints.
    pub fn hint(&self) -> Option<String> {
        self.field.findings().into_iter().chain(self.note.clone()).reduce(|first, second| format!("{first}; {second}"))
    }

    /// A line for the printed report.
    pub fn summary(&self) -> String {
        let (keypoints, points) = (self.detection.keypoints.len(), self.field.points().len());
        let mut text = format!("{}: {keypoints} keypoints from {points} points", self.name);
        if self.field.num_skipped() > 0 {
            text +=
                &format!(" ({} skipped, which are not finite, outliers or missing returns)", self.field.num_skipped());
        }
        if self.shown.len() < points {
            text += &format!(" ({} shown)", self.shown.len());
        }
        text
    }

    pub(crate) fn data(&self) -> Value {
        let keypoints = self.detection.keypoints.iter().map(|keypoint| io::keypoint_json(keypoint, self.origin));
        let keypoints: Vec<Value> = keypoints.collect();
        let annotations: Vec<[f64; 3]> = self.annotations.iter().map(|&at| add_origin(at, self.origin)).collect();
        let Normalization { center, scale } = self.field.normalization();
        json!({
            "name": self.name,
            "points": Vertices::of(&self.shown, self.origin, &self.saliency[0]),
            "surface": self.surface_data(),
            "keypoints": keypoints,
            "annotations": annotations,
            "hint": self.hint(),
            "num_points": self.field.points().len(),
            "num_skipped": self.field.num_skipped(),
            "num_encoded": self.field.num_encoded(),
            "counts": self.detection.counts,
            "voxel_size": self.detection.voxel_size,
            "normalization": { "center": add_origin(center, self.origin), "scale": scale },
        })
    }

    /// The surface, if there is one. A normal is four signed bytes: x, y and z times 127, and padding. Triangles
    /// are 32-bit indices. Both are base64.
    fn surface_data(&self) -> Option<Value> {
        let Mesh { vertices, normals, triangles, .. } = &self.surface;
        let normals = normals.iter().flat_map(|[x, y, z]| [*x, *y, *z, 0.0].map(|v| (v * 127.0).round() as i8 as u8));
        let indices = triangles.as_flattened().iter().flat_map(|index| index.to_le_bytes());
        (!triangles.is_empty()).then(|| {
            json!({
                "count": triangles.len(),
                "vertices": Vertices::of(vertices, self.origin, &self.saliency[1]),
                "normals": STANDARD.encode(normals.collect::<Vec<u8>>()),
                "triangles": STANDARD.encode(indices.collect::<Vec<u8>>()),
            })
        })
    }
}

/// Every n-th point, with the smallest n that gives few enough points.
pub(crate) fn subsample(points: &[Point]) -> Vec<Point> {
    points.iter().step_by(points.len().div_ceil(MAX_SHOWN).max(1)).copied().collect()
}

/// The outer surface, at the finest resolution with at most [`MAX_TRIANGLES`] triangles.
fn surface(field: &Field, control: &Control) -> Result<Mesh> {
    let mut mesh = Mesh::default();
    for resolution in SURFACE_RESOLUTIONS {
        mesh = field.mesh_with(&MeshOptions::default().with_resolution(resolution).with_outer(true), control)?;
        if mesh.triangles.len() <= MAX_TRIANGLES {
            break;
        }
    }
    Ok(mesh)
}
