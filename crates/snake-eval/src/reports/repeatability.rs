//! Reports of repeatability: tables, curves, CSV and JSON.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{Models, Pair, Report, alike, named_with_models, num_models, summed};
use crate::tables::paper::{PaperRepeatability, PaperTable};
use crate::tables::plot::{Line, Panel};
use crate::tables::{self, Statistic, Table, mean};
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

/// A sweep over one disturbance: its conditions, the column value of each condition, and the paper's table.
struct Sweep {
    belongs: fn(&Condition) -> bool,
    column_value: fn(&Condition) -> f64,
    paper: fn(&PaperRepeatability) -> &PaperTable,
}

// The clean views belong to both sweeps.
const DOWN_SAMPLING: Sweep =
    Sweep { belongs: |c| c.noise == 0.0, column_value: |c| c.downsample as f64, paper: |paper| &paper.downsample };
const NOISE: Sweep = Sweep { belongs: |c| c.downsample == 1, column_value: |c| c.noise, paper: |paper| &paper.noise };

/// The figures of every method and condition, as means over all pairs.
struct Evaluation<'a> {
    sweeps: &'a Sweeps,
    settings: &'a Value,
    summaries: Vec<Summary>,
    num_pairs: usize,
    num_seeds: usize,
    num_models: usize,
    paper: Option<&'a PaperRepeatability>,
}

/// Means over the pairs for one method under one condition.
struct Summary {
    method: String,
    models: Models,
    condition: Condition,
    keypoints: f64,
    /// Mean over the pairs that have keypoints; `None` if no pair has any.
    coverage: Option<f64>,
    /// Relative repeatability for each epsilon.
    repeatability: Vec<Statistic>,
}

impl Summary {
    /// Summarises the rows of all pairs for one method and condition, seed by seed and model by model.
    fn new(runs: &[Vec<&Row>]) -> Self {
        let Row { method, condition, repeatability, .. } = runs[0][0];
        let keypoints: Vec<f64> = runs.iter().flatten().map(|row| row.keypoints as f64).collect();
        let coverage: Vec<f64> = runs.iter().flatten().filter_map(|row| row.coverage).collect();
        let at = |i| {
            let shares = |rows: &Vec<&Row>| rows.iter().map(|row| row.repeatability[i]).collect::<Vec<_>>();
            let shares: Vec<Vec<f64>> = runs.iter().map(shares).collect();
            Statistic::over_seeds(&shares.iter().map(|shares| mean(shares)).collect::<Vec<_>>(), &shares[0])
        };
        Self {
            method: method.clone(),
            models: summed(runs.iter().flatten().map(|row| &row.models)),
            condition: *condition,
            keypoints: mean(&keypoints),
            coverage: (!coverage.is_empty()).then(|| mean(&coverage)),
            repeatability: (0..repeatability.len()).map(at).collect(),
        }
    }
}

/// The report of the pairs of each seed. All pairs have rows for the same methods and conditions; rows of the same method and
/// condition are those of several models. The tables also show the paper's rows, and the JSON has the settings.
///
/// # Panics
/// When there are no pairs, or when two pairs have rows for different methods or conditions.
pub fn report(sweeps: &Sweeps, settings: &Value, runs: &[&[Pair<Row>]], paper: Option<&PaperRepeatability>) -> Report {
    let evaluation = Evaluation::new(sweeps, settings, runs, paper);
    let curves = Some(("relative repeatability", evaluation.panels()));
    Report { tables: evaluation.tables(), curves, csv: evaluation.csv(), json: evaluation.json() }
}

impl<'a> Evaluation<'a> {
    /// Summarises the pairs of each seed.
    fn new(
        sweeps: &'a Sweeps,
        settings: &'a Value,
        runs: &[&[Pair<Row>]],
        paper: Option<&'a PaperRepeatability>,
    ) -> Self {
        let rows = runs[0].first().map_or(&[][..], |pair| &pair.rows);
        let groups = alike(rows, |a, b| (&a.method, a.condition) == (&b.method, b.condition));
        let rows_of = |group: &Vec<usize>| -> Vec<Vec<&Row>> {
            runs.iter()
                .flat_map(|pairs| group.iter().map(|&i| pairs.iter().map(|pair| &pair.rows[i]).collect()))
                .collect()
        };
        let summaries = groups.iter().map(|group| Summary::new(&rows_of(group))).collect();
        let (num_pairs, num_models) = (runs[0].len(), num_models(&groups));
        Self { sweeps, settings, summaries, num_pairs, num_seeds: runs.len(), num_models, paper }
    }

