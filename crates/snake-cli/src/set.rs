//! `--set NAME=VALUE`: the options that have no flag of their own.

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use serde_json::{Map, Value};
use snake_core::{Builtin, DetectOptions, EncodeOptions, OptionGroup, OptionInfo};
use snake_registration::{AlignOptions, PairOptions, RegisterOptions};

use crate::terminal::{self, Report};

#[derive(Args)]
pub struct SetArguments {
    /// Set any option by its name, such as `--set refine_steps=10`. `snake-cli options` lists all of them; a text, a number,
    /// true, false, none or a list in JSON is a value. It may be given several times.
    #[arg(long, value_name = "NAME=VALUE", value_parser = assignment, display_order = 1000)]
    set: Vec<(String, Value)>,
}

impl SetArguments {
    /// Names and values, as [`with_named_values`](snake_core::with_named_values) takes them.
    pub fn given(&self) -> Map<String, Value> {
        self.set.iter().cloned().collect()
    }
}

/// Reads `NAME=VALUE`.
fn assignment(text: &str) -> Result<(String, Value), String> {
    let (name, text) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    Ok((name.trim().replace('-', "_"), value(text)))
}

/// A value as it is typed: JSON, or else a text.
pub fn value(text: &str) -> Value {
    match text.trim() {
        "none" => Value::Null,
        text => serde_json::from_str(text).unwrap_or_else(|_| text.into()),
    }
}

/// Prints the options of detection with the values of the built-in models, and those of registration with their defaults.
pub fn list() -> Result<()> {
    let [compact, scenes] = [Builtin::Compact, Builtin::Scenes].map(Builtin::recommended);
    let mut report = Report::default();
    report.heading(format!("{:<22} {:>16} {:>16}", "detection", "compact", "scenes"));
    rows(&mut report, EncodeOptions::OPTIONS, &[values_of(&compact.encode), values_of(&scenes.encode)]);
    rows(&mut report, DetectOptions::OPTIONS, &[values_of(&compact.detect), values_of(&scenes.detect)]);
    report.heading(format!("{:<22} {:>16}", "registration", "default"));
    rows(&mut report, RegisterOptions::OPTIONS, &[values_of(&RegisterOptions::default())]);
    report.heading(format!("{:<22} {:>16}", "register", "default"));
    rows(&mut report, PairOptions::OPTIONS, &[values_of(&PairOptions::default())]);
    report.heading(format!("{:<22} {:>16}", "align", "default"));
    rows(&mut report, AlignOptions::OPTIONS, &[values_of(&AlignOptions::default())]);
    terminal::print(&report)
}

/// Prints the options of a table, each with its values and a help.
fn rows(report: &mut Report, options: &[OptionInfo], columns: &[Value]) {
    for option in options {
        let values: String = columns.iter().map(|values| format!(" {:>16}", shown(&values[option.name]))).collect();
        report.line(format!("{:<22}{values}", option.name));
        option.lines("none", 96).iter().for_each(|line| report.line(format!("    {line}")));
    }
}

/// The options of a group by name, with numbers as they are written: 0.07 and not its nearest float64.
pub fn values_of<T: Serialize>(options: &T) -> Value {
    serde_json::to_string(options).and_then(|text| serde_json::from_str(&text)).unwrap_or_default()
}

/// A value as `--set` takes it.
pub fn shown(value: &Value) -> String {
    match value {
        Value::Null => "none".into(),
        Value::String(text) => text.clone(),
        value => value.to_string(),
    }
}

/// The words to type instead of a flag that is only the name of an option, such as `--refine-steps`, or an earlier name of
/// one.
pub fn instead_of(flag: &str) -> Option<String> {
    let name = flag.strip_prefix("--")?.split('=').next()?.replace('-', "_");
    if ["count", "keypoints"].contains(&&name[..]) {
        return Some("type --max-keypoints NUMBER".into());
    }
    let tables = [
        EncodeOptions::OPTIONS,
        DetectOptions::OPTIONS,
        RegisterOptions::OPTIONS,
        PairOptions::OPTIONS,
        AlignOptions::OPTIONS,
    ];
    let is_option = tables.into_iter().flatten().any(|option| option.name == name);
    is_option.then(|| format!("type --set {name}=VALUE"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_json_or_text() {
        let read = |text: &str| assignment(text).unwrap();
        assert_eq!(read("refine-steps=3"), ("refine_steps".into(), 3.into()));
        assert_eq!(read("nms_radius=10%"), ("nms_radius".into(), "10%".into()));
        assert_eq!(read("max_points=none"), ("max_points".into(), Value::Null));
        assert_eq!(read("source_viewpoint=[0, 0, 1.5]").1, serde_json::json!([0, 0, 1.5]));
        assert!(assignment("snap").is_err());
    }

    #[test]
    fn a_flag_of_an_option_names_the_option() {
        assert_eq!(instead_of("--refine-steps").unwrap(), "type --set refine_steps=VALUE");
        assert_eq!(instead_of("--hypotheses=3").unwrap(), "type --set hypotheses=VALUE");
        assert_eq!(instead_of("--count").unwrap(), "type --max-keypoints NUMBER");
        assert_eq!(instead_of("--colour"), None);
    }
}
