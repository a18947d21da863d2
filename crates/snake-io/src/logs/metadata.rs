//! The list of files in the `metadata.yaml` of a bag of ROS 2.

use std::path::PathBuf;

use yaml_rust2::parser::{Event, Parser};

/// The keys on the way to the list.
const KEYS: [&str; 2] = ["rosbag2_bagfile_information", "relative_file_paths"];

/// An open mapping or sequence.
enum Open {
    Sequence,
    /// A mapping, with the last key if its value has not come.
    Mapping(Option<String>),
}

/// The values of `relative_file_paths`. Events are read one by one: the depth of the text costs no stack, and aliases, which
/// could multiply it, are not followed.
pub(crate) fn file_paths(text: &str) -> Result<Vec<PathBuf>, String> {
    let mut parser = Parser::new_from_str(text);
    let mut open: Vec<Open> = Vec::new();
    let mut paths = None;
    loop {
        let (event, _) = parser.next_token().map_err(|error| error.to_string())?;
        let is_listed = paths.is_some() && open.len() == KEYS.len() + 1;
        match event {
            Event::StreamEnd => return Err(format!("no list {}", KEYS.join("."))),
            Event::SequenceEnd if is_listed => return Ok(paths.unwrap_or_default()),
            Event::Scalar(path, ..) if is_listed => paths.get_or_insert_default().push(path.into()),
            _ if is_listed => return Err(format!("{} has other values than names", KEYS[1])),
            Event::SequenceStart(..) => {
                if is_at_list(&open) {
                    paths = Some(Vec::new());
                }
                open.push(Open::Sequence);
            }
            Event::MappingStart(..) => open.push(Open::Mapping(None)),
            Event::SequenceEnd | Event::MappingEnd => {
                open.pop();
                end_value(&mut open, None);
            }
            Event::Scalar(text, ..) => end_value(&mut open, Some(text)),
            Event::Alias(_) => end_value(&mut open, None),
            Event::Nothing | Event::StreamStart | Event::DocumentStart | Event::DocumentEnd => (),
        }
    }
}

/// Whether the next value is that of the last of [`KEYS`].
fn is_at_list(open: &[Open]) -> bool {
    open.len() == KEYS.len()
        && open.iter().zip(KEYS).all(|(open, key)| matches!(open, Open::Mapping(Some(name)) if name == key))
}

/// Notes that a node has ended: in a mapping it was a key, or the value of the key before.
fn end_value(open: &mut [Open], text: Option<String>) {
    if let Some(Open::Mapping(key)) = open.last_mut() {
        *key = if key.is_some() { None } else { Some(text.unwrap_or_default()) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_found_in_either_notation() {
        for list in ["\n    - a_0.mcap\n    - \"a 1.mcap\"\n", " [a_0.mcap, 'a 1.mcap']\n"] {
            let text = format!(
                "other: {{relative_file_paths: [x]}}\nrosbag2_bagfile_information:\n  ? [a, b]\n  : c\n  version: 5\n  \
                 more: {{relative_file_paths: [y]}}\n  relative_file_paths:{list}  after: 1\n"
            );
            assert_eq!(file_paths(&text).unwrap(), [PathBuf::from("a_0.mcap"), "a 1.mcap".into()]);
        }
    }

    #[test]
    fn other_texts_are_refused_without_much_stack_or_memory() {
        let refused = |text: &str| file_paths(text).unwrap_err();
        assert!(refused("").contains("no list rosbag2_bagfile_information.relative_file_paths"));
        assert!(refused("rosbag2_bagfile_information: {relative_file_paths: [{a: b}]}").contains("other values"));
        assert!(refused("a: [").contains("line "));
        refused(&"- ".repeat(200_000));
        refused(&"[".repeat(200_000));
        let doubled: String = (1..60).map(|i| format!("k{i}: &a{i} [*a{0}, *a{0}]\n", i - 1)).collect();
        refused(&format!("k0: &a0 [x]\n{doubled}"));
    }
}
