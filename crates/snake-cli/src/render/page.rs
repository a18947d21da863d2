//! One page with clouds, keypoints and surfaces: markup, style, script and data in a single file.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use snake_core::{Detection, Field, Mesh, Normalization, Options, Point, RigidTransform, add_origin};
use snake_io as io;
use snake_registration::Registration;

use super::colormap::Colormap;

const BODY: &str = include_str!("page/body.html");
const STYLE: &str = include_str!("page/style.css");
const SCRIPTS: [&str; 2] = [include_str!("page/scene.js"), include_str!("page/controls.js")];

/// The content of the page.
pub struct Page {
    /// One or two clouds.
    pub clouds: Vec<ShownCloud>,
    /// Present if there are two clouds.
    pub pair: Option<Pair>,
    pub options: Options,
    pub model_name: String,
    pub colormap: Colormap,
}

/// A cloud with its field, surface and keypoints.
pub struct ShownCloud {
    pub name: String,
    /// Offset to add to all positions of the cloud.
    pub origin: [f64; 3],
    pub field: Field,
    /// The points that the page shows.
    pub shown: Vec<Point>,
    pub surface: Mesh,
    /// Saliency of the shown points and of the surface's vertices.
    pub saliency: [Vec<f32>; 2],
    pub detection: Detection,
}

/// The alignment of two clouds and their repeated keypoints.
pub struct Pair {
    /// Maps a point of the second cloud to the first; the origins are included.
    pub t_first_second: RigidTransform,
    /// The registration that found the transform; `None` if the user gave it.
    pub registration: Option<Registration>,
    pub epsilon: f64,
    /// For each keypoint of the first cloud: the index of the keypoint of the second that repeats it, and their
    /// distance.
    pub partners: Vec<Option<(usize, f64)>>,
}

impl Page {
    /// The whole file.
    pub fn html(&self) -> serde_json::Result<String> {
        let names: Vec<&str> = self.clouds.iter().map(|cloud| cloud.name.as_str()).collect();
        let title = escaped(&names.join(" + "));
        // Only "<" could end the script element or begin a comment in it.
        let data = serde_json::to_string(&self.data())?.replace('<', "\\u003c");
        let script = SCRIPTS.join("\n");
        Ok(format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; \
             script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:\">\n\
             <link rel=\"icon\" href=\"data:,\">\n<title>{title}: keypoints</title>\n\
             <style>\n{STYLE}</style>\n</head>\n<body>\n{BODY}\
             <script type=\"application/json\" id=\"data\">{data}</script>\n<script>\n{script}</script>\n\
             </body>\n</html>\n"
        ))
    }

    fn data(&self) -> Value {
        let colors: Vec<u8> = (0..=255).flat_map(|i| self.colormap.color(i as f32 / 255.0)).collect();
        let clouds: Vec<Value> = self.clouds.iter().map(ShownCloud::data).collect();
        json!({
            "clouds": clouds,
            "pair": self.pair.as_ref().map(Pair::data),
            "colors": STANDARD.encode(colors),
            "options": self.options,
            "model": self.model_name,
            "version": env!("CARGO_PKG_VERSION"),
        })
    }
}

impl ShownCloud {
    pub fn keypoint_positions(&self) -> Vec<Point> {
        self.detection.keypoints.iter().map(|keypoint| keypoint.position).collect()
    }

    /// A line for the printed report.
    pub fn summary(&self) -> String {
        let (keypoints, points) = (self.detection.keypoints.len(), self.field.points().len());
        let mut text = format!("{}: {keypoints} keypoints from {points} points", self.name);
        if self.field.num_skipped() > 0 {
            text += &format!(" ({} skipped, which are not finite)", self.field.num_skipped());
        }
        if self.shown.len() < points {
            text += &format!(" ({} shown)", self.shown.len());
        }
        text
    }

    fn data(&self) -> Value {
        let keypoints = self.detection.keypoints.iter().map(|keypoint| io::keypoint_json(keypoint, self.origin));
        let keypoints: Vec<Value> = keypoints.collect();
        let Normalization { center, scale } = self.field.normalization();
        json!({
            "name": self.name,
            "points": Vertices::of(&self.shown, self.origin, &self.saliency[0]),
            "surface": self.surface_data(),
            "keypoints": keypoints,
            "num_points": self.field.points().len(),
            "num_skipped": self.field.num_skipped(),
            "num_encoded": self.field.num_encoded(),
            "counts": self.detection.counts,
            "normalization": { "center": add_origin(center, self.origin), "scale": scale },
        })
    }

