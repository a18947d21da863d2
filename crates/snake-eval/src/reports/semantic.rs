//! Reports of semantic consistency: tables, curves, CSV and JSON.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use snake_core::Result;

use super::{Models, Report, Sample, Summary, alike, csv, json, named_with_models, num_models, rows_by_run};
use crate::tables::paper::PaperTable;
use crate::tables::{Axis, Chart, Series, Statistic, deviation_name, mean};
use crate::{MatchCounts, SmplProtocol, smpl_iou};

/// The matches of one method on one shape or pair of bodies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The name of the method.
    pub method: String,
    /// The models that were chosen for the clouds.
    #[serde(default, skip_serializing_if = "Models::is_empty")]
    pub models: Models,
    /// Number of keypoints; for a pair of bodies, on the first one.
    pub keypoints: usize,
    /// Counts for each threshold, by the strict rule.
    pub strict: Vec<MatchCounts>,
    /// Counts for each threshold, by the rule of the paper's released code.
    pub paper: Vec<MatchCounts>,
}

/// A figure of counts.
struct Kind {
    /// The names of its mean and deviation in files.
    names: [&'static str; 2],
    counts: fn(&Row) -> &[MatchCounts],
    /// The value for one shape.
    shape: fn(&MatchCounts) -> f64,
    /// The value for a class, from the counts of its shapes.
    class: fn(&[MatchCounts]) -> Result<f64>,
    /// The value for pairs of bodies. The counts already include the random keypoints of the paper's rule.
    bodies: fn(&[MatchCounts]) -> Result<f64>,
}

const KINDS: [Kind; 3] = [
    Kind {
        names: ["strict", "strict_deviation"],
        counts: |row| &row.strict,
        shape: MatchCounts::iou,
        class: |counts| Ok(sum(counts).iou()),
        bodies: |counts| smpl_iou(counts, SmplProtocol::Strict),
    },
    Kind {
        names: ["paper", "paper_deviation"],
        counts: |row| &row.paper,
        shape: MatchCounts::iou,
        class: |counts| Ok(sum(counts).iou()),
        bodies: |counts| smpl_iou(counts, SmplProtocol::PaperCompatible { seed: 0 }),
    },
    Kind {
        names: ["recall", "recall_deviation"],
        counts: |row| &row.strict,
        shape: MatchCounts::recall,
        class: |counts| Ok(sum(counts).recall()),
        bodies: |counts| Ok(sum(counts).recall()),
    },
];

fn sum(counts: &[MatchCounts]) -> MatchCounts {
    let mut sum = MatchCounts::default();
    counts.iter().for_each(|&one| sum += one);
    sum
}

/// The rows of one method, class by class.
type Classes<'a> = Vec<Vec<&'a Row>>;

/// The statistics over the seeds and models of the mean over the classes. `class` names the only one.
fn summarize(runs: &[Classes], class: Option<&str>, are_bodies: bool) -> Result<Summary> {
    let statistic = |kind: &Kind, threshold: usize| {
        let class_value = |rows: &Vec<&Row>| {
            let counts: Vec<MatchCounts> = rows.iter().map(|row| (kind.counts)(row)[threshold]).collect();
            if are_bodies { (kind.bodies)(&counts) } else { (kind.class)(&counts) }
        };
        let run_value = |classes: &Classes| Ok(mean(&classes.iter().map(class_value).collect::<Result<Vec<_>>>()?));
        let shapes = runs[0].iter().flatten().map(|row| (kind.shape)(&(kind.counts)(row)[threshold]));
        let run_values = runs.iter().map(run_value).collect::<Result<Vec<_>>>()?;
        Ok(Statistic::over_seeds(&run_values, &shapes.collect::<Vec<_>>()))
    };
    let Row { method, strict, .. } = runs[0][0][0];
    let swept = |kind: &Kind| {
        Ok((kind.names, (0..strict.len()).map(|threshold| statistic(kind, threshold)).collect::<Result<_>>()?))
    };
    let keypoints = |rows: &Vec<&Row>| mean(&rows.iter().map(|row| row.keypoints as f64).collect::<Vec<_>>());
    Ok(Summary {
        keys: vec![("method", method.as_str().into()), ("class", class.into())],
        title: named_with_models(method, runs.iter().flatten().flatten().map(|row| &row.models)),
        swept: KINDS.iter().map(swept).collect::<Result<_>>()?,
        means: vec![("keypoints", Some(mean(&runs.iter().flatten().map(keypoints).collect::<Vec<_>>())))],
    })
}

/// The report of the shapes with their classes, or the pairs of bodies without classes, seed by seed. Rows of the same method
/// belong to several models. The tables also show the paper's rows, and the JSON has the settings.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when a row has no counts.
///
/// # Panics
/// When there are no shapes, or when two shapes have rows for different methods or thresholds.
pub fn report(
    threshold: &[f64],
    settings: &Value,
    runs: &[&[Sample<Row>]],
    classes: &[Option<&str>],
    paper: Option<&'static PaperTable>,
) -> Result<Report> {
    let mut distinct = classes.to_vec();
    distinct.sort_unstable();
    distinct.dedup();
    let named: Vec<Option<&str>> = distinct.iter().copied().filter(Option::is_some).collect();
    let groups = alike(runs[0].first().map_or(&[][..], |shape| &shape.rows), |a, b| a.method == b.method);
    let (mut summaries, mut means) = (Vec::new(), Vec::new());
    for group in &groups {
        let rows = rows_by_run(runs, group);
        let summarize_classes = |chosen: &[Option<&str>], class| {
            let class_rows = |(run, class): (usize, Option<&str>)| {
                let shapes = rows[run].iter().zip(classes).filter(|(_, other)| **other == class);
                shapes.map(|(row, _)| *row).collect()
            };
            let run_classes = |run| chosen.iter().map(|&class| class_rows((run, class))).collect();
            let runs: Vec<Classes> = (0..rows.len()).map(run_classes).collect();
            summarize(&runs, class, named.is_empty())
        };
        means.push(summaries.len());
        summaries.push(summarize_classes(&distinct, None)?);
        for class in &named {
            summaries.push(summarize_classes(&[*class], *class)?);
        }
    }
    let (over, parts) = match named.len() {
        0 => (format!("{} pairs", classes.len()), "pairs"),
        number => (format!("{} shapes of {number} classes", classes.len()), "shapes"),
    };
    let deviation = deviation_name(runs.len(), num_models(&groups), parts);
    let over = format!("over {over} at each threshold ± {deviation}");
    let all: Vec<&Summary> = summaries.iter().collect();
    let means: Vec<&Summary> = means.into_iter().map(|index| &summaries[index]).collect();
    let csv = csv(("threshold", threshold), &all, None);
    let rows = all.iter().map(|summary| summary.json()).collect();
    let json = json(settings, [("shapes", classes.len().into())], rows);
    Ok(Report { charts: charts(&over, threshold, &means, paper), y_label: "mIoU", csv, json })
}

/// A table for the IoU by each rule, which have curves, and one for the recall.
fn charts(over: &str, threshold: &[f64], means: &[&Summary], paper: Option<&'static PaperTable>) -> Vec<Chart> {
    let chart = |kind: usize, title: String, rule: Option<&str>, paper| {
        let series = |summary: &&Summary| {
            let mut series = Series::new(summary.title.clone(), summary.method(), summary.swept[kind].1.iter());
            series.cells.push(summary.means[0].1.map_or("-".into(), |keypoints| format!("{keypoints:.1}")));
            series
        };
        let label = rule.map(|rule| format!("threshold ({rule})"));
        let axis = Axis { label, prefix: "", values: threshold.to_vec(), x: |threshold| threshold };
        let series = means.iter().map(series).collect();
        Chart { title, first: "method", axis, others: &["keypoints"], series, paper }
    };
    vec![
        chart(0, format!("mIoU {over}, strict"), Some("strict"), None),
        chart(1, format!("mIoU {over}, as the paper's released code counts"), Some("as released"), paper),
        chart(2, format!("Share of annotated keypoints found {over}, strict"), None, None),
    ]
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::tables;
    use crate::tables::paper::KEYPOINTNET;

    fn shape(keypoints: usize, strict: [usize; 3], paper: [usize; 3]) -> Sample<Row> {
        let counts = |[ground_truth, false_positives, false_negatives]: [usize; 3]| {
            vec![MatchCounts { ground_truth, false_positives, false_negatives }]
        };
        let (method, models) = ("iss".into(), Models::new());
        let row = Row { method, models, keypoints, strict: counts(strict), paper: counts(paper) };
        Sample { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn classes_are_summed_and_then_averaged() {
        let shapes = [shape(4, [4, 0, 0], [4, 0, 0]), shape(6, [4, 4, 4], [4, 0, 0]), shape(1, [2, 2, 1], [2, 0, 1])];
        let classes = [Some("chair"), Some("chair"), Some("airplane")];
        let settings = json!({});
        let report = report(&[0.1], &settings, &[&shapes], &classes, Some(&KEYPOINTNET)).unwrap();
        // By the strict rule the chair has (8 - 4) / (8 + 4), the airplane 1 / 4; by the released code 1 and 1 / 2.
        let markdown = tables::markdown(&report.charts);
        // The single shapes have 1, 0 and 1 / 4 by the strict rule; by the released code 1, 1 and 1 / 2.
        let expected = "mIoU over 3 shapes of 2 classes at each threshold ± standard deviation over shapes, strict:

| method | 0.1 | keypoints |
|---|---|---|
| iss | 0.292 ±0.520 | 3.0 |

mIoU over 3 shapes of 2 classes at each threshold ± standard deviation over shapes, as the paper's released code counts:

| method | 0.1 | keypoints |
|---|---|---|
| iss | 0.750 ±0.289 | 3.0 |
| snake (paper) | 0.412 | - |
";
        assert!(markdown.starts_with(expected), "{markdown}");
        // The chair has a recall of 4 / 8, the airplane of 1 / 2; the single shapes have 1, 0 and 1 / 2.
        let recall = "Share of annotated keypoints found over 3 shapes of 2 classes at each threshold ± standard deviation over shapes, strict:

| method | 0.1 | keypoints |
|---|---|---|
| iss | 0.500 ±0.500 | 3.0 |
";
        assert!(markdown.contains(recall), "{markdown}");
        let csv = &report.csv;
        assert_eq!(csv.lines().nth(2).unwrap(), "iss,airplane,0.1,0.25,,0.5,,0.5,,1");
        assert_eq!(csv.lines().count(), 4);
        let papers = report.charts.iter().map(|chart| chart.paper.map_or(0, |paper| paper.at(&[0.1]).len()));
        assert_eq!(papers.collect::<Vec<_>>(), [0, 7, 0]);
        assert_eq!(report.files().len(), 4);
    }

    #[test]
    fn pairs_are_averaged_by_the_rule() {
        let shapes = [shape(4, [4, 0, 0], [4, 0, 0]), shape(6, [4, 4, 4], [4, 4, 4])];
        let settings = json!({});
        let report = report(&[0.1], &settings, &[&shapes], &[None, None], None).unwrap();
        let json: Value = serde_json::from_str(&report.json).unwrap();
        let row = &json["rows"][0];
        assert_eq!((&row["strict"], &row["keypoints"]), (&json!([0.5]), &json!(5.0)));
        // The running IoU is 4 / 4, then 4 / 12.
        let paper = row["paper"][0].as_f64().unwrap();
        assert!((paper - (1.0 + 1.0 / 3.0) / 2.0).abs() < 1e-12);
        assert!(
            tables::text_lines(&report.charts)
                .join("\n")
                .contains("mIoU over 2 pairs at each threshold ± standard deviation over pairs, strict")
        );
    }

    #[test]
    fn each_seed_has_its_own_classes() {
        // Classes of 1 and 1 / 4, then of 0 and 1 / 4.
        let first = [shape(4, [4, 0, 0], [4, 0, 0]), shape(2, [2, 2, 1], [2, 0, 1])];
        let second = [shape(6, [4, 4, 4], [4, 0, 0]), shape(2, [2, 2, 1], [2, 0, 1])];
        let settings = json!({});
        let classes = [Some("chair"), Some("airplane")];
        let report = report(&[0.1], &settings, &[&first, &second], &classes, None).unwrap();
        let markdown = tables::markdown(&report.charts);
        assert!(markdown.contains("± standard deviation over 2 seeds, strict"), "{markdown}");
        // Means of 0.625 and 0.125.
        assert!(markdown.contains("| iss | 0.375 ±0.354 | 3.5 |"), "{markdown}");
    }
}
