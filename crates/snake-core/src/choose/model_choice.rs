//! The model that a caller asked for.

use std::sync::{Arc, OnceLock};

use serde_json::{Map, Value};

use crate::control::clock::Instant;
use crate::{Builtin, Model, Options, Preset, Result};

/// The model of a call: a named one, or for each cloud the built-in one that suits it.
#[derive(Debug, Clone)]
pub enum ModelChoice {
    /// For each cloud the built-in model that suits it.
    Auto(BuiltinModels),
    /// This model for all clouds.
    Named(NamedModel),
}

impl Default for ModelChoice {
    fn default() -> Self {
        Self::Auto(BuiltinModels::default())
    }
}

impl From<NamedModel> for ModelChoice {
    fn from(model: NamedModel) -> Self {
        Self::Named(model)
    }
}

/// The built-in models between which a cloud decides, each loaded when it is first used. Clones share them.
#[derive(Debug, Clone)]
pub struct BuiltinModels {
    /// Each model, and the seconds that it took to load.
    loaded: Arc<[OnceLock<(Model, f64)>; Builtin::ALL.len()]>,
    options: [Options; Builtin::ALL.len()],
}

impl Default for BuiltinModels {
    fn default() -> Self {
        Self { loaded: Arc::default(), options: Builtin::ALL.map(Builtin::recommended) }
    }
}

impl BuiltinModels {
    /// The same models with other options to begin with than those that one of them recommends.
    #[must_use]
    pub fn with_options(mut self, which: Builtin, options: Options) -> Self {
        self.options[which as usize] = options;
        self
    }

    /// One of the models.
    pub fn get(&self, which: Builtin) -> &Model {
        let place = &self.loaded[which as usize];
        if let Some((model, _)) = place.get() {
            return model;
        }
        // Loaded before the place is locked: a child process that is forked meanwhile would find it locked forever.
        let start = Instant::now();
        let model = Model::builtin(which);
        &place.get_or_init(|| (model, start.elapsed().as_secs_f64())).0
    }

    /// Whether one of the models was used already.
    pub fn is_loaded(&self, which: Builtin) -> bool {
        self.loaded[which as usize].get().is_some()
    }

    pub(super) fn load_seconds(&self) -> f64 {
        self.loaded.iter().filter_map(OnceLock::get).map(|(_, seconds)| seconds).sum()
    }

    pub(super) fn options(&self, which: Builtin) -> &Options {
        &self.options[which as usize]
    }
}

/// A model with its name in reports and the options to begin with.
#[derive(Debug, Clone)]
pub struct NamedModel {
    /// The model.
    pub model: Model,
    /// Its name in reports.
    pub name: String,
    /// The options that given values replace.
    pub options: Options,
}

impl NamedModel {
    /// A model with the options that it recommends.
    pub fn new(model: Model, name: impl Into<String>) -> Self {
        let options = *model.recommended();
        Self { model, name: name.into(), options }
    }

    /// The same model with other options to begin with.
    #[must_use]
    pub fn with_options(mut self, options: Options) -> Self {
        self.options = options;
        self
    }
}

impl Options {
    /// These options with some of them replaced by name, as [`Options::with_values`] does. The value `preset` names a set of
    /// options ([`Preset`], or `standard`) that come in place of these.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for an unknown name and for a value of another type;
    /// [`Error::Option`](crate::Error::Option) for an unknown preset.
    pub fn resolve(&self, values: &Map<String, Value>) -> Result<Self> {
        let start = match values.get("preset") {
            None | Some(Value::Null) => *self,
            Some(Value::String(name)) if name == "standard" => *Model::named(name)?.recommended(),
            Some(Value::String(name)) => Preset::named(name)?.options(),
            Some(other) => Preset::named(&other.to_string())?.options(),
        };
        let mut values = values.clone();
        values.remove("preset");
        start.with_values(&values)
    }
}
