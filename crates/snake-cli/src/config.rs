//! The configuration file `snake.toml`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::{Context, Result, bail};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};
use snake_core::Options;

/// The largest configuration file, in bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Values of options by name.
#[derive(Debug, Default, Clone)]
struct Values(Map<String, Value>);

impl<'de> Deserialize<'de> for Values {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let table = toml::Table::deserialize(deserializer)?;
        // JSON has no such numbers: each would become no value, which turns an option off.
        if let Some((name, _)) = table.iter().find(|(_, value)| !is_finite(value)) {
            return Err(D::Error::custom(format!("option `{name}`: expected finite numbers")));
        }
        table.try_into().map(Self).map_err(D::Error::custom)
    }
}

/// Whether each number of a value is finite.
fn is_finite(value: &toml::Value) -> bool {
    match value {
        toml::Value::Float(number) => number.is_finite(),
        toml::Value::Array(values) => values.iter().all(is_finite),
        toml::Value::Table(table) => table.values().all(is_finite),
        _ => true,
    }
}

/// The values of a configuration file. Options have the names that `snake-cli model` prints.
#[derive(Debug, Default, Clone, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Default of --model.
    pub model: Option<PathBuf>,
    /// Default of --threads.
    pub threads: Option<u16>,
    /// Options for every model.
    options: Values,
    /// Options for the models of these names or paths.
    models: BTreeMap<String, Values>,
}

/// The configuration of this run: the file that SNAKE_CONFIG names, or else `snake.toml` in the working folder if there is
/// one.
pub fn get() -> Result<&'static Config> {
    static CONFIG: OnceLock<Config> = OnceLock::new();
    if let Some(config) = CONFIG.get() {
        return Ok(config);
    }
    let named = std::env::var_os("SNAKE_CONFIG").filter(|name| !name.is_empty()).map(PathBuf::from);
    let config = match named {
        Some(path) => Config::read(&path)?,
        None if Path::new("snake.toml").is_file() => Config::read(Path::new("snake.toml"))?,
        None => Config::default(),
    };
    Ok(CONFIG.get_or_init(|| config))
}

impl Config {
    fn read(path: &Path) -> Result<Self> {
        let mut text = String::new();
        let file = File::open(path).and_then(|file| file.take(MAX_BYTES).read_to_string(&mut text));
        let length = file.with_context(|| format!("cannot read {}", path.display()))?;
        if length as u64 == MAX_BYTES {
            bail!("{} is no configuration: it has {MAX_BYTES} bytes or more", path.display());
        }
        Self::parse(&text).with_context(|| path.display().to_string())
    }

    fn parse(text: &str) -> Result<Self> {
        let config: Self = toml::from_str(text)?;
        // Wrong names and values are errors even for models that this run does not use.
        for options in std::iter::once(&config.options).chain(config.models.values()) {
            Options::default().with_values(&options.0)?;
        }
        Ok(config)
    }

    /// The options of a model, overridden by those for every model and then by those for this one.
    pub fn options_of(&self, model: &Path, recommended: &Options) -> Result<Options> {
        let shared = recommended.with_values(&self.options.0)?;
        match model.to_str().and_then(|name| self.models.get(name)) {
            Some(own) => Ok(shared.with_values(&own.0)?),
            None => Ok(shared),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_a_model_come_after_those_of_all() {
        let text = "model = 'scenes'\nthreads = 2\n[options]\nmax_keypoints = 9\nnms_radius = '3r'\n\
                    [models.scenes]\nmax_keypoints = 7\nrotations = 4\n[models.'my/weights.safetensors']\nsnap = true\n";
        let config = Config::parse(text).unwrap();
        let options = |model: &str| config.options_of(Path::new(model), &Options::default()).unwrap();
        let scenes = options("scenes");
        assert_eq!((scenes.detect.max_keypoints, scenes.encode.rotations), (7, 4));
        assert_eq!(scenes.detect.nms_radius.unwrap().to_string(), "3r");
        assert_eq!((options("compact").detect.max_keypoints, options("compact").detect.snap), (9, false));
        assert!(options("my/weights.safetensors").detect.snap);
    }

    #[test]
    #[cfg(unix)]
    fn a_file_without_end_is_refused() {
        let error = Config::read(Path::new("/dev/zero")).unwrap_err().to_string();
        assert_eq!(error, "/dev/zero is no configuration: it has 1048576 bytes or more");
    }

    #[test]
    fn wrong_names_and_values_are_refused_by_name() {
        for (text, expected) in [
            ("[options]\nradius = 1", "unknown option `radius`"),
            ("[models.scenes]\nmax_keypoints = 'many'", "max_keypoints"),
            ("modle = 'scenes'", "modle"),
            ("threads = [", "expected"),
            ("[options]\nmax_keypoints = nan", "option `max_keypoints`: expected finite numbers"),
            ("[options]\nnms_radius = -inf", "option `nms_radius`: expected finite numbers"),
            ("[models.scenes]\nmin_confidence = inf", "option `min_confidence`: expected finite numbers"),
        ] {
            let error = format!("{:#}", Config::parse(text).unwrap_err());
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
