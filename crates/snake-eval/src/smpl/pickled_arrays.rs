//! Arrays in a pickle: NumPy arrays, sparse SciPy matrices and arrays of chumpy, the library behind the SMPL files.

use std::borrow::Cow;

use snake_io::Array;

use super::pickle::{Node, Pickle};

/// The deepest nesting of arrays; expressions of chumpy are one or two deep.
const MAX_DEPTH: usize = 8;
/// The most items of a dense matrix that is made from a sparse one.
const MAX_ITEMS: usize = 1 << 24;

/// Converts a value to an array, for any of these kinds of arrays.
pub fn array(pickle: &Pickle, node: &Node) -> Result<Array, String> {
    nested(pickle, node, 0)
}

fn nested(pickle: &Pickle, node: &Node, depth: usize) -> Result<Array, String> {
    let Node::Object { class, arguments, state } = *node else { return Err("is not an array".into()) };
    if depth == MAX_DEPTH {
        return Err(format!("holds arrays more than {MAX_DEPTH} deep"));
    }
    let (class, arguments) = (pickle.name(class), pickle.node(arguments));
    if class.ends_with("._frombuffer") {
        return from_buffer(pickle, arguments);
    }
    let state = pickle.node(state.ok_or_else(|| format!("is a {class} without content"))?);
    let part = |key: &str| {
        let part = pickle.get(state, key).ok_or_else(|| format!("is a {class} without `{key}`"))?;
        nested(pickle, part, depth + 1)
    };
    match class {
        "chumpy.ch.Ch" => part("x"),
        "chumpy.reordering.Select" => {
            let shape = pickle.get(state, "preferred_shape").ok_or("is a selection without a shape")?;
            select(&part("a")?, &part("idxs")?, lengths(pickle, shape)?)
        }
        _ if class.ends_with(".csc_matrix") => {
            let shape = pickle.get(state, "_shape").or_else(|| pickle.get(state, "shape"));
            let shape = shape.ok_or("is a sparse matrix without a shape")?;
            dense(&part("data")?, &part("indices")?, &part("indptr")?, &lengths(pickle, shape)?)
        }
        _ if class.ends_with("multiarray._reconstruct") => plain(pickle, state),
        _ => Err(format!("is a {class}, not an array")),
    }
}

/// A NumPy array from its state: (version, shape, type, whether in Fortran order, bytes).
fn plain(pickle: &Pickle, state: &Node) -> Result<Array, String> {
    let [_, shape, dtype, order, data] = pickle.items(state).collect::<Vec<_>>()[..] else {
        return Err("is an array of an unknown kind".into());
    };
    let fortran_order = matches!(order, Node::Bool(true) | Node::Int(1));
    Array::decode(&descr(pickle, dtype)?, &lengths(pickle, shape)?, fortran_order, &bytes(pickle, data)?)
}

/// A NumPy array of protocol 5: (bytes, type, shape, order).
fn from_buffer(pickle: &Pickle, arguments: &Node) -> Result<Array, String> {
    let [data, dtype, shape, order] = pickle.items(arguments).collect::<Vec<_>>()[..] else {
        return Err("is an array of an unknown kind".into());
    };
    let fortran_order = matches!(order, Node::Bytes(order) if **order == *b"F");
    Array::decode(&descr(pickle, dtype)?, &lengths(pickle, shape)?, fortran_order, &bytes(pickle, data)?)
}

/// The type of an array's items: `numpy.dtype("f8", ..)` with the state (version, byte order, ..).
fn descr(pickle: &Pickle, dtype: &Node) -> Result<String, String> {
    let unknown = || "has items of an unknown type".to_owned();
    let Node::Object { class, arguments, state: Some(state) } = *dtype else { return Err(unknown()) };
    let kind = pickle.items(pickle.node(arguments)).next();
    let order = pickle.items(pickle.node(state)).nth(1);
    match (pickle.name(class), kind, order) {
        ("numpy.dtype", Some(Node::Bytes(kind)), Some(Node::Bytes(order))) => {
            Ok(String::from_utf8_lossy(order).into_owned() + &String::from_utf8_lossy(kind))
        }
        _ => Err(unknown()),
    }
}

/// The bytes of an array. Python 3 writes them as Latin-1 text in protocols below 3.
fn bytes<'a>(pickle: &'a Pickle, node: &'a Node) -> Result<Cow<'a, [u8]>, String> {
    match node {
        Node::Bytes(bytes) => Ok(Cow::Borrowed(bytes)),
        Node::Object { class, arguments, .. } if pickle.name(*class) == "_codecs.encode" => {
            let text = pickle.items(pickle.node(*arguments)).next();
            let text = text.and_then(|node| if let Node::Bytes(text) = node { Some(text) } else { None });
            let text = text.and_then(|text| std::str::from_utf8(text).ok()).ok_or("has bytes that are not text")?;
            let latin_1 = text.chars().map(|char| u8::try_from(char).ok()).collect::<Option<Vec<u8>>>();
            Ok(Cow::Owned(latin_1.ok_or("has bytes that are not Latin-1 text")?))
        }
        _ => Err("is not made of bytes".into()),
    }
}

/// The lengths of a shape.
fn lengths(pickle: &Pickle, shape: &Node) -> Result<Vec<usize>, String> {
    let length = |node: &Node| if let Node::Int(length) = node { usize::try_from(*length).ok() } else { None };
    let lengths: Option<Vec<usize>> = pickle.items(shape).map(length).collect();
    lengths.ok_or_else(|| "has an invalid shape".into())
}

/// The items of an array at the given indices, in another shape.
fn select(array: &Array, indices: &Array, shape: Vec<usize>) -> Result<Array, String> {
    let item = |number: &f64| index(*number, array.items.len()).map(|index| array.items[index]);
    let items = indices.items.iter().map(item).collect::<Option<Vec<f64>>>();
    let items = items.ok_or("selects items out of range")?;
    if shape.iter().try_fold(1_usize, |product, &length| product.checked_mul(length)) != Some(items.len()) {
        return Err("selects more or fewer items than its shape has".into());
    }
    Ok(Array { shape, items })
}

/// The dense form of a sparse matrix in compressed columns (CSC). Entries at the same position are added.
fn dense(data: &Array, rows: &Array, starts: &Array, shape: &[usize]) -> Result<Array, String> {
    let &[num_rows, num_columns] = shape else { return Err("is a sparse matrix without two axes".into()) };
    let length = num_rows.checked_mul(num_columns).filter(|length| *length <= MAX_ITEMS);
    let length = length.ok_or_else(|| format!("is a sparse matrix of {num_rows} by {num_columns}"))?;
    let damaged = || "is a sparse matrix with entries out of range".to_owned();
    if starts.items.len() != num_columns + 1 || rows.items.len() != data.items.len() {
        return Err(damaged());
    }
    let mut items = vec![0.0; length];
    for (column, ends) in starts.items.windows(2).enumerate() {
        let ends = [ends[0], ends[1]].map(|end| index(end, data.items.len() + 1));
        let [Some(start), Some(end)] = ends else { return Err(damaged()) };
        let (rows, values) = (rows.items.get(start..end), data.items.get(start..end));
        for (row, value) in rows.ok_or_else(damaged)?.iter().zip(values.ok_or_else(damaged)?) {
            items[index(*row, num_rows).ok_or_else(damaged)? * num_columns + column] += value;
        }
    }
    Ok(Array { shape: shape.to_vec(), items })
}

/// A whole number below a length, as an index.
fn index(number: f64, length: usize) -> Option<usize> {
    (number >= 0.0 && number.fract() == 0.0 && number < length as f64).then_some(number as usize)
}
