//! The header of a PLY file.

use crate::arrays::dtype::Dtype;
use crate::text::lines::{Lines, text};
use snake_geometry::excerpt;

/// The names of a vertex's coordinates.
pub(crate) const AXES: [&str; 3] = ["x", "y", "z"];

/// Names of the property with the corners of a face or of strips of triangles.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// What a header says about the data.
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

/// A number, or a list of numbers after its length.
pub(crate) struct Property {
    pub(crate) role: Role,
    pub(crate) length: Option<Dtype>,
    pub(crate) item: Dtype,
}

/// The use of a property.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Role {
    Axis(usize),
    Corners,
    Unused,
}

impl Header {
    /// Parses a header, in which the three values that are read of a vertex have these names. The rest of the lines is the data.
    pub(crate) fn parse<'a>(bytes: &'a [u8], axes: &[&str; 3]) -> Result<(Self, Lines<'a>), String> {
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
                        elements.into_iter().map(|element| element.typed(order, axes)).collect::<Result<_, _>>()?;
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

    /// Refuses headers that would be misread, and counts that exceed the data, before any memory is taken for them.
    fn checked(self, data_length: usize) -> Result<Self, String> {
        for name in ["vertex", "face"] {
            if self.elements.iter().filter(|element| element.name == name).count() > 1 {
                return Err(format!("header: two elements `{name}` have the same name"));
            }
        }
        for element in &self.elements {
            let least: usize = element.properties.iter().map(|property| property.least_size(self.is_ascii)).sum();
            // The last line of an ascii file may lack its line feed.
            if element.count.saturating_mul(least) > data_length.saturating_add(usize::from(self.is_ascii)) {
                let Element { name, count, .. } = element;
                let reason = format!("header: {count} times element `{name}` takes at least {least} bytes each");
                return Err(format!("{}, {data_length} bytes follow", excerpt(&reason, 160)));
            }
        }
        Ok(self)
    }
}

impl Element {
    /// The bytes of a row in binary data, if it has no lists.
    pub(crate) fn stride(&self) -> Option<usize> {
        self.properties.iter().map(|property| property.length.is_none().then_some(property.item.size)).sum()
    }
}

impl Property {
    /// The fewest bytes of a property: a digit and a separator in ascii; the value, or the length of an empty list, in
    /// binary.
    fn least_size(&self, is_ascii: bool) -> usize {
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
    fn typed(self, order: &str, axes: &[&str; 3]) -> Result<Element, String> {
        let Self { name, count, properties } = self;
        let is_vertex = name == "vertex";
        // Some scanners write the axes in upper case.
        let any_case = !properties.iter().any(|[_, _, name]| axes.contains(&name.as_str()));
        let axis = |name: &str| {
            let name = if any_case { name.to_ascii_lowercase() } else { name.into() };
            axes.iter().position(|axis| is_vertex && name == *axis)
        };
        let typed = |[length, item, name]: &[String; 3]| {
            let type_of = |word: &str| dtype(word, order).ok_or_else(|| unknown_type(word, name));
            let role = match axis(name) {
                Some(axis) if length.is_empty() => Role::Axis(axis),
                _ if CORNERS.contains(&name.as_str()) && !length.is_empty() => Role::Corners,
                _ => Role::Unused,
            };
            let length = if length.is_empty() { None } else { Some(type_of(length)?) };
            Ok(Property { role, length, item: type_of(item)? })
        };
        let typed = properties.iter().map(typed).collect::<Result<Vec<_>, String>>()?;
        for axis_name in axes.iter().filter(|_| is_vertex) {
            // One name can stand for all three.
            let axis = axis(axis_name).unwrap_or_default();
            match typed.iter().filter(|property| property.role == Role::Axis(axis)).count() {
                1 => {}
                0 => return Err(no_axis(axis_name, &properties)),
                _ => return Err(format!("header: two properties `{axis_name}` have the same name")),
            }
        }
        Ok(Element { name, count, properties: typed })
    }
}

fn no_axis(axis: &str, properties: &[[String; 3]]) -> String {
    let names: Vec<&str> = properties.iter().map(|[_, _, name]| name.as_str()).collect();
    let hint = if names.iter().any(|name| name.starts_with("packed_")) {
        "; it holds packed splats, which splat-transform FILE.ply NEW.ply unpacks"
    } else {
        ""
    };
    format!("header: element `vertex` has no scalar property `{axis}`, only {}{hint}", excerpt(&names.join(", "), 200))
}

fn unknown_type(word: &str, property: &str) -> String {
    format!("header: property `{}` has the unknown type `{}`", excerpt(property, 40), excerpt(word, 20))
}

/// The type with this name, of the byte order `<` or `>`. Text has no byte order, and any type.
fn dtype(name: &str, order: &str) -> Option<Dtype> {
    let code = match name {
        _ if order.is_empty() => return Dtype::parse("<f8"),
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
    Dtype::parse(&format!("{order}{code}"))
}
