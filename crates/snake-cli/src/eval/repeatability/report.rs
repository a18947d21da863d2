//! The figures of repeatability: tables, curves, CSV and JSON.

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};

use super::super::paper::PaperRow;
use super::super::plot::{self, Line, Panel};
use super::super::record::Pair;
use super::super::table::{self, Table};
use super::views::Condition;
use super::{Plan, Row};

/// The sweeps that a condition can belong to; the undisturbed views to both.
const DOWN_SAMPLED: fn(&Condition) -> bool = |c| c.noise == 0.0;
const NOISY: fn(&Condition) -> bool = |c| c.downsample == 1;

/// Means over all pairs.
pub struct Report<'a> {
    plan: &'a Plan,
    settings: &'a Value,
    summaries: Vec<Summary>,
    num_pairs: usize,
    paper: &'a [PaperRow],
}

/// Means over the pairs for one method under one condition.
struct Summary {
    method: String,
    condition: Condition,
    keypoints: f64,
    /// Over the pairs that have keypoints; `None` if none has.
    coverage: Option<f64>,
    /// Mean and standard deviation for each epsilon.
    repeatability: Vec<(f64, f64)>,
}

impl Summary {
    /// Of the rows of all pairs that belong to the same method and condition.
    fn new(rows: &[&Row]) -> Self {
        let Row { method, condition, repeatability, .. } = rows[0];
        let keypoints = rows.iter().map(|row| row.keypoints as f64).collect::<Vec<_>>();
        let coverage: Vec<f64> = rows.iter().filter_map(|row| row.coverage).collect();
        let at = |i| mean_and_deviation(&rows.iter().map(|row| row.repeatability[i]).collect::<Vec<_>>());
        Self {
            method: method.clone(),
            condition: *condition,
            keypoints: mean_and_deviation(&keypoints).0,
            coverage: (!coverage.is_empty()).then(|| mean_and_deviation(&coverage).0),
            repeatability: (0..repeatability.len()).map(at).collect(),
        }
    }
}

/// Mean, and standard deviation over the pairs (n - 1; of one pair 0).
fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0).max(1.0)).sqrt())
}

/// Mean and standard deviation as a table shows them.
fn cell((mean, deviation): &(f64, f64)) -> String {
    format!("{mean:.3} ±{deviation:.3}")
}

impl<'a> Report<'a> {
    /// Sums up pairs that all have the same rows; the paper's rows are shown beside them.
    pub fn new(plan: &'a Plan, settings: &'a Value, pairs: &[Pair<Row>], paper: &'a [PaperRow]) -> Self {
        let num_rows = pairs.first().map_or(0, |pair| pair.rows.len());
        let rows_of = |i: usize| pairs.iter().map(|pair| &pair.rows[i]).collect::<Vec<_>>();
        let summaries = (0..num_rows).map(|i| Summary::new(&rows_of(i))).collect();
        Self { plan, settings, summaries, num_pairs: pairs.len(), paper }
    }

    /// The tables, for people.
    pub fn text(&self) -> String {
        table::text(&self.tables())
    }

    /// Writes `repeatability.csv`, `.json`, `.md` and `.svg`.
    pub fn write(&self, output: &Path) -> Result<()> {
        let markdown = table::markdown(&self.tables());
        let svg = plot::svg("relative repeatability", &self.panels());
        let texts = [("csv", self.csv()), ("json", self.json()?), ("md", markdown), ("svg", svg)];
        table::write(output, "repeatability", &texts)
    }

    /// The paper's three tables: over epsilon, over down-sampling and over noise.
    fn tables(&self) -> Vec<Table> {
        let down_sampling = self.over("down-sampling", DOWN_SAMPLED, |c| format!("1 in {}", c.downsample));
        let noise = self.over("noise", NOISY, |c| format!("σ {}", c.noise));
        std::iter::once(self.over_epsilon()).chain(down_sampling).chain(noise).collect()
    }

