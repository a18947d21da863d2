//! The choice of a model for each cloud.

use std::sync::{Arc, OnceLock};

use serde_json::{Map, Value};

use super::cloud_note::cloud_note;
use super::rule::{by_cloud, by_options};
use crate::cloud::UsedCloud;
use crate::control::Control;
use crate::control::clock::Instant;
use crate::{Builtin, Detection, Field, Model, Options, Preset, Result};
use snake_geometry::{Cloud, NormalizationMethod, Point};

/// Chooses model and options for each cloud of a run, as `snake-cli`, Python and C do.
///
/// A named model is used for all clouds. Without one, options that only one kind of model has name it: `voxel_size` scenes, and
/// `preset`, `normalization` and several `rotations` objects. Else the cloud decides ([`Builtin::for_cloud`]). A built-in model is
/// loaded when it is first used, and clones share it.
///
/// ```
/// use snake_core::{Builtin, Chooser, Control};
/// # let ring = |a: f32, b: f32| [(1.0 + 0.4 * b.cos()) * a.cos(), (1.0 + 0.4 * b.cos()) * a.sin(), 0.4 * b.sin()];
/// # let points: Vec<[f32; 3]> = (0..500).map(|i| ring(i as f32 * 0.1, i as f32 * 2.4)).collect();
/// let values = serde_json::json!({ "max_keypoints": 20 });
/// let chooser = Chooser::default().with_values(values.as_object().unwrap())?;
/// let chosen = chooser.for_points(&points)?;
/// let detection = chosen.detect(&Control::default())?;
/// println!("{}: {} keypoints", chosen.name, detection.keypoints.len());
/// # assert_eq!(chosen.which, Some(Builtin::Compact));
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Chooser {
    named: Option<NamedModel>,
    /// The option that names a built-in model.
    by_option: Option<(&'static str, Builtin)>,
    /// The options of each built-in model.
    options: [Options; Builtin::ALL.len()],
    /// Each built-in model that was used, and the seconds that it took to load.
    loaded: Arc<[OnceLock<(Model, f64)>; Builtin::ALL.len()]>,
}

impl Default for Chooser {
    fn default() -> Self {
        let options = Builtin::ALL.map(Builtin::recommended);
        Self { named: None, by_option: None, options, loaded: Arc::default() }
    }
}

impl From<NamedModel> for Chooser {
    fn from(model: NamedModel) -> Self {
        Self { named: Some(model), ..Self::default() }
    }
}

impl Chooser {
    /// The same choice with other options to begin with than those that a built-in model recommends.
    #[must_use]
    pub fn with_options(mut self, which: Builtin, options: Options) -> Self {
        self.options[which as usize] = options;
        self
    }

    /// The choice for given values of options, by name as in [`Options::with_values`]. The value `preset` names a set of options
    /// to begin with ([`Preset`](crate::Preset), or `standard`); else each model begins with its own.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for an unknown name and for a value of another type;
    /// [`Error::Option`](crate::Error::Option) for an unknown preset.
    pub fn with_values(&self, values: &Map<String, Value>) -> Result<Self> {
        let mut chooser = self.clone();
        if let Some(named) = &mut chooser.named {
            named.options = named.options.resolve(values)?;
            return Ok(chooser);
        }
        chooser.by_option = by_options(values);
        for which in chooser.candidates() {
            chooser.options[which as usize] = self.options[which as usize].resolve(values)?;
        }
        Ok(chooser)
    }

    /// Whether one model is used for all clouds because the caller named it.
    pub fn is_named(&self) -> bool {
        self.named.is_some()
    }

    /// The seed of the options, for random draws before a cloud is known.
    pub fn seed(&self) -> u64 {
        let options = self.named.as_ref().map_or(&self.options[self.candidates()[0] as usize], |named| &named.options);
        options.encode.seed
    }

    /// The model and the options for a cloud.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for a cloud without finite points.
    pub fn for_cloud<'a>(&self, cloud: &'a Cloud) -> Result<Chosen<'a>> {
        self.choose(&cloud.points, cloud.origin)
    }

    /// The model and the options for a cloud `(N, 3)` near zero.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for a cloud without finite points.
    pub fn for_points<'a>(&self, points: &'a [Point]) -> Result<Chosen<'a>> {
        self.choose(points, [0.0; 3])
    }

    /// The models between which it chooses, with the options of each.
    pub fn models(&self) -> Vec<NamedModel> {
        match &self.named {
            Some(named) => vec![named.clone()],
            None => self.candidates().into_iter().map(|which| self.named_builtin(which)).collect(),
        }
    }

    /// A built-in model, which is loaded now if it was not used before.
    pub fn builtin(&self, which: Builtin) -> &Model {
        let slot = &self.loaded[which as usize];
        if let Some((model, _)) = slot.get() {
            return model;
        }
        // Loaded before the slot is locked: a child process that is forked meanwhile would find it locked forever.
        let start = Instant::now();
        let model = Model::builtin(which);
        &slot.get_or_init(|| (model, start.elapsed().as_secs_f64())).0
    }

    /// Seconds that loading of built-in models took so far.
    pub fn load_seconds(&self) -> f64 {
        self.loaded.iter().filter_map(OnceLock::get).map(|(_, seconds)| seconds).sum()
    }

    /// The built-in models that clouds can have.
    fn candidates(&self) -> Vec<Builtin> {
        self.by_option.map_or(Builtin::ALL.to_vec(), |(_, which)| vec![which])
    }

    fn named_builtin(&self, which: Builtin) -> NamedModel {
        let name = format!("{}, built-in", which.name());
        NamedModel { model: self.builtin(which).clone(), name, options: self.options[which as usize] }
    }

    fn choose<'a>(&self, points: &'a [Point], origin: [f64; 3]) -> Result<Chosen<'a>> {
        let cloud = UsedCloud::new(points)?;
        let suited = || by_cloud(&cloud);
        let builtin = |which, by, note| (Some(which), self.named_builtin(which), by, note);
        let (which, NamedModel { model, name, options }, by, note) = match (&self.named, self.by_option) {
            (Some(named), _) => (None, named.clone(), ChosenBy::Name, None),
            (None, Some((option, which))) => {
                builtin(which, ChosenBy::Option(option), note_of_option(option, which, suited().0))
            }
            (None, None) => {
                let (which, note) = suited();
                builtin(which, ChosenBy::Cloud, note)
            }
        };
        let (cloud, origin) = placed(cloud, points, origin, options.encode.normalization)?;
        Ok(Chosen { which, model, name, options, by, note, cloud, origin })
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
    pub fn with_options(self, options: Options) -> Self {
        Self { options, ..self }
    }
}

