//! Tables of results as plain text and as Markdown, curves as SVG, and the figures of the paper beside them.

pub mod paper;
pub mod plot;
mod statistic;

pub use statistic::{Statistic, deviation_name, mean};

/// A table of results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// The title, which stands above the table.
    pub title: String,
    /// The names of the columns. There is at least one.
    pub head: Vec<String>,
    /// The rows, each with a cell for each column.
    pub rows: Vec<Vec<String>>,
}

/// The tables as lines of plain text.
pub fn text_lines(tables: &[Table]) -> Vec<String> {
    let mut lines = Vec::new();
    for (index, Table { title, head, rows }) in tables.iter().enumerate() {
        if index > 0 {
            lines.push(String::new());
        }
        lines.push(title.clone());
        for row in std::iter::once(head).chain(rows) {
            let cells = row.iter().skip(1).map(|cell| format!("  {cell:>11}")).collect::<String>();
            lines.push(format!("{:14}{cells}", row.first().map_or("", String::as_str)));
        }
    }
    lines
}

/// The tables as Markdown.
pub fn markdown(tables: &[Table]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let table = |Table { title, head, rows }: &Table| {
        let rule = format!("|{}\n", "---|".repeat(head.len()));
        let rows: String = rows.iter().map(|row| line(row)).collect();
        format!("{title}:\n\n{}{rule}{rows}", line(head))
    };
    tables.iter().map(table).collect::<Vec<_>>().join("\n")
}
