//! Soft scattering: each point's feature is added to the eight nearest voxels.
//!
//! The weights w are those of trilinear interpolation at the point. A voxel of mass m = Σ w holds
//! Σ w · feature / max(m, typical mass), where the typical mass is the mean over the cloud's voxels with mass. This is a
//! weighted mean where points are dense, and smaller where they only touch the voxel's border. The volume therefore
//! changes smoothly as the cloud moves through the voxels.
//!
//! The points of one voxel contribute to it and its neighbours: 27 slots of feature and mass. Slots are first summed over
//! a voxel's points. Then each voxel adds the slots of the voxels around it that contribute to it. Memory does not grow
//! with the number of points, and the bits do not depend on the number of threads.

use crate::Result;
use crate::control::Counter;
use crate::lattice::VolumeFrame;
use crate::lattice::VoxelGroups;
use snake_geometry::{Point, try_chunks_in_parallel};
use snake_kernels::{Corners, SimdLevel, add_weighted};

/// Number of voxels to which the points of one voxel contribute: itself and its neighbours, x fastest.
const SLOTS: usize = 27;

/// Offsets of the slots of a point's eight corners from its first slot, in the order of [`Corners`].
const CORNER_SLOTS: [usize; 8] = [0, 1, 3, 4, 9, 10, 12, 13];

/// Number of values in a voxel's slots. Each slot has `channels` sums of features and a mass.
pub(super) fn slots_width(channels: usize) -> usize {
    SLOTS * (channels + 1)
}

/// Adds the feature of a point to the slots of its voxel.
pub(super) fn spread(frame: &VolumeFrame, point: Point, feature: &[f32], slots: &mut [f32]) {
    let mut first = 0;
    let mut fraction = [0.0; 3];
    for (axis, stride) in [1, 3, 9].into_iter().enumerate() {
        let (low, from_low) = frame.cell_along(axis, point[axis]);
        first += (low + 1 - frame.place_along(axis, point[axis])) * stride;
        fraction[axis] = from_low;
    }
    let weights = Corners { fraction, ..Corners::default() }.weights();
    add_weighted(SimdLevel::current(), feature, &weights, &CORNER_SLOTS.map(|slot| first + slot), slots);
}

/// Computes the volume `[z][y][x][channel]` from the slots `(voxels, slots_width)` of the occupied voxels, into zeroed
/// values. Returns the voxels with mass, ascending.
pub(super) fn gather(
    frame: &VolumeFrame,
    groups: &VoxelGroups,
    slots: &[f32],
    values: &mut [f32],
    counter: &Counter,
) -> Result<Vec<usize>> {
    let num_voxels: usize = frame.resolution.iter().product();
    let channels = values.len() / num_voxels;
    // The row of each occupied voxel, plus one, in a volume with a border of one empty voxel on each side.
    let [width, height, depth] = frame.resolution;
    let (pitch, plane_pitch) = (width + 2, (width + 2) * (height + 2));
    let mut rows = vec![0_u32; plane_pitch * (depth + 2)];
    let corner = |voxel: usize| {
        let [x, y, z] = coordinates(frame, voxel);
        x + pitch * y + plane_pitch * z
    };
    (1..).zip(groups.voxels()).for_each(|(row, voxel)| rows[corner(voxel) + 1 + pitch + plane_pitch] = row);
    // For each slot, the step from the corner of a voxel's neighbourhood to the voxel that contributes through this slot.
    let steps: [usize; SLOTS] =
        std::array::from_fn(|slot| (2 - slot % 3) + pitch * (2 - slot / 3 % 3) + plane_pitch * (2 - slot / 9));
    // The slots that contribute to a voxel, in a fixed order.
    let reaching = |voxel: usize| {
        let neighbors = &rows[corner(voxel)..];
        steps.iter().enumerate().filter(|&(_, &step)| neighbors[step] > 0).map(|(slot, &step)| {
            let row = neighbors[step] as usize - 1;
            &slots[(row * SLOTS + slot) * (channels + 1)..][..channels + 1]
        })
    };
    let plane = num_voxels / depth;
    let mut masses = vec![0.0_f32; num_voxels];
    try_chunks_in_parallel(&mut masses, plane, &|z, masses| {
        let mass = |voxel: usize| reaching(voxel).map(|slot| slot[channels]).sum();
        masses.iter_mut().enumerate().for_each(|(i, voxel_mass)| *voxel_mass = mass(z * plane + i));
        counter.check()
    })?;
    let touched: Vec<usize> = (0..num_voxels).filter(|&voxel| masses[voxel] > 0.0).collect();
    let total: f64 = touched.iter().map(|&voxel| f64::from(masses[voxel])).sum();
    let typical = (total / touched.len().max(1) as f64) as f32;
    try_chunks_in_parallel(values, plane * channels, &|z, values| {
        for (i, values) in values.chunks_exact_mut(channels).enumerate() {
            let voxel = z * plane + i;
            if masses[voxel] > 0.0 {
                for slot in reaching(voxel) {
                    values.iter_mut().zip(slot).for_each(|(value, sum)| *value += sum);
                }
                let divisor = masses[voxel].max(typical);
                values.iter_mut().for_each(|value| *value /= divisor);
            }
        }
        counter.check()
    })?;
    Ok(touched)
}

/// A voxel's index along x, y and z.
fn coordinates(frame: &VolumeFrame, voxel: usize) -> [usize; 3] {
    let [width, height, _] = frame.resolution;
    [voxel % width, voxel / width % height, voxel / (width * height)]
}
