//! Options that are written once. A struct of options is a table: from a row follow the field, its setter, its default, the
//! check of its range, its JSON and an [`OptionInfo`], from which command lines and other languages take name, type and help.

use serde::de::value::Error as Refused;
use serde::de::{DeserializeOwned, Deserializer, Error as _, Visitor};
use serde::{Serialize, forward_to_deserialize_any};

use crate::{Error, Length, Result};

/// A struct of options as a table:
///
/// ```
/// # use serde::{Deserialize, Serialize};
/// snake_geometry::options! {
///     /// Options of a search.
///     pub struct SearchOptions {
///         /// Largest number of results. The first paragraph is the help of every interface.
///         ///
///         /// What follows is for Rust alone.
///         limit, with_limit: Option<usize> = None, none "all results", from 1 to 100, flag "NUMBER";
///     }
/// }
/// # fn main() { assert_eq!(SearchOptions::default().with_limit(Some(3)).limit, Some(3)) }
/// ```
///
/// `none` says what `None` means, and `from` is the range: `from 1 or more` has no end, and `from 0 to 9 " (voxels)"` a note.
/// `flag` names the value of a flag on the command line, for an option that is common enough for one.
#[doc(hidden)]
#[macro_export]
macro_rules! options {
    (
        $(#[$meta:meta])*
        pub struct $options:ident { $(
            $(#[doc = $doc:literal])+
            $(#[serde($($serde:tt)*)])?
            $name:ident, $setter:ident: $type:ty = $default:expr
            $(, none $none:literal)?
            $(, from $low:literal $(to $high:literal)? $(or $more:ident)? $($note:literal)?)?
            $(, flag $flag:literal)?;
        )+ }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        #[non_exhaustive]
        pub struct $options { $(
            $(#[doc = $doc])+
            $(#[doc = concat!("\nWithout a value, null in JSON: ", $none, ".")])?
            $(#[doc = concat!("\nAllowed: ", $crate::options!(@range $low $(to $high)? $(or $more)? $($note)?), ".")])?
            #[doc = concat!("\nDefault: `", stringify!($default), "`.")]
            $(#[serde($($serde)*)])?
            pub $name: $type,
        )+ }

        impl Default for $options {
            fn default() -> Self {
                Self { $($name: $default),+ }
            }
        }

        $crate::setters!($options { $($name: $type => $setter),+ });

        impl $crate::OptionGroup for $options {
            const OPTIONS: &'static [$crate::OptionInfo] = &[$($crate::OptionInfo {
                name: stringify!($name),
                doc: concat!($($doc, "\n"),+),
                range: concat!("" $(, $crate::options!(@range $low $(to $high)? $(or $more)? $($note)?))?),
                none: concat!("" $(, $none)?),
                flag: concat!("" $(, $flag)?),
                kind: $crate::OptionKind::of::<$type>,
            }),+];
        }

        impl $options {
            /// Checks each option against its own range.
            #[allow(dead_code, reason = "a group may have no ranges")]
            pub(crate) fn check_ranges(&self) -> $crate::Result<()> {
                $($(
                    let allowed = $crate::options!(@range $low $(to $high)? $(or $more)? $($note)?);
                    let bounds = (f64::from($low), [$(f64::from($high), )? f64::from(f32::MAX)][0]);
                    $crate::check_range(stringify!($name), &self.$name, bounds, allowed)?;
                )?)+
                Ok(())
            }
        }
    };
    (@range $low:literal $(to $high:literal)? $(or $more:ident)? $($note:literal)?) => {
        concat!($low $(, " to ", $high)? $(, " or ", stringify!($more))? $(, $note)?)
    };
}

/// Name, kind, default, range and help of an option.
#[derive(Debug, Clone, Copy)]
pub struct OptionInfo {
    /// The name: that of the field, of the key in JSON, and of the keyword in Python.
    pub name: &'static str,
    /// The documentation of the field.
    pub doc: &'static str,
    /// The range in words, such as `1 to 256`; empty without one.
    pub range: &'static str,
    /// What `None`, null in JSON, means; empty for an option that cannot be `None`.
    pub none: &'static str,
    /// The name of the value of the flag on a command line; empty for an option without a flag.
    pub flag: &'static str,
    /// What values look like.
    pub kind: fn() -> OptionKind,
}

impl OptionInfo {
    /// The first paragraph of the documentation as one line, without a period at its end.
    pub fn help(&self) -> String {
        let lines = self.doc.lines().map(str::trim).take_while(|line| !line.is_empty());
        let help = lines.collect::<Vec<_>>().join(" ");
        help.strip_suffix('.').map_or(help.clone(), str::to_owned)
    }

    /// What values are allowed and what none of them means, such as `allowed: 1 or more; none: all points`, where `none` is how
    /// no value is written; empty if there is nothing to say.
    pub fn limits(&self, none: &str) -> String {
        let allowed = match (self.kind)() {
            OptionKind::Choice([names @ .., last]) => format!("{} or {last}", names.join(", ")),
            _ => self.range.to_owned(),
        };
        let facts = [("allowed", allowed.as_str()), (none, self.none)];
        let facts = facts.iter().filter(|(name, text)| !name.is_empty() && !text.is_empty());
        facts.map(|(name, text)| format!("{name}: {text}")).collect::<Vec<_>>().join("; ")
    }

    /// [`OptionInfo::help`] and [`OptionInfo::limits`] as lines of about `width` characters at most.
    pub fn lines(&self, none: &str, width: usize) -> Vec<String> {
        let limits = Some(self.limits(none)).filter(|limits| !limits.is_empty());
        let text = limits.map_or(self.help(), |limits| format!("{} [{limits}]", self.help()));
        let mut lines = vec![String::new()];
        for word in text.split(' ') {
            match lines.last_mut() {
                Some(line) if line.is_empty() => word.clone_into(line),
                Some(line) if line.chars().count() + 1 + word.chars().count() <= width => *line += &format!(" {word}"),
                _ => lines.push(word.into()),
            }
        }
        lines
    }
}

/// A struct of options, made by [`options!`].
pub trait OptionGroup: Default + Serialize + DeserializeOwned {
    /// Its options, in the order of the fields.
    const OPTIONS: &'static [OptionInfo];

    /// The range of an option in words.
    fn range(name: &str) -> &'static str {
        Self::OPTIONS.iter().find(|option| option.name == name).map_or("", |option| option.range)
    }
}

/// What the values of an option look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OptionKind {
    /// True or false.
    Flag,
    /// A whole number, 0 or more.
    Whole,
    /// A number.
    Number,
    /// A [`Length`]: a number or a text such as `3r`.
    Length,
    /// One of these names.
    Choice(&'static [&'static str]),
    /// A list of numbers, or of such lists.
    List,
}

impl OptionKind {
    /// The kind of a type, which is what its [`Deserialize`](serde::Deserialize) asks for.
    pub fn of<T: DeserializeOwned>() -> Self {
        let mut kind = Self::List;
        // The probe has no value to give, so the result is always an error.
        let _refused = T::deserialize(Probe(&mut kind));
        kind
    }
}

/// Notes what is asked for, and gives nothing.
struct Probe<'a>(&'a mut OptionKind);

