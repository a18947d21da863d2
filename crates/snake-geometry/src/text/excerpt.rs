//! Excerpts of a file's text for error messages.

/// An excerpt that is safe to show: one short line without control characters.
pub fn excerpt(text: &str, max_chars: usize) -> String {
    let mut chars = text.trim().chars();
    let shown: String = chars.by_ref().take(max_chars).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if chars.next().is_some() { shown + "…" } else { shown }
}
