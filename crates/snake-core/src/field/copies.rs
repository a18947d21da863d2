//! The feature volumes of a field: one for each rotated copy of the cloud.

use rayon::prelude::*;

use crate::control::Control;
use crate::network::encoder::EncoderMemory;
use crate::network::volume::Volume;
use crate::network::{Network, weights};
use crate::{Error, Result};
use snake_geometry::{
    Normalization, Point,
    rotations::{self, Rotation, rotate},
};

/// The feature volume of one rotated copy of the cloud.
#[derive(Debug, Clone)]
pub(super) struct RotatedCopy {
    pub(super) rotation: Rotation,
    pub(super) volume: Volume,
}

/// Where a cloud lies in the network's frame: its normalisation, the rotation of its first copy, and the number of copies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    pub(super) normalization: Normalization,
    pub(super) orientation: Rotation,
    pub(super) rotations: usize,
}

/// The memory of a field, which the next field uses again.
#[derive(Debug, Clone, Default)]
pub(crate) struct FieldMemory {
    pub(super) points: Vec<Point>,
    pub(super) indices: Vec<usize>,
    encoder: EncoderMemory,
}

/// Encodes each rotated copy of a cloud.
pub(super) fn encode_rotated_copies(
    network: &Network,
    points: &[Point],
    placement: &Placement,
    memory: &mut FieldMemory,
    control: &Control,
) -> Result<Vec<RotatedCopy>> {
    check_number_of_points(points.len())?;
    let Placement { normalization, orientation, rotations } = placement;
    let counter = control.begin("encoding", rotations * network.encoder.work(points.len()));
    let mut copies = Vec::with_capacity(*rotations);
    for rotation in rotations::super_fibonacci(*rotations) {
        let rotation = rotations::compose(&rotation, orientation);
        let point = |index: usize| rotate(&rotation, normalization.to_network(points[index]));
        let volume = network.encoder.encode(points.len(), point, &mut memory.encoder, &counter)?;
        counter.check()?;
        copies.push(RotatedCopy { rotation, volume: finite(volume)? });
    }
    Ok(copies)
}

/// Refuses more points than 32-bit indices can count.
pub(crate) fn check_number_of_points(number: usize) -> Result<()> {
    match u32::try_from(number) {
        Ok(_) => Ok(()),
        Err(_) => {
            let reason = format!("{number} points, at most {} can be encoded; set max_points", u32::MAX);
            Err(Error::Input { what: "points", reason })
        }
    }
}

/// Refuses features that are not finite.
fn finite(volume: Volume) -> Result<Volume> {
    if volume.values.par_iter().all(|value| value.is_finite()) {
        return Ok(volume);
    }
    Err(weights::error("encoder", "finite features", "weights so large that they overflow".into()))
}
