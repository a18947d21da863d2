//! Tables of registration, as means over the scenes.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use snake_core::Result;

use super::{Pair, Report, alike, num_models};
use crate::datasets::ScenePair;
use crate::tables::paper::{PaperRegistration, PaperTable};
use crate::tables::{self, Statistic, Table, mean};
use crate::{RegistrationOutcome, feature_matching_recall, registration_recall};

/// A pair counts for feature matching recall above this inlier ratio, as in the 3DMatch benchmark.
pub const INLIER_RATIO: f64 = 0.05;
/// A pair counts as registered up to this RMSE in metres, as in the 3DMatch benchmark.
pub const RMSE: f64 = 0.2;

/// The figures of one detector, descriptor and number of keypoints on one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Number of keypoints, the mean of both clouds.
    pub found: f64,
    /// Number of correspondences.
    pub correspondences: usize,
    /// Inlier ratio of the correspondences.
    pub inlier_ratio: f64,
    /// In square metres; `None` if no transform was found.
    pub squared_error: Option<f64>,
}

/// A detector with a descriptor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Method {
    /// The name of the detector.
    pub detector: String,
    /// The name of the descriptor.
    pub descriptor: String,
}

/// The combinations that are compared.
#[derive(Debug, Clone, Copy)]
pub struct Cases<'a> {
    /// The detectors with their descriptors; one that stands there several times has as many models.
    pub methods: &'a [Method],
    /// The numbers of keypoints, for each method. There is at least one.
    pub keypoints: &'a [usize],
}

/// The figures of every case: a detector, a descriptor and a number of keypoints.
struct Evaluation<'a> {
    settings: &'a Value,
    keypoints: &'a [usize],
    scenes: Vec<&'a str>,
    num_pairs: usize,
    num_seeds: usize,
    num_models: usize,
    summaries: Vec<Summary>,
    paper: Option<&'a PaperRegistration>,
}

/// The figures of one case: the mean over the seeds and models for each scene, and the mean over the scenes.
struct Summary {
    method: Method,
    keypoints: usize,
    scenes: Vec<Figures>,
    mean: Figures,
    deviation: Deviations,
}

/// Standard deviations over seeds or scenes, where there are several.
#[derive(Serialize)]
struct Deviations {
    feature_matching_recall: Option<f64>,
    inlier_ratio: Option<f64>,
    registration_recall: Option<f64>,
}

/// The figures of one case.
#[derive(Clone, Serialize)]
struct Figures {
    feature_matching_recall: f64,
    inlier_ratio: f64,
    /// `None` if all pairs are consecutive fragments.
    registration_recall: Option<f64>,
    /// Numbers of keypoints and of correspondences, means over the pairs.
    found: f64,
    correspondences: f64,
}

impl Figures {
    /// The figures of one scene, from its pairs.
    fn for_scene(pairs: &[(&ScenePair, &Row)]) -> Result<Self> {
        let ratios: Vec<f64> = pairs.iter().map(|(_, row)| row.inlier_ratio).collect();
        let outcome = |(pair, row): &(&ScenePair, &Row)| {
            let [first, second] = pair.fragments;
            RegistrationOutcome { first, second, squared_error: row.squared_error }
        };
        let outcomes: Vec<_> = pairs.iter().map(outcome).collect();
        Ok(Self {
            feature_matching_recall: feature_matching_recall(&ratios, INLIER_RATIO)?,
            inlier_ratio: mean(&ratios),
            // The only error is that all pairs are consecutive fragments.
            registration_recall: registration_recall(&outcomes, RMSE).ok(),
            found: mean(&pairs.iter().map(|(_, row)| row.found).collect::<Vec<_>>()),
            correspondences: mean(&pairs.iter().map(|(_, row)| row.correspondences as f64).collect::<Vec<_>>()),
        })
    }

    /// The unweighted mean over scenes or seeds.
    fn mean(all: &[Self]) -> Self {
        let of = |figure: fn(&Self) -> f64| mean(&all.iter().map(figure).collect::<Vec<_>>());
        let recalls: Vec<f64> = all.iter().filter_map(|one| one.registration_recall).collect();
        Self {
            feature_matching_recall: of(|one| one.feature_matching_recall),
            inlier_ratio: of(|one| one.inlier_ratio),
            registration_recall: (!recalls.is_empty()).then(|| mean(&recalls)),
            found: of(|one| one.found),
            correspondences: of(|one| one.correspondences),
        }
    }
}

impl Deviations {
    /// The deviations over the seeds' means, or over the scenes of a single seed.
    fn new(seeds: &[Figures], scenes: &[Figures]) -> Self {
        let of = |figure: fn(&Figures) -> Option<f64>| {
            let all = |figures: &[Figures]| figures.iter().filter_map(figure).collect::<Vec<_>>();
            Statistic::over_seeds(&all(seeds), &all(scenes)).deviation
        };
        Self {
            feature_matching_recall: of(|figures| Some(figures.feature_matching_recall)),
            inlier_ratio: of(|figures| Some(figures.inlier_ratio)),
            registration_recall: of(|figures| figures.registration_recall),
        }
    }
}

