//! Options that several sub-commands share: the model, the threads and the encoding.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use snake_core::{Builtin, Chooser, Chosen, EncodeOptions, NamedModel, SimdLevel, max_num_threads};
use snake_registration::RegisterOptions;

use crate::flags::{OF_MODEL, OptionFlags};
use crate::inputs::check_inputs;
use crate::output::InputFiles;
use crate::set::SetArguments;
use crate::{model, terminal};

/// Options of every sub-command that runs the network.
#[derive(Args)]
pub struct ComputeArguments {
    /// Weight file (.safetensors), or the name of a model. Built in are compact (for objects), standard (for objects,
    /// better and slower) and scenes (for rooms, LiDAR sweeps and streets). Any other NAME is a file NAME.safetensors in
    /// SNAKE_MODELS or beside the program [default: scenes for a cloud that looks like a room, a sweep or terrain, else
    /// compact].
    #[arg(long, value_name = "MODEL", env = "SNAKE_MODEL", hide_env_values = true)]
    pub model: Option<PathBuf>,
    /// Number of threads, at most 256 or the number of processors [default: one for each processor]. The result does
    /// not depend on it.
    #[arg(long, value_name = "NUMBER", env = "SNAKE_THREADS", hide_env_values = true)]
    pub threads: Option<u16>,
}

impl ComputeArguments {
    /// Starts the threads. Call it before any computation.
    pub fn start_threads(&self) -> Result<()> {
        if Path::new("snake.toml").is_file() {
            bail!("snake.toml: no such file is read; give options as flags or by --set, and the model by SNAKE_MODEL");
        }
        if let Some(threads) = self.threads {
            let most = max_num_threads();
            if !(1..=most).contains(&usize::from(threads)) {
                bail!("--threads is {threads}: allowed is 1 to {most}");
            }
            rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
        }
        SimdLevel::check_environment().map_err(anyhow::Error::msg)?;
        let simd = SimdLevel::current().name();
        terminal::detail("threads", || format!("{}, SIMD {simd}", rayon::current_num_threads()));
        Ok(())
    }

    /// Starts the threads of a command, and refuses outputs that are among its inputs.
    pub fn begin<'a>(
        &'a self,
        inputs: impl IntoIterator<Item = &'a PathBuf>,
        outputs: impl IntoIterator<Item = &'a PathBuf>,
    ) -> Result<()> {
        self.start_threads()?;
        let inputs: Vec<&PathBuf> = inputs.into_iter().collect();
        check_inputs(inputs.iter().copied())?;
        let files = InputFiles::new(inputs.into_iter().chain(&self.model));
        outputs.into_iter().try_for_each(|path| files.refuse_as_output(path))
    }

    /// Loads the model of `--model`, or else the built-in model `which`, with the options that it recommends.
    pub fn load_model(&self, which: Builtin) -> Result<NamedModel> {
        load(self.model.as_deref().unwrap_or(Path::new(which.name())))
    }

    /// The chooser of model and options for each cloud, for given values of options.
    pub fn chooser(&self, values: &Map<String, Value>) -> Result<Chooser> {
        let chooser = match &self.model {
            Some(path) => load(path)?.into(),
            None => Chooser::default(),
        };
        Ok(chooser.with_values(values)?)
    }

    /// [`ComputeArguments::chooser`] for a registration; `None` if its options run no model and none is named. A named
    /// model is always loaded, so that a mistake in its name is reported.
    pub fn chooser_of_registration(&self, options: &RegisterOptions) -> Result<Option<Chooser>> {
        let is_used = options.needs_model() || self.model.is_some();
        is_used.then(|| self.chooser(&Map::new())).transpose()
    }
}

/// Prints the model and the options of a cloud, with `--verbose`.
pub fn detail_of(chosen: &Chosen) {
    terminal::detail("model", || format!("{}, {} parameters", chosen.name, chosen.model.num_parameters()));
    terminal::detail("options", || serde_json::to_string(&chosen.options).unwrap_or_default());
}

/// Loads a model with the options that it recommends.
fn load(path: &Path) -> Result<NamedModel> {
    let began = Instant::now();
    let model = NamedModel::new(model::load(Some(path))?, model::name(Some(path)));
    terminal::detail("loaded", || format!("{}, {:.3} s", model.name, began.elapsed().as_secs_f64()));
    Ok(model)
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

    /// [`EncodeFlags::given`] with the preset.
    pub fn values(&self) -> Map<String, Value> {
        let preset = self.preset.iter().map(|name| ("preset".to_owned(), name.clone().into()));
        self.given().into_iter().chain(preset).collect()
    }
}

/// Parses the value of an option from its name in weight files and reports.
pub fn named<T: DeserializeOwned>(name: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(name.into())
}