    /// The same as curves; down-sampling on a logarithmic axis.
    fn panels(&self) -> Vec<Panel> {
        let Plan { epsilon, table_epsilon, conditions, .. } = self.plan;
        let ours = |s: &Summary| Line {
            name: s.method.clone(),
            values: s.repeatability.iter().map(|(mean, _)| Some(*mean)).collect(),
            dashed: false,
        };
        let theirs = |row: &PaperRow| Line { name: row.method.into(), values: row.at(epsilon), dashed: true };
        let over_epsilon = Panel {
            x_label: "ε".into(),
            ticks: epsilon.iter().map(|epsilon| (*epsilon, epsilon.to_string())).collect(),
            lines: self.under(conditions[0]).map(ours).chain(self.paper.iter().map(theirs)).collect(),
        };
        let down_sampling = self.swept(DOWN_SAMPLED).map(|swept| {
            let tick = |c: &Condition| ((c.downsample as f64).log2(), c.downsample.to_string());
            let x_label = format!("down-sampling, 1 in (ε {table_epsilon})");
            Panel { x_label, ticks: swept.iter().map(tick).collect(), lines: self.lines(&swept) }
        });
        let noise = self.swept(NOISY).map(|swept| {
            let ticks = swept.iter().map(|c| (c.noise, c.noise.to_string())).collect();
            Panel { x_label: format!("noise σ (ε {table_epsilon})"), ticks, lines: self.lines(&swept) }
        });
        std::iter::once(over_epsilon).chain(down_sampling).chain(noise).collect()
    }

    /// A line for each method over conditions, at the tables' epsilon.
    fn lines(&self, swept: &[Condition]) -> Vec<Line> {
        let line = |i, first: &Summary| Line {
            name: first.method.clone(),
            values: swept
                .iter()
                .map(|c| self.under(*c).nth(i).map(|s| s.repeatability[self.table_column()].0))
                .collect(),
            dashed: false,
        };
        self.under(self.plan.conditions[0]).enumerate().map(|(i, first)| line(i, first)).collect()
    }

    /// The conditions of a sweep, if there are several.
    fn swept(&self, belongs: fn(&Condition) -> bool) -> Option<Vec<Condition>> {
        let swept: Vec<Condition> = self.plan.conditions.iter().copied().filter(belongs).collect();
        (swept.len() > 1).then_some(swept)
    }

    /// Where the tables' epsilon is.
    fn table_column(&self) -> usize {
        self.plan.epsilon.iter().position(|epsilon| *epsilon == self.plan.table_epsilon).unwrap_or(0)
    }

    /// Undisturbed views, a row for each method.
    fn over_epsilon(&self) -> Table {
        let mut head = vec!["method".to_owned()];
        head.extend(self.plan.epsilon.iter().map(|epsilon| format!("ε {epsilon}")));
        head.extend(["keypoints".into(), "coverage".into()]);
        let row = |s: &Summary| {
            let mut row = vec![s.method.clone()];
            row.extend(s.repeatability.iter().map(cell));
            row.push(format!("{:.1}", s.keypoints));
            row.push(s.coverage.map_or("-".into(), |coverage| format!("{coverage:.4}")));
            row
        };
        let title = format!("Relative repeatability, mean ± standard deviation over {} pairs", self.num_pairs);
        let paper_row = |paper: &PaperRow| {
            let mut row = vec![paper.method.to_owned()];
            row.extend(paper.cells(&self.plan.epsilon));
            row.extend(["-".into(), "-".into()]);
            row
        };
        let rows = self.under(self.plan.conditions[0]).map(row).chain(self.paper.iter().map(paper_row)).collect();
        Table { title, head, rows }
    }

    /// One epsilon, a row for each method and a column for each condition that belongs; none of a single condition.
    fn over(&self, what: &str, belongs: fn(&Condition) -> bool, name: fn(&Condition) -> String) -> Option<Table> {
        let swept = self.swept(belongs)?;
        let head = std::iter::once("method".to_owned()).chain(swept.iter().map(name)).collect();
        let mut rows: Vec<Vec<String>> = self.under(self.plan.conditions[0]).map(|s| vec![s.method.clone()]).collect();
        for condition in swept {
            let cells = self.under(condition).map(|s| cell(&s.repeatability[self.table_column()]));
            rows.iter_mut().zip(cells).for_each(|(row, cell)| row.push(cell));
        }
        Some(Table { title: format!("At ε {}, over {what}", self.plan.table_epsilon), head, rows })
    }

    /// The methods under one condition, in their order.
    fn under(&self, condition: Condition) -> impl Iterator<Item = &Summary> {
        self.summaries.iter().filter(move |summary| summary.condition == condition)
    }

    /// A line for each method, condition and epsilon.
    fn csv(&self) -> String {
        let mut text =
            String::from("method,downsample,noise,epsilon,repeatability,deviation,keypoints,coverage,pairs\n");
        for s in &self.summaries {
            for (epsilon, (mean, deviation)) in self.plan.epsilon.iter().zip(&s.repeatability) {
                let Condition { downsample, noise } = s.condition;
                let coverage = s.coverage.map(|coverage| coverage.to_string()).unwrap_or_default();
                let (method, keypoints, pairs) = (&s.method, s.keypoints, self.num_pairs);
                text += &format!(
                    "{method},{downsample},{noise},{epsilon},{mean},{deviation},{keypoints},{coverage},{pairs}\n"
                );
            }
        }
        text
    }

