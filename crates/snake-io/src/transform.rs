//! Reads rigid transforms, and writes registrations.

use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::formats::{extension, unknown_extension};
use crate::text::{matrix, write_rows};
use crate::{Error, Result, write_atomically};
use snake_geometry::RigidTransform;

/// The extensions that [`write_registration`] accepts.
pub const REGISTRATION_EXTENSIONS: &[&str] = &["json", "txt"];

#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Registration { t_target_source: [[f64; 4]; 4] },
    Rows([[f64; 4]; 4]),
}

/// Reads the four rows of the matrix, by themselves or under the key `t_target_source` of an object.
pub(crate) fn read_json(bytes: &[u8]) -> std::result::Result<RigidTransform, String> {
    match serde_json::from_slice(bytes) {
        Ok(Written::Registration { t_target_source: rows } | Written::Rows(rows)) => checked(rows),
        Err(_) => Err("expected {\"t_target_source\": [[..4], ..4]}, or the rows alone".into()),
    }
}

/// Reads four rows of four numbers.
pub(crate) fn read_text(bytes: &[u8]) -> std::result::Result<RigidTransform, String> {
    checked(matrix(bytes).ok_or("expected four rows of four numbers")?)
}

/// The transform of these rows.
fn checked(rows: [[f64; 4]; 4]) -> std::result::Result<RigidTransform, String> {
    RigidTransform::from_matrix(rows).map_err(|error| error.to_string())
}

/// Reads a rigid transform.
///
/// A `json` file holds an object with the key `t_target_source`, as [`write_registration`] writes it, or only the four
/// rows. A `txt` file holds four rows of four numbers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when the extension is not among
/// [`REGISTRATION_EXTENSIONS`] or the content is not a rigid transform.
pub fn read_transform(path: &Path) -> Result<RigidTransform> {
    let read = match extension(path).as_str() {
        "json" => read_json,
        "txt" => read_text,
        _ => return Err(unknown_extension(path, "read", REGISTRATION_EXTENSIONS)),
    };
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
    read(&bytes).map_err(|reason| Error::Format { path: path.into(), reason })
}

/// Writes a registration. A `json` file holds the record, an object that should have the key `t_target_source`. A `txt`
/// file holds the four rows of the matrix.
///
/// # Errors
/// The errors of [`write_keypoints`](crate::write_keypoints).
pub fn write_registration(path: &Path, t_target_source: &RigidTransform, record: &impl Serialize) -> Result<()> {
    check_registration_path(path)?;
    let is_json = extension(path) == "json";
    let write = |file: &mut dyn Write| {
        if is_json {
            serde_json::to_writer(&mut *file, record)?;
            writeln!(file)
        } else {
            write_rows(file, t_target_source)
        }
    };
    write_atomically(path, write).map_err(|source| Error::Io { path: path.into(), source })
}

/// Refuses a path whose extension [`write_registration`] would refuse, so that a caller can check it before any work.
///
/// # Errors
/// [`Error::Format`] when the extension is not among [`REGISTRATION_EXTENSIONS`].
pub fn check_registration_path(path: &Path) -> Result<()> {
    if REGISTRATION_EXTENSIONS.contains(&extension(path).as_str()) {
        Ok(())
    } else {
        Err(unknown_extension(path, "written", REGISTRATION_EXTENSIONS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: [[f64; 4]; 4] =
        [[0.0, -1.0, 0.0, 3.5], [1.0, 0.0, 0.0, -1e6], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]];

    #[test]
    fn all_forms_hold_the_same_rows() {
        let rows = serde_json::json!(ROWS).to_string();
        assert_eq!(read_json(rows.as_bytes()).unwrap().to_matrix(), ROWS);
        assert_eq!(
            read_json(format!(r#"{{"rmse": 1, "t_target_source": {rows}}}"#).as_bytes()).unwrap().to_matrix(),
            ROWS
        );
        let text = "0 -1 0 3.5\r\n1 0 0 -1e6\n\n0 0 1 0.25\n 0\t0 0 1";
        assert_eq!(read_text(text.as_bytes()).unwrap().to_matrix(), ROWS);
    }

    #[test]
    fn anything_else_is_refused() {
        for text in
            ["", "1 0 0 0\n0 1 0 0\n0 0 1 0", "1 0 0\n0 1 0\n0 0 1\n0 0 0", "1 0 0 x\n0 1 0 0\n0 0 1 0\n0 0 0 1"]
        {
            assert!(read_text(text.as_bytes()).unwrap_err().contains("four rows"), "{text}");
        }
        assert!(read_text(b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 2").unwrap_err().contains("rigid"));
        for text in ["", "{}", "[[1]]", r#"{"t_target_source": null}"#] {
            assert!(read_json(text.as_bytes()).unwrap_err().contains("t_target_source"), "{text}");
        }
    }
}
