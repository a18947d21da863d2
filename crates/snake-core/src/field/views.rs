//! The feature volumes of a field: one for each rotated copy of the cloud.

use rayon::prelude::*;

use crate::Result;
use crate::call::control::Control;
use crate::network::encoder::EncoderMemory;
use crate::network::scene::SceneMemory;
use crate::network::volume::Volume;
use crate::network::{Network, NetworkEncoder, weights};
use snake_geometry::{
    Normalization, Point,
    rotations::{self, Rotation, rotate},
};

use super::check_number_of_points;

/// The feature volume of one rotated copy of the cloud.
#[derive(Debug, Clone)]
pub(super) struct View {
    pub(super) rotation: Rotation,
    pub(super) volume: Volume,
}

impl View {
    pub(super) fn all(
        network: &Network,
        points: &[Point],
        normalization: Normalization,
        orientation: &Rotation,
        rotations: usize,
        memory: &mut FieldMemory,
        control: &Control,
    ) -> Result<Vec<Self>> {
        check_number_of_points(points.len())?;
        let encoder = match &network.encoder {
            NetworkEncoder::Cube(encoder) => encoder,
            NetworkEncoder::Scene(encoder) => {
                let in_voxels: Vec<Point> = points.iter().map(|&point| normalization.to_network(point)).collect();
                let volume = encoder.encode(&in_voxels, &mut memory.scene, control)?;
                return Ok(vec![Self { rotation: rotations::IDENTITY, volume: finite(volume)? }]);
            }
        };
        let counter = control.begin("encoding", rotations * encoder.work(points.len()));
        let mut views = std::mem::take(&mut memory.views);
        for rotation in rotations::super_fibonacci(rotations) {
            let rotation = rotations::compose(&rotation, orientation);
            let point = |index: usize| rotate(&rotation, normalization.to_network(points[index]));
            let volume = encoder.encode(points.len(), point, &mut memory.encoder, &counter)?;
            counter.check()?;
            views.push(Self { rotation, volume: finite(volume)? });
        }
        Ok(views)
    }
}

/// Refuses features that are not finite.
fn finite(volume: Volume) -> Result<Volume> {
    match volume.values.par_iter().all(|value| value.is_finite()) {
        true => Ok(volume),
        false => Err(weights::error("encoder", "finite features", "weights so large that they overflow".into())),
    }
}

/// The memory of a field, which the next field uses again.
#[derive(Debug, Clone, Default)]
pub(crate) struct FieldMemory {
    pub(super) points: Vec<Point>,
    pub(super) indices: Vec<usize>,
    pub(super) views: Vec<View>,
    encoder: EncoderMemory,
    scene: SceneMemory,
}
