//! A flag for each common option, from the tables of the core: name, type, range and help are written there.

use std::marker::PhantomData;

use anyhow::Result;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use serde_json::{Map, Value};
use snake_core::{
    Builtin, DetectOptions, EncodeOptions, MeshOptions, OptionGroup, OptionInfo, OptionKind, in_words,
    with_named_values,
};
use snake_registration::{AlignOptions, PairOptions, RegisterOptions};

use crate::set::{shown, value, values_of};

/// The heading of the options that a model recommends.
pub const OF_MODEL: &str = "Options of the model (it recommends the values; those of compact are shown)";
/// The heading of the options of registration.
pub const OF_REGISTRATION: &str =
    "Registration options (LENGTH: in the clouds' units, or multiples of their resolution: 3r)";

/// Options of which the common ones are flags.
pub trait FlagGroup: OptionGroup + Clone {
    /// The heading in the help.
    const HEADING: Option<&'static str>;

    /// The values that the help shows as defaults.
    fn defaults() -> Self {
        Self::default()
    }
}

impl FlagGroup for EncodeOptions {
    const HEADING: Option<&'static str> = Some(OF_MODEL);

    fn defaults() -> Self {
        Builtin::Compact.recommended().encode
    }
}

impl FlagGroup for DetectOptions {
    const HEADING: Option<&'static str> = Some(OF_MODEL);

    fn defaults() -> Self {
        Builtin::Compact.recommended().detect
    }
}

impl FlagGroup for MeshOptions {
    const HEADING: Option<&'static str> = None;
}

impl FlagGroup for RegisterOptions {
    const HEADING: Option<&'static str> = Some(OF_REGISTRATION);
}

impl FlagGroup for PairOptions {
    const HEADING: Option<&'static str> = Some(OF_REGISTRATION);
}

impl FlagGroup for AlignOptions {
    const HEADING: Option<&'static str> = Some(OF_REGISTRATION);
}

/// The options of a group that were given as flags.
pub struct OptionFlags<T> {
    given: Map<String, Value>,
    group: PhantomData<fn() -> T>,
}

impl<T> OptionFlags<T> {
    /// Names and values, as [`with_named_values`] takes them.
    pub fn given(&self) -> Map<String, Value> {
        self.given.clone()
    }
}

impl<T: FlagGroup> Args for OptionFlags<T> {
    fn augment_args(command: Command) -> Command {
        let defaults = values_of(&T::defaults());
        command.args(flags::<T>().map(|option| flag::<T>(option, &defaults[option.name])))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<T: FlagGroup> FromArgMatches for OptionFlags<T> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let value = |option: &OptionInfo| match (option.kind)() {
            OptionKind::Flag => matches.get_flag(option.name).then_some(true.into()),
            _ => matches.get_one::<Value>(option.name).cloned(),
        };
        let given = flags::<T>().filter_map(|option| Some((option.name.to_owned(), value(option)?)));
        Ok(Self { given: given.collect(), group: PhantomData })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.given.extend(Self::from_arg_matches(matches)?.given);
        Ok(())
    }
}

/// The options of a group that are flags.
fn flags<T: OptionGroup>() -> impl Iterator<Item = &'static OptionInfo> {
    T::OPTIONS.iter().filter(|option| !option.flag.is_empty())
}

/// The flag of an option.
fn flag<T: FlagGroup>(option: &'static OptionInfo, default: &Value) -> Arg {
    let arg =
        Arg::new(option.name).long(option.name.replace('_', "-")).help_heading(T::HEADING).allow_negative_numbers(true);
    if (option.kind)() == OptionKind::Flag {
        return arg.help(option.help()).action(ArgAction::SetTrue);
    }
    let (default, none) = match (default, is_off_at_zero::<T>(option)) {
        (Value::Null, true) => (format!("0, {}", option.none), ""),
        (Value::Null, false) => (option.none.to_owned(), ""),
        (value, is_off) => (shown(value), if is_off { "0" } else { "" }),
    };
    let facts = [format!("default: {default}"), option.limits(none)];
    let facts = facts.iter().filter(|fact| !fact.is_empty()).map(String::as_str);
    let help = format!("{} [{}]", option.help(), facts.collect::<Vec<_>>().join("; "));
    arg.help(help).value_name(option.flag).value_parser(move |text: &str| read::<T>(option, text))
}

/// Whether 0 is the value without effect.
fn is_off_at_zero<T: FlagGroup>(option: &OptionInfo) -> bool {
    let zero = with_named_values(&T::default(), &Map::from_iter([(option.name.to_owned(), 0.into())]));
    zero.is_ok_and(|zero| values_of(&zero)[option.name].is_null())
}

/// The value of an option, if it is of the right type.
fn read<T: OptionGroup>(option: &OptionInfo, text: &str) -> Result<Value, String> {
    let value = value(text);
    match serde_json::from_value::<T>(Value::from_iter([(option.name, value.clone())])) {
        Ok(_) => Ok(value),
        Err(error) if option.range.is_empty() => Err(in_words(&error)),
        Err(error) => Err(format!("{}; allowed is {}", in_words(&error), option.range)),
    }
}
