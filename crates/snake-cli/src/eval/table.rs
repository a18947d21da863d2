//! Tables for people and Markdown, and the files that results are written to.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};
use snake_core::io;

/// A table: its title, its columns' heads and its rows.
pub struct Table {
    pub title: String,
    pub head: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

/// The tables, for people.
pub fn text(tables: &[Table]) -> String {
    let table = |Table { title, head, rows }: &Table| {
        let mut text = format!("{title}\n");
        for row in std::iter::once(head).chain(rows) {
            let cells = row.iter().skip(1).map(|cell| format!("  {cell:>11}")).collect::<String>();
            writeln!(text, "{:14}{cells}", row[0]).unwrap_or_default();
        }
        text
    };
    tables.iter().map(table).collect::<Vec<_>>().join("\n")
}

/// The same in Markdown.
pub fn markdown(tables: &[Table]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let table = |Table { title, head, rows }: &Table| {
        let rule = format!("|{}\n", "---|".repeat(head.len()));
        let rows: String = rows.iter().map(|row| line(row)).collect();
        format!("{title}:\n\n{}{rule}{rows}", line(head))
    };
    tables.iter().map(table).collect::<Vec<_>>().join("\n")
}

/// Writes the texts as `metric.EXTENSION`.
pub fn write(output: &Path, metric: &str, texts: &[(&str, String)]) -> Result<()> {
    for (extension, text) in texts {
        let path = output.join(format!("{metric}.{extension}"));
        io::write_atomically(&path, |file| file.write_all(text.as_bytes()))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
