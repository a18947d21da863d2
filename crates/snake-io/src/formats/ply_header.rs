//! The header of a PLY file.

use crate::table::find;
use crate::table::scalar::Scalar;
use crate::text::lines::{Lines, text};
use snake_geometry::excerpt;

/// The names of a vertex's coordinates.
const AXES: [&str; 3] = ["x", "y", "z"];

/// Names of the property with the corners of a face or of strips of triangles.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// The layout of the data.
pub(crate) struct Header {
    pub(crate) is_ascii: bool,
    pub(crate) elements: Vec<Element>,
}

/// Rows with the same properties.
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: usize,
    pub(crate) properties: Vec<Property>,
}

/// A number, or a list of numbers that follows its length.
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) length: Option<Scalar>,
    pub(crate) item: Scalar,
}

impl Header {
    /// Parses a header. The rest of the lines is the data.
    pub(crate) fn parse(bytes: &[u8]) -> Result<(Self, Lines<'_>), String> {
        let mut lines = Lines::from_header(bytes);
        if lines.next().is_none_or(|(_, line)| !line.trim_ascii().eq_ignore_ascii_case(b"ply")) {
            return Err("not a PLY file: it does not begin with a line `ply`".into());
        }
        let (mut order, mut elements) = (None, Vec::<Declared>::new());
        for (number, line) in lines.by_ref() {
            let line = text(line);
            let bad = |what: &str| format!("header, line {number}: {what} `{}`", excerpt(&line, 60));
            let words: Vec<&str> = line.split_whitespace().take(6).collect();
            match words[..] {
                ["comment" | "obj_info", ..] => {}
                ["end_header"] => {
                    let order: &str = order.ok_or("header: no line `format`")?;
                    let elements =
                        elements.into_iter().map(|element| element.typed(order)).collect::<Result<_, _>>()?;
                    let header = Self { is_ascii: order.is_empty(), elements };
                    return header.checked(lines.rest().len()).map(|header| (header, lines));
                }
                ["format", name, ..] => {
                    order = Some(match name {
                        "ascii" => "",
                        "binary_little_endian" => "<",
                        "binary_big_endian" => ">",
                        _ => return Err(bad("a format that is not known:")),
                    });
                }
                ["element", name, count, ..] => {
                    let count = count.parse().map_err(|_| bad("no number of rows in"))?;
                    elements.push(Declared { name: name.into(), count, properties: Vec::new() });
                }
                ["property", "list", length, item, ref name @ ..] if !name.is_empty() => {
                    let element = elements.last_mut().ok_or_else(|| bad("no element above"))?;
                    element.properties.push([length, item, name[0]].map(String::from));
                }
                ["property", item, name, ..] => {
                    let element = elements.last_mut().ok_or_else(|| bad("no element above"))?;
                    element.properties.push(["", item, name].map(String::from));
                }
                _ => return Err(bad("no entry of a PLY header:")),
            }
        }
        Err("no line `end_header`".into())
    }

    /// Refuses headers that would be misread, and counts that exceed the data, before memory is allocated for them.
    fn checked(self, data_length: usize) -> Result<Self, String> {
        for name in ["vertex", "face"] {
            if self.elements.iter().filter(|element| element.name == name).count() > 1 {
                return Err(format!("header: two elements `{name}` have the same name"));
            }
        }
        let Some(vertex) = self.elements.iter().find(|element| element.name == "vertex") else {
            let names: Vec<&str> = self.elements.iter().map(|element| element.name.as_str()).collect();
            return Err(format!("no element `vertex`; the elements are {}", excerpt(&names.join(", "), 200)));
        };
        vertex.axes()?;
        for element in &self.elements {
            let min: usize = element.properties.iter().map(|property| property.min_size(self.is_ascii)).sum();
            // The last line of an ascii file may lack its line feed.
            if element.count.saturating_mul(min) > data_length.saturating_add(usize::from(self.is_ascii)) {
                let Element { name, count, .. } = element;
                let reason = format!("header: {count} times element `{name}` takes at least {min} bytes each");
                return Err(format!("{}, {data_length} bytes follow", excerpt(&reason, 160)));
            }
        }
        Ok(self)
    }
}

