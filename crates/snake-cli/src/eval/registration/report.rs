//! Tables of registration: means over the scenes.

use std::path::Path;

use anyhow::Result;
use serde::Serialize;
use serde_json::{Value, json};
use snake_core::metrics::{RegistrationOutcome, feature_matching_recall, registration_recall};
use snake_core::registration::{Descriptor, KeypointDetector};

use super::super::record::Pair;
use super::super::table::{self, Table};
use super::scenes::ScenePair;
use super::{INLIER_RATIO, Plan, RMSE, Row};

/// The figures of every case.
pub struct Report<'a> {
    settings: &'a Value,
    keypoints: &'a [usize],
    scenes: Vec<&'a str>,
    num_pairs: usize,
    summaries: Vec<Summary>,
}

/// The figures of one case, of each scene and their mean.
struct Summary {
    detector: Value,
    descriptor: Value,
    keypoints: usize,
    scenes: Vec<Figures>,
    mean: Figures,
}

/// The figures of one case.
#[derive(Serialize)]
struct Figures {
    feature_matching_recall: f64,
    inlier_ratio: f64,
    /// `None` of nothing but consecutive fragments.
    registration_recall: Option<f64>,
    /// Keypoints that there were, and their correspondences, means over the pairs.
    found: f64,
    correspondences: f64,
}

impl Figures {
    /// Of the pairs of one scene.
    fn of_scene(pairs: &[(&ScenePair, &Row)]) -> Result<Self> {
        let ratios: Vec<f64> = pairs.iter().map(|(_, row)| row.inlier_ratio).collect();
        let outcome = |(pair, row): &(&ScenePair, &Row)| {
            let [first, second] = pair.fragments;
            RegistrationOutcome { first, second, squared_error: row.squared_error }
        };
        let outcomes: Vec<_> = pairs.iter().map(outcome).collect();
        Ok(Self {
            feature_matching_recall: feature_matching_recall(&ratios, INLIER_RATIO)?,
            inlier_ratio: mean(ratios.iter().copied()),
            // Its only error is that no pair is left.
            registration_recall: registration_recall(&outcomes, RMSE).ok(),
            found: mean(pairs.iter().map(|(_, row)| row.found)),
            correspondences: mean(pairs.iter().map(|(_, row)| row.correspondences as f64)),
        })
    }