    /// The surface, if there is one. Normals are four signed bytes, x y z and padding, each 127 times its value.
    /// Triangles are indices of 32 bits. Both are base64.
    fn surface_data(&self) -> Option<Value> {
        let Mesh { vertices, normals, triangles } = &self.surface;
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

impl Pair {
    /// Number of keypoints of the first cloud that repeat.
    fn repeated(&self) -> usize {
        self.partners.iter().flatten().count()
    }

    /// A line for the printed report.
    pub fn summary(&self) -> String {
        let repeated =
            format!("{} of {} keypoints repeat within {:.4}", self.repeated(), self.partners.len(), self.epsilon);
        match &self.registration {
            Some(Registration { num_inliers, num_correspondences, .. }) => {
                format!("{repeated}; {num_inliers} of {num_correspondences} matches agree")
            }
            None => repeated,
        }
    }

    fn data(&self) -> Value {
        let links = self.partners.iter().enumerate();
        let links =
            links.filter_map(|(first, partner)| partner.map(|(second, distance)| json!([first, second, distance])));
        json!({
            "t_first_second": self.t_first_second,
            "registration": self.registration.as_ref().map(|found| [found.num_inliers, found.num_correspondences]),
            "epsilon": self.epsilon,
            "links": links.collect::<Vec<_>>(),
        })
    }
}

/// Quantised vertices. Positions have 16 bits within their bounding box, `low + (high - low) q / 65535`, and saliency
/// has 8 bits within [0, 1]. The error is below a pixel of any screen, and the size is a third of that of floats.
#[derive(serde::Serialize)]
struct Vertices {
    count: usize,
    low: [f64; 3],
    high: [f64; 3],
    /// Little-endian, x y z of one vertex after the other; base64.
    positions: String,
    /// One byte each; base64.
    saliency: String,
}

impl Vertices {
    fn of(points: &[Point], origin: [f64; 3], saliency: &[f32]) -> Self {
        let along = |axis: usize, choose: fn(f64, f64) -> f64, start: f64| {
            points.iter().map(|point| add_origin(*point, origin)[axis]).fold(start, choose)
        };
        let low: [f64; 3] = std::array::from_fn(|axis| along(axis, f64::min, f64::INFINITY));
        let high: [f64; 3] = std::array::from_fn(|axis| along(axis, f64::max, f64::NEG_INFINITY));
        let quantised = |point: &Point| -> [[u8; 2]; 3] {
            std::array::from_fn(|axis| {
                let extent = (high[axis] - low[axis]).max(f64::MIN_POSITIVE);
                let share = (add_origin(*point, origin)[axis] - low[axis]) / extent;
                ((share * 65535.0).round() as u16).to_le_bytes()
            })
        };
        let positions: Vec<[[u8; 2]; 3]> = points.iter().map(quantised).collect();
        let saliency: Vec<u8> = saliency.iter().map(|s| (s * 255.0).round() as u8).collect();
        let positions = STANDARD.encode(positions.as_flattened().as_flattened());
        Self { count: points.len(), low, high, positions, saliency: STANDARD.encode(saliency) }
    }
}

/// Text with the special characters of HTML escaped.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_come_back_within_half_a_step() {
        let points = [[0.0, -5.0, 1e6], [1.0, 5.0, 1e6], [0.3, 0.1, 1e6]];
        let vertices = Vertices::of(&points, [0.0; 3], &[0.0, 1.0, 0.5]);
        let bytes = STANDARD.decode(&vertices.positions).unwrap();
        let (steps, _) = bytes.as_chunks::<2>();
        for (index, step) in steps.iter().enumerate() {
            let axis = index % 3;
            let extent = vertices.high[axis] - vertices.low[axis];
            let value = vertices.low[axis] + extent * f64::from(u16::from_le_bytes(*step)) / 65535.0;
            assert!((value - f64::from(points[index / 3][axis])).abs() <= extent / 65535.0, "{index}");
        }
        assert_eq!(STANDARD.decode(&vertices.saliency).unwrap(), [0, 255, 128]);
    }

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escaped("<a href=\"&\">"), "&lt;a href=&quot;&amp;&quot;&gt;");
    }
}
