//! Reports of repeatability: tables, curves, CSV and JSON.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Models, Report, Sample, Summary, alike, csv, json, named_with_models, num_models, rows_by_run};
use crate::tables::paper::{PaperRepeatability, PaperTable};
use crate::tables::{Axis, Chart, Series, Statistic, deviation_name, mean};
use crate::views::Condition;

/// The figures of one method under one condition on one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The name of the method.
    pub method: String,
    /// The models that were chosen for the clouds.
    #[serde(default, skip_serializing_if = "Models::is_empty")]
    pub models: Models,
    /// The disturbance of the views.
    #[serde(flatten)]
    pub condition: Condition,
    /// Number of keypoints in view 1.
    pub keypoints: usize,
    /// Mean distance from the points of view 1 to their nearest keypoint; `None` without keypoints.
    pub coverage: Option<f64>,
    /// Relative repeatability for each epsilon.
    pub repeatability: Vec<f64>,
    /// Repeatability beyond chance for each epsilon, of the keypoints that view 2 sees; `None` where it sees none.
    pub beyond_chance: Vec<Option<f64>>,
    /// The share of keypoints on flat places; `None` without keypoints.
    pub flat: Option<f64>,
}

/// The thresholds and conditions of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweeps {
    /// The distances below which a keypoint counts as repeated, in units of the views.
    pub epsilon: Vec<f64>,
    /// The epsilon at which the conditions are tabulated, one of `epsilon`.
    pub table_epsilon: f64,
    /// The conditions, clean views first.
    pub conditions: Vec<Condition>,
}

/// A sweep over one disturbance.
struct Sweep {
    name: &'static str,
    /// The label of the diagram.
    label: &'static str,
    /// The words before a value in the table.
    prefix: &'static str,
    belongs: fn(&Condition) -> bool,
    value: fn(&Condition) -> f64,
    /// The coordinate of a value in the diagram.
    x: fn(f64) -> f64,
    paper: fn(&PaperRepeatability) -> &PaperTable,
}

/// The sweeps, each of which has the clean views too.
const SWEEPS: [Sweep; 2] = [
    Sweep {
        name: "down-sampling",
        label: "down-sampling, 1 in",
        prefix: "1 in ",
        belongs: |condition| condition.noise == 0.0,
        value: |condition| condition.downsample as f64,
        x: f64::log2,
        paper: |paper| &paper.downsample,
    },
    Sweep {
        name: "noise",
        label: "noise σ",
        prefix: "σ ",
        belongs: |condition| condition.downsample == 1,
        value: |condition| condition.noise,
        x: |sigma| sigma,
        paper: |paper| &paper.noise,
    },
];

/// The rows of one method under one condition: a list for each seed and model, and their means over the pairs.
struct Figures<'a> {
    condition: Condition,
    runs: Vec<Vec<&'a Row>>,
    summary: Summary,
}

impl<'a> Figures<'a> {
    fn new(runs: Vec<Vec<&'a Row>>) -> Self {
        let Row { method, condition, repeatability, .. } = runs[0][0];
        let all = || runs.iter().flatten();
        let keypoints: Vec<f64> = all().map(|row| row.keypoints as f64).collect();
        let mean_of = |figure: fn(&Row) -> Option<f64>| {
            let figures: Vec<f64> = all().filter_map(|row| figure(row)).collect();
            (!figures.is_empty()).then(|| mean(&figures))
        };
        let statistic = |share: &dyn Fn(&Row) -> Option<f64>| {
            let run_shares = |rows: &Vec<&Row>| rows.iter().filter_map(|row| share(row)).collect::<Vec<f64>>();
            let means: Vec<f64> = runs.iter().map(|rows| mean(&run_shares(rows))).collect();
            Statistic::over_seeds(&means, &run_shares(&runs[0]))
        };
        let epsilons = 0..repeatability.len();
        let repeated = epsilons.clone().map(|i| statistic(&|row| Some(row.repeatability[i]))).collect();
        let beyond_chance = epsilons.map(|i| statistic(&|row| row.beyond_chance[i])).collect();
        let summary = Summary {
            title: named_with_models(method, all().map(|row| &row.models)),
            keys: vec![
                ("method", method.as_str().into()),
                ("downsample", condition.downsample.into()),
                ("noise", condition.noise.into()),
            ],
            swept: vec![
                (["repeatability", "deviation"], repeated),
                (["beyond_chance", "deviation_beyond_chance"], beyond_chance),
            ],
            means: vec![
                ("keypoints", Some(mean(&keypoints))),
                ("coverage", mean_of(|row| row.coverage)),
                ("flat", mean_of(|row| row.flat)),
            ],
        };
        Self { condition: *condition, runs, summary }
    }