impl Options {
    /// These options with some of them replaced by name, as [`Options::with_values`] does. The value `preset` names a set of
    /// options ([`Preset`], or `standard`) that replace these.
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

/// A cloud in the frame of a normalisation. With a fixed one coordinates are in the network's frame, or twice
/// those, so the origin belongs to them.
fn placed<'a>(
    cloud: UsedCloud<'a>,
    points: &[Point],
    origin: [f64; 3],
    method: NormalizationMethod,
) -> Result<(UsedCloud<'a>, [f64; 3])> {
    if !method.is_fixed() || origin == [0.0; 3] {
        return Ok((cloud, origin));
    }
    let points = Cloud { points: points.to_vec(), origin }.into_points();
    Ok((UsedCloud::new(&points)?.into_owned(), [0.0; 3]))
}

/// The note on a model that an option named, if another one suits the cloud.
fn note_of_option(option: &str, which: Builtin, suited: Builtin) -> Option<String> {
    let kind = match which {
        Builtin::Compact => "objects",
        Builtin::Scenes => "scenes",
    };
    (which != suited).then(|| {
        let [name, other] = [which, suited].map(Builtin::name);
        format!("option `{option}` is for {kind}, so the model is `{name}`; without it this cloud has `{other}`")
    })
}

/// The reason for the model of a cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ChosenBy {
    /// The caller named it.
    Name,
    /// An option that only its kind of models has.
    Option(&'static str),
    /// The cloud looks like an object or like a scene.
    Cloud,
}

/// A cloud with the model and the options that it has.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Chosen<'a> {
    /// Which built-in model it is; `None` if the caller named the model.
    pub which: Option<Builtin>,
    /// The model.
    pub model: Model,
    /// The name of the model in reports.
    pub name: String,
    /// The options.
    pub options: Options,
    /// The reason for the model.
    pub by: ChosenBy,
    /// A text for the user if an option named another model than the one that suits the cloud, or if the cloud could be of
    /// either kind.
    pub note: Option<String>,
    /// The cloud, in the frame that the options ask for.
    pub cloud: UsedCloud<'a>,
    /// To be added to all positions.
    pub origin: [f64; 3],
}

