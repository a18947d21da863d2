//! Tables of registration, as means over the scenes.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use snake_core::Result;

use super::{Report, Sample, alike, cell, json, num_models, object, rows_by_run};
use crate::datasets::ScenePair;
use crate::tables::paper::PaperRegistration;
use crate::tables::{Axis, Chart, Series, Statistic, deviation_name, mean};
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

/// The names of the figures in files. The numbers of keypoints and of correspondences are means over the pairs.
const NAMES: [&str; 5] = ["feature_matching_recall", "inlier_ratio", "registration_recall", "found", "correspondences"];
/// How many of the figures have a deviation: those with a table of their own.
const NUM_DEVIATIONS: usize = 3;

/// A value for each of [`NAMES`]. There is no registration recall if all pairs are consecutive fragments.
type Figures = [Option<f64>; NAMES.len()];

/// The figures of one case: the mean over the seeds and models for each scene, and the mean over the scenes.
struct Summary<'a> {
    method: &'a Method,
    keypoints: usize,
    scenes: Vec<Figures>,
    mean: Figures,
    /// Standard deviations over seeds or scenes, where there are several.
    deviation: [Option<f64>; NUM_DEVIATIONS],
}

/// The figures of one scene, from its pairs.
fn scene_figures(pairs: &[(&ScenePair, &Row)]) -> Result<Figures> {
    let row_mean = |figure: fn(&Row) -> f64| Some(mean(&pairs.iter().map(|(_, row)| figure(row)).collect::<Vec<_>>()));
    let ratios: Vec<f64> = pairs.iter().map(|(_, row)| row.inlier_ratio).collect();
    let outcome = |(pair, row): &(&ScenePair, &Row)| {
        let [first, second] = pair.fragments;
        RegistrationOutcome { first, second, squared_error: row.squared_error }
    };
    let outcomes: Vec<_> = pairs.iter().map(outcome).collect();
    Ok([
        Some(feature_matching_recall(&ratios, INLIER_RATIO)?),
        row_mean(|row| row.inlier_ratio),
        // The only error is that all pairs are consecutive fragments.
        registration_recall(&outcomes, RMSE).ok(),
        row_mean(|row| row.found),
        row_mean(|row| row.correspondences as f64),
    ])
}

/// The unweighted mean over scenes or seeds, of those that have the figure.
fn mean_figures(all: &[Figures]) -> Figures {
    std::array::from_fn(|figure| {
        let values: Vec<f64> = all.iter().filter_map(|figures| figures[figure]).collect();
        (!values.is_empty()).then(|| mean(&values))
    })
}

impl<'a> Summary<'a> {
    /// The summary of one case from its figures: those of each scene for each seed and model.
    fn new(method: &'a Method, keypoints: usize, runs: &[Vec<Figures>]) -> Self {
        let means: Vec<Figures> = runs.iter().map(|scenes| mean_figures(scenes)).collect();
        let over_runs = |scene: usize| mean_figures(&runs.iter().map(|scenes| scenes[scene]).collect::<Vec<_>>());
        let deviation = |figure: usize| {
            let values = |all: &[Figures]| all.iter().filter_map(|figures| figures[figure]).collect::<Vec<_>>();
            Statistic::over_seeds(&values(&means), &values(&runs[0])).deviation
        };
        Self {
            method,
            keypoints,
            scenes: (0..runs[0].len()).map(over_runs).collect(),
            mean: mean_figures(&means),
            deviation: std::array::from_fn(deviation),
        }
    }

    /// Lines of the CSV file: one for each scene, then the mean over the scenes and its deviation.
    fn csv(&self, scenes: &[&str]) -> String {
        let Method { detector, descriptor } = self.method;
        let line = |scene: &str, values: &[Option<f64>]| {
            let cells: Vec<String> = (0..NAMES.len()).map(|i| cell(values.get(i).copied().flatten())).collect();
            format!("{detector},{descriptor},{},{scene},{}\n", self.keypoints, cells.join(","))
        };
        let quoted = scenes.iter().map(|scene| format!("\"{}\"", scene.replace('"', "\"\"")));
        let scenes: String = quoted.zip(&self.scenes).map(|(scene, figures)| line(&scene, figures)).collect();
        scenes + &line("mean", &self.mean) + &line("deviation", &self.deviation)
    }

