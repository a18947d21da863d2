//! Reads stereolithography (STL) meshes, ascii and binary.

use std::collections::HashMap;

use crate::table::shape::{Position, Shape};
use crate::text::lines::{Lines, no_position, text};
use crate::text::number::number;

/// Bytes before the triangles of a binary file; the last four are the number of triangles.
const HEADER_BYTES: usize = 84;
/// Bytes of a triangle: a normal, three corners, two bytes of attributes.
const TRIANGLE_BYTES: usize = 50;
/// The first facet of an ascii file begins within this number of bytes.
const MAX_TITLE_BYTES: usize = 1 << 10;

/// Reads the triangles. Corners at the same position become one point, in the order of their first occurrence.
///
/// A file is binary if its length matches the number of triangles that it states, even if it begins with `solid`, as in
/// the files of some programs. Bytes after the triangles and text after `endsolid` are ignored.
pub(crate) fn read(bytes: &[u8]) -> Result<Shape, String> {
    let promised = bytes.get(HEADER_BYTES - 4..HEADER_BYTES).and_then(|count| count.first_chunk());
    let promised = promised.map(|count| u32::from_le_bytes(*count) as usize);
    let exact = promised.is_some_and(|count| HEADER_BYTES + count * TRIANGLE_BYTES == bytes.len());
    match promised {
        _ if !exact && is_ascii(bytes) => ascii(bytes),
        Some(count) => binary(&bytes[HEADER_BYTES..], count),
        None => Err("not an STL file: neither `solid` nor a header of 84 bytes".into()),
    }
}

/// Whether a file begins with `solid` and has another keyword of the format near its beginning. The title of a
/// binary file has no such keyword.
fn is_ascii(bytes: &[u8]) -> bool {
    let Some((_, line)) = Lines::from_header(bytes).next() else { return false };
    let begins = text(line).trim_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case("solid"));
    let head = bytes[..bytes.len().min(MAX_TITLE_BYTES)].to_ascii_lowercase();
    let has = |word: &[u8]| head.windows(word.len()).any(|piece| piece == word);
    begins && ["facet", "vertex", "endsolid"].iter().any(|word| has(word.as_bytes()))
}

fn binary(data: &[u8], count: usize) -> Result<Shape, String> {
    if count > data.len() / TRIANGLE_BYTES {
        return Err(format!("{count} triangles of {TRIANGLE_BYTES} bytes each, but {} bytes follow", data.len()));
    }
    let rest = data.len() - count * TRIANGLE_BYTES;
    if rest > 0 && rest.is_multiple_of(TRIANGLE_BYTES) && data[data.len() - rest..].iter().any(|&byte| byte != 0) {
        let all = data.len() / TRIANGLE_BYTES;
        return Err(format!("the header promises {count} triangles, {all} follow; export the file again"));
    }
    let mut soup = Soup::default();
    for triangle in data.chunks_exact(TRIANGLE_BYTES).take(count) {
        let (values, _) = triangle[12..48].as_chunks::<4>();
        let value = |index: usize| f64::from(f32::from_le_bytes(values[index]));
        (0..3).try_for_each(|corner| soup.add([value(3 * corner), value(3 * corner + 1), value(3 * corner + 2)]))?;
    }
    Ok(soup.shape)
}

/// Reads the three numbers after each word `vertex`, wherever lines end. Text after the last `endsolid` is ignored.
fn ascii(bytes: &[u8]) -> Result<Shape, String> {
    let (mut soup, mut is_ended) = (Soup::default(), false);
    let (mut begun, mut last): (Option<Vec<f64>>, _) = (None, (0, &bytes[..0]));
    for (line_number, line) in Lines::from_text(bytes)? {
        last = (line_number, line);
        let line = text(line);
        // A title may contain any words. It ends with its line or before the first facet.
        let mut is_title = false;
        for word in line.split_ascii_whitespace() {
            let is = |key: &str| word.eq_ignore_ascii_case(key);
            if let Some(mut values) = begun.take() {
                values.push(number(word).ok_or_else(|| no_position(line_number, line.trim()))?);
                match values[..] {
                    [x, y, z] => soup.add([x, y, z])?,
                    _ => begun = Some(values),
                }
            } else if is("solid") || is("endsolid") {
                (is_title, is_ended) = (true, is_ended || is("endsolid"));
            } else if is("facet") {
                (is_title, is_ended) = (false, false);
            } else if is("vertex") && !is_title && !is_ended {
                begun = Some(Vec::with_capacity(3));
            }
        }
    }
    if begun.is_some() {
        return Err(no_position(last.0, text(last.1).trim()));
    }
    if !is_ended {
        return Err("cut short: no line `endsolid` at the end".into());
    }
    match soup.corners.len() {
        0 => Ok(soup.shape),
        rest => Err(format!("{rest} corners are left over: the number of lines `vertex` is no multiple of three")),
    }
}

