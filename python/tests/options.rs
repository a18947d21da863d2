//! The options in Python's docstrings and stub are those of the tables, and so are the results. `SNAKE_WRITE_OPTIONS=1` writes them.

use std::path::Path;

use serde::Serialize;
use serde_json::Value;
use snake_core::{
    Builtin, DetectOptions, EncodeOptions, MeshOptions, OptionGroup, OptionInfo, OptionKind, Options, Preset,
};
use snake_detectors::{Harris3dOptions, IssOptions, Sift3dOptions, SurfaceVariationOptions};
use snake_geometry::{RecordField, RecordInfo, RecordKind};
use snake_registration::{AlignOptions, PairOptions, RECORDS, RegisterOptions};

const COMMAND: &str = "SNAKE_WRITE_OPTIONS=1 cargo test --release -p snake-rs-python --test options";

#[test]
fn docstrings_have_every_option_with_its_default() {
    let Options { encode, detect, .. } = Builtin::Compact.recommended();
    let preset = entry("preset=None", &[format!("Named set of options to begin with: {}.", quoted(&presets(), ", "))]);
    for (name, text) in [
        ("encode", entries(&encode)),
        ("detect", entries(&detect)),
        ("mesh", entries(&MeshOptions::default())),
        ("register", [entries(&RegisterOptions::default()), entries(&PairOptions::default())].concat()),
        ("align", entries(&AlignOptions::default())),
        ("iss", entries(&IssOptions::default())),
        ("harris3d", entries(&Harris3dOptions::default())),
        ("sift3d", entries(&Sift3dOptions::default())),
        ("surface_variation", entries(&SurfaceVariationOptions::default())),
        ("preset", preset),
    ] {
        check(&folder().join(format!("src/help/{name}.txt")), &text);
    }
}

#[test]
fn the_stub_has_every_option_and_every_result() {
    let preset = format!("    preset: Literal[{}] | None\n", quoted(&presets(), ", "));
    let classes = [
        class("_Preset", "TypedDict", &preset),
        class("_EncodeOptions", "_Preset", &types(EncodeOptions::OPTIONS)),
        class("_DetectOptions", "_Preset", &types(DetectOptions::OPTIONS)),
        "@type_check_only\nclass _Options(_EncodeOptions, _DetectOptions, total=False): ...\n".into(),
        class("_RegistrationOptions", "TypedDict", &types(RegisterOptions::OPTIONS)),
        class("_PairOptions", "TypedDict", &types(PairOptions::OPTIONS)),
        "@type_check_only\nclass _RegisterOptions(_RegistrationOptions, _PairOptions, total=False): ...\n".into(),
        class("_AlignOptions", "_RegistrationOptions", &types(AlignOptions::OPTIONS)),
        class("_IssOptions", "TypedDict", &types(IssOptions::OPTIONS)),
        class("_Harris3dOptions", "TypedDict", &types(Harris3dOptions::OPTIONS)),
        class("_Sift3dOptions", "TypedDict", &types(Sift3dOptions::OPTIONS)),
        class("_SurfaceVariationOptions", "TypedDict", &types(SurfaceVariationOptions::OPTIONS)),
        class("_MeshOptions", "TypedDict", &types(MeshOptions::OPTIONS)),
    ];
    let results: Vec<String> = RECORDS.iter().copied().map(result).collect();
    let path = folder().join("snake_rs/_core.pyi");
    let stub = std::fs::read_to_string(&path).unwrap();
    let options = format!("# Options, written by {COMMAND}\n\n");
    let stub = with_part(&stub, &options, &classes.join("\n"), "\n# The end of the options.\n");
    let stub =
        with_part(&stub, "# Results, written as the options.\n\n", &results.concat(), "# The end of the results.\n");
    check(&path, &stub);
}

/// A text with another part between two lines.
fn with_part(text: &str, begin: &str, part: &str, end: &str) -> String {
    let (before, rest) = text.split_once(begin).unwrap();
    let (_, after) = rest.split_once(end).unwrap();
    format!("{before}{begin}{part}{end}{after}")
}

/// The class of a result.
fn result(record: &RecordInfo) -> String {
    let field = |field: &RecordField| format!("    {}: {}\n", field.name, type_of_value(&(field.kind)()));
    let fields: String = record.fields().map(field).collect();
    format!("@final\n@dataclass(frozen=True, eq=False)\nclass {}:\n{fields}\n", record.name)
}

fn type_of_value(kind: &RecordKind) -> String {
    match kind {
        RecordKind::Flag => "bool".into(),
        RecordKind::Whole => "int".into(),
        RecordKind::Number => "float".into(),
        RecordKind::Text => "str".into(),
        RecordKind::Record(record) => record.name.into(),
        RecordKind::Optional(kind) => format!("{} | None", type_of_value(kind)),
        RecordKind::List(item) => match type_of_value(item).as_str() {
            "list[float]" => "NDArray[np.float64]".into(),
            item => format!("list[{item}]"),
        },
    }
}

/// The folder of the package.
fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Refuses a file with another text, or writes the text.
fn check(path: &Path, text: &str) {
    if std::env::var_os("SNAKE_WRITE_OPTIONS").is_some() {
        std::fs::write(path, text).unwrap();
    }
    let written = std::fs::read_to_string(path).unwrap_or_default();
    assert!(written == text, "{} is old: {COMMAND}", path.display());
}

fn presets() -> [&'static str; 5] {
    Preset::ALL.map(Preset::name)
}

fn quoted(names: &[&str], separator: &str) -> String {
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(separator)
}

/// Options with their values and help.
fn entries<T: OptionGroup + Serialize>(options: &T) -> String {
    let values: Value = serde_json::from_str(&serde_json::to_string(options).unwrap()).unwrap();
    let value = |option: &OptionInfo| match &values[option.name] {
        Value::Null => "None".into(),
        Value::Bool(true) => "True".into(),
        Value::Bool(false) => "False".into(),
        value => value.to_string(),
    };
    let of = |option: &OptionInfo| entry(&format!("{}={}", option.name, value(option)), &option.lines("None", 80));
    T::OPTIONS.iter().map(of).collect()
}

/// An option with its value, beside lines of help.
fn entry(option: &str, lines: &[String]) -> String {
    format!("    {option:<32}  {}\n", lines.join(&format!("\n{:38}", "")))
}

fn class(name: &str, parent: &str, fields: &str) -> String {
    format!("@type_check_only\nclass {name}({parent}, total=False):\n{fields}")
}

fn types(options: &[OptionInfo]) -> String {
    options.iter().map(|option| format!("    {}: {}\n", option.name, python_type(option))).collect()
}

/// The type of an option in Python.
fn python_type(option: &OptionInfo) -> String {
    let kind = match (option.kind)() {
        OptionKind::Flag => "bool".into(),
        OptionKind::Whole => "int".into(),
        OptionKind::Number => "float".into(),
        OptionKind::Length => "float | str".into(),
        OptionKind::Choice(names) => format!("Literal[{}]", quoted(names, ", ")),
        OptionKind::List => "ArrayLike".into(),
    };
    if option.none.is_empty() { kind } else { format!("{kind} | None") }
}
