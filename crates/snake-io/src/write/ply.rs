//! Elements of PLY files for the writer of `ply-rs`.

use std::io::{self, Write};

use ply_rs::ply::{ElementDef, Encoding, Header, PropertyAccess, PropertyDef, PropertyType, ScalarType};
use ply_rs::writer::Writer;

use crate::table::scalar::{Column, Scalar};

/// The list with the corners of a face.
pub(crate) const CORNERS: &str = "vertex_indices";

/// An element with these columns.
pub(crate) fn element(name: &str, count: usize, columns: &[Column]) -> ElementDef {
    let property = |&(name, scalar): &Column| {
        let scalar = match scalar {
            Scalar::FLOAT => ScalarType::Float,
            Scalar::BYTE => ScalarType::UChar,
            Scalar::INT => ScalarType::Int,
            _ => ScalarType::Double,
        };
        (name.into(), PropertyDef::new(name.into(), PropertyType::Scalar(scalar)))
    };
    ElementDef { name: name.into(), count, properties: columns.iter().map(property).collect() }
}

/// An element of faces.
pub(crate) fn face(count: usize) -> ElementDef {
    let corners = PropertyType::List(ScalarType::UChar, ScalarType::Int);
    let property = (CORNERS.into(), PropertyDef::new(CORNERS.into(), corners));
    ElementDef { properties: [property].into_iter().collect(), ..element("face", count, &[]) }
}

/// Writes the header of a binary little-endian file with these elements.
pub(crate) fn write_header<const N: usize>(mut out: &mut dyn Write, elements: [&ElementDef; N]) -> io::Result<()> {
    let mut header = Header::new();
    header.encoding = Encoding::BinaryLittleEndian;
    header.elements = elements.map(|element| (element.name.clone(), element.clone())).into_iter().collect();
    Writer::<Row>::new().write_header(&mut out, &header).map(drop)
}

/// A row for the writer, which requests its numbers by the names of their columns.
#[derive(Default)]
pub(crate) struct Row<'a> {
    pub(crate) columns: &'a [Column],
    pub(crate) values: &'a [f64],
    pub(crate) corners: &'a [i32],
}

impl Row<'_> {
    /// Writes the row as one of an element with the same columns.
    pub(crate) fn write(self, mut out: &mut dyn Write, element: &ElementDef) -> io::Result<()> {
        Writer::new().write_little_endian_element(&mut out, &self, element).map(drop)
    }

    fn value(&self, name: &str) -> Option<f64> {
        self.columns.iter().zip(self.values).find(|((column, _), _)| *column == name).map(|(_, value)| *value)
    }
}

impl PropertyAccess for Row<'_> {
    fn new() -> Self {
        Self::default()
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        self.value(name).map(|value| value as f32)
    }

    fn get_double(&self, name: &str) -> Option<f64> {
        self.value(name)
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        self.value(name).map(|value| value as u8)
    }

    fn get_int(&self, name: &str) -> Option<i32> {
        self.value(name).map(|value| value as i32)
    }

    fn get_list_int(&self, _name: &str) -> Option<&[i32]> {
        Some(self.corners)
    }
}
