//! The figures of semantic consistency: tables, curves, CSV and JSON.

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};
use snake_core::metrics::{MatchCounts, SmplProtocol, smpl_iou};

use super::super::paper::PaperRow;
use super::super::plot::{self, Line, Panel};
use super::super::record::Pair;
use super::super::table::{self, Table};
use super::Row;

/// The figures of all methods.
pub struct Report<'a> {
    threshold: &'a [f64],
    settings: &'a Value,
    figures: Vec<Figure>,
    num_shapes: usize,
    num_classes: usize,
    paper: &'a [PaperRow],
}

/// The IoU of one method over a class, or the mean over the classes, or over pairs of bodies.
struct Figure {
    method: String,
    class: Option<String>,
    keypoints: f64,
    /// For each threshold, by either rule.
    strict: Vec<f64>,
    paper: Vec<f64>,
}

impl Figure {
    /// Of the rows of one method.
    fn new(rows: &[&Row], class: Option<&str>, iou: impl Fn(&[MatchCounts], bool) -> Result<f64>) -> Result<Self> {
        let at = |threshold: usize, is_paper: bool| {
            let counts = |row: &&Row| if is_paper { row.paper[threshold] } else { row.strict[threshold] };
            iou(&rows.iter().map(counts).collect::<Vec<_>>(), is_paper)
        };
        let all = |is_paper| (0..rows[0].strict.len()).map(|threshold| at(threshold, is_paper)).collect::<Result<_>>();
        Ok(Self {
            method: rows[0].method.clone(),
            class: class.map(str::to_owned),
            keypoints: rows.iter().map(|row| row.keypoints as f64).sum::<f64>() / rows.len() as f64,
            strict: all(false)?,
            paper: all(true)?,
        })
    }

    /// The mean over the classes.
    fn mean(classes: &[Self]) -> Self {
        let mean = |of: fn(&Self) -> &[f64]| {
            let at = |i: usize| classes.iter().map(|class| of(class)[i]).sum::<f64>() / classes.len() as f64;
            (0..of(&classes[0]).len()).map(at).collect()
        };
        Self {
            method: classes[0].method.clone(),
            class: None,
            keypoints: classes.iter().map(|class| class.keypoints).sum::<f64>() / classes.len() as f64,
            strict: mean(|class| &class.strict),
            paper: mean(|class| &class.paper),
        }
    }
}

impl<'a> Report<'a> {
    /// Sums up shapes with their classes, or pairs of bodies, which have none; the paper's rows are shown beside them.
    pub fn new(
        threshold: &'a [f64],
        settings: &'a Value,
        shapes: &[Pair<Row>],
        classes: &[Option<&str>],
        paper: &'a [PaperRow],
    ) -> Result<Self> {
        let mut different = classes.to_vec();
        different.sort_unstable();
        different.dedup();
        let mut figures = Vec::new();
        for method in 0..shapes.first().map_or(0, |shape| shape.rows.len()) {
            let of_class = |class: &Option<&str>| {
                let belongs = shapes.iter().zip(classes).filter(|(_, other)| *other == class);
                let rows: Vec<&Row> = belongs.map(|(shape, _)| &shape.rows[method]).collect();
                Figure::new(&rows, *class, if class.is_some() { class_iou } else { pairs_iou })
            };
            let mut of_classes = different.iter().map(of_class).collect::<Result<Vec<_>>>()?;
            if different[0].is_some() {
                figures.push(Figure::mean(&of_classes));
            }
            figures.append(&mut of_classes);
        }
        let num_classes = different.iter().flatten().count();
        Ok(Self { threshold, settings, figures, num_shapes: shapes.len(), num_classes, paper })
    }

    /// The tables, for people.
    pub fn text(&self) -> String {
        table::text(&self.tables())
    }

    /// Writes `semantic.csv`, `.json`, `.md` and `.svg`.
    pub fn write(&self, output: &Path) -> Result<()> {
        let markdown = table::markdown(&self.tables());
        let texts =
            [("csv", self.csv()), ("json", self.json()?), ("md", markdown), ("svg", plot::svg("mIoU", &self.panels()))];
        table::write(output, "semantic", &texts)
    }

    /// The means over classes or pairs.
    fn means(&self) -> impl Iterator<Item = &Figure> {
        self.figures.iter().filter(|figure| figure.class.is_none())
    }

    /// A table by each rule.
    fn tables(&self) -> Vec<Table> {
        let head = ["method".to_owned()].into_iter();
        let head: Vec<String> =
            head.chain(self.threshold.iter().map(f64::to_string)).chain(["keypoints".into()]).collect();
        let table = |rule: &str, of: fn(&Figure) -> &[f64], paper: &[PaperRow]| {
            let row = |figure: &Figure| {
                let mut row = vec![figure.method.clone()];
                row.extend(of(figure).iter().map(|iou| format!("{iou:.3}")));
                row.push(format!("{:.1}", figure.keypoints));
                row
            };
            let paper_row = |paper: &PaperRow| {
                let mut row = vec![paper.method.to_owned()];
                row.extend(paper.cells(self.threshold));
                row.push("-".into());
                row
            };
            let over = match self.num_classes {
                0 => format!("{} pairs", self.num_shapes),
                classes => format!("{} shapes of {classes} classes", self.num_shapes),
            };
            let rows = self.means().map(row).chain(paper.iter().map(paper_row)).collect();
            Table { title: format!("mIoU over {over} at each threshold, {rule}"), head: head.clone(), rows }
        };
        vec![
            table("strict", |figure| &figure.strict, &[]),
            table("as the paper's released code counts", |figure| &figure.paper, self.paper),
        ]
    }

