//! Texts of bounded length.

use std::borrow::Cow;
use std::fmt::Display;

/// Texts of at most this many characters are shown whole.
const MAX_CHARS: usize = 1500;
/// Number of characters that remain at each end of a longer text.
const END_CHARS: usize = 500;

/// The text of an error, cut in the middle if it has over 1500 characters: names and values may have any length.
pub fn shortened(text: &str) -> Cow<'_, str> {
    // A text has at least as many bytes as characters, and its bytes are counted quickly.
    if text.len() <= MAX_CHARS || text.chars().nth(MAX_CHARS).is_none() {
        return text.into();
    }
    let place = |character: Option<(usize, char)>| character.map_or(0, |(place, _)| place);
    let head = place(text.char_indices().nth(END_CHARS));
    let tail = place(text.char_indices().nth_back(END_CHARS - 1));
    let left_out = text[head..tail].chars().count();
    format!("{} … {left_out} characters … {}", &text[..head], &text[tail..]).into()
}

/// [`shortened`] of a value's text.
pub fn shortened_value(value: &dyn Display) -> String {
    shortened(&value.to_string()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_keep_their_ends_and_short_ones_all() {
        for text in ["".to_owned(), "é".repeat(1500), "a".repeat(1500)] {
            assert_eq!(shortened(&text), text);
        }
        let long = format!("begin{}end", "é扫".repeat(5_000_000));
        let short = shortened(&long);
        assert!(short.starts_with("beginé扫") && short.ends_with("扫end") && short.chars().count() < 1100, "{short}");
        assert!(short.contains(" … 9999008 characters … "), "{short}");
    }
}