/// The report of the rows of all pairs, seed by seed. There is at least one pair. The tables also show the paper's
/// rows, and the JSON has the settings.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when a scene has no pairs.
///
/// # Panics
/// When a pair does not have a row for each of the cases.
pub fn report(
    cases: &Cases,
    settings: &Value,
    pairs: &[&ScenePair],
    runs: &[&[Pair<Row>]],
    paper: Option<&PaperRegistration>,
) -> Result<Report> {
    let evaluation = Evaluation::new(cases, settings, pairs, runs, paper)?;
    Ok(Report { tables: evaluation.tables(), curves: None, csv: evaluation.csv(), json: evaluation.json() })
}

impl<'a> Evaluation<'a> {
    /// Summarises the rows of all pairs, seed by seed.
    fn new(
        cases: &Cases<'a>,
        settings: &'a Value,
        pairs: &[&'a ScenePair],
        runs: &[&[Pair<Row>]],
        paper: Option<&'a PaperRegistration>,
    ) -> Result<Self> {
        let mut scenes: Vec<&str> = Vec::new();
        for pair in pairs {
            if !scenes.contains(&pair.scene.as_str()) {
                scenes.push(&pair.scene);
            }
        }
        let scene_figures = |scene: &str, rows: &[Pair<Row>], case: usize| {
            let rows = pairs.iter().zip(rows).filter(|(pair, _)| pair.scene == scene);
            Figures::for_scene(&rows.map(|(pair, rows)| (*pair, &rows.rows[case])).collect::<Vec<_>>())
        };
        let summary = |group: &[usize], column: usize| {
            let places = group.iter().map(|method| method * cases.keypoints.len() + column);
            let mut per_run = Vec::new();
            for (rows, case) in runs.iter().flat_map(|rows| places.clone().map(move |case| (rows, case))) {
                per_run.push(scenes.iter().map(|scene| scene_figures(scene, rows, case)).collect::<Result<Vec<_>>>()?);
            }
            let means: Vec<Figures> = per_run.iter().map(|scenes| Figures::mean(scenes)).collect();
            let over_runs =
                |scene: usize| Figures::mean(&per_run.iter().map(|scenes| scenes[scene].clone()).collect::<Vec<_>>());
            Ok(Summary {
                method: cases.methods[group[0]].clone(),
                keypoints: cases.keypoints[column],
                scenes: (0..scenes.len()).map(over_runs).collect(),
                mean: Figures::mean(&means),
                deviation: Deviations::new(&means, &per_run[0]),
            })
        };
        let groups = alike(cases.methods, |a, b| a == b);
        let columns = 0..cases.keypoints.len();
        let all = groups.iter().flat_map(|group| columns.clone().map(|column| summary(group, column)));
        let summaries = all.collect::<Result<_>>()?;
        let (num_pairs, num_seeds, num_models) = (pairs.len(), runs.len(), num_models(&groups));
        Ok(Self { settings, keypoints: cases.keypoints, scenes, num_pairs, num_seeds, num_models, summaries, paper })
    }

    /// One table for each figure, with a row for each detector and descriptor and a column for each number of keypoints.
    fn tables(&self) -> Vec<Table> {
        let (pairs, scenes) = (self.num_pairs, self.scenes.len());
        let over = match (scenes, self.num_seeds, self.num_models) {
            (1, 1, 1) => String::new(),
            (_, seeds, models) => format!(" ± {}", tables::deviation_name(seeds, models, "scenes")),
        };
        let recall =
            |mean: Option<f64>, deviation| mean.map_or("-".into(), |mean| Statistic { mean, deviation }.cell());
        vec![
            self.table(
                format!("Feature matching recall, {pairs} pairs, mean over scenes ({scenes}){over}"),
                |case| recall(Some(case.mean.feature_matching_recall), case.deviation.feature_matching_recall),
                self.paper.map(|paper| &paper.feature_matching_recall),
            ),
            self.table(
                "Inlier ratio".into(),
                |case| recall(Some(case.mean.inlier_ratio), case.deviation.inlier_ratio),
                self.paper.map(|paper| &paper.inlier_ratio),
            ),
            self.table(
                "Registration recall, without consecutive fragments".into(),
                |case| recall(case.mean.registration_recall, case.deviation.registration_recall),
                self.paper.map(|paper| &paper.registration_recall),
            ),
            self.table(
                "Keypoints / correspondences, means over the pairs".into(),
                |case| format!("{:.0} / {:.0}", case.mean.found, case.mean.correspondences),
                None,
            ),
        ]
    }

    fn table(&self, title: String, cell: impl Fn(&Summary) -> String, paper: Option<&PaperTable>) -> Table {
        let mut head = vec!["keypoints".to_owned()];
        head.extend(self.keypoints.iter().map(usize::to_string));
        let row = |cases: &[Summary]| {
            let Method { detector, descriptor } = &cases[0].method;
            let method = format!("{detector} {descriptor}");
            std::iter::once(method).chain(cases.iter().map(&cell)).collect()
        };
        let mut rows: Vec<Vec<String>> = self.summaries.chunks(self.keypoints.len()).map(row).collect();
        let column_values: Vec<f64> = self.keypoints.iter().map(|&keypoints| keypoints as f64).collect();
        rows.extend(paper.into_iter().flat_map(|table| table.rows(&column_values)));
        Table { title, head, rows }
    }

    /// The CSV file: a line for each case and scene, then the mean over the scenes and its deviation.
    fn csv(&self) -> String {
        let mut text = String::from(
            "detector,descriptor,keypoints,scene,feature_matching_recall,inlier_ratio,registration_recall,found,correspondences\n",
        );
        let cell = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        for Summary { method: Method { detector, descriptor }, keypoints, scenes, mean, deviation } in &self.summaries {
            let quoted = self.scenes.iter().map(|scene| format!("\"{}\"", scene.replace('"', "\"\"")));
            for (scene, figures) in quoted.zip(scenes).chain(std::iter::once(("mean".into(), mean))) {
                let Figures { feature_matching_recall, inlier_ratio, registration_recall, found, correspondences } =
                    figures;
                let recall = cell(*registration_recall);
                text += &format!(
                    "{detector},{descriptor},{keypoints},{scene},{feature_matching_recall},{inlier_ratio},{recall},{found},{correspondences}\n"
                );
            }
            let Deviations { feature_matching_recall, inlier_ratio, registration_recall } = deviation;
            let cells = [feature_matching_recall, inlier_ratio, registration_recall].map(|value| cell(*value));
            text += &format!("{detector},{descriptor},{keypoints},deviation,{},,\n", cells.join(","));
        }
        text
    }

    fn json(&self) -> String {
        let row = |summary: &Summary| {
            let Summary { method: Method { detector, descriptor }, keypoints, scenes, mean, deviation } = summary;
            json!({"detector": detector, "descriptor": descriptor, "keypoints": keypoints, "mean": mean, "deviation": deviation, "scenes": scenes})
        };
        let rows: Vec<Value> = self.summaries.iter().map(row).collect();
        let all = json!({"settings": self.settings, "pairs": self.num_pairs, "scenes": self.scenes, "rows": rows});
        format!("{all:#}\n")
    }
}

#[cfg(test)]
mod tests {
    use snake_geometry::RigidTransform;

