//! Text of a file in error messages.

/// A piece of a file's content that is safe to show: one line, short, without control characters.
pub fn excerpt(text: &str, max_chars: usize) -> String {
    let mut chars = text.trim().chars();
    let shown: String = chars.by_ref().take(max_chars).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if chars.next().is_some() { shown + "…" } else { shown }
}