/// Collects separate triangles and the points that they share.
#[derive(Default)]
struct Soup {
    shape: Shape,
    indices: HashMap<[u64; 3], u32>,
    /// The corners of the current triangle.
    corners: Vec<u32>,
}

impl Soup {
    fn add(&mut self, position: Position) -> Result<(), String> {
        // Adding 0 turns -0 into 0.
        let place = position.map(|v| (v + 0.0).to_bits());
        let index = match self.indices.get(&place) {
            Some(&index) => index,
            None => {
                let index = u32::try_from(self.shape.points.len()).map_err(|_| "more than 2^32 points")?;
                self.shape.points.push(position);
                self.indices.insert(place, index);
                index
            }
        };
        self.corners.push(index);
        if let [a, b, c] = self.corners[..] {
            self.shape.triangles.push([a, b, c]);
            self.corners.clear();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [Position; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 2.0]];
    const TRIANGLES: [[u32; 3]; 2] = [[0, 1, 2], [2, 1, 3]];

    fn binary_file(title: &str) -> Vec<u8> {
        let mut bytes = format!("{title:80}").into_bytes();
        bytes.extend(2_u32.to_le_bytes());
        for triangle in TRIANGLES {
            bytes.extend([7; 12]);
            let corners = triangle.iter().flat_map(|&corner| POINTS[corner as usize]);
            bytes.extend(corners.flat_map(|v| (v as f32).to_le_bytes()));
            bytes.extend([1, 2]);
        }
        bytes
    }

    #[test]
    fn ascii_and_binary_even_if_it_begins_with_solid() {
        let text = "solid a b\r\nfacet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 -0.0 0\n VERTEX 0 1 5e-1\n endloop\n\
            endfacet\nfacet normal 0 0 0\nouter loop\nvertex 0 1 .5\nvertex 1 0 0\nvertex 0 0 2\nendloop\nendfacet\nendsolid a b\n";
        for bytes in [text.as_bytes(), &binary_file("made by hand"), &binary_file("solid made by hand")] {
            let shape = read(bytes).unwrap();
            assert_eq!((&shape.points[..], &shape.triangles[..]), (&POINTS[..], &TRIANGLES[..]));
        }
        assert!(read(b"solid\nendsolid\n").unwrap().points.is_empty());
        // Some programs append bytes.
        assert_eq!(read(&[binary_file("x"), vec![0; 9]].concat()).unwrap().points, POINTS);
    }

    #[test]
    fn bad_files_are_named() {
        let mut liar = binary_file("liar");
        liar[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
        for (bytes, expected) in [
            (&b""[..], "not an STL file"),
            (b"ply\n", "not an STL file"),
            (&liar, "4294967295 triangles of 50 bytes each, but 100 bytes follow"),
            (&binary_file("x")[..180], "but 96 bytes follow"),
            (b"solid\nvertex 0 0 0\nvertex 0 0 0\nvertex 1", "line 4: no three coordinates in `vertex 1`"),
            (b"solid\nvertex 0 0 0\nvertex 0 0 0\nvertex 1 1 1\n", "no line `endsolid`"),
            (b"solid\nvertex 0 0 0\nendsolid", "1 corners are left over"),
        ] {
            let reason = read(bytes).unwrap_err();
            assert!(reason.contains(expected), "{reason}");
        }
    }
}
