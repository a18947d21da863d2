//! Results that are declared and documented once: a struct gives its JSON and a [`RecordInfo`], from which other languages
//! derive classes, types and documentation.

use crate::RigidTransform;

/// A struct whose fields [`RecordInfo`] lists, with their documentation:
///
/// ```
/// # use serde::{Deserialize, Serialize};
/// snake_geometry::record! {
/// /// A result.
/// #[derive(Serialize, Deserialize)]
/// pub struct Count {
///     /// Number of points.
///     pub points: usize,
/// }
/// }
/// # fn main() { assert_eq!(<Count as snake_geometry::Record>::INFO.fields[0].name, "points") }
/// ```
#[doc(hidden)]
#[macro_export]
macro_rules! record {
    (
        $(#[$($meta:tt)+])*
        pub struct $name:ident { $(
            $(#[$($field_meta:tt)+])*
            pub $field:ident: $type:ty,
        )+ }
    ) => {
        $(#[$($meta)+])*
        pub struct $name { $(
            $(#[$($field_meta)+])*
            pub $field: $type,
        )+ }

        impl $crate::Record for $name {
            const INFO: &'static $crate::RecordInfo = &$crate::RecordInfo {
                name: stringify!($name),
                doc: concat!($($crate::record!(@doc $($meta)+)),*),
                fields: &[$($crate::RecordField {
                    name: stringify!($field),
                    doc: concat!($($crate::record!(@doc $($field_meta)+)),*),
                    kind: <$type as $crate::RecordValue>::kind,
                    is_skipped: false $(|| $crate::record!(@skip $($field_meta)+))*,
                }),+],
            };
        }

        impl $crate::RecordValue for $name {
            fn kind() -> $crate::RecordKind {
                $crate::RecordKind::Record(<Self as $crate::Record>::INFO)
            }
        }
    };
    (@doc doc = $text:literal) => { concat!($text, "\n") };
    (@doc $($other:tt)+) => { "" };
    (@skip serde(skip)) => { true };
    (@skip $($other:tt)+) => { false };
}

/// A result with a table of its fields.
pub trait Record {
    /// The table.
    const INFO: &'static RecordInfo;
}

/// A result: its name, documentation and fields.
#[derive(Debug)]
pub struct RecordInfo {
    /// The name of the struct.
    pub name: &'static str,
    /// The documentation of the struct.
    pub doc: &'static str,
    /// The fields in their order.
    pub fields: &'static [RecordField],
}

impl RecordInfo {
    /// The fields that are part of JSON.
    pub fn fields(&self) -> impl Iterator<Item = &'static RecordField> + use<> {
        self.fields.iter().filter(|field| !field.is_skipped)
    }
}

/// A field of a result.
#[derive(Debug)]
pub struct RecordField {
    /// The name: that of the key in JSON, and of the attribute in Python.
    pub name: &'static str,
    /// The documentation of the field.
    pub doc: &'static str,
    /// What it holds.
    pub kind: fn() -> RecordKind,
    /// Whether it is for Rust alone.
    pub is_skipped: bool,
}

/// What a field holds.
#[derive(Debug)]
pub enum RecordKind {
    /// True or false.
    Flag,
    /// A whole number.
    Whole,
    /// A real number.
    Number,
    /// A text or a name.
    Text,
    /// Several values; lists of numbers in a list are a matrix.
    List(Box<RecordKind>),
    /// A value, or null.
    Optional(Box<RecordKind>),
    /// Another result.
    Record(&'static RecordInfo),
}

/// A type that a field of a result can have.
pub trait RecordValue {
    /// What it holds.
    fn kind() -> RecordKind;
}

macro_rules! values {
    ($($type:ty: $kind:ident),+) => { $(
        impl RecordValue for $type {
            fn kind() -> RecordKind {
                RecordKind::$kind
            }
        }
    )+ };
}
values!(bool: Flag, usize: Whole, f32: Number, f64: Number, String: Text);

impl RecordValue for RigidTransform {
    fn kind() -> RecordKind {
        <[[f64; 4]; 4]>::kind()
    }
}

impl<T: RecordValue> RecordValue for Vec<T> {
    fn kind() -> RecordKind {
        RecordKind::List(Box::new(T::kind()))
    }
}

impl<T: RecordValue> RecordValue for Option<T> {
    fn kind() -> RecordKind {
        RecordKind::Optional(Box::new(T::kind()))
    }
}

impl<T: RecordValue, const N: usize> RecordValue for [T; N] {
    fn kind() -> RecordKind {
        RecordKind::List(Box::new(T::kind()))
    }
}
