//! The tasks: a source of clouds, the detection of keypoints, and a sink that prints them.

use bincode::{Decode, Encode};
use cu_sensor_payloads::{PointCloud, PointCloudSoa, PointCloudSoaHandle};
use cu29::prelude::*;
use cu29::units::si::length::meter;
use serde::{Deserialize, Serialize};
use snake_core::{Builtin, Detection, FrameDetector, Model, Point, PointSource};

/// Number of points that a cloud has room for.
const CAPACITY: usize = 65536;

/// A cloud of Copper, in metres. The handle keeps it out of the stack.
pub type Cloud = PointCloudSoaHandle<CAPACITY>;

/// The keypoints of a cloud, by falling saliency, in the frame of the cloud.
#[derive(Debug, Default, Clone, Encode, Decode, Serialize, Deserialize, Reflect)]
pub struct Keypoints {
    /// Positions `(K, 3)` in metres.
    pub positions: Vec<Point>,
    /// Saliencies `(K)` in [0, 1].
    pub saliencies: Vec<f32>,
}

/// The coordinates of Copper are quantities with a unit, which are read where they are.
struct InMetres<'a>(&'a PointCloudSoa<CAPACITY>);

impl PointSource for InMetres<'_> {
    fn num_points(&self) -> usize {
        self.0.len()
    }

    fn point(&self, index: usize) -> Point {
        [self.0.x(), self.0.y(), self.0.z()].map(|axis| axis[index].get::<meter>())
    }
}

/// In the place of a sensor's driver: a torus of 4000 points, 10 m wide, that turns.
#[derive(Default, Reflect)]
pub struct Lidar {
    num_clouds: u16,
}

impl Freezable for Lidar {}

impl CuSrcTask for Lidar {
    type Resources<'r> = ();
    type Output<'m> = output_msg!(Cloud);

    fn new(_config: Option<&ComponentConfig>, _resources: Self::Resources<'_>) -> CuResult<Self> {
        Ok(Self::default())
    }

    fn process(&mut self, context: &CuContext, output: &mut Self::Output<'_>) -> CuResult<()> {
        let now = context.now();
        let turn = f32::from(self.num_clouds) * 0.1;
        let mut cloud = PointCloudSoa::boxed_zeroed();
        for i in 0..4000_u16 {
            let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
            let ring = 4.0 + v.cos();
            let [x, y, z] = [ring * (u + turn).cos(), ring * (u + turn).sin(), v.sin()];
            cloud.push(PointCloud::new(now, x, y, z, 0.0, None));
        }
        self.num_clouds = self.num_clouds.wrapping_add(1);
        output.set_payload(Cloud::from_box(cloud));
        output.tov = now.into();
        Ok(())
    }
}

/// Detects the keypoints of each cloud.
#[derive(Reflect)]
pub struct KeypointTask {
    #[reflect(ignore)]
    detector: FrameDetector,
    #[reflect(ignore)]
    detection: Detection,
}

// The next cloud does not depend on the last one: there is no state to keep.
impl Freezable for KeypointTask {}

impl CuTask for KeypointTask {
    type Resources<'r> = ();
    type Input<'m> = input_msg!(Cloud);
    type Output<'m> = output_msg!(Keypoints);

    fn new(_config: Option<&ComponentConfig>, _resources: Self::Resources<'_>) -> CuResult<Self> {
        let model = Model::builtin(Builtin::Compact);
        let options = *model.recommended();
        let detector = FrameDetector::new(model, options).map_err(|error| CuError::new_with_cause("options", error))?;
        Ok(Self { detector, detection: Detection::default() })
    }

    fn process(
        &mut self,
        _context: &CuContext,
        input: &Self::Input<'_>,
        output: &mut Self::Output<'_>,
    ) -> CuResult<()> {
        let Some(cloud) = input.payload() else { return Ok(()) };
        cloud
            .with_inner(|cloud| self.detector.detect_into(&InMetres(cloud), &mut self.detection))
            .map_err(|error| CuError::new_with_cause("keypoints", error))?;
        let keypoints = &self.detection.keypoints;
        output.set_payload(Keypoints {
            positions: keypoints.iter().map(|keypoint| keypoint.position).collect(),
            saliencies: keypoints.iter().map(|keypoint| keypoint.saliency).collect(),
        });
        output.tov = input.tov;
        Ok(())
    }
}

/// Prints the number of keypoints of each cloud, and the best one.
#[derive(Reflect)]
pub struct Printer;

impl Freezable for Printer {}

impl CuSinkTask for Printer {
    type Resources<'r> = ();
    type Input<'m> = input_msg!(Keypoints);

    fn new(_config: Option<&ComponentConfig>, _resources: Self::Resources<'_>) -> CuResult<Self> {
        Ok(Self)
    }

    fn process(&mut self, _context: &CuContext, input: &Self::Input<'_>) -> CuResult<()> {
        if let Some(Keypoints { positions, saliencies }) = input.payload() {
            println!(
                "{} keypoints; the first at {:?} m, saliency {:?}",
                positions.len(),
                positions.first(),
                saliencies.first()
            );
        }
        Ok(())
    }
}
