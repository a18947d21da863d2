//! Reports of semantic consistency: tables, curves, CSV and JSON.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use snake_core::Result;

use super::{Models, Pair, Report, alike, named_with_models, num_models};
use crate::tables::paper::PaperTable;
use crate::tables::plot::{Line, Panel};
use crate::tables::{self, Statistic, Table, mean};
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

/// The figures of all methods.
struct Evaluation<'a> {
    threshold: &'a [f64],
    settings: &'a Value,
    figures: Vec<Figure>,
    num_shapes: usize,
    num_classes: usize,
    num_seeds: usize,
    num_models: usize,
    paper: Option<&'a PaperTable>,
}

/// The figures of one method: of a class, or their means over the classes or over the pairs of bodies.
struct Figure {
    /// The name of the method, and with the models that were chosen.
    method: String,
    title: String,
    class: Option<String>,
    keypoints: f64,
    /// IoU for each threshold, by the strict rule and by the paper's.
    strict: Vec<Statistic>,
    paper: Vec<Statistic>,
    /// Recall for each threshold, by the strict rule.
    recall: Vec<Statistic>,
}

/// Computes the IoU of shapes or of pairs of bodies. The flag selects the paper's rule instead of the strict one.
type Iou = fn(&[MatchCounts], bool) -> Result<f64>;

/// The value of one cell of a method's figure.
#[derive(Clone, Copy, PartialEq)]
enum Cell {
    Iou { is_paper: bool },
    Recall,
}

/// The rows of one method, class by class.
type Classes<'a> = Vec<Vec<&'a Row>>;

impl Figure {
    /// The statistic over the seeds and models of the mean over the classes.
    fn new(runs: &[Classes], class: Option<&str>, iou: Iou) -> Result<Self> {
        let at = |threshold: usize, cell: Cell| {
            let is_paper = cell == Cell::Iou { is_paper: true };
            let counts = |row: &&Row| if is_paper { row.paper[threshold] } else { row.strict[threshold] };
            let score = |counts: MatchCounts| if cell == Cell::Recall { counts.recall() } else { counts.iou() };
            let class_score = |rows: &Vec<&Row>| {
                let counts: Vec<MatchCounts> = rows.iter().map(counts).collect();
                if cell == Cell::Recall { Ok(sum(&counts).recall()) } else { iou(&counts, is_paper) }
            };
            let run_score = |classes: &Classes| Ok(mean(&classes.iter().map(class_score).collect::<Result<Vec<_>>>()?));
            let parts: Vec<f64> = runs[0].iter().flatten().map(|row| score(counts(row))).collect();
            Ok(Statistic::over_seeds(&runs.iter().map(run_score).collect::<Result<Vec<_>>>()?, &parts))
        };
        let first = runs[0][0][0];
        let all = |cell| (0..first.strict.len()).map(|threshold| at(threshold, cell)).collect::<Result<_>>();
        let keypoints = |rows: &Vec<&Row>| mean(&rows.iter().map(|row| row.keypoints as f64).collect::<Vec<_>>());
        Ok(Self {
            method: first.method.clone(),
            title: named_with_models(&first.method, runs.iter().flatten().flatten().map(|row| &row.models)),
            class: class.map(str::to_owned),
            keypoints: mean(&runs.iter().flatten().map(keypoints).collect::<Vec<_>>()),
            strict: all(Cell::Iou { is_paper: false })?,
            paper: all(Cell::Iou { is_paper: true })?,
            recall: all(Cell::Recall)?,
        })
    }
}

/// The report of the shapes with their classes, or the pairs of bodies without classes, seed by seed. Rows of the same method
/// are those of several models. The tables also show the paper's rows, and the JSON has the settings.
///
/// # Errors
/// [`Error::Input`](snake_core::Error::Input) when a row has no counts.
///
/// # Panics
/// When there are no shapes, or when two shapes have rows for different methods or thresholds.
pub fn report(
    threshold: &[f64],
    settings: &Value,
    runs: &[&[Pair<Row>]],
    classes: &[Option<&str>],
    paper: Option<&PaperTable>,
) -> Result<Report> {
    let evaluation = Evaluation::new(threshold, settings, runs, classes, paper)?;
    let curves = Some(("mIoU", evaluation.panels()));
    Ok(Report { tables: evaluation.tables(), curves, csv: evaluation.csv(), json: evaluation.json() })
}

