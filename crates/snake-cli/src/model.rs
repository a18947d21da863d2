//! `snake-cli model`: what a weight file is.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};
use snake_core::Model;

/// Loads a weight file, or the built-in model.
pub fn load(file: Option<&Path>) -> Result<Model> {
    match file {
        Some(path) => Model::load(path).with_context(|| format!("cannot load the model {}", path.display())),
        None => Ok(Model::builtin()?),
    }
}

/// Prints the network's shape, its recommended options and its metadata.
pub fn run(file: Option<&Path>) -> Result<()> {
    let model = load(file)?;
    let config = model.config();
    let [x, y, z] = config.frame.resolution;
    let name = file.map_or("built-in".into(), |path| path.display().to_string());
    let mut text = format!("{name}: {} parameters\n", model.num_parameters());
    writeln!(text, "volume: {x} x {y} x {z} voxels, {} channels", config.c_dim)?;
    writeln!(text, "U-Net: {} levels from {} channels", config.unet_levels, config.unet_base_channels)?;
    writeln!(text, "recommended options: {}", serde_json::to_string(model.recommended())?)?;
    writeln!(text, "metadata:")?;
    for (key, value) in model.metadata() {
        writeln!(text, "  {key}: {value}")?;
    }
    crate::print(&text)
}
