//! Writes rows of numbers as PLY, PCD, NPY and text, for keypoints and clouds.

use std::io::{self, Write};

use crate::arrays::npy;
use crate::formats::pcd;
use crate::table::scalar::{Column, Scalar};
use crate::write::ply::{self, Row};

/// Named columns and their rows, in f64, which represents every type exactly.
pub(crate) struct Rows<C, R> {
    pub(crate) columns: C,
    pub(crate) num_rows: usize,
    pub(crate) rows: R,
}

impl<C: AsRef<[Column]>, R: Iterator<Item: AsRef<[f64]>>> Rows<C, R> {
    /// Writes binary little-endian vertices.
    pub(crate) fn write_ply(self, out: &mut dyn Write) -> io::Result<()> {
        let columns = self.columns.as_ref();
        let vertex = ply::element("vertex", self.num_rows, columns);
        ply::write_header(out, [&vertex])?;
        for row in self.rows {
            let values = row.as_ref();
            columns.iter().zip(values).try_for_each(|((_, scalar), value)| scalar.check(*value))?;
            Row { columns, values, ..Row::default() }.write(out, &vertex)?;
        }
        Ok(())
    }

    /// Writes a binary unorganised cloud. A comment states the origin of its points, if there is
    /// one. The position of the sensor is relative to this origin, as the points are.
    pub(crate) fn write_pcd(
        self,
        out: &mut dyn Write,
        origin: [f64; 3],
        viewpoint: Option<[f64; 3]>,
    ) -> io::Result<()> {
        let columns = self.columns.as_ref();
        let words = |of: fn(&Column) -> String| columns.iter().map(of).collect::<Vec<_>>().join(" ");
        let kinds = words(|(_, scalar)| char::from(scalar.kind).to_uppercase().to_string());
        let (names, sizes) = (words(|(name, _)| name.to_string()), words(|(_, scalar)| scalar.size.to_string()));
        let (counts, rows) = (vec!["1"; columns.len()].join(" "), self.num_rows);
        writeln!(out, "# .PCD v0.7 - Point Cloud Data file format")?;
        if origin != [0.0; 3] {
            writeln!(out, "{}", pcd::origin_comment(origin))?;
        }
        write!(out, "VERSION 0.7\nFIELDS {names}\nSIZE {sizes}\n")?;
        let [x, y, z] = viewpoint.unwrap_or_default();
        write!(out, "TYPE {kinds}\nCOUNT {counts}\nWIDTH {rows}\nHEIGHT 1\nVIEWPOINT {x} {y} {z} 1 0 0 0\n")?;
        write!(out, "POINTS {rows}\nDATA binary\n")?;
        for row in self.rows {
            let values = columns.iter().zip(row.as_ref());
            values.into_iter().try_for_each(|((_, scalar), value)| scalar.write(out, *value))?;
        }
        Ok(())
    }

    /// Writes an array `(rows, columns)` of `<f8`, because an index above 2^24 is not exact in `<f4`.
    pub(crate) fn write_npy(self, out: &mut dyn Write) -> io::Result<()> {
        npy::write_header(out, "<f8", &format!("{}, {}", self.num_rows, self.columns.as_ref().len()))?;
        for row in self.rows {
            row.as_ref().iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
        }
        Ok(())
    }

    /// Writes a line with the names and then one line per row.
    pub(crate) fn write_csv(self, out: &mut dyn Write) -> io::Result<()> {
        let names: Vec<&str> = self.columns.as_ref().iter().map(|(name, _)| *name).collect();
        writeln!(out, "{}", names.join(","))?;
        self.write_lines(out, ",")
    }

    /// Writes one line per row, with every number in its shortest exact form.
    pub(crate) fn write_lines(self, out: &mut dyn Write, separator: &str) -> io::Result<()> {
        for row in self.rows {
            for (column, ((_, scalar), value)) in self.columns.as_ref().iter().zip(row.as_ref()).enumerate() {
                let separator = if column == 0 { "" } else { separator };
                match *scalar {
                    Scalar::FLOAT => write!(out, "{separator}{}", *value as f32)?,
                    _ => write!(out, "{separator}{value}")?,
                }
            }
            writeln!(out)?;
        }
        Ok(())
    }
}
