//! Tables of results as plain text and as Markdown, curves as SVG, and the figures of the paper beside them.

pub mod paper;
mod plot;
mod statistic;

pub use plot::svg;
pub use statistic::{Statistic, deviation_name, mean};

use paper::PaperTable;

/// One figure of all methods along an axis: a table, and a diagram if the axis has a label.
pub struct Chart {
    /// The title, which stands above the table.
    pub title: String,
    /// The head of the first column.
    pub first: &'static str,
    /// The columns, or the horizontal axis.
    pub axis: Axis,
    /// The heads of the columns after those of the axis.
    pub others: &'static [&'static str],
    /// The rows, or the curves.
    pub series: Vec<Series>,
    /// The figures of the paper, which stand below.
    pub paper: Option<&'static PaperTable>,
}

/// The columns of a table, or the horizontal axis of a diagram.
pub struct Axis {
    /// The label of the diagram; `None` for a table alone.
    pub label: Option<String>,
    /// The words before a value at the head of its column.
    pub prefix: &'static str,
    /// The values.
    pub values: Vec<f64>,
    /// The coordinate of a value in the diagram.
    pub x: fn(f64) -> f64,
}

/// The figures of one method.
pub struct Series {
    /// The method in the table.
    pub title: String,
    /// The method in the diagram.
    pub method: String,
    /// The cells after the title.
    pub cells: Vec<String>,
    /// A value from 0 to 1 for each of the axis; `None` where there is no figure.
    pub curve: Vec<Option<f64>>,
}

impl Series {
    /// The figures of a method with a statistic for each value of the axis.
    pub fn new<'a>(title: String, method: &str, statistics: impl Iterator<Item = &'a Statistic> + Clone) -> Self {
        let cells = statistics.clone().map(Statistic::cell).collect();
        Self { title, method: method.into(), cells, curve: statistics.map(|statistic| Some(statistic.mean)).collect() }
    }
}

impl Chart {
    /// The rows of the table, its head first.
    fn rows(&self) -> Vec<Vec<String>> {
        let Axis { prefix, values, .. } = &self.axis;
        let mut head = vec![self.first.to_owned()];
        head.extend(values.iter().map(|value| format!("{prefix}{value}")));
        head.extend(self.others.iter().map(|&other| other.to_owned()));
        let ours = self.series.iter().map(|Series { title, cells, .. }| [std::slice::from_ref(title), cells].concat());
        let mut theirs = self.paper.map(|paper| paper.rows(values)).unwrap_or_default();
        theirs.iter_mut().for_each(|row| row.resize(head.len(), "-".into()));
        std::iter::once(head.clone()).chain(ours).chain(theirs).collect()
    }
}

/// The tables as lines of plain text.
pub fn text_lines(charts: &[Chart]) -> Vec<String> {
    let mut lines = Vec::new();
    for (index, chart) in charts.iter().enumerate() {
        if index > 0 {
            lines.push(String::new());
        }
        lines.push(chart.title.clone());
        for row in chart.rows() {
            let cells = row.iter().skip(1).map(|cell| format!("  {cell:>11}")).collect::<String>();
            lines.push(format!("{:14}{cells}", row[0]));
        }
    }
    lines
}

/// The tables as Markdown.
pub fn markdown(charts: &[Chart]) -> String {
    let line = |cells: &Vec<String>| format!("| {} |\n", cells.join(" | "));
    let table = |chart: &Chart| {
        let rows = chart.rows();
        let rule = format!("|{}\n", "---|".repeat(rows[0].len()));
        let body: String = rows[1..].iter().map(line).collect();
        format!("{}:\n\n{}{rule}{body}", chart.title, line(&rows[0]))
    };
    charts.iter().map(table).collect::<Vec<_>>().join("\n")
}
