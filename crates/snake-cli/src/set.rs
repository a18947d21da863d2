//! `--set NAME=VALUE`: the options that have no flag of their own.

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use snake_core::{Builtin, Model, Options, with_named_values};
use snake_registration::RegisterOptions;

use crate::terminal::{self, Report};

#[derive(Args)]
pub struct SetArguments {
    /// Set any option by its name, such as `--set refine_steps=10`. `snake-cli options` lists all of them; a text, a number,
    /// true, false, none or a list in JSON is a value. It may be given several times.
    #[arg(long, value_name = "NAME=VALUE", value_parser = assignment)]
    set: Vec<(String, Value)>,
}

impl SetArguments {
    /// The options with the given ones replaced.
    pub fn apply<T: Clone + Serialize + DeserializeOwned>(&self, options: &T) -> Result<T> {
        Ok(with_named_values(options, &self.set.iter().cloned().collect())?)
    }

    /// Whether an option is given.
    pub fn names(&self, option: &str) -> bool {
        self.set.iter().any(|(name, _)| name == option)
    }
}

/// Reads `NAME=VALUE`. A value that is no JSON is a text.
fn assignment(text: &str) -> Result<(String, Value), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = match value.trim() {
        "none" => Value::Null,
        value => serde_json::from_str(value).unwrap_or_else(|_| value.into()),
    };
    Ok((name.trim().replace('-', "_"), value))
}

/// Prints the options of detection with the values of the built-in models, and those of registration with their defaults.
pub fn list() -> Result<()> {
    let of = |which| serde_json::to_value(Model::builtin(which).recommended());
    let (compact, scenes) = (of(Builtin::Compact)?, of(Builtin::Scenes)?);
    let mut report = Report::default();
    report.heading(format!("{:<22} {:>16} {:>16}", "detection", "compact", "scenes"));
    for group in ["encode", "detect"] {
        for (name, value) in compact[group].as_object().into_iter().flatten() {
            report.line(format!("{name:<22} {:>16} {:>16}", shown(value), shown(&scenes[group][name])));
        }
    }
    report.heading(format!("{:<22} {:>16}", "registration", "default"));
    for (name, value) in serde_json::to_value(RegisterOptions::default())?.as_object().into_iter().flatten() {
        report.line(format!("{name:<22} {:>16}", shown(value)));
    }
    terminal::print(&report)
}

/// A value as `--set` takes it.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "none".into(),
        Value::String(text) => text.clone(),
        value => value.to_string(),
    }
}

/// What to type instead of a flag that is no flag but the name of an option, such as `--refine-steps`.
pub fn instead_of(flag: &str) -> Option<String> {
    let name = flag.strip_prefix("--")?.split('=').next()?.replace('-', "_");
    let is_option = [serde_json::to_value(Options::default()), serde_json::to_value(RegisterOptions::default())]
        .iter()
        .flatten()
        .any(|options| has(options, &name));
    is_option.then(|| format!("type --set {name}=VALUE"))
}

fn has(options: &Value, name: &str) -> bool {
    let groups = [options.get("encode"), options.get("detect"), Some(options)];
    groups.into_iter().flatten().filter_map(Value::as_object).any(|group| Map::contains_key(group, name))
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
        assert_eq!(instead_of("--colour"), None);
    }
}
