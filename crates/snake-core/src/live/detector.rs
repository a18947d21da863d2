//! Detection in a sequence of clouds.

use crate::Model;
use crate::Result;
use crate::control::Control;
use crate::control::clock::Instant;
use crate::detect::Detection;
use crate::field::{Field, FieldMemory};
use crate::options::Options;
use snake_geometry::PointSource;

/// A model with its options for a sequence of clouds, such as the sweeps of a laser scanner. The feature volumes take most
/// of the memory; the next cloud reuses it.
///
/// ```
/// use snake_core::{Builtin, Detection, FrameDetector, Model};
/// # let sweeps = [[[0.0_f32, 0.0, 1.0], [2.0, 0.0, 0.5], [0.0, 1.0, 0.0], [1.0, 1.0, 1.0]]];
/// let model = Model::builtin(Builtin::Compact);
/// let options = *model.recommended();
/// let mut detector = FrameDetector::new(model, options)?;
/// let mut detection = Detection::default();
/// for sweep in &sweeps {
///     detector.detect_into(&sweep[..], &mut detection)?;
///     println!("{} keypoints", detection.keypoints.len());
/// }
/// # Ok::<(), snake_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FrameDetector {
    model: Model,
    options: Options,
    memory: FieldMemory,
    findings: Vec<String>,
}

impl FrameDetector {
    /// A detector for a model with these options.
    ///
    /// # Errors
    /// [`Error::Option`](crate::Error::Option) when an option is out of its range.
    pub fn new(model: Model, options: Options) -> Result<Self> {
        model.network().check(&options)?;
        Ok(Self { model, options, memory: FieldMemory::default(), findings: Vec::new() })
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// [`Field::findings`] of the last cloud.
    pub fn findings(&self) -> &[String] {
        &self.findings
    }

    /// Replaces `detection` by the keypoints of a cloud. They are bit-identical to those of [`Model::detect`].
    ///
    /// # Errors
    /// The errors of [`Model::detect`]; `detection` then keeps its old content.
    pub fn detect_into(&mut self, source: &(impl PointSource + ?Sized), detection: &mut Detection) -> Result<()> {
        self.detect_into_with(source, detection, &Control::default())
    }

    /// [`FrameDetector::detect_into`] with progress, cancellation and a deadline.
    ///
    /// # Errors
    /// The errors of [`Model::detect_with`].
    pub fn detect_into_with(
        &mut self,
        source: &(impl PointSource + ?Sized),
        detection: &mut Detection,
        control: &Control,
    ) -> Result<()> {
        let Options { encode, detect } = &self.options;
        let start = Instant::now();
        let field = Field::from_source(self.model.network().clone(), source, encode, &mut self.memory, control)?;
        let seconds = start.elapsed().as_secs_f64();
        *detection = field.detect_in(detect, control)?;
        detection.timing.encode = seconds;
        self.findings = field.findings();
        field.recycle_into(&mut self.memory);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::tests::cylinder;
    use crate::{Builtin, CancelFlag, Error};

    #[test]
    fn a_refused_cloud_leaves_the_last_detection_and_the_detector_goes_on() {
        let model = Model::builtin(Builtin::Compact);
        let options = *model.recommended();
        let mut detector = FrameDetector::new(model, options).unwrap();
        let mut detection = Detection::default();
        let (points, _) = cylinder();
        detector.detect_into(&points, &mut detection).unwrap();
        let kept = detection.clone();
        let error = detector.detect_into(&[[f32::NAN; 3]; 4][..], &mut detection).unwrap_err().to_string();
        assert_eq!(error, "points: none of the 4 points is finite");
        let flag = CancelFlag::default();
        flag.cancel();
        let cancelled = detector.detect_into_with(&points, &mut detection, &Control::new().cancel(&flag));
        assert!(matches!(cancelled, Err(Error::Cancelled)));
        assert_eq!(detection, kept);
        detector.detect_into(&points, &mut detection).unwrap();
        assert_eq!(detection.keypoints, kept.keypoints);
    }
}