    use crate::tables::paper::THREE_D_MATCH;

    use super::*;

    fn pair(scene: &str, fragments: [usize; 2]) -> ScenePair {
        let t_target_source = RigidTransform::identity();
        ScenePair { scene: scene.into(), source: 0, target: 1, fragments, t_target_source, information: None }
    }

    fn row(inlier_ratio: f64, squared_error: Option<f64>) -> Pair<Row> {
        let row = Row { found: 50.0, correspondences: 10, inlier_ratio, squared_error };
        Pair { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn figures_are_means_over_the_scenes_by_hand() {
        let method = Method { detector: "iss".into(), descriptor: "fpfh".into() };
        let cases = Cases { methods: &[method], keypoints: &[100] };
        // Scene a has three pairs, one of them consecutive and one without a transform; b only a consecutive one.
        let pairs = [pair("a", [0, 1]), pair("a", [0, 2]), pair("a", [0, 3]), pair("b", [4, 5])];
        let rows = [row(0.5, None), row(0.04, Some(0.03)), row(0.06, None), row(0.0, Some(0.0))];
        let settings = json!({"seed": 0});
        let report = Evaluation::new(&cases, &settings, &pairs.each_ref(), &[&rows], Some(&THREE_D_MATCH)).unwrap();
        let csv = report.csv();
        let lines: Vec<&str> = csv.lines().skip(1).collect();
        let a = format!("iss,fpfh,100,\"a\",{},{},0.5,50,10", 2.0 / 3.0, (0.5 + 0.04 + 0.06) / 3.0);
        assert_eq!(lines[..2], [&a[..], "iss,fpfh,100,\"b\",0,0,,50,10"]);
        assert!(lines[2].starts_with(&format!("iss,fpfh,100,mean,{},", 1.0 / 3.0)) && lines[2].ends_with(",0.5,50,10"));
        // The deviation of 2 / 3 and 0; only one scene has a recall.
        let deviation = ["iss", "fpfh", "100", "deviation", "0.4714045207910317", "0.14142135623730953", "", "", ""];
        assert_eq!(lines[3], deviation.join(","));
        let markdown = tables::markdown(&report.tables());
        let expected = "Registration recall, without consecutive fragments:

| keypoints | 100 |
|---|---|
| iss fpfh | 0.500 |
| snake d3feat (paper) | 0.509 |
";
        assert!(markdown.contains(expected), "{markdown}");
        for part in
            ["4 pairs, mean over scenes (2) ± standard deviation over scenes:", "| 0.333 ±0.471 |", "| 50 / 10 |"]
        {
            assert!(markdown.contains(part), "{markdown}");
        }
        let json: Value = serde_json::from_str(&report.json()).unwrap();
        assert_eq!(json["rows"][0]["scenes"][1]["registration_recall"], Value::Null);
    }
}