impl Element {
    /// The number of bytes of a row in binary data; `None` if the element has lists.
    pub(crate) fn stride(&self) -> Option<usize> {
        self.properties.iter().map(|property| property.length.is_none().then_some(property.item.size)).sum()
    }

    /// The properties that are numbers, not lists.
    pub(crate) fn scalars(&self) -> impl Iterator<Item = (usize, &Property)> {
        self.properties.iter().enumerate().filter(|(_, property)| property.length.is_none())
    }

    /// The indices of x, y and z among the [`Element::scalars`] of a vertex. Some scanners write upper-case names.
    pub(crate) fn axes(&self) -> Result<[usize; 3], String> {
        let names: Vec<&str> = self.scalars().map(|(_, property)| property.name.as_str()).collect();
        find(&names, AXES).map_err(|(axis, count)| match count {
            0 => self.no_axis(axis),
            _ => format!("header: two properties `{axis}` have the same name"),
        })
    }

    fn no_axis(&self, axis: &str) -> String {
        let names: Vec<&str> = self.properties.iter().map(|property| property.name.as_str()).collect();
        let hint = if names.iter().any(|name| name.starts_with("packed_")) {
            "; it holds packed splats, which splat-transform FILE.ply NEW.ply unpacks"
        } else {
            ""
        };
        let listed = excerpt(&names.join(", "), 200);
        format!("header: element `vertex` has no scalar property `{axis}`, only {listed}{hint}")
    }
}

impl Property {
    /// Whether this is the list of the corners of a face.
    pub(crate) fn has_corners(&self) -> bool {
        self.length.is_some() && CORNERS.contains(&self.name.as_str())
    }

    /// The minimum number of bytes of a property: a digit and a separator in ascii; in binary data
    /// the value, or the length of an empty list.
    fn min_size(&self, is_ascii: bool) -> usize {
        if is_ascii { 2 } else { self.length.unwrap_or(self.item).size }
    }
}

/// An element with the words of its properties: the type of a list's length or nothing, the type, the name.
struct Declared {
    name: String,
    count: usize,
    properties: Vec<[String; 3]>,
}

impl Declared {
    fn typed(self, order: &str) -> Result<Element, String> {
        let Self { name, count, properties } = self;
        let typed = |[length, item, name]: [String; 3]| {
            let scalar = |word: &str| scalar(word, order).ok_or_else(|| unknown_type(word, &name));
            let length = if length.is_empty() { None } else { Some(scalar(&length)?) };
            Ok(Property { length, item: scalar(&item)?, name })
        };
        Ok(Element { name, count, properties: properties.into_iter().map(typed).collect::<Result<_, String>>()? })
    }
}

fn unknown_type(word: &str, property: &str) -> String {
    format!("header: property `{}` has the unknown type `{}`", excerpt(property, 40), excerpt(word, 20))
}

/// The type with this name, in the byte order `<` or `>`. Text has no byte order and can have any type.
fn scalar(name: &str, order: &str) -> Option<Scalar> {
    let code = match name {
        _ if order.is_empty() => return Scalar::parse("<f8"),
        "char" | "int8" => "i1",
        "uchar" | "uint8" => "u1",
        "short" | "int16" => "i2",
        "ushort" | "uint16" => "u2",
        "int" | "int32" => "i4",
        "uint" | "uint32" => "u4",
        "int64" => "i8",
        "uint64" => "u8",
        "half" | "float16" => "f2",
        "float" | "float32" => "f4",
        "double" | "float64" => "f8",
        _ => return None,
    };
    Scalar::parse(&format!("{order}{code}"))
}