    fn json(&self) -> Value {
        let named =
            |values: &[Option<f64>]| object(NAMES.into_iter().zip(values).map(|(name, value)| (name, (*value).into())));
        let Method { detector, descriptor } = self.method;
        let scenes: Vec<Value> = self.scenes.iter().map(|scene| named(scene)).collect();
        json!({
            "detector": detector,
            "descriptor": descriptor,
            "keypoints": self.keypoints,
            "mean": named(&self.mean),
            "deviation": named(&self.deviation),
            "scenes": scenes,
        })
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
    runs: &[&[Sample<Row>]],
    paper: Option<&'static PaperRegistration>,
) -> Result<Report> {
    let mut scenes: Vec<&str> = Vec::new();
    for pair in pairs {
        if !scenes.contains(&pair.scene.as_str()) {
            scenes.push(&pair.scene);
        }
    }
    let run_figures = |rows: &Vec<&Row>| {
        let scene_rows = |scene: &&str| {
            let rows = pairs.iter().copied().zip(rows.iter().copied()).filter(|(pair, _)| pair.scene == *scene);
            scene_figures(&rows.collect::<Vec<_>>())
        };
        scenes.iter().map(scene_rows).collect::<Result<Vec<Figures>>>()
    };
    let groups = alike(cases.methods, |a, b| a == b);
    let mut summaries = Vec::new();
    for group in &groups {
        for (column, &keypoints) in cases.keypoints.iter().enumerate() {
            let rows: Vec<usize> = group.iter().map(|method| method * cases.keypoints.len() + column).collect();
            let rows = rows_by_run(runs, &rows);
            let figures: Vec<Vec<Figures>> = rows.iter().map(run_figures).collect::<Result<_>>()?;
            summaries.push(Summary::new(&cases.methods[group[0]], keypoints, &figures));
        }
    }
    let num_models = num_models(&groups);
    let deviation = match (scenes.len(), runs.len(), num_models) {
        (1, 1, 1) => String::new(),
        (_, seeds, models) => format!(" ± {}", deviation_name(seeds, models, "scenes")),
    };
    let over = format!("{} pairs, mean over scenes ({}){deviation}", pairs.len(), scenes.len());
    let head = format!("detector,descriptor,keypoints,scene,{}\n", NAMES.join(","));
    let csv = summaries.iter().fold(head, |text, summary| text + &summary.csv(&scenes));
    let others = [("pairs", pairs.len().into()), ("scenes", scenes.into())];
    let json = json(settings, others, summaries.iter().map(Summary::json).collect());
    Ok(Report { charts: charts(&over, cases.keypoints, &summaries, paper), y_label: "", csv, json })
}

/// One table for each figure, with a row for each detector and descriptor and a column for each number of keypoints.
fn charts(
    over: &str,
    keypoints: &[usize],
    summaries: &[Summary],
    paper: Option<&'static PaperRegistration>,
) -> Vec<Chart> {
    let chart = |title: &str, paper, cell: &dyn Fn(&Summary) -> String| {
        let series = |cases: &[Summary]| {
            let Method { detector, descriptor } = cases[0].method;
            let title = format!("{detector} {descriptor}");
            Series { method: title.clone(), title, cells: cases.iter().map(cell).collect(), curve: Vec::new() }
        };
        let values = keypoints.iter().map(|&number| number as f64).collect();
        Chart {
            title: title.to_owned(),
            first: "keypoints",
            axis: Axis { label: None, prefix: "", values, x: |number| number },
            others: &[],
            series: summaries.chunks(keypoints.len()).map(series).collect(),
            paper,
        }
    };
    let statistic = |case: &Summary, figure: usize| {
        let deviation = case.deviation[figure];
        case.mean[figure].map_or("-".into(), |mean| Statistic { mean, deviation }.cell())
    };
    let number = |case: &Summary, figure: usize| format!("{:.0}", case.mean[figure].unwrap_or(f64::NAN));
    let matching_recall = paper.map(|paper| &paper.feature_matching_recall);
    let registration_recall = paper.map(|paper| &paper.registration_recall);
    vec![
        chart(&format!("Feature matching recall, {over}"), matching_recall, &|case| statistic(case, 0)),
        chart("Inlier ratio", paper.map(|paper| &paper.inlier_ratio), &|case| statistic(case, 1)),
        chart("Registration recall, without consecutive fragments", registration_recall, &|case| statistic(case, 2)),
        chart("Keypoints / correspondences, means over the pairs", None, &|case| {
            format!("{} / {}", number(case, 3), number(case, 4))
        }),
    ]
}

#[cfg(test)]
mod tests {
    use snake_geometry::RigidTransform;

    use crate::tables;
    use crate::tables::paper::THREE_D_MATCH;

    use super::*;

    fn pair(scene: &str, fragments: [usize; 2]) -> ScenePair {
        let t_target_source = RigidTransform::identity();
        ScenePair { scene: scene.into(), source: 0, target: 1, fragments, t_target_source, information: None }
    }

    fn row(inlier_ratio: f64, squared_error: Option<f64>) -> Sample<Row> {
        let row = Row { found: 50.0, correspondences: 10, inlier_ratio, squared_error };
        Sample { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn figures_are_means_over_the_scenes_by_hand() {
        let method = Method { detector: "iss".into(), descriptor: "fpfh".into() };
        let cases = Cases { methods: &[method], keypoints: &[100] };
        // Scene a has three pairs, one of them consecutive and one without a transform; b only a consecutive one.
        let pairs = [pair("a", [0, 1]), pair("a", [0, 2]), pair("a", [0, 3]), pair("b", [4, 5])];
        let rows = [row(0.5, None), row(0.04, Some(0.03)), row(0.06, None), row(0.0, Some(0.0))];
        let settings = json!({"seed": 0});
        let report = report(&cases, &settings, &pairs.each_ref(), &[&rows], Some(&THREE_D_MATCH)).unwrap();
        let csv = &report.csv;
        let lines: Vec<&str> = csv.lines().skip(1).collect();
        let a = format!("iss,fpfh,100,\"a\",{},{},0.5,50,10", 2.0 / 3.0, (0.5 + 0.04 + 0.06) / 3.0);
        assert_eq!(lines[..2], [&a[..], "iss,fpfh,100,\"b\",0,0,,50,10"]);
        assert!(lines[2].starts_with(&format!("iss,fpfh,100,mean,{},", 1.0 / 3.0)) && lines[2].ends_with(",0.5,50,10"));
        // The deviation of 2 / 3 and 0; only one scene has a recall.
        let deviation = ["iss", "fpfh", "100", "deviation", "0.4714045207910317", "0.14142135623730953", "", "", ""];
        assert_eq!(lines[3], deviation.join(","));
        let markdown = tables::markdown(&report.charts);
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
        let json: Value = serde_json::from_str(&report.json).unwrap();
        assert_eq!(json["rows"][0]["scenes"][1]["registration_recall"], Value::Null);
    }
}
