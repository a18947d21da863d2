//! Text that is safe to print.

use std::borrow::Cow;

/// The text on one line. Characters that end the line, control the terminal or change the direction of writing are
/// escaped, for example as `\n` and `\u{1b}`.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_harmful) {
        return text.into();
    }
    text.chars().map(|c| if is_harmful(c) { c.escape_debug().to_string() } else { c.to_string() }).collect()
}

/// Control characters, separators of lines and paragraphs, and bidirectional controls.
pub fn is_harmful(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_harmful_characters_are_escaped() {
        for harmless in ["", "a b.ply", "C:\\scans\\é \"x\" 'y'.ply", "扫描 🐍", "فارسی\u{200c}ها"] {
            assert_eq!(printable(harmless), harmless);
        }
        let harmful = "\u{1b}[1m\r\n\t\u{0}\u{7f}\u{85}\u{202e}\u{2066}\u{2028}\u{200f}\u{61c}";
        let shown = printable(harmful);
        assert_eq!(shown, "\\u{1b}[1m\\r\\n\\t\\0\\u{7f}\\u{85}\\u{202e}\\u{2066}\\u{2028}\\u{200f}\\u{61c}");
    }
}
