//! Reads one rigid transform in the formats of a registration.

use serde::Deserialize;

use snake_core::RigidTransform;

#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Registration { t_target_source: [[f64; 4]; 4] },
    Rows([[f64; 4]; 4]),
}

/// Reads the four rows of the matrix, alone or under the key `t_target_source` of an object.
pub(super) fn read_json(bytes: &[u8]) -> Result<RigidTransform, String> {
    match serde_json::from_slice(bytes) {
        Ok(Written::Registration { t_target_source: rows } | Written::Rows(rows)) => checked(rows),
        Err(_) => Err("expected {\"t_target_source\": [[..4], ..4]}, or the rows alone".into()),
    }
}

/// Reads four rows of four numbers.
pub(super) fn read_text(bytes: &[u8]) -> Result<RigidTransform, String> {
    let numbers = |row: &str| -> Option<[f64; 4]> {
        let numbers: Option<Vec<f64>> = row.split_whitespace().map(|number| number.parse().ok()).collect();
        numbers?.try_into().ok()
    };
    let text = String::from_utf8_lossy(bytes);
    let rows: Option<Vec<_>> = text.lines().filter(|row| !row.trim().is_empty()).map(numbers).collect();
    checked(rows.and_then(|rows| rows.try_into().ok()).ok_or("expected four rows of four numbers")?)
}

/// The transform of these rows.
pub(super) fn checked(rows: [[f64; 4]; 4]) -> Result<RigidTransform, String> {
    RigidTransform::from_matrix(rows).map_err(|error| error.to_string())
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
        for rows in ["2 0 0 0\n0 1 0 0\n0 0 1 0", "1 0 0 nan\n0 1 0 0\n0 0 1 0", "0 1 0 0\n0 1 0 0\n0 0 1 0"] {
            assert!(read_text(format!("{rows}\n0 0 0 1").as_bytes()).unwrap_err().contains("rigid"), "{rows}");
        }
        assert!(read_text(b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 2").unwrap_err().contains("rigid"));
        for text in ["", "{}", "[[1]]", r#"{"t_target_source": null}"#] {
            assert!(read_json(text.as_bytes()).unwrap_err().contains("t_target_source"), "{text}");
        }
    }
}