    /// The paper's three tables: over epsilon, over down-sampling and over noise.
    fn tables(&self) -> Vec<Table> {
        let down_sampling = self.over("down-sampling", &DOWN_SAMPLING, |c| format!("1 in {}", c.downsample));
        let noise = self.over("noise", &NOISE, |c| format!("σ {}", c.noise));
        std::iter::once(self.over_epsilon()).chain(down_sampling).chain(noise).collect()
    }

    /// The tables as curves, with a logarithmic axis for down-sampling.
    fn panels(&self) -> Vec<Panel> {
        let Sweeps { epsilon, table_epsilon, conditions } = self.sweeps;
        let ours = |s: &Summary| Line::new(&s.method, s.repeatability.iter().map(|share| Some(share.mean)).collect());
        let theirs = self.paper.into_iter().flat_map(|paper| Line::from_paper(&paper.epsilon, epsilon));
        let over_epsilon = Panel {
            x_label: "ε".into(),
            ticks: epsilon.iter().map(|epsilon| (*epsilon, epsilon.to_string())).collect(),
            lines: self.under(conditions[0]).map(ours).chain(theirs).collect(),
        };
        let down_sampling = self.swept(&DOWN_SAMPLING).map(|swept| {
            let tick = |c: &Condition| ((c.downsample as f64).log2(), c.downsample.to_string());
            let x_label = format!("down-sampling, 1 in (ε {table_epsilon})");
            Panel { x_label, ticks: swept.iter().map(tick).collect(), lines: self.lines(&swept, &DOWN_SAMPLING) }
        });
        let noise = self.swept(&NOISE).map(|swept| {
            let ticks = swept.iter().map(|c| (c.noise, c.noise.to_string())).collect();
            Panel { x_label: format!("noise σ (ε {table_epsilon})"), ticks, lines: self.lines(&swept, &NOISE) }
        });
        std::iter::once(over_epsilon).chain(down_sampling).chain(noise).collect()
    }

    /// One line for each method over the conditions of a sweep, at the tables' epsilon.
    fn lines(&self, swept: &[Condition], sweep: &Sweep) -> Vec<Line> {
        let share = |c: &Condition, i| self.under(*c).nth(i).map(|s| s.repeatability[self.table_column()].mean);
        let line = |i, first: &Summary| Line::new(&first.method, swept.iter().map(|c| share(c, i)).collect());
        let ours = self.under(self.sweeps.conditions[0]).enumerate().map(|(i, first)| line(i, first));
        let theirs = self.paper_sweep(swept, sweep);
        ours.chain(theirs.into_iter().flat_map(|(table, column_values)| Line::from_paper(table, &column_values)))
            .collect()
    }

    /// The conditions of a sweep; `None` if there is only one.
    fn swept(&self, sweep: &Sweep) -> Option<Vec<Condition>> {
        let swept: Vec<Condition> = self.sweeps.conditions.iter().copied().filter(sweep.belongs).collect();
        (swept.len() > 1).then_some(swept)
    }

    /// The paper's table of a sweep with the requested column values; `None` if its epsilon differs from ours.
    fn paper_sweep(&self, swept: &[Condition], sweep: &Sweep) -> Option<(&'a PaperTable, Vec<f64>)> {
        let paper = self.paper.filter(|paper| paper.table_epsilon == self.sweeps.table_epsilon)?;
        Some(((sweep.paper)(paper), swept.iter().map(sweep.column_value).collect()))
    }

    /// The index of the tables' epsilon.
    fn table_column(&self) -> usize {
        self.sweeps.epsilon.iter().position(|epsilon| *epsilon == self.sweeps.table_epsilon).unwrap_or(0)
    }

