//! Options that several sub-commands share: the model, the threads and the encoding.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use snake_core::{Builtin, EncodeOptions, Length, Model, Options, Point, Preset, SimdLevel};

use snake_registration::RegisterOptions;

use crate::flags::{OF_MODEL, OptionFlags};
use crate::set::SetArguments;
use crate::{config, model, terminal};

/// The most threads on a machine with fewer processors: more threads would only wait for each other.
const MAX_THREADS: usize = 256;

/// A model with the options that it recommends, as the configuration file changes them.
pub struct Loaded {
    pub model: Model,
    /// The name in reports.
    pub name: String,
    pub options: Options,
}

/// Options of every sub-command that runs the network.
#[derive(Args)]
pub struct ComputeArguments {
    /// Weight file (.safetensors), or the name of a model. Built in are compact (for objects), standard (for objects,
    /// better and slower) and scenes (for rooms, LiDAR sweeps and streets). Any
    /// other NAME is a file NAME.safetensors in SNAKE_MODELS, beside the program or in the user's data folder [default:
    /// scenes
    /// for a cloud that looks like a room, a sweep or terrain, else compact].
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
        SimdLevel::check_environment().map_err(anyhow::Error::msg)?;
        let simd = SimdLevel::current().name();
        terminal::detail("threads", || format!("{}, SIMD {simd}", rayon::current_num_threads()));
        Ok(())
    }

    /// Loads the model of `--model`, by default `compact`, with the options that follow from those of `start`.
    pub fn load_model(&self, start: impl Fn(&Model) -> Options) -> Result<Loaded> {
        load(self.named()?, start)
    }

    /// Loads the model of `--model`, or else those that suit the options, with the options as `resolve` changes them.
    pub fn load_models(&self, suits: Suits, resolve: impl Fn(&Loaded) -> Result<Options>) -> Result<Models> {
        let load = |path: Option<&Path>| -> Result<Loaded> {
            let loaded = load(path, recommended)?;
            Ok(Loaded { options: resolve(&loaded)?, ..loaded })
        };
        let scenes = Some(Path::new("scenes"));
        let models = match (self.named()?, suits) {
            (None, Suits::TheCloud) => Models { first: load(None)?, scenes: Some(load(scenes)?) },
            (None, Suits::Scenes) => Models { first: load(scenes)?, scenes: None },
            (named, _) => Models { first: load(named)?, scenes: None },
        };
        let options = &models.first.options;
        terminal::detail("options", || serde_json::to_string(options).unwrap_or_default());
        Ok(models)
    }

    /// [`ComputeArguments::load_models`] for a registration; `None` if its options run no model and none is named. A model that
    /// is named is loaded, so that a mistake in its name is said.
    pub fn load_for_registration(&self, options: &RegisterOptions) -> Result<Option<Models>> {
        let load = || self.load_models(Suits::TheCloud, |loaded| Ok(loaded.options));
        (options.needs_model() || self.named()?.is_some()).then(load).transpose()
    }

    /// The model that is named on the command line, in the environment or in the configuration.
    fn named(&self) -> Result<Option<&Path>> {
        Ok(match &self.model {
            None => config::get()?.model.as_deref(),
            given => given.as_deref(),
        })
    }
}

/// Which built-in model suits options of the command line.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Suits {
    /// Options that only models of objects have.
    Objects,
    /// Options that only models of scenes have.
    Scenes,
    /// Options that all have: the cloud decides.
    TheCloud,
}

/// The model of a run with its options, or, where none is named, the built-in models of which each cloud gets its own.
pub struct Models {
    first: Loaded,
    scenes: Option<Loaded>,
}

impl Models {
    /// The model for a cloud.
    pub fn for_cloud(&self, points: &[Point]) -> &Loaded {
        match &self.scenes {
            Some(scenes) if Builtin::for_cloud(points) == Builtin::Scenes => scenes,
            _ => &self.first,
        }
    }

    /// The model for everything that is no cloud, such as the options of reading.
    pub fn first(&self) -> &Loaded {
        &self.first
    }

    /// Whether the cloud decides.
    pub fn are_chosen(&self) -> bool {
        self.scenes.is_some()
    }
}

/// The options that a model recommends.
pub fn recommended(model: &Model) -> Options {
    *model.recommended()
}

/// Loads a model with the options that the configuration makes of those of `start`.
pub fn load(path: Option<&Path>, start: impl Fn(&Model) -> Options) -> Result<Loaded> {
    let began = Instant::now();
    let (model, name) = (model::load(path)?, model::name(path));
    let options = config::get()?.options_of(path.unwrap_or(Path::new("compact")), &start(&model))?;
    terminal::detail("model", || {
        format!("{name}, {} parameters, {:.3} s", model.num_parameters(), began.elapsed().as_secs_f64())
    });
    Ok(Loaded { model, name, options })
}

/// Options of the encoding. Each one defaults to the value of the preset, or else to the model's recommended value.
#[derive(Args)]
#[command(next_help_heading = OF_MODEL)]
pub struct EncodeFlags {
    /// Start from a named set of options: the paper's settings for a data set (modelnet40, keypointnet, smpl, redwood
    /// or 3dmatch), or the options of the model standard [default: the model's own].
    #[arg(long)]
    preset: Option<String>,
    #[command(flatten)]
    encode: OptionFlags<EncodeOptions>,
    #[command(flatten)]
    set: SetArguments,
}

impl EncodeFlags {
    /// The options of the command line by name.
    pub fn given(&self) -> Map<String, Value> {
        self.encode.given().into_iter().chain(self.set.given()).collect()
    }

    /// The name of the preset.
    pub fn preset(&self) -> Option<&str> {
        self.preset.as_deref()
    }

    /// The options of the preset or the model, with those of the command line in their place.
    pub fn resolve(&self, loaded: &Loaded) -> Result<Options> {
        let options = match &self.preset {
            Some(name) => Preset::named(name)?.options(),
            None => loaded.options,
        };
        Ok(options.with_values(&self.given())?)
    }

    /// What the options say of the model where none is named.
    pub fn suits(&self) -> Suits {
        let given = self.given();
        let is_rotated = given.get("rotations").and_then(Value::as_u64).is_some_and(|rotations| rotations > 1);
        if given.contains_key("voxel_size") {
            Suits::Scenes
        } else if self.preset.is_some() || given.contains_key("normalization") || is_rotated {
            Suits::Objects
        } else {
            Suits::TheCloud
        }
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