    fn json(&self) -> Result<String> {
        let row = |s: &Summary| {
            json!({
                "method": s.method,
                "downsample": s.condition.downsample,
                "noise": s.condition.noise,
                "repeatability": s.repeatability.iter().map(|(mean, _)| mean).collect::<Vec<_>>(),
                "deviation": s.repeatability.iter().map(|(_, deviation)| deviation).collect::<Vec<_>>(),
                "keypoints": s.keypoints,
                "coverage": s.coverage,
            })
        };
        let rows: Vec<Value> = self.summaries.iter().map(row).collect();
        let all = json!({"settings": self.settings, "pairs": self.num_pairs, "rows": rows});
        Ok(serde_json::to_string_pretty(&all)? + "\n")
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::paper::MODELNET40;
    use super::*;

    const CLEAN: Condition = Condition { downsample: 1, noise: 0.0 };
    const BLURRED: Condition = Condition { downsample: 1, noise: 0.1 };

    fn row(condition: Condition, keypoints: usize, repeatability: [f64; 2]) -> Row {
        let coverage = (keypoints > 0).then_some(0.25);
        Row { method: "iss".into(), condition, keypoints, coverage, repeatability: repeatability.into() }
    }

    #[test]
    fn tables_by_hand() {
        let conditions = vec![CLEAN, BLURRED];
        let plan = Plan { epsilon: vec![0.1, 0.2], table_epsilon: 0.2, conditions, num_points: 1, seed: 0 };
        let pairs = [
            Pair { name: "a".into(), rows: vec![row(CLEAN, 4, [0.5, 1.0]), row(BLURRED, 0, [0.0, 0.0])] },
            Pair { name: "b".into(), rows: vec![row(CLEAN, 8, [0.25, 1.0]), row(BLURRED, 2, [0.0, 0.5])] },
        ];
        let settings = json!({"seed": 0});
        let report = Report::new(&plan, &settings, &pairs, &[]);
        let markdown = "Relative repeatability, mean ± standard deviation over 2 pairs:

| method | ε 0.1 | ε 0.2 | keypoints | coverage |
|---|---|---|---|---|
| iss | 0.375 ±0.177 | 1.000 ±0.000 | 6.0 | 0.2500 |

At ε 0.2, over noise:

| method | σ 0 | σ 0.1 |
|---|---|---|
| iss | 1.000 ±0.000 | 0.250 ±0.354 |
";
        assert_eq!(table::markdown(&report.tables()), markdown);
        let csv = report.csv();
        assert_eq!(csv.lines().nth(1).unwrap(), "iss,1,0,0.1,0.375,0.1767766952966369,6,0.25,2");
        assert_eq!(csv.lines().count(), 5);
        let json: Value = serde_json::from_str(&report.json().unwrap()).unwrap();
        assert_eq!(json["rows"][1]["repeatability"], json!([0.0, 0.25]));
        assert_eq!((json["rows"].as_array().unwrap().len(), &json["settings"]), (2, &settings));
        assert!(report.text().contains("iss             0.375 ±0.177"));
        let panels = report.panels();
        let curves: Vec<_> =
            panels.iter().map(|panel| (panel.ticks[1].clone(), panel.lines[0].values.clone())).collect();
        let expected = [
            ((0.2, "0.2".to_owned()), vec![Some(0.375), Some(1.0)]),
            ((0.1, "0.1".to_owned()), vec![Some(1.0), Some(0.25)]),
        ];
        assert_eq!(curves, expected);
    }

    #[test]
    fn the_papers_rows_stand_where_they_have_figures() {
        let plan =
            Plan { epsilon: vec![0.04, 0.3], table_epsilon: 0.3, conditions: vec![CLEAN], num_points: 1, seed: 0 };
        let pairs = [Pair { name: "a".into(), rows: vec![row(CLEAN, 4, [0.5, 1.0])] }];
        let settings = json!({});
        let report = Report::new(&plan, &settings, &pairs, &MODELNET40);
        let markdown = table::markdown(&report.tables());
        assert!(
            markdown.ends_with("| SNAKE (paper) | 0.864 | - | - | - |\n| random (paper) | 0.094 | - | - | - |\n"),
            "{markdown}"
        );
    }
}