    fn repeatability(&self) -> &[Statistic] {
        &self.summary.swept[0].1
    }

    fn beyond_chance(&self) -> &[Statistic] {
        &self.summary.swept[1].1
    }
}

/// The report of the pairs of each seed. All pairs have rows for the same methods and conditions; rows of the same method and
/// condition belong to several models. The tables also show the paper's rows, and the JSON has the settings.
///
/// # Panics
/// When there are no pairs, or when two pairs have rows for different methods or conditions.
pub fn report(
    sweeps: &Sweeps,
    settings: &Value,
    runs: &[&[Sample<Row>]],
    paper: Option<&'static PaperRepeatability>,
) -> Report {
    let rows = runs[0].first().map_or(&[][..], |pair| &pair.rows);
    let groups = alike(rows, |a, b| (&a.method, a.condition) == (&b.method, b.condition));
    let figures: Vec<Figures> = groups.iter().map(|group| Figures::new(rows_by_run(runs, group))).collect();
    let deviation = deviation_name(runs.len(), num_models(&groups), "pairs");
    let title = format!("Relative repeatability, mean over {} pairs ± {deviation}", runs[0].len());
    let mut charts = vec![over_epsilon(title, sweeps, &figures, paper)];
    charts.extend(SWEEPS.iter().filter_map(|sweep| over_sweep(sweep, sweeps, &figures, paper)));
    charts.push(beyond_chance(sweeps, &figures));
    let summaries: Vec<&Summary> = figures.iter().map(|figures| &figures.summary).collect();
    let csv = csv(("epsilon", &sweeps.epsilon), &summaries, Some(runs[0].len()));
    let rows = summaries.iter().map(|summary| summary.json()).collect();
    let json = json(settings, [("pairs", runs[0].len().into())], rows);
    Report { charts, y_label: "relative repeatability", csv, json }
}

/// The clean views over epsilon.
fn over_epsilon(
    title: String,
    sweeps: &Sweeps,
    figures: &[Figures],
    paper: Option<&'static PaperRepeatability>,
) -> Chart {
    let series = |figures: &Figures| {
        let Summary { title, means, .. } = &figures.summary;
        let mut series = Series::new(title.clone(), figures.summary.method(), figures.repeatability().iter());
        series.cells.push(means[0].1.map_or("-".into(), |keypoints| format!("{keypoints:.1}")));
        series.cells.push(means[1].1.map_or("-".into(), |coverage| format!("{coverage:.4}")));
        series
    };
    let x = |epsilon| epsilon;
    Chart {
        title,
        first: "method",
        axis: Axis { label: Some("ε".into()), prefix: "ε ", values: sweeps.epsilon.clone(), x },
        others: &["keypoints", "coverage"],
        series: under(figures, sweeps.conditions[0]).map(series).collect(),
        paper: paper.map(|paper| &paper.epsilon),
    }
}

/// The clean views over epsilon, of the keypoints that the other view sees.
fn beyond_chance(sweeps: &Sweeps, figures: &[Figures]) -> Chart {
    let series = |figures: &Figures| {
        let Summary { title, means, .. } = &figures.summary;
        let mut series = Series::new(title.clone(), figures.summary.method(), figures.beyond_chance().iter());
        series.cells.push(means[2].1.map_or("-".into(), |flat| format!("{flat:.3}")));
        series
    };
    Chart {
        title: "Beyond chance: 0 is the share that random points of the other view would find".into(),
        first: "method",
        axis: Axis { label: None, prefix: "beyond ε ", values: sweeps.epsilon.clone(), x: |epsilon| epsilon },
        others: &["on flat places"],
        series: under(figures, sweeps.conditions[0]).map(series).collect(),
        paper: None,
    }
}