    /// The table of the clean views over epsilon, with a row for each method.
    fn over_epsilon(&self) -> Table {
        let mut head = vec!["method".to_owned()];
        head.extend(self.sweeps.epsilon.iter().map(|epsilon| format!("ε {epsilon}")));
        head.extend(["keypoints".into(), "coverage".into()]);
        let row = |s: &Summary| {
            let mut row = vec![named_with_models(&s.method, std::iter::once(&s.models))];
            row.extend(s.repeatability.iter().map(Statistic::cell));
            row.push(format!("{:.1}", s.keypoints));
            row.push(s.coverage.map_or("-".into(), |coverage| format!("{coverage:.4}")));
            row
        };
        let over = tables::deviation_name(self.num_seeds, self.num_models, "pairs");
        let title = format!("Relative repeatability, mean over {} pairs ± {over}", self.num_pairs);
        let theirs = self.paper.into_iter().flat_map(|paper| paper.epsilon.rows(&self.sweeps.epsilon));
        let theirs = theirs.map(|row| [row, vec!["-".into(), "-".into()]].concat());
        let rows = self.under(self.sweeps.conditions[0]).map(row).chain(theirs).collect();
        Table { title, head, rows }
    }

    /// The table of a sweep, with a row for each method and a column for each condition; `None` if there is only one.
    fn over(&self, what: &str, sweep: &Sweep, name: fn(&Condition) -> String) -> Option<Table> {
        let swept = self.swept(sweep)?;
        let head = std::iter::once("method".to_owned()).chain(swept.iter().map(name)).collect();
        let first_cell = |(i, first): (usize, &Summary)| {
            let models = swept.iter().filter_map(|condition| self.under(*condition).nth(i)).map(|s| &s.models);
            vec![named_with_models(&first.method, models)]
        };
        let mut rows: Vec<Vec<String>> = self.under(self.sweeps.conditions[0]).enumerate().map(first_cell).collect();
        for condition in &swept {
            let cells = self.under(*condition).map(|s| s.repeatability[self.table_column()].cell());
            rows.iter_mut().zip(cells).for_each(|(row, cell)| row.push(cell));
        }
        let theirs = self.paper_sweep(&swept, sweep);
        rows.extend(theirs.into_iter().flat_map(|(table, column_values)| table.rows(&column_values)));
        Some(Table { title: format!("At ε {}, over {what}", self.sweeps.table_epsilon), head, rows })
    }

    /// The summaries of all methods under one condition, in their order.
    fn under(&self, condition: Condition) -> impl Iterator<Item = &Summary> {
        self.summaries.iter().filter(move |summary| summary.condition == condition)
    }

    /// The CSV file: a line for each method, condition and epsilon.
    fn csv(&self) -> String {
        let mut text =
            String::from("method,downsample,noise,epsilon,repeatability,deviation,keypoints,coverage,pairs\n");
        for s in &self.summaries {
            for (epsilon, share) in self.sweeps.epsilon.iter().zip(&s.repeatability) {
                let Condition { downsample, noise } = s.condition;
                let coverage = s.coverage.map(|coverage| coverage.to_string()).unwrap_or_default();
                let (method, keypoints, pairs) = (&s.method, s.keypoints, self.num_pairs);
                let share = share.csv();
                text += &format!("{method},{downsample},{noise},{epsilon},{share},{keypoints},{coverage},{pairs}\n");
            }
        }
        text
    }

