//! Commas and apostrophes in numbers, and the advice for them.

use crate::text::number::number;
use crate::text::separator::Separator;

/// The advice for commas that separate columns and decimals.
pub(crate) const COMMAS: &str = "export them with decimal points, or with semicolons between the columns";

/// The advice for numbers with commas or apostrophes in them.
pub(crate) fn commas(row: &str) -> Option<String> {
    let separators = [Separator::Char(b';'), Separator::Char(b'\t'), Separator::WhiteSpace, Separator::Char(b',')];
    let has = |separator: &Separator, decimal: bool| {
        let repaired = |field: &str| {
            if decimal {
                number(&field.trim_end_matches(',').replacen(',', ".", 1)).is_some()
            } else {
                field.contains('.') && number(&field.replace([',', '\''], "")).is_some()
            }
        };
        let is_unread = |field: &str| number(field).is_none() && field.trim_end_matches(',').contains([',', '\'']);
        separator.fields(row).any(is_unread) && separator.fields(row).filter(|field| repaired(field)).count() >= 3
    };
    if let Some(separator) = separators.iter().find(|separator| has(separator, true)) {
        return Some(match separator {
            Separator::Char(b',') => format!("decimal commas and commas between the columns; {COMMAS}"),
            _ if row.contains(", ") => format!("decimal commas and commas between the columns; {COMMAS}"),
            _ => "decimal commas; write decimal points: sed 's/,/./g' FILE > NEW".into(),
        });
    }
    let is_grouped = separators.iter().any(|separator| has(separator, false));
    is_grouped.then(|| "separators of thousands; export the numbers without them".into())
}