/// The conditions of a sweep at the tables' epsilon; `None` if there is only one. The paper's figures stand there if they are for
/// the same epsilon.
fn over_sweep(
    sweep: &Sweep,
    sweeps: &Sweeps,
    figures: &[Figures],
    paper: Option<&'static PaperRepeatability>,
) -> Option<Chart> {
    let epsilon = sweeps.table_epsilon;
    let column = sweeps.epsilon.iter().position(|other| *other == epsilon).unwrap_or(0);
    let conditions: Vec<Condition> = sweeps.conditions.iter().copied().filter(sweep.belongs).collect();
    let series = |(index, first): (usize, &Figures)| {
        let method = first.summary.method();
        let swept: Vec<&Figures> = conditions.iter().filter_map(|&c| under(figures, c).nth(index)).collect();
        let models = swept.iter().flat_map(|figures| figures.runs.iter().flatten()).map(|row| &row.models);
        let statistics = swept.iter().map(|figures| &figures.repeatability()[column]);
        Series::new(named_with_models(method, models), method, statistics)
    };
    (conditions.len() > 1).then(|| Chart {
        title: format!("At ε {epsilon}, over {}", sweep.name),
        first: "method",
        axis: Axis {
            label: Some(format!("{} (ε {epsilon})", sweep.label)),
            prefix: sweep.prefix,
            values: conditions.iter().map(sweep.value).collect(),
            x: sweep.x,
        },
        others: &[],
        series: under(figures, sweeps.conditions[0]).enumerate().map(series).collect(),
        paper: paper.filter(|paper| paper.table_epsilon == epsilon).map(sweep.paper),
    })
}

