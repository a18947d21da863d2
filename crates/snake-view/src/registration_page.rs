//! The page of a registration: the source moved onto the target, with the matches that agree as lines.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use snake_core::Result;
use snake_geometry::{Cloud, FinitePoints, Normalization, NormalizationMethod, Point, add_origin};
use snake_registration::{PairOptions, RegisterOptions, Registration, Verdict, transform_points};

use crate::page::document;
use crate::shown_cloud::subsample;
use crate::vertices::Vertices;

/// Colours of target and source.
const COLORS: [[u8; 3]; 2] = [[46, 116, 181], [240, 140, 30]];

/// The content of the page. Arrays have the target first and then the source; the scene is in the target's frame.
pub struct RegistrationPage<'a> {
    /// The names on the page.
    pub names: [String; 2],
    /// The clouds.
    pub clouds: [&'a Cloud; 2],
    /// The registration of the source to the target; its transforms include the origins.
    pub registration: &'a Registration,
    /// The options of the registration.
    pub options: RegisterOptions,
    /// The options of the pair.
    pub pair_options: PairOptions,
}

impl RegistrationPage<'_> {
    /// The content of the HTML file.
    ///
    /// # Errors
    /// [`Error::Input`](snake_core::Error::Input) for a cloud without finite points or without extent.
    pub fn html(&self) -> Result<String> {
        Ok(document(&format!("{}: registration", self.names.join(" + ")), &self.data()?))
    }

    fn data(&self) -> Result<Value> {
        let Registration { t_target_source, verdict, fit, matches, .. } = self.registration;
        let Verdict { confidence, is_reliable, is_ambiguous, notes, .. } = verdict;
        let ends = |end: usize| matches.pairs.iter().map(|pair| pair[end]).collect::<Vec<Point>>();
        let (source, target) = (ends(0), ends(1));
        let [target_cloud, source_cloud] = self.clouds;
        let near = t_target_source.subtract_origins(source_cloud.origin, target_cloud.origin);
        let links: Vec<Value> = transform_points(&near, &source)
            .iter()
            .zip(&target)
            .enumerate()
            .map(|(index, (a, b))| {
                let squared: f32 = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum();
                json!([index, index, squared.sqrt()])
            })
            .collect();
        Ok(json!({
            "kind": "registration",
            "clouds": [self.cloud(0, &target)?, self.cloud(1, &source)?],
            "pair": {
                "t_first_second": t_target_source,
                "links": links,
                "verdict": {
                    "confidence": confidence,
                    "is_reliable": is_reliable,
                    "is_ambiguous": is_ambiguous,
                    "num_matches": matches.num_matches,
                    "inlier_distance": fit.inlier_distance,
                    "fitness": fit.fitness,
                    "notes": notes,
                },
            },
            "colors": STANDARD.encode(color_table().as_flattened()),
            "options": options(&self.options, &self.pair_options),
            "version": env!("CARGO_PKG_VERSION"),
        }))
    }

    /// A cloud with the ends of the matches as its keypoints. The field for saliency selects the colour.
    fn cloud(&self, index: usize, ends: &[Point]) -> Result<Value> {
        let cloud = self.clouds[index];
        let PairOptions { source_viewpoint, target_viewpoint, .. } = self.pair_options;
        let source_viewpoint = source_viewpoint.map(|place| place.map(|v| v * self.registration.scale));
        let given = [target_viewpoint, source_viewpoint][index];
        let finite = FinitePoints::clean("points", &cloud.points, given)?.points;
        let shown = subsample(&finite);
        let Normalization { center, scale } = Normalization::of(&finite, NormalizationMethod::UnitSphere)?;
        let keypoint = |end: &Point| {
            let [x, y, z] = add_origin(*end, cloud.origin);
            json!({ "x": x, "y": y, "z": z })
        };
        Ok(json!({
            "name": self.names[index],
            "points": Vertices::of(&shown, cloud.origin, &vec![index as f32; shown.len()]),
            "surface": null,
            "keypoints": ends.iter().map(keypoint).collect::<Vec<_>>(),
            "num_points": cloud.points.len(),
            "num_skipped": cloud.points.len() - finite.len(),
            "num_encoded": cloud.points.len(),
            "normalization": { "center": add_origin(center, cloud.origin), "scale": scale },
        }))
    }
}

/// All options of a registration as one object.
fn options(options: &RegisterOptions, pair_options: &PairOptions) -> Value {
    let groups = [json!(options), json!(pair_options)];
    groups.iter().filter_map(Value::as_object).flatten().map(|(name, value)| (name.clone(), value.clone())).collect()
}

/// Colours for values from 0, the target, to 1, the source.
fn color_table() -> [[u8; 3]; 256] {
    std::array::from_fn(|index| COLORS[index / 128])
}