impl<'a> Evaluation<'a> {
    /// Summarises the shapes, seed by seed.
    fn new(
        threshold: &'a [f64],
        settings: &'a Value,
        runs: &[&[Pair<Row>]],
        classes: &[Option<&str>],
        paper: Option<&'a PaperTable>,
    ) -> Result<Self> {
        let mut distinct = classes.to_vec();
        distinct.sort_unstable();
        distinct.dedup();
        let num_classes = distinct.iter().flatten().count();
        let mut figures = Vec::new();
        let methods = alike(runs[0].first().map_or(&[][..], |shape| &shape.rows), |a, b| a.method == b.method);
        for method in &methods {
            let figure = |chosen: &[Option<&str>], class, iou| {
                let class_rows = |run: usize, row: usize, class: &Option<&str>| -> Vec<&Row> {
                    let belongs = runs[run].iter().zip(classes).filter(|(_, other)| *other == class);
                    belongs.map(|(shape, _)| &shape.rows[row]).collect()
                };
                let run_classes = |(run, row)| chosen.iter().map(|class| class_rows(run, row, class)).collect();
                let places = (0..runs.len()).flat_map(|run| method.iter().map(move |&row| (run, row)));
                let per_run: Vec<Classes> = places.map(run_classes).collect();
                Figure::new(&per_run, class, iou)
            };
            figures.push(figure(&distinct, None, if num_classes > 0 { class_iou } else { pairs_iou })?);
            for class in distinct.iter().filter(|class| class.is_some()) {
                figures.push(figure(&[*class], *class, class_iou)?);
            }
        }
        let (num_shapes, num_seeds, num_models) = (classes.len(), runs.len(), num_models(&methods));
        Ok(Self { threshold, settings, figures, num_shapes, num_classes, num_seeds, num_models, paper })
    }

    /// The means over classes or pairs.
    fn means(&self) -> impl Iterator<Item = &Figure> {
        self.figures.iter().filter(|figure| figure.class.is_none())
    }

    /// One table for the IoU by each rule and one for the recall.
    fn tables(&self) -> Vec<Table> {
        let head = ["method".to_owned()].into_iter();
        let head: Vec<String> =
            head.chain(self.threshold.iter().map(f64::to_string)).chain(["keypoints".into()]).collect();
        let table = |what: &str, rule: &str, of: fn(&Figure) -> &[Statistic], paper: Option<&PaperTable>| {
            let row = |figure: &Figure| {
                let mut row = vec![figure.title.clone()];
                row.extend(of(figure).iter().map(Statistic::cell));
                row.push(format!("{:.1}", figure.keypoints));
                row
            };
            let (over, parts) = match self.num_classes {
                0 => (format!("{} pairs", self.num_shapes), "pairs"),
                classes => (format!("{} shapes of {classes} classes", self.num_shapes), "shapes"),
            };
            let deviation = tables::deviation_name(self.num_seeds, self.num_models, parts);
            let theirs = paper.into_iter().flat_map(|paper| paper.rows(self.threshold));
            let rows = self.means().map(row).chain(theirs.map(|row| [row, vec!["-".into()]].concat())).collect();
            let title = format!("{what} over {over} at each threshold ± {deviation}, {rule}");
            Table { title, head: head.clone(), rows }
        };
        vec![
            table("mIoU", "strict", |figure| &figure.strict, None),
            table("mIoU", "as the paper's released code counts", |figure| &figure.paper, self.paper),
            table("Share of annotated keypoints found", "strict", |figure| &figure.recall, None),
        ]
    }

    /// The tables as curves.
    fn panels(&self) -> Vec<Panel> {
        let panel = |rule: &str, of: fn(&Figure) -> &[Statistic], paper: Option<&PaperTable>| {
            let ours =
                |figure: &Figure| Line::new(&figure.method, of(figure).iter().map(|iou| Some(iou.mean)).collect());
            let theirs = paper.into_iter().flat_map(|paper| Line::from_paper(paper, self.threshold));
            Panel {
                x_label: format!("threshold ({rule})"),
                ticks: self.threshold.iter().map(|threshold| (*threshold, threshold.to_string())).collect(),
                lines: self.means().map(ours).chain(theirs).collect(),
            }
        };
        vec![panel("strict", |figure| &figure.strict, None), panel("as released", |figure| &figure.paper, self.paper)]
    }

    /// The CSV file: a line for each method, class and threshold. The class of the mean over all classes is empty.
    fn csv(&self) -> String {
        let mut text = String::from(
            "method,class,threshold,strict,strict_deviation,paper,paper_deviation,recall,recall_deviation,keypoints\n",
        );
        for Figure { method, class, keypoints, strict, paper, recall, .. } in &self.figures {
            for (((threshold, strict), paper), recall) in self.threshold.iter().zip(strict).zip(paper).zip(recall) {
                let class = class.as_deref().unwrap_or_default();
                let (strict, paper, recall) = (strict.csv(), paper.csv(), recall.csv());
                text += &format!("{method},{class},{threshold},{strict},{paper},{recall},{keypoints}\n");
            }
        }
        text
    }