/// The figures of all methods under one condition, in their order.
fn under<'a, 'r>(figures: &'a [Figures<'r>], condition: Condition) -> impl Iterator<Item = &'a Figures<'r>> {
    figures.iter().filter(move |figures| figures.condition == condition)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::tables;
    use crate::tables::paper::MODELNET40;

    const CLEAN: Condition = Condition { downsample: 1, noise: 0.0 };
    const BLURRED: Condition = Condition { downsample: 1, noise: 0.1 };

    fn row(condition: Condition, keypoints: usize, repeatability: [f64; 2]) -> Row {
        let coverage = (keypoints > 0).then_some(0.25);
        let (method, models) = ("iss".into(), Models::new());
        let beyond_chance = repeatability.map(|share| (keypoints > 0).then_some(share - 0.25)).into();
        let flat = (keypoints > 0).then_some(0.125);
        Row { method, models, condition, keypoints, coverage, repeatability: repeatability.into(), beyond_chance, flat }
    }

    #[test]
    fn tables_by_hand() {
        let conditions = vec![CLEAN, BLURRED];
        let sweeps = Sweeps { epsilon: vec![0.1, 0.2], table_epsilon: 0.2, conditions };
        let pairs = [
            Sample { name: "a".into(), rows: vec![row(CLEAN, 4, [0.5, 1.0]), row(BLURRED, 0, [0.0, 0.0])] },
            Sample { name: "b".into(), rows: vec![row(CLEAN, 8, [0.25, 1.0]), row(BLURRED, 2, [0.0, 0.5])] },
        ];
        let settings = json!({"seed": 0});
        let report = report(&sweeps, &settings, &[&pairs], None);
        let markdown = "Relative repeatability, mean over 2 pairs ± standard deviation over pairs:

| method | ε 0.1 | ε 0.2 | keypoints | coverage |
|---|---|---|---|---|
| iss | 0.375 ±0.177 | 1.000 ±0.000 | 6.0 | 0.2500 |

At ε 0.2, over noise:

| method | σ 0 | σ 0.1 |
|---|---|---|
| iss | 1.000 ±0.000 | 0.250 ±0.354 |

Beyond chance: 0 is the share that random points of the other view would find:

| method | beyond ε 0.1 | beyond ε 0.2 | on flat places |
|---|---|---|---|
| iss | 0.125 ±0.177 | 0.750 ±0.000 | 0.125 |
";
        assert_eq!(tables::markdown(&report.charts), markdown);
        let csv = &report.csv;
        assert_eq!(
            csv.lines().nth(1).unwrap(),
            "iss,1,0,0.1,0.375,0.1767766952966369,0.125,0.1767766952966369,6,0.25,0.125,2"
        );
        assert_eq!(csv.lines().count(), 5);
        let json: Value = serde_json::from_str(&report.json).unwrap();
        assert_eq!(json["rows"][1]["repeatability"], json!([0.0, 0.25]));
        assert_eq!((json["rows"].as_array().unwrap().len(), &json["settings"]), (2, &settings));
        assert!(tables::text_lines(&report.charts).join("\n").contains("iss             0.375 ±0.177"));
        let tick = |chart: &Chart| ((chart.axis.x)(chart.axis.values[1]), chart.axis.label.clone().unwrap());
        let drawn = report.charts.iter().filter(|chart| chart.axis.label.is_some());
        let curves: Vec<_> = drawn.map(|chart| (tick(chart), chart.series[0].curve.clone())).collect();
        assert!(csv.contains("iss,1,0.1,0.2,0.25,0.3535533905932738,0.25,,1,0.25,0.125,2"), "{csv}");
        let expected = [
            ((0.2, "ε".to_owned()), vec![Some(0.375), Some(1.0)]),
            ((0.1, "noise σ (ε 0.2)".to_owned()), vec![Some(1.0), Some(0.25)]),
        ];
        assert_eq!(curves, expected);
    }

    #[test]
    fn models_that_were_chosen_are_named_in_the_tables() {
        let sweeps = Sweeps { epsilon: vec![0.1, 0.2], table_epsilon: 0.2, conditions: vec![CLEAN] };
        let pair = |models: &[(&str, usize)]| {
            let models = models.iter().map(|&(model, number)| (model.to_owned(), number)).collect();
            Sample { name: "a".into(), rows: vec![Row { models, ..row(CLEAN, 4, [0.5, 1.0]) }] }
        };
        let first_row = |pairs: &[Sample<Row>]| {
            let lines = report(&sweeps, &json!({}), &[pairs], None).text_lines();
            lines.into_iter().find(|line| line.starts_with("iss")).unwrap()
        };
        let scenes = pair(&[("scenes", 2)]);
        assert!(first_row(std::slice::from_ref(&scenes)).starts_with("iss (scenes) "));
        assert!(first_row(&[scenes, pair(&[("scenes", 1), ("compact", 1)])]).starts_with("iss (compact 1, scenes 3) "));
        // A table over noise counts the clouds under all of it.
        let sweeps = Sweeps { conditions: vec![CLEAN, BLURRED], ..sweeps.clone() };
        let by = |model: &str| Models::from([(model.to_owned(), 2)]);
        let rows = vec![
            Row { models: by("scenes"), ..row(CLEAN, 4, [0.5, 1.0]) },
            Row { models: by("compact"), ..row(BLURRED, 4, [0.5, 1.0]) },
        ];
        let pairs = [Sample { name: "a".into(), rows }];
        let settings = json!({});
        let tables = tables::markdown(&report(&sweeps, &settings, &[&pairs], None).charts);
        assert!(tables.contains("| iss (scenes) |") && tables.contains("| iss (compact 2, scenes 2) |"), "{tables}");
    }

    #[test]
    fn the_papers_rows_stand_where_they_have_figures() {
        let blurred = Condition { downsample: 1, noise: 0.08 };
        let pairs = [Sample { name: "a".into(), rows: vec![row(CLEAN, 4, [0.5, 1.0]), row(blurred, 4, [0.25, 0.75])] }];
        let settings = json!({});
        let markdown = |table_epsilon| {
            let (epsilon, conditions) = (vec![0.04, 0.3], vec![CLEAN, blurred]);
            let sweeps = Sweeps { epsilon, table_epsilon, conditions };
            tables::markdown(&report(&sweeps, &settings, &[&pairs], Some(&MODELNET40)).charts)
        };
        let usual = markdown(0.04);
        for row in [
            "| iss | 0.500 | 1.000 | 4.0 |",
            "| snake (paper) | 0.864 | - | - | - |",
            "| iss (paper) | 0.096 | 0.020 |",
        ] {
            assert!(usual.contains(row), "{usual}");
        }
        // The paper's sweeps have another epsilon.
        assert!(!markdown(0.3).contains("| iss (paper) | 0.096 | 0.020 |"));
    }

    #[test]
    fn seeds_by_hand() {
        let sweeps = Sweeps { epsilon: vec![0.1, 0.2], table_epsilon: 0.2, conditions: vec![CLEAN] };
        let pair = |shares| Sample { name: "a".into(), rows: vec![row(CLEAN, 4, shares)] };
        let runs = [[pair([0.25, 0.5]), pair([0.5, 0.5])], [pair([0.5, 0.75]), pair([0.75, 0.75])]];
        let settings = json!({});
        let report = report(&sweeps, &settings, &runs.each_ref().map(|run| &run[..]), None);
        let markdown = tables::markdown(&report.charts);
        assert!(markdown.starts_with("Relative repeatability, mean over 2 pairs ± standard deviation over 2 seeds:"));
        // Means of 0.375 and 0.625, 0.5 and 0.75.
        assert!(markdown.contains("| iss | 0.500 ±0.177 | 0.625 ±0.177 | 4.0 | 0.2500 |"), "{markdown}");
    }
}
