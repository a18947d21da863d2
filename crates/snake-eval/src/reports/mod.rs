//! Reports: the figures of many pairs, summarised as tables, curves, CSV and JSON.

pub mod registration;
pub mod repeatability;
pub mod semantic;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::tables::{self, Chart, Statistic};

/// The figures of an evaluation, to print and to write.
pub struct Report {
    charts: Vec<Chart>,
    /// The label of the vertical axis of all diagrams.
    y_label: &'static str,
    csv: String,
    json: String,
}

impl Report {
    /// The tables as lines of plain text.
    pub fn text_lines(&self) -> Vec<String> {
        tables::text_lines(&self.charts)
    }

    /// The report as files: extensions and contents.
    pub fn files(&self) -> Vec<(&'static str, String)> {
        let text = [("csv", self.csv.clone()), ("json", self.json.clone()), ("md", tables::markdown(&self.charts))];
        text.into_iter().chain(tables::svg(self.y_label, &self.charts).map(|curves| ("svg", curves))).collect()
    }
}

/// The figures of one pair of clouds, or of one shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sample<Row> {
    /// The name of the pair or shape.
    pub name: String,
    /// The rows, in the same order for every pair.
    pub rows: Vec<Row>,
}

/// How many clouds each model was chosen for, by its name; empty for a method without models, and where one was named.
pub type Models = BTreeMap<String, usize>;

/// The name of a method in tables, with the models that were chosen for its clouds.
fn named_with_models<'a>(method: &str, models: impl Iterator<Item = &'a Models>) -> String {
    let mut all = Models::new();
    models.flatten().for_each(|(model, number)| *all.entry(model.clone()).or_default() += number);
    let several = all.len() > 1;
    let name = |(model, number): (&String, &usize)| if several { format!("{model} {number}") } else { model.clone() };
    let names: Vec<String> = all.iter().map(name).collect();
    if names.is_empty() { method.to_owned() } else { format!("{method} ({})", names.join(", ")) }
}

/// The indices of the rows that belong together, in the order of their first ones: a method that runs several models has a row
/// for each of them.
fn alike<T>(rows: &[T], are_alike: impl Fn(&T, &T) -> bool) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (index, row) in rows.iter().enumerate() {
        match groups.iter_mut().find(|group| are_alike(&rows[group[0]], row)) {
            Some(group) => group.push(index),
            None => groups.push(vec![index]),
        }
    }
    groups
}

/// The largest group, which is the number of models.
fn num_models(groups: &[Vec<usize>]) -> usize {
    groups.iter().map(Vec::len).max().unwrap_or(1)
}

/// The rows of a group for all pairs: a list for each seed and model.
fn rows_by_run<'a, Row>(runs: &[&'a [Sample<Row>]], group: &[usize]) -> Vec<Vec<&'a Row>> {
    let pairs_of = |pairs: &'a [Sample<Row>], row: usize| pairs.iter().map(|pair| &pair.rows[row]).collect();
    runs.iter().flat_map(|&pairs| group.iter().map(move |&row| pairs_of(pairs, row))).collect()
}

/// The figures of one method under one condition, or on one class, as they stand in files.
struct Summary {
    /// The columns that name the row, the method first.
    keys: Vec<(&'static str, Value)>,
    /// The method with the models that were chosen, as tables name it.
    title: String,
    /// Statistics for each value of the axis, under the names of their means and deviations.
    swept: Vec<([&'static str; 2], Vec<Statistic>)>,
    /// Means that do not depend on the axis.
    means: Vec<(&'static str, Option<f64>)>,
}

impl Summary {
    fn method(&self) -> &str {
        self.keys[0].1.as_str().unwrap_or_default()
    }

    fn json(&self) -> Value {
        let keys = self.keys.iter().map(|(name, value)| (*name, value.clone()));
        let swept = self.swept.iter().flat_map(|([mean, deviation], statistics)| {
            let means: Vec<f64> = statistics.iter().map(|statistic| statistic.mean).collect();
            let deviations: Vec<Option<f64>> = statistics.iter().map(|statistic| statistic.deviation).collect();
            [(*mean, means.into()), (*deviation, deviations.into())]
        });
        let means = self.means.iter().map(|(name, mean)| (*name, (*mean).into()));
        object(keys.chain(swept).chain(means))
    }
}

fn object<'a>(members: impl Iterator<Item = (&'a str, Value)>) -> Value {
    members.map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>().into()
}

/// A number in a CSV file, which is empty where there is none.
fn cell(value: Option<f64>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// The CSV file: a line for each summary and value of the axis, with the number of pairs if it is given.
fn csv(axis: (&str, &[f64]), summaries: &[&Summary], pairs: Option<usize>) -> String {
    let Some(first) = summaries.first() else { return String::new() };
    let keys = first.keys.iter().map(|(name, _)| *name).chain([axis.0]);
    let swept = first.swept.iter().flat_map(|(names, _)| *names);
    let means = first.means.iter().map(|(name, _)| *name).chain(pairs.map(|_| "pairs"));
    let mut text = keys.chain(swept).chain(means).collect::<Vec<_>>().join(",") + "\n";
    let key = |(_, value): &(&str, Value)| match value {
        Value::String(name) => name.clone(),
        number => cell(number.as_f64()),
    };
    for summary in summaries {
        for (index, value) in axis.1.iter().enumerate() {
            let keys = summary.keys.iter().map(key).chain([value.to_string()]);
            let swept = summary.swept.iter().map(|(_, statistics)| statistics[index].csv());
            let means = summary.means.iter().map(|(_, mean)| cell(*mean)).chain(pairs.map(|pairs| pairs.to_string()));
            text += &(keys.chain(swept).chain(means).collect::<Vec<_>>().join(",") + "\n");
        }
    }
    text
}

/// The JSON file: the settings, the other members and the rows.
fn json<'a>(settings: &Value, others: impl IntoIterator<Item = (&'a str, Value)>, rows: Vec<Value>) -> String {
    let all = object(others.into_iter().chain([("settings", settings.clone()), ("rows", rows.into())]));
    format!("{all:#}\n")
}
