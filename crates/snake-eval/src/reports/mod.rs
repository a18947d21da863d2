//! Reports: the figures of many pairs, summarised as tables, curves, CSV and JSON.

pub mod registration;
pub mod repeatability;
pub mod semantic;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::tables::plot::{self, Panel};
use crate::tables::{self, Table};

/// The figures of an evaluation, to print and to write.
pub struct Report {
    tables: Vec<Table>,
    /// The label of the vertical axis, and the curves; `None` where a report has none.
    curves: Option<(&'static str, Vec<Panel>)>,
    csv: String,
    json: String,
}

impl Report {
    /// The tables as lines of plain text.
    pub fn text_lines(&self) -> Vec<String> {
        tables::text_lines(&self.tables)
    }

    /// The report as files: extensions and contents.
    pub fn files(&self) -> Vec<(&'static str, String)> {
        let text = [("csv", self.csv.clone()), ("json", self.json.clone()), ("md", tables::markdown(&self.tables))];
        let curves = self.curves.as_ref().map(|(label, panels)| ("svg", plot::svg(label, panels)));
        text.into_iter().chain(curves).collect()
    }
}

/// The figures of one pair of clouds, or of one shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pair<Row> {
    /// The name of the pair or shape.
    pub name: String,
    /// The rows, in the same order for every pair.
    pub rows: Vec<Row>,
}

/// How many clouds each model was chosen for, by its name; empty for a method without models, and where one was named.
pub type Models = BTreeMap<String, usize>;

/// The numbers of clouds of several rows together.
fn summed<'a>(models: impl Iterator<Item = &'a Models>) -> Models {
    let mut all = Models::new();
    models.flatten().for_each(|(model, number)| *all.entry(model.clone()).or_default() += number);
    all
}

/// The name of a method in tables, with the models that were chosen for its clouds.
fn named_with_models<'a>(method: &str, models: impl Iterator<Item = &'a Models>) -> String {
    let all = summed(models);
    let several = all.len() > 1;
    let name = |(model, number): (&String, &usize)| if several { format!("{model} {number}") } else { model.clone() };
    let names: Vec<String> = all.iter().map(name).collect();
    if names.is_empty() { method.to_owned() } else { format!("{method} ({})", names.join(", ")) }
}

/// The places of the rows that belong together, in the order of their first ones: a method that runs several models has a row
/// for each of them.
fn alike<T>(rows: &[T], are_alike: impl Fn(&T, &T) -> bool) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (place, row) in rows.iter().enumerate() {
        match groups.iter_mut().find(|group| are_alike(&rows[group[0]], row)) {
            Some(group) => group.push(place),
            None => groups.push(vec![place]),
        }
    }
    groups
}

/// The most rows that belong together: the number of models.
fn num_models(groups: &[Vec<usize>]) -> usize {
    groups.iter().map(Vec::len).max().unwrap_or(1)
}
