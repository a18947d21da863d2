//! Tables as plain text and as Markdown, and the files of the results.

use std::path::Path;

use anyhow::{Context, Result};
use snake_io as io;

/// A table: its title, the heads of its columns and its rows.
pub struct Table {
    pub title: String,
    pub head: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

/// The tables as lines of plain text.
pub fn lines(tables: &[Table]) -> Vec<String> {
    let mut lines = Vec::new();
    for (index, Table { title, head, rows }) in tables.iter().enumerate() {
        if index > 0 {
            lines.push(String::new());
        }
        lines.push(title.clone());
        for row in std::iter::once(head).chain(rows) {
            let cells = row.iter().skip(1).map(|cell| format!("  {cell:>11}")).collect::<String>();
            lines.push(format!("{:14}{cells}", row[0]));
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

/// The extensions of a metric's result files.
pub const EXTENSIONS: [&str; 5] = ["csv", "json", "jsonl", "md", "svg"];

/// Writes each text to `METRIC.EXTENSION` in the output directory.
pub fn write(output: &Path, metric: &str, texts: &[(&str, String)]) -> Result<()> {
    for (extension, text) in texts {
        let path = output.join(format!("{metric}.{extension}"));
        io::write_atomically(&path, |file| file.write_all(text.as_bytes()))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
