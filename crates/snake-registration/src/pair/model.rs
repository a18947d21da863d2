//! Which registrations run a model.

use snake_core::{Error, Model, Result};

use crate::options::{Descriptor, KeypointDetector, RegisterOptions};

impl RegisterOptions {
    /// Whether the detector or the descriptor runs a model.
    pub fn needs_model(&self) -> bool {
        self.detector == KeypointDetector::Snake || self.descriptor == Descriptor::Field
    }

    /// The model, if these options run it.
    pub(crate) fn model_of<'a>(&self, model: Option<&'a Model>) -> Result<Option<&'a Model>> {
        match model {
            None if self.needs_model() => Err(no_model()),
            given => Ok(given.filter(|_| self.needs_model())),
        }
    }
}

/// The error of a call without a model that asks for its keypoints or descriptors.
pub(crate) fn no_model() -> Error {
    let allowed = "a model for the detector snake and the descriptor field";
    Error::Option { name: "model", value: "none".into(), allowed }
}