    fn json(&self) -> String {
        let row = |Figure { method, class, keypoints, strict, paper, recall, .. }: &Figure| {
            let means = |all: &[Statistic]| all.iter().map(|iou| iou.mean).collect::<Vec<_>>();
            let deviations = |all: &[Statistic]| all.iter().map(|iou| iou.deviation).collect::<Vec<_>>();
            json!({
                "method": method,
                "class": class,
                "keypoints": keypoints,
                "strict": means(strict),
                "strict_deviation": deviations(strict),
                "paper": means(paper),
                "paper_deviation": deviations(paper),
                "recall": means(recall),
                "recall_deviation": deviations(recall),
            })
        };
        let rows: Vec<Value> = self.figures.iter().map(row).collect();
        let all = json!({"settings": self.settings, "shapes": self.num_shapes, "rows": rows});
        format!("{all:#}\n")
    }
}

/// The IoU of a class: of the summed counts of its shapes, by either rule.
fn class_iou(counts: &[MatchCounts], _is_paper: bool) -> Result<f64> {
    Ok(sum(counts).iou())
}

fn sum(counts: &[MatchCounts]) -> MatchCounts {
    let mut sum = MatchCounts::default();
    counts.iter().for_each(|&one| sum += one);
    sum
}

/// The IoU of pairs of bodies. The counts already include the random keypoints of the paper's rule.
fn pairs_iou(counts: &[MatchCounts], is_paper: bool) -> Result<f64> {
    smpl_iou(counts, if is_paper { SmplProtocol::PaperCompatible { seed: 0 } } else { SmplProtocol::Strict })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::paper::KEYPOINTNET;

    fn shape(keypoints: usize, strict: [usize; 3], paper: [usize; 3]) -> Pair<Row> {
        let counts = |[ground_truth, false_positives, false_negatives]: [usize; 3]| {
            vec![MatchCounts { ground_truth, false_positives, false_negatives }]
        };
        let (method, models) = ("iss".into(), Models::new());
        let row = Row { method, models, keypoints, strict: counts(strict), paper: counts(paper) };
        Pair { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn classes_are_summed_and_then_averaged() {
        let shapes = [shape(4, [4, 0, 0], [4, 0, 0]), shape(6, [4, 4, 4], [4, 0, 0]), shape(1, [2, 2, 1], [2, 0, 1])];
        let classes = [Some("chair"), Some("chair"), Some("airplane")];
        let settings = json!({});
        let report = Evaluation::new(&[0.1], &settings, &[&shapes], &classes, Some(&KEYPOINTNET)).unwrap();
        // By the strict rule the chair has (8 - 4) / (8 + 4), the airplane 1 / 4; by the released code 1 and 1 / 2.
        let markdown = tables::markdown(&report.tables());
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
        let csv = report.csv();
        assert_eq!(csv.lines().nth(2).unwrap(), "iss,airplane,0.1,0.25,,0.5,,0.5,,1");
        assert_eq!(csv.lines().count(), 4);
        let panels = report.panels();
        assert_eq!((panels[0].lines.len(), panels[1].lines.len()), (1, 8));
        assert_eq!(panels[1].lines[1].values, [Some(0.412)]);
    }

    #[test]
    fn pairs_are_averaged_by_the_rule() {
        let shapes = [shape(4, [4, 0, 0], [4, 0, 0]), shape(6, [4, 4, 4], [4, 4, 4])];
        let settings = json!({});
        let report = Evaluation::new(&[0.1], &settings, &[&shapes], &[None, None], None).unwrap();
        let [figure] = &report.figures[..] else { panic!("one method") };
        assert_eq!((figure.strict[0].mean, figure.keypoints), (0.5, 5.0));
        // The running IoU is 4 / 4, then 4 / 12.
        assert!((figure.paper[0].mean - (1.0 + 1.0 / 3.0) / 2.0).abs() < 1e-12);
        assert!(
            tables::text_lines(&report.tables())
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
        let report = Evaluation::new(&[0.1], &settings, &[&first, &second], &classes, None).unwrap();
        let markdown = tables::markdown(&report.tables());
        assert!(markdown.contains("± standard deviation over 2 seeds, strict"), "{markdown}");
        // Means of 0.625 and 0.125.
        assert!(markdown.contains("| iss | 0.375 ±0.354 | 3.5 |"), "{markdown}");
    }
}
