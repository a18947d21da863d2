//! Parses numbers as the programs of this field print them, for all text formats.

/// A number: what Rust parses (`+1.0`, `.5`, `5.`, `1e-3`, `nan`, `-inf`), with the exponents of Fortran (`1.0D+00`) and
/// the infinities and NaNs of Windows (`1.#INF`, `-1.#IND`, `1.#QNAN00`, `-nan(ind)`).
#[inline]
pub(crate) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| unusual(word))
}

/// A number, or NaN for a cell that marks a missing value.
#[inline]
pub(crate) fn cell(word: &str) -> Option<f64> {
    number(word).or_else(|| is_missing(word).then_some(f64::NAN))
}

fn unusual(word: &str) -> Option<f64> {
    let magnitude = word.trim_start_matches(['+', '-']);
    if word.len() > magnitude.len() + 1 {
        return None;
    }
    let lower = magnitude.to_ascii_lowercase();
    if let Some(kind) = lower.strip_prefix("1.#") {
        let value = if kind.starts_with("inf") { f64::INFINITY } else { f64::NAN };
        let is_known = !kind.is_empty() && kind.bytes().all(|byte| byte.is_ascii_alphanumeric());
        return is_known.then_some(if word.starts_with('-') { -value } else { value });
    }
    if lower.starts_with("nan(") && lower.ends_with(')') {
        return Some(f64::NAN);
    }
    let is_decimal = |byte: u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'+' | b'-' | b'd');
    (lower.contains('d') && lower.bytes().all(is_decimal)).then(|| word.replace(['d', 'D'], "e").parse().ok())?
}

/// Whether a cell is empty or holds the mark of databases, statistics programs or spreadsheets for a missing value.
fn is_missing(word: &str) -> bool {
    const MARKS: [&str; 12] = ["", "-", "--", ".", "?", "na", "n/a", "n.a.", "<na>", "null", "none", "nil"];
    MARKS.iter().any(|mark| word.eq_ignore_ascii_case(mark)) || is_spreadsheet_error(word)
}

/// Whether a cell holds an error of a spreadsheet, such as `#N/A`, `#NUM!`, `#DIV/0!`, `#NAME?` or `#NV`.
pub(crate) fn is_spreadsheet_error(word: &str) -> bool {
    let Some(name) = word.strip_prefix('#') else { return false };
    let is_name =
        |name: &str| name.len() > 1 && name.bytes().all(|b| b.is_ascii_uppercase() || matches!(b, b'/' | b'0'));
    matches!(name, "N/A" | "N/D" | "NV") || name.strip_suffix(['!', '?']).is_some_and(is_name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_notation_of_a_number() {
        for (word, value) in [
            ("+1.0", 1.0),
            (".5", 0.5),
            ("5.", 5.0),
            ("-1E-3", -1e-3),
            ("1.5D+03", 1500.0),
            ("-1d2", -100.0),
            ("inf", f64::INFINITY),
            ("1.#INF", f64::INFINITY),
            ("-1.#INF00", f64::NEG_INFINITY),
            ("0.1000000014901161193847656", f64::from(0.1_f32)),
        ] {
            assert_eq!(number(word), Some(value), "{word}");
        }
        for word in
            ["", "-", "--1", "+-1", "1,5", "1.5f", "d", "1d", "dd", "dead", "1.#", "0x10", "1_0", "e5", "nano", "1e5d3"]
        {
            assert_eq!(number(word), None, "{word}");
        }
    }

    #[test]
    fn other_words_are_no_cells() {
        for word in ["#X", "#", "#!", "x", "#1", "no", "P1"] {
            assert_eq!(cell(word), None, "{word}");
        }
    }
}