    /// The same as curves.
    fn panels(&self) -> Vec<Panel> {
        let panel = |rule: &str, of: fn(&Figure) -> &[f64], paper: &[PaperRow]| {
            let ours = |figure: &Figure| Line {
                name: figure.method.clone(),
                values: of(figure).iter().copied().map(Some).collect(),
                dashed: false,
            };
            let theirs =
                |row: &PaperRow| Line { name: row.method.into(), values: row.at(self.threshold), dashed: true };
            Panel {
                x_label: format!("threshold ({rule})"),
                ticks: self.threshold.iter().map(|threshold| (*threshold, threshold.to_string())).collect(),
                lines: self.means().map(ours).chain(paper.iter().map(theirs)).collect(),
            }
        };
        vec![panel("strict", |figure| &figure.strict, &[]), panel("as released", |figure| &figure.paper, self.paper)]
    }

    /// A line for each method, class and threshold; the mean over all classes has no class.
    fn csv(&self) -> String {
        let mut text = String::from("method,class,threshold,strict,paper,keypoints\n");
        for Figure { method, class, keypoints, strict, paper } in &self.figures {
            for ((threshold, strict), paper) in self.threshold.iter().zip(strict).zip(paper) {
                let class = class.as_deref().unwrap_or_default();
                text += &format!("{method},{class},{threshold},{strict},{paper},{keypoints}\n");
            }
        }
        text
    }

    fn json(&self) -> Result<String> {
        let row = |Figure { method, class, keypoints, strict, paper }: &Figure| json!({"method": method, "class": class, "keypoints": keypoints, "strict": strict, "paper": paper});
        let rows: Vec<Value> = self.figures.iter().map(row).collect();
        let all = json!({"settings": self.settings, "shapes": self.num_shapes, "rows": rows});
        Ok(serde_json::to_string_pretty(&all)? + "\n")
    }
}

/// The IoU of the counts of a class's shapes, by either rule.
fn class_iou(counts: &[MatchCounts], _is_paper: bool) -> Result<f64> {
    let mut sum = MatchCounts::default();
    counts.iter().for_each(|&one| sum += one);
    Ok(sum.iou())
}

/// The figure of pairs of bodies; the random filling was before.
fn pairs_iou(counts: &[MatchCounts], is_paper: bool) -> Result<f64> {
    Ok(smpl_iou(counts, if is_paper { SmplProtocol::PaperCompatible { seed: 0 } } else { SmplProtocol::Strict })?)
}

#[cfg(test)]
mod tests {
    use super::super::super::paper::KEYPOINTNET;
    use super::*;

    fn shape(keypoints: usize, strict: [usize; 3], paper: [usize; 3]) -> Pair<Row> {
        let counts = |[ground_truth, false_positives, false_negatives]: [usize; 3]| {
            vec![MatchCounts { ground_truth, false_positives, false_negatives }]
        };
        let row = Row { method: "iss".into(), keypoints, strict: counts(strict), paper: counts(paper) };
        Pair { name: "a".into(), rows: vec![row] }
    }

    #[test]
    fn classes_are_summed_and_then_averaged() {
        let shapes = [shape(4, [4, 0, 0], [4, 0, 0]), shape(6, [4, 4, 4], [4, 0, 0]), shape(1, [2, 2, 1], [2, 0, 1])];
        let classes = [Some("chair"), Some("chair"), Some("airplane")];
        let settings = json!({});
        let report = Report::new(&[0.1], &settings, &shapes, &classes, &KEYPOINTNET).unwrap();
        // Strictly the chair has (8 - 4) / (8 + 4), the airplane 1 / 4; as released 1 and 1 / 2.
        let markdown = table::markdown(&report.tables());
        let expected = "mIoU over 3 shapes of 2 classes at each threshold, strict:

| method | 0.1 | keypoints |
|---|---|---|
| iss | 0.292 | 3.0 |

mIoU over 3 shapes of 2 classes at each threshold, as the paper's released code counts:

| method | 0.1 | keypoints |
|---|---|---|
| iss | 0.750 | 3.0 |
| SNAKE (paper) | 0.412 | - |
";
        assert_eq!(markdown, expected);
        let csv = report.csv();
        assert_eq!(csv.lines().nth(2).unwrap(), "iss,airplane,0.1,0.25,0.5,1");
        assert_eq!(csv.lines().count(), 4);
        let panels = report.panels();
        assert_eq!((panels[0].lines.len(), panels[1].lines.len()), (1, 2));
        assert_eq!(panels[1].lines[1].values, [Some(0.412)]);
    }

    #[test]
    fn pairs_are_averaged_by_the_rule() {
        let shapes = [shape(4, [4, 0, 0], [4, 0, 0]), shape(6, [4, 4, 4], [4, 4, 4])];
        let settings = json!({});
        let report = Report::new(&[0.1], &settings, &shapes, &[None, None], &[]).unwrap();
        let [figure] = &report.figures[..] else { panic!("one method") };
        assert_eq!((figure.strict[0], figure.keypoints), (0.5, 5.0));
        // Running: 4 / 4, then 4 / 12.
        assert!((figure.paper[0] - (1.0 + 1.0 / 3.0) / 2.0).abs() < 1e-12);
        assert!(report.text().contains("mIoU over 2 pairs at each threshold, strict"));
    }
}
