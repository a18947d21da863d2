//! `snake-cli model`: describes a model.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use snake_core::{Builtin, Model};

use crate::terminal::{self, Report};

/// Loads a model from a weight file or by its name; the default is `compact`.
pub fn load(model: Option<&Path>) -> Result<Model> {
    let Some(model) = model else { return Ok(Model::builtin(Builtin::Compact)) };
    if let Some(name) = builtin_name(model) {
        return Ok(Model::named(name)?);
    }
    let file = locate(model)?;
    Model::load(&file).with_context(|| format!("cannot load the model {}", file.display()))
}

/// The name of a built-in model, unless a file has that name.
fn builtin_name(model: &Path) -> Option<&'static str> {
    Model::NAMES.into_iter().find(|name| model.as_os_str() == *name && !model.exists())
}

/// The weight file of a path or a name. A name stands for the first file NAME.safetensors in these folders:
/// SNAKE_MODELS, the program's folder and its subfolder `models`.
fn locate(model: &Path) -> Result<PathBuf> {
    let is_name = model.extension().is_none() && model.components().count() == 1 && !model.exists();
    if !is_name {
        return Ok(model.into());
    }
    let beside = std::env::current_exe().ok().and_then(|program| Some(program.parent()?.to_owned()));
    let folders: Vec<PathBuf> = [
        std::env::var_os("SNAKE_MODELS").map(PathBuf::from),
        beside.clone(),
        beside.map(|folder| folder.join("models")),
    ]
    .into_iter()
    .flatten()
    .collect();
    let file = model.with_extension("safetensors");
    if let Some(found) = folders.iter().map(|folder| folder.join(&file)).find(|path| path.is_file()) {
        return Ok(found);
    }
    let places: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
    bail!(
        "no model `{}`: built in are {}, and there is no {} in {}",
        model.display(),
        Model::NAMES.join(", "),
        file.display(),
        places.join(", ")
    );
}

/// The name of the model in reports.
pub fn name(model: Option<&Path>) -> String {
    let model = model.unwrap_or(Path::new("compact"));
    builtin_name(model).map_or_else(|| model.display().to_string(), |name| format!("{name}, built-in"))
}

/// Prints the network's shape, its recommended options and its metadata.
pub fn run(model: Option<&Path>) -> Result<()> {
    let name = name(model);
    let model = load(model)?;
    let config = model.config();
    let mut report = Report::default();
    report.line(format!("{name}: {} parameters", model.num_parameters()));
    report.line(format!("volume: {}, {} channels", config.volume, config.c_dim));
    report.line(format!("U-Net: {} levels from {} channels", config.unet_levels, config.unet_base_channels));
    report.line(format!("recommended options: {}", serde_json::to_string(model.recommended())?));
    report.line("metadata:");
    for (key, value) in model.metadata() {
        report.line(format!("  {key}: {value}"));
    }
    terminal::print(&report)
}