impl Probe<'_> {
    fn note<T>(self, kind: OptionKind) -> std::result::Result<T, Refused> {
        *self.0 = kind;
        Err(Refused::custom("a probe has no values"))
    }
}

impl<'de> Deserializer<'de> for Probe<'_> {
    type Error = Refused;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::Length)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, _: V) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::Flag)
    }

    fn deserialize_u64<V: Visitor<'de>>(self, _: V) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::Whole)
    }

    fn deserialize_f32<V: Visitor<'de>>(self, _: V) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::Number)
    }

    fn deserialize_f64<V: Visitor<'de>>(self, _: V) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::Number)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> std::result::Result<V::Value, Refused> {
        visitor.visit_some(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        names: &'static [&'static str],
        _: V,
    ) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::Choice(names))
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, _: V) -> std::result::Result<V::Value, Refused> {
        self.note(OptionKind::List)
    }

    forward_to_deserialize_any! {
        i8 i16 i32 i64 u8 u16 u32 char str string bytes byte_buf unit unit_struct newtype_struct seq tuple_struct map
        struct identifier ignored_any
    }
}

/// A value that can have a range.
pub trait Ranged {
    /// The value as text if it lies outside.
    fn outside(&self, low: f64, high: f64) -> Option<String>;
}

impl Ranged for usize {
    fn outside(&self, low: f64, high: f64) -> Option<String> {
        (!(low..=high).contains(&(*self as f64))).then(|| self.to_string())
    }
}

impl Ranged for f32 {
    fn outside(&self, low: f64, high: f64) -> Option<String> {
        (!(low as f32..=high as f32).contains(self)).then(|| self.to_string())
    }
}

impl Ranged for f64 {
    fn outside(&self, low: f64, high: f64) -> Option<String> {
        (!(low..=high).contains(self)).then(|| self.to_string())
    }
}