    fn json(&self) -> String {
        let row = |s: &Summary| {
            json!({
                "method": s.method,
                "downsample": s.condition.downsample,
                "noise": s.condition.noise,
                "repeatability": s.repeatability.iter().map(|share| share.mean).collect::<Vec<_>>(),
                "deviation": s.repeatability.iter().map(|share| share.deviation).collect::<Vec<_>>(),
                "keypoints": s.keypoints,
                "coverage": s.coverage,
            })
        };
        let rows: Vec<Value> = self.summaries.iter().map(row).collect();
        let all = json!({"settings": self.settings, "pairs": self.num_pairs, "rows": rows});
        format!("{all:#}\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::paper::MODELNET40;

    const CLEAN: Condition = Condition { downsample: 1, noise: 0.0 };
    const BLURRED: Condition = Condition { downsample: 1, noise: 0.1 };

    fn row(condition: Condition, keypoints: usize, repeatability: [f64; 2]) -> Row {
        let coverage = (keypoints > 0).then_some(0.25);
        let (method, models) = ("iss".into(), Models::new());
        Row { method, models, condition, keypoints, coverage, repeatability: repeatability.into() }
    }

    #[test]
    fn tables_by_hand() {
        let conditions = vec![CLEAN, BLURRED];
        let sweeps = Sweeps { epsilon: vec![0.1, 0.2], table_epsilon: 0.2, conditions };
        let pairs = [
            Pair { name: "a".into(), rows: vec![row(CLEAN, 4, [0.5, 1.0]), row(BLURRED, 0, [0.0, 0.0])] },
            Pair { name: "b".into(), rows: vec![row(CLEAN, 8, [0.25, 1.0]), row(BLURRED, 2, [0.0, 0.5])] },
        ];
        let settings = json!({"seed": 0});
        let report = Evaluation::new(&sweeps, &settings, &[&pairs], None);
        let markdown = "Relative repeatability, mean over 2 pairs ± standard deviation over pairs:

| method | ε 0.1 | ε 0.2 | keypoints | coverage |
|---|---|---|---|---|
| iss | 0.375 ±0.177 | 1.000 ±0.000 | 6.0 | 0.2500 |

At ε 0.2, over noise:

| method | σ 0 | σ 0.1 |
|---|---|---|
| iss | 1.000 ±0.000 | 0.250 ±0.354 |
";
        assert_eq!(tables::markdown(&report.tables()), markdown);
        let csv = report.csv();
        assert_eq!(csv.lines().nth(1).unwrap(), "iss,1,0,0.1,0.375,0.1767766952966369,6,0.25,2");
        assert_eq!(csv.lines().count(), 5);
        let json: Value = serde_json::from_str(&report.json()).unwrap();
        assert_eq!(json["rows"][1]["repeatability"], json!([0.0, 0.25]));
        assert_eq!((json["rows"].as_array().unwrap().len(), &json["settings"]), (2, &settings));
        assert!(tables::text_lines(&report.tables()).join("\n").contains("iss             0.375 ±0.177"));
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
    fn models_that_were_chosen_are_named_in_the_tables() {
        let sweeps = Sweeps { epsilon: vec![0.1, 0.2], table_epsilon: 0.2, conditions: vec![CLEAN] };
        let pair = |models: &[(&str, usize)]| {
            let models = models.iter().map(|&(model, number)| (model.to_owned(), number)).collect();
            Pair { name: "a".into(), rows: vec![Row { models, ..row(CLEAN, 4, [0.5, 1.0]) }] }
        };
        let first_row = |pairs: &[Pair<Row>]| {
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
        let pairs = [Pair { name: "a".into(), rows }];
        let settings = json!({});
        let tables = tables::markdown(&Evaluation::new(&sweeps, &settings, &[&pairs], None).tables());
        assert!(tables.contains("| iss (scenes) |") && tables.contains("| iss (compact 2, scenes 2) |"), "{tables}");
    }

    #[test]
    fn the_papers_rows_stand_where_they_have_figures() {
        let blurred = Condition { downsample: 1, noise: 0.08 };
        let pairs = [Pair { name: "a".into(), rows: vec![row(CLEAN, 4, [0.5, 1.0]), row(blurred, 4, [0.25, 0.75])] }];
        let settings = json!({});
        let markdown = |table_epsilon| {
            let (epsilon, conditions) = (vec![0.04, 0.3], vec![CLEAN, blurred]);
            let sweeps = Sweeps { epsilon, table_epsilon, conditions };
            tables::markdown(&Evaluation::new(&sweeps, &settings, &[&pairs], Some(&MODELNET40)).tables())
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
        let pair = |shares| Pair { name: "a".into(), rows: vec![row(CLEAN, 4, shares)] };
        let runs = [[pair([0.25, 0.5]), pair([0.5, 0.5])], [pair([0.5, 0.75]), pair([0.75, 0.75])]];
        let settings = json!({});
        let report = Evaluation::new(&sweeps, &settings, &runs.each_ref().map(|run| &run[..]), None);
        let markdown = tables::markdown(&report.tables());
        assert!(markdown.starts_with("Relative repeatability, mean over 2 pairs ± standard deviation over 2 seeds:"));
        // Means of 0.375 and 0.625, 0.5 and 0.75.
        assert!(markdown.contains("| iss | 0.500 ±0.177 | 0.625 ±0.177 | 4.0 | 0.2500 |"), "{markdown}");
    }
}
