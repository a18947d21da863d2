//! Options that several sub-commands share: the model, the threads and the encoding.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde::de::DeserializeOwned;
use snake_core::{Length, Model, NormalizationMethod, Options, Preset, SimdLevel};

use crate::{config, model, terminal};

/// The most threads on a machine with fewer processors: more threads would only wait for each other.
const MAX_THREADS: usize = 256;

/// A model with the options that it recommends, as the configuration file changes them.
pub struct Loaded {
    pub model: Model,
    /// The name in reports.
    pub name: String,
    pub options: Options,
    /// Whether the model was not named anywhere.
    pub is_default: bool,
}

/// Options of every sub-command that runs the network.
#[derive(Args)]
pub struct ComputeArguments {
    /// Weight file (.safetensors), or the name of a model. Built in are compact (for objects), standard (for objects,
    /// better and slower), scenes (for rooms, LiDAR sweeps and streets) and rooms (for rooms in metres, in windows). Any
    /// other NAME is a file NAME.safetensors in SNAKE_MODELS, beside the program or in the user's data folder [default:
    /// compact; detect takes scenes for a cloud that looks like a sweep].
    #[arg(long, value_name = "MODEL", env = "SNAKE_MODEL", hide_env_values = true)]
    pub model: Option<PathBuf>,
    /// Number of threads, at most 256 or the number of processors [default: one for each processor]. The result does
    /// not depend on it.
    #[arg(long, value_name = "NUMBER", env = "SNAKE_THREADS", hide_env_values = true,
        value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
}

impl ComputeArguments {
    /// Starts the threads. Call it before any computation.
    pub fn start_threads(&self) -> Result<()> {
        let threads = match self.threads {
            None => config::get()?.threads,
            given => given,
        };
        if let Some(threads) = threads {
            let most = std::thread::available_parallelism().map_or(1, usize::from).max(MAX_THREADS);
            if threads == 0 || usize::from(threads) > most {
                bail!("--threads is {threads}: allowed is 1 to {most}");
            }
            rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
        }
        let simd = SimdLevel::current().name();
        let wanted = std::env::var("SNAKE_SIMD").unwrap_or_default();
        if !wanted.is_empty() && wanted != simd {
            let names: Vec<&str> = SimdLevel::available().into_iter().map(SimdLevel::name).collect();
            terminal::warn(&format!(
                "SNAKE_SIMD is {wanted}: allowed is {}; {simd} is used instead",
                names.join(" or ")
            ));
        }
        terminal::detail("threads", || format!("{}, SIMD {simd}", rayon::current_num_threads()));
        Ok(())
    }

    /// Loads the model of `--model`, by default the built-in one.
    pub fn load_model(&self) -> Result<Loaded> {
        let path = match &self.model {
            None => config::get()?.model.as_deref(),
            given => given.as_deref(),
        };
        Ok(Loaded { is_default: path.is_none(), ..load(path)? })
    }
}

impl Loaded {
    /// The built-in model for scenes.
    pub fn scenes() -> Result<Self> {
        load(Some(Path::new("scenes")))
    }
}

fn load(path: Option<&Path>) -> Result<Loaded> {
    let start = Instant::now();
    let (model, name) = (model::load(path)?, model::name(path));
    let options = config::get()?.options_of(path.unwrap_or(Path::new("compact")), model.recommended())?;
    terminal::detail("model", || {
        format!("{name}, {} parameters, {:.3} s", model.num_parameters(), start.elapsed().as_secs_f64())
    });
    Ok(Loaded { model, name, options, is_default: false })
}

/// Options of the encoding. Each one defaults to the value of the preset, or else to the model's recommended value.
#[derive(Args)]
#[command(next_help_heading = "Encoding options (the model recommends the values; those of compact are shown)")]
pub struct EncodeFlags {
    /// Start from a named set of options: the paper's settings for a data set (modelnet40, keypointnet, smpl, redwood
    /// or 3dmatch), or the options of the model standard [default: the model's own].
    #[arg(long)]
    preset: Option<String>,
    /// How the cloud is mapped into the network's cube ±0.5. unit-sphere: the mean moves to the origin, the farthest
    /// point to the sphere of radius 0.5. principal-axes: the same, and the cloud is encoded in its principal axes, so
    /// that keypoints hardly depend on how it is turned. unit-cube: the mean moves to the origin, the largest coordinate
    /// to ±0.5. none: the cloud already lies in the cube [default: principal-axes].
    #[arg(long, value_parser = named::<NormalizationMethod>)]
    normalization: Option<NormalizationMethod>,
    /// Encode at most this many points, drawn at random. The report gives the number of encoded points
    /// [default: all points].
    #[arg(long)]
    max_points: Option<usize>,
    /// Seed of the random draws of --max-points and --sample [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    /// Average the field over this many rotated copies of the cloud. Keypoints repeat far better, and the time grows in
    /// proportion [default: 1].
    #[arg(long)]
    rotations: Option<usize>,
    /// Size of a voxel, for scene models: in cloud units, or in multiples of the cloud's resolution (`2r`). Details smaller
    /// than a voxel are not seen [default: chosen from the cloud].
    #[arg(long, value_name = "LENGTH")]
    voxel_size: Option<Length>,
}

impl EncodeFlags {
    /// Whether a preset or a normalisation is named, which suit only some models.
    pub fn names_a_model(&self) -> bool {
        self.preset.is_some() || self.normalization.is_some()
    }

    /// The options of the preset or the model, with the encoding overridden by the command line.
    pub fn resolve(&self, loaded: &Loaded) -> Result<Options> {
        let mut preset = match &self.preset {
            Some(name) => Preset::named(name)?.options(),
            None => loaded.options,
        };
        override_with(&mut preset.encode.normalization, self.normalization);
        override_with(&mut preset.encode.max_points, self.max_points.map(Some));
        override_with(&mut preset.encode.seed, self.seed);
        override_with(&mut preset.encode.rotations, self.rotations);
        override_with(&mut preset.encode.voxel_size, self.voxel_size.map(none_if_zero));
        Ok(preset)
    }
}

/// Replaces an option by the given value, if there is one.
pub fn override_with<T>(option: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *option = given;
    }
}

/// The length, or `None` for 0, which turns the option off.
pub fn none_if_zero(length: Length) -> Option<Length> {
    Some(length).filter(|length| *length != Length::Units(0.0))
}

/// Parses the value of an option from its name in weight files and reports.
pub fn named<T: DeserializeOwned>(name: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(name.into())
}