impl Ranged for Length {
    fn outside(&self, low: f64, high: f64) -> Option<String> {
        (!(low..=high).contains(&self.number())).then(|| self.to_string())
    }
}

impl<T: Ranged> Ranged for Option<T> {
    fn outside(&self, low: f64, high: f64) -> Option<String> {
        self.as_ref()?.outside(low, high)
    }
}

/// Refuses a value outside its range.
///
/// # Errors
/// [`Error::Option`] with the name and the range.
pub fn check_range(
    name: &'static str,
    value: &impl Ranged,
    (low, high): (f64, f64),
    allowed: &'static str,
) -> Result<()> {
    match value.outside(low, high) {
        Some(value) => Err(Error::Option { name, value, allowed }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;
    use crate::{NormalizationMethod, RigidTransform};

    options! {
        /// Options of every kind.
        pub struct TestOptions {
            /// Number of results, at least.
            ///
            /// Not for other languages.
            number, with_number: usize = 3, from 2 or more;
            /// A share.
            share, with_share: Option<f32> = None, none "off", from 0.001 to 0.999 " (of all)", flag "SHARE";
            /// A ratio.
            ratio, with_ratio: f64 = 0.975, from 0 to 1;
            /// A radius.
            radius, with_radius: Option<Length> = None, none "no limit", from 0 or more;
            /// A switch.
            #[serde(alias = "flag")]
            switch, with_switch: bool = false;
            /// A name.
            method, with_method: NormalizationMethod = NormalizationMethod::UnitCube;
            /// A list.
            place, with_place: Option<[f64; 3]> = None, none "nowhere";
            /// A matrix.
            transform, with_transform: Option<RigidTransform> = None, none "none";
        }
    }

    #[test]
    fn the_table_says_what_the_struct_is() {
        let of = |name| TestOptions::OPTIONS.iter().find(|option| option.name == name).unwrap();
        let json = serde_json::to_value(TestOptions::default()).unwrap();
        assert_eq!(json.as_object().unwrap().len(), TestOptions::OPTIONS.len());
        assert!(TestOptions::OPTIONS.iter().all(|option| json.get(option.name).is_some()));
        let set = TestOptions::default().with_switch(true).with_place(Some([1.0, 2.0, 3.0]));
        let set = set.with_method(NormalizationMethod::None).with_transform(Some(RigidTransform::default()));
        assert_eq!(serde_json::from_str::<TestOptions>(&serde_json::to_string(&set).unwrap()).unwrap(), set);
        assert_eq!(of("number").help(), "Number of results, at least");
        let ranges = ["number", "share", "radius", "switch"].map(|name| of(name).range);
        assert_eq!(ranges, ["2 or more", "0.001 to 0.999 (of all)", "0 or more", ""]);
        assert_eq!((of("share").none, of("share").flag, of("number").flag), ("off", "SHARE", ""));
        assert_eq!(of("method").limits("null"), "allowed: unit-sphere, principal-axes, unit-cube, half or none");
        assert_eq!(of("radius").limits("null"), "allowed: 0 or more; null: no limit");
        assert_eq!(
            (of("radius").limits(""), of("switch").limits("null")),
            ("allowed: 0 or more".into(), String::new())
        );
        let kinds =
            ["number", "share", "ratio", "radius", "switch", "place", "transform"].map(|name| (of(name).kind)());
        use OptionKind::{Flag, Length, List, Number, Whole};
        assert_eq!(kinds, [Whole, Number, Number, Length, Flag, List, List]);
    }

    #[test]
    fn each_option_is_checked_against_its_range() {
        let good = TestOptions::default();
        for wanted in [0.001, 0.999] {
            assert!(good.with_share(Some(wanted)).check_ranges().is_ok());
        }
        assert!(good.with_number(usize::MAX).with_radius(Some(Length::Resolutions(0.0))).check_ranges().is_ok());
        let refused = |options: TestOptions| options.check_ranges().unwrap_err().to_string();
        assert_eq!(refused(good.with_number(1)), "option `number` is 1: allowed is 2 or more");
        for share in [0.0, 1.0, f32::NAN] {
            let expected = format!("option `share` is {share}: allowed is 0.001 to 0.999 (of all)");
            assert_eq!(refused(good.with_share(Some(share))), expected);
        }
        for ratio in [-0.1, 1.1, f64::NAN] {
            assert!(refused(good.with_ratio(ratio)).contains("`ratio`"), "{ratio}");
        }
        for radius in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(refused(good.with_radius(Some(Length::Percent(radius)))).contains("`radius`"), "{radius}");
        }
    }
}
