//! Writes rows of numbers as PLY, PCD, NPY and text, for keypoints and clouds.

use std::io::{self, Write};

use crate::arrays::npy;
use crate::formats::pcd;

/// The type of a column in formats that have types.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Float,
    Double,
    Byte,
    Int,
}

/// The name of a column and its type.
pub(crate) type Column = (&'static str, Kind);

/// Named columns and their rows, in f64, which represents every type exactly.
pub(crate) struct Table<C, R> {
    pub(crate) columns: C,
    pub(crate) num_rows: usize,
    pub(crate) rows: R,
}

impl Kind {
    pub(crate) fn size(self) -> usize {
        match self {
            Self::Byte => 1,
            Self::Float | Self::Int => 4,
            Self::Double => 8,
        }
    }

    /// The name of the type in PLY.
    pub(crate) fn in_ply(self) -> &'static str {
        match self {
            Self::Float => "float",
            Self::Double => "double",
            Self::Byte => "uchar",
            Self::Int => "int",
        }
    }

    pub(crate) fn from_ply_type(name: &str) -> Option<Self> {
        [Self::Float, Self::Double, Self::Byte, Self::Int].into_iter().find(|kind| kind.in_ply() == name)
    }

    /// Takes a number from the start of bytes; 0 where they end.
    pub(crate) fn read(self, bytes: &mut &[u8]) -> f64 {
        let (number, rest) = bytes.split_at_checked(self.size()).unwrap_or_default();
        *bytes = rest;
        let word = || number.try_into().unwrap_or_default();
        match self {
            Self::Byte => number.first().copied().unwrap_or_default().into(),
            Self::Float => f32::from_le_bytes(word()).into(),
            Self::Int => i32::from_le_bytes(word()).into(),
            Self::Double => f64::from_le_bytes(number.try_into().unwrap_or_default()),
        }
    }

    pub(crate) fn write(self, out: &mut dyn Write, value: f64) -> io::Result<()> {
        match self {
            Self::Float => out.write_all(&(value as f32).to_le_bytes()),
            Self::Double => out.write_all(&value.to_le_bytes()),
            Self::Byte => out.write_all(&[value as u8]),
            Self::Int if value <= f64::from(i32::MAX) => out.write_all(&(value as i32).to_le_bytes()),
            Self::Int => Err(io::Error::other(format!("{value} exceeds the four bytes of an index"))),
        }
    }
}

impl<C: AsRef<[Column]>, R: Iterator<Item: AsRef<[f64]>>> Table<C, R> {
    /// Writes binary little-endian vertices.
    pub(crate) fn write_ply(self, out: &mut dyn Write) -> io::Result<()> {
        write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", self.num_rows)?;
        for (name, kind) in self.columns.as_ref() {
            writeln!(out, "property {} {name}", kind.in_ply())?;
        }
        writeln!(out, "end_header")?;
        self.write_binary(out)
    }

    /// Writes a binary unorganised cloud. A comment states the origin of its points, if there is one; the position of the
    /// sensor is relative to it, as the points are.
    pub(crate) fn write_pcd(
        self,
        out: &mut dyn Write,
        origin: [f64; 3],
        viewpoint: Option<[f64; 3]>,
    ) -> io::Result<()> {
        let columns = self.columns.as_ref();
        let words = |of: fn(&Column) -> String| columns.iter().map(of).collect::<Vec<_>>().join(" ");
        let kinds = words(|(_, kind)| match kind {
            Kind::Float | Kind::Double => "F".into(),
            Kind::Byte => "U".into(),
            Kind::Int => "I".into(),
        });
        let (names, sizes) = (words(|(name, _)| name.to_string()), words(|(_, kind)| kind.size().to_string()));
        let (counts, rows) = (vec!["1"; columns.len()].join(" "), self.num_rows);
        writeln!(out, "# .PCD v0.7 - Point Cloud Data file format")?;
        if origin != [0.0; 3] {
            writeln!(out, "{}", pcd::origin_comment(origin))?;
        }
        write!(out, "VERSION 0.7\nFIELDS {names}\nSIZE {sizes}\n")?;
        let [x, y, z] = viewpoint.unwrap_or_default();
        write!(out, "TYPE {kinds}\nCOUNT {counts}\nWIDTH {rows}\nHEIGHT 1\nVIEWPOINT {x} {y} {z} 1 0 0 0\n")?;
        write!(out, "POINTS {rows}\nDATA binary\n")?;
        self.write_binary(out)
    }

    fn write_binary(self, out: &mut dyn Write) -> io::Result<()> {
        for row in self.rows {
            let values = self.columns.as_ref().iter().zip(row.as_ref());
            values.into_iter().try_for_each(|((_, kind), value)| kind.write(out, *value))?;
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

    /// Writes a line with the names and a line for each row.
    pub(crate) fn write_csv(self, out: &mut dyn Write) -> io::Result<()> {
        let names: Vec<&str> = self.columns.as_ref().iter().map(|(name, _)| *name).collect();
        writeln!(out, "{}", names.join(","))?;
        self.write_lines(out, ",")
    }

    /// Writes a line for each row, every number in its shortest exact form.
    pub(crate) fn write_lines(self, out: &mut dyn Write, separator: &str) -> io::Result<()> {
        for row in self.rows {
            for (column, ((_, kind), value)) in self.columns.as_ref().iter().zip(row.as_ref()).enumerate() {
                let separator = if column == 0 { "" } else { separator };
                match kind {
                    Kind::Float => write!(out, "{separator}{}", *value as f32)?,
                    _ => write!(out, "{separator}{value}")?,
                }
            }
            writeln!(out)?;
        }
        Ok(())
    }
}
