//! What the sub-commands share: model, threads and how a cloud is encoded.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde::de::DeserializeOwned;
use snake_core::{Length, Model, NormalizationMethod, Options, Preset, SimdLevel};

use crate::model;
use crate::terminal;

/// Threads at most, where there are not more processors: a thousand on few processors only wait for each other.
const MAX_THREADS: usize = 256;

/// What every sub-command that computes takes.
#[derive(Args)]
pub struct ComputeArguments {
    /// Weight file (.safetensors), or the name of a model: compact (for objects), standard (for objects, better and
    /// slower) and rooms (for rooms in metres) are built in, another is that of a file in SNAKE_MODELS, beside the program
    /// or in the user's data folder [default: compact].
    #[arg(long, value_name = "MODEL", env = "SNAKE_MODEL", hide_env_values = true)]
    pub model: Option<PathBuf>,
    /// Threads, at most 256 or the number of processors; default: all processors. The result does not depend on it.
    #[arg(long, value_name = "NUMBER", env = "SNAKE_THREADS", hide_env_values = true,
        value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
}

impl ComputeArguments {
    /// Starts the threads; before anything is computed.
    pub fn start_threads(&self) -> Result<()> {
        if let Some(threads) = self.threads {
            let most = std::thread::available_parallelism().map_or(1, usize::from).max(MAX_THREADS);
            if usize::from(threads) > most {
                bail!("--threads is {threads}: allowed is 1 to {most}");
            }
            rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
        }
        let simd = SimdLevel::current().name();
        let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
        if !wanted.is_empty() && wanted != simd {
            let names: Vec<&str> = SimdLevel::available().into_iter().map(SimdLevel::name).collect();
            terminal::warn(&format!("SNAKE_SIMD is {wanted}, not {}; {simd} is used", names.join(" or ")));
        }
        terminal::detail("threads", || format!("{}, SIMD {simd}", rayon::current_num_threads()));
        Ok(())
    }

    /// Loads the model of `--model`, by default the built-in one.
    pub fn load_model(&self) -> Result<Model> {
        let start = Instant::now();
        let model = model::load(self.model.as_deref())?;
        terminal::detail("model", || {
            let (name, parameters) = (model::name(self.model.as_deref()), model.num_parameters());
            format!("{name}, {parameters} parameters, {:.3} s", start.elapsed().as_secs_f64())
        });
        Ok(model)
    }
}

/// How a cloud is encoded. What is not given comes from the preset, or from the model's recommended options.
#[derive(Args)]
#[command(next_help_heading = "Encoding options (default: what the model recommends)")]
pub struct EncodeFlags {
    /// Start from the paper's settings for a data set, modelnet40, keypointnet, smpl, redwood or 3dmatch, or from those of
    /// the model standard.
    #[arg(long)]
    preset: Option<String>,
    /// unit-sphere: mean to the origin, farthest point to the sphere of radius 0.5; unit-cube: largest coordinate to
    /// the cube ±0.5; none: the cloud is in that cube already.
    #[arg(long, value_parser = named::<NormalizationMethod>)]
    normalization: Option<NormalizationMethod>,
    /// Encode at most this many points, drawn at random; the report says how many.
    #[arg(long)]
    max_points: Option<usize>,
    /// Seed of that draw, and of --sample.
    #[arg(long)]
    seed: Option<u64>,
    /// Average over this many turned copies of the cloud: keypoints repeat far better, at as many times the cost.
    #[arg(long)]
    rotations: Option<usize>,
}

impl EncodeFlags {
    /// The preset's or the model's options, their encoding overridden by what was given.
    pub fn resolve(&self, model: &Model) -> Result<Options> {
        let mut preset = match &self.preset {
            Some(name) => Preset::named(name)?.options(),
            None => *model.recommended(),
        };
        override_with(&mut preset.encode.normalization, self.normalization);
        override_with(&mut preset.encode.max_points, self.max_points.map(Some));
        override_with(&mut preset.encode.seed, self.seed);
        override_with(&mut preset.encode.rotations, self.rotations);
        Ok(preset)
    }
}

/// Replaces an option by what was given.
pub fn override_with<T>(option: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *option = given;
    }
}

/// A length that 0 turns off.
pub fn none_if_zero(length: Length) -> Option<Length> {
    Some(length).filter(|length| *length != Length::Units(0.0))
}

/// Parses an option's value by the name that it has in weight files and reports.
pub fn named<T: DeserializeOwned>(name: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(name.into())
}