    /// The plain mean over the scenes.
    fn mean(scenes: &[Self]) -> Self {
        let of = |figure: fn(&Self) -> f64| mean(scenes.iter().map(figure));
        let recalls: Vec<f64> = scenes.iter().filter_map(|scene| scene.registration_recall).collect();
        Self {
            feature_matching_recall: of(|scene| scene.feature_matching_recall),
            inlier_ratio: of(|scene| scene.inlier_ratio),
            registration_recall: (!recalls.is_empty()).then(|| mean(recalls.iter().copied())),
            found: of(|scene| scene.found),
            correspondences: of(|scene| scene.correspondences),
        }
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

impl<'a> Report<'a> {
    /// Sums up the rows of all pairs, of which there is at least one.
    pub fn new(plan: &'a Plan, settings: &'a Value, pairs: &[&'a ScenePair], rows: &[Pair<Row>]) -> Result<Self> {
        let mut scenes: Vec<&str> = Vec::new();
        for pair in pairs {
            if !scenes.contains(&pair.scene.as_str()) {
                scenes.push(&pair.scene);
            }
        }
        let summary = |(i, (detector, descriptor, keypoints)): (usize, (KeypointDetector, Descriptor, usize))| {
            let of_scene = |scene: &&str| {
                let rows = pairs.iter().zip(rows).filter(|(pair, _)| pair.scene == *scene);
                Figures::of_scene(&rows.map(|(pair, rows)| (*pair, &rows.rows[i])).collect::<Vec<_>>())
            };
            let scenes = scenes.iter().map(of_scene).collect::<Result<Vec<_>>>()?;
            let mean = Figures::mean(&scenes);
            Ok(Summary { detector: json!(detector), descriptor: json!(descriptor), keypoints, scenes, mean })
        };
        let summaries = plan.cases().into_iter().enumerate().map(summary).collect::<Result<_>>()?;
        Ok(Self { settings, keypoints: plan.keypoints, scenes, num_pairs: pairs.len(), summaries })
    }

    /// The tables, for people.
    pub fn text(&self) -> String {
        table::text(&self.tables())
    }

    /// Writes `registration.csv`, `.json` and `.md`.
    pub fn write(&self, output: &Path) -> Result<()> {
        let markdown = table::markdown(&self.tables());
        table::write(output, "registration", &[("csv", self.csv()), ("json", self.json()?), ("md", markdown)])
    }

    /// Of each figure a table: a row for each detector and descriptor, a column for each number of keypoints.
    fn tables(&self) -> Vec<Table> {
        let (pairs, scenes) = (self.num_pairs, self.scenes.len());
        let titled = |title: String, cell: fn(&Figures) -> String| {
            let mut head = vec!["keypoints".to_owned()];
            head.extend(self.keypoints.iter().map(usize::to_string));
            let row = |cases: &[Summary]| {
                let name = |value: &Value| value.as_str().unwrap_or_default().to_owned();
                let method = name(&cases[0].detector) + " " + &name(&cases[0].descriptor);
                std::iter::once(method).chain(cases.iter().map(|case| cell(&case.mean))).collect()
            };
            Table { title, head, rows: self.summaries.chunks(self.keypoints.len()).map(row).collect() }
        };
        vec![
            titled(format!("Feature matching recall, {pairs} pairs, mean over scenes ({scenes})"), |figures| {
                format!("{:.3}", figures.feature_matching_recall)
            }),
            titled("Inlier ratio".into(), |figures| format!("{:.3}", figures.inlier_ratio)),
            titled("Registration recall, without consecutive fragments".into(), |figures| {
                figures.registration_recall.map_or("-".into(), |recall| format!("{recall:.3}"))
            }),
            titled("Keypoints / correspondences, means over the pairs".into(), |figures| {
                format!("{:.0} / {:.0}", figures.found, figures.correspondences)
            }),
        ]
    }

    /// A line for each case and scene, and one for the mean over the scenes.
    fn csv(&self) -> String {
        let mut text = String::from(
            "detector,descriptor,keypoints,scene,feature_matching_recall,inlier_ratio,registration_recall,found,correspondences\n",
        );
        for Summary { detector, descriptor, keypoints, scenes, mean } in &self.summaries {
            let quoted = self.scenes.iter().map(|scene| format!("\"{}\"", scene.replace('"', "\"\"")));
            for (scene, figures) in quoted.zip(scenes).chain(std::iter::once(("mean".into(), mean))) {
                let Figures { feature_matching_recall, inlier_ratio, registration_recall, found, correspondences } =
                    figures;
                let recall = registration_recall.map(|recall| recall.to_string()).unwrap_or_default();
                let (detector, descriptor) =
                    (detector.as_str().unwrap_or_default(), descriptor.as_str().unwrap_or_default());
                text += &format!(
                    "{detector},{descriptor},{keypoints},{scene},{feature_matching_recall},{inlier_ratio},{recall},{found},{correspondences}\n"
                );
            }
        }
        text
    }

    fn json(&self) -> Result<String> {
        let row = |summary: &Summary| {
            let Summary { detector, descriptor, keypoints, scenes, mean } = summary;
            json!({"detector": detector, "descriptor": descriptor, "keypoints": keypoints, "mean": mean, "scenes": scenes})
        };
        let rows: Vec<Value> = self.summaries.iter().map(row).collect();
        let all = json!({"settings": self.settings, "pairs": self.num_pairs, "scenes": self.scenes, "rows": rows});
        Ok(serde_json::to_string_pretty(&all)? + "\n")
    }
}

#[cfg(test)]
mod tests {
    use snake_core::Model;

    use super::*;

    fn pair(scene: &str, fragments: [usize; 2]) -> ScenePair {
        let t_target_source = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
        ScenePair { scene: scene.into(), source: 0, target: 1, fragments, t_target_source, information: None }
    }

    fn row(inlier_ratio: f64, squared_error: Option<f64>) -> Pair<Row> {
        let row = Row { found: 50.0, correspondences: 10, inlier_ratio, squared_error };
        Pair { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn figures_are_means_over_the_scenes_by_hand() {
        let model = Model::builtin().unwrap();
        let (detectors, descriptors) = ([KeypointDetector::Iss], [Descriptor::Fpfh]);
        let plan = Plan { model: &model, detectors: &detectors, descriptors: &descriptors, keypoints: &[100], seed: 0 };
        // Scene a has three pairs, one of them consecutive and one without a transform; b only a consecutive one.
        let pairs = [pair("a", [0, 1]), pair("a", [0, 2]), pair("a", [0, 3]), pair("b", [4, 5])];
        let rows = [row(0.5, None), row(0.04, Some(0.03)), row(0.06, None), row(0.0, Some(0.0))];
        let settings = json!({"seed": 0});
        let report = Report::new(&plan, &settings, &pairs.each_ref(), &rows).unwrap();
        let csv = report.csv();
        let lines: Vec<&str> = csv.lines().skip(1).collect();
        let a = format!("iss,fpfh,100,\"a\",{},{},0.5,50,10", 2.0 / 3.0, (0.5 + 0.04 + 0.06) / 3.0);
        assert_eq!(lines[..2], [&a[..], "iss,fpfh,100,\"b\",0,0,,50,10"]);
        assert!(lines[2].starts_with(&format!("iss,fpfh,100,mean,{},", 1.0 / 3.0)) && lines[2].ends_with(",0.5,50,10"));
        let markdown = table::markdown(&report.tables());
        let expected = "Registration recall, without consecutive fragments:

| keypoints | 100 |
|---|---|
| iss fpfh | 0.500 |
";
        assert!(markdown.contains(expected), "{markdown}");
        assert!(markdown.contains("4 pairs, mean over scenes (2)") && markdown.contains("| 50 / 10 |"), "{markdown}");
        let json: Value = serde_json::from_str(&report.json().unwrap()).unwrap();
        assert_eq!(json["rows"][0]["scenes"][1]["registration_recall"], Value::Null);
    }
}