impl Chosen<'_> {
    /// Another cloud with the same model and options.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) for a cloud without finite points.
    pub fn with_cloud<'b>(&self, cloud: &'b Cloud) -> Result<Chosen<'b>> {
        let used = UsedCloud::new(&cloud.points)?;
        let (used, origin) = placed(used, &cloud.points, cloud.origin, self.options.encode.normalization)?;
        let Self { which, options, by, .. } = *self;
        let model = self.model.clone();
        Ok(Chosen { which, model, name: self.name.clone(), options, by, note: None, cloud: used, origin })
    }

    /// The notes for a user before detection: [`Chosen::note`], and what is wrong with the cloud.
    pub fn notes(&self) -> Vec<String> {
        let cloud = cloud_note(&self.cloud, self.model.config(), &self.options);
        self.note.iter().cloned().chain(cloud).collect()
    }

    /// [`Model::detect`] in the cloud.
    ///
    /// # Errors
    /// The errors of [`Model::detect_with`].
    pub fn detect(&self, control: &Control) -> Result<Detection> {
        self.model.detect_cloud(&self.cloud, &self.options, control)
    }

    /// [`Model::encode`] of the cloud.
    ///
    /// # Errors
    /// The errors of [`Model::encode_with`].
    pub fn encode(&self, control: &Control) -> Result<Field> {
        self.model.encode_cloud(&self.cloud, &self.options.encode, control)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choose::rule::tests::corner_of_a_room;
    use crate::cloud::tests::sphere;

    fn values(json: &str) -> Map<String, Value> {
        serde_json::from_str(json).unwrap()
    }

    fn chooser(json: &str) -> Chooser {
        Chooser::default().with_values(&values(json)).unwrap()
    }

    /// A bumpy ball.
    fn object() -> Vec<Point> {
        let bumpy = |p: Point| p.map(|v| v * (1.0 + 0.2 * (5.0 * p[2]).sin()));
        sphere(3000, 1.0).into_iter().map(bumpy).collect()
    }

    fn room() -> Vec<Point> {
        corner_of_a_room(1.0, 0.0)
    }

    #[test]
    fn options_of_one_kind_of_model_name_it_and_else_the_cloud_decides() {
        for (json, on_object, on_room) in [
            ("{}", "compact", "scenes"),
            (r#"{"max_keypoints": 5, "rotations": 1, "voxel_size": null, "preset": null}"#, "compact", "scenes"),
            (r#"{"voxel_size": 0}"#, "compact", "scenes"),
            (r#"{"voxel_size": 0.1, "rotations": 4}"#, "scenes", "scenes"),
            (r#"{"voxel_size": "3r"}"#, "scenes", "scenes"),
            (r#"{"rotations": 4}"#, "compact", "compact"),
            (r#"{"normalization": "unit-sphere"}"#, "compact", "compact"),
            (r#"{"preset": "3dmatch"}"#, "compact", "compact"),
        ] {
            let chooser = chooser(json);
            for (points, expected) in [(object(), on_object), (room(), on_room)] {
                let chosen = chooser.for_points(&points).unwrap();
                assert_eq!(chosen.name, format!("{expected}, built-in"), "{json}");
                let suited = Builtin::for_cloud(&points).name();
                assert_eq!(chosen.note.is_some(), suited != expected, "{json}: {:?}", chosen.note);
            }
        }
    }

    #[test]
    fn the_models_of_a_choice_are_those_that_clouds_have() {
        for (json, expected) in [
            ("{}", &["compact, built-in", "scenes, built-in"][..]),
            (r#"{"rotations": 4}"#, &["compact, built-in"]),
            (r#"{"voxel_size": 0.1}"#, &["scenes, built-in"]),
        ] {
            let models = chooser(json).models();
            assert_eq!(models.iter().map(|model| &model.name[..]).collect::<Vec<_>>(), expected);
            let points = room();
            let chosen = chooser(json).for_points(&points).map(|chosen| (chosen.name, chosen.options)).unwrap();
            assert!(models.iter().any(|model| (&model.name, model.options) == (&chosen.0, chosen.1)), "{json}");
        }
        let named = NamedModel::new(Model::builtin(Builtin::Compact), "mine");
        assert_eq!(Chooser::from(named).models()[0].name, "mine");
    }

    #[test]
    fn only_the_model_that_is_chosen_is_loaded() {
        let chooser = Chooser::default();
        let are_loaded = || Builtin::ALL.map(|which| chooser.loaded[which as usize].get().is_some());
        assert_eq!(are_loaded(), [false, false]);
        chooser.clone().for_points(&room()).unwrap();
        assert_eq!(are_loaded(), [false, true]);
    }

    #[test]
    fn a_named_model_begins_with_its_own_options_and_a_preset_replaces_them() {
        let named = NamedModel::new(Model::builtin(Builtin::Compact), "mine");
        let started = named.clone().with_options(named.options.with_values(&values(r#"{"snap": true}"#)).unwrap());
        let options = |json: &str| {
            let chooser = Chooser::from(started.clone()).with_values(&values(json)).unwrap();
            let points = object();
            let chosen = chooser.for_points(&points).unwrap();
            assert_eq!((&chosen.name[..], chosen.by), ("mine", ChosenBy::Name));
            chosen.options
        };
        let given = options(r#"{"max_keypoints": 7}"#).detect;
        assert_eq!((given.snap, given.max_keypoints), (true, 7));
        let preset = options(r#"{"preset": "keypointnet", "max_keypoints": 7}"#);
        assert_eq!((preset.detect.snap, preset.encode.max_points), (false, Some(2048)));
        assert_eq!(options(r#"{"preset": "standard"}"#).encode.rotations, 4);
    }

    #[test]
    fn the_frame_of_a_cloud_is_that_of_its_own_model() {
        let cloud = Cloud { points: object(), origin: [100.0, 0.0, 0.0] };
        let moved = chooser(r#"{"normalization": "none"}"#);
        let chosen = moved.for_cloud(&cloud).unwrap();
        assert_eq!((chosen.origin, chosen.cloud.points()[0][0]), ([0.0; 3], cloud.points[0][0] + 100.0));
        let chooser = Chooser::default();
        let chosen = chooser.for_cloud(&cloud).unwrap();
        assert_eq!((chosen.origin, chosen.cloud.points()), (cloud.origin, &cloud.points[..]));
        assert!(chooser.for_points(&[]).is_err());
    }
}
