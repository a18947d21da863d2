//! The surroundings of a point: surfaces and free space in bins of a cylinder about its normal.

use super::RADIUS;
use std::f64::consts::TAU;

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3};

use super::free_space::FreeSpace;
use crate::cloud::near_grid::NearGrid;
use crate::cloud::surface;
use snake_geometry::Vector;

/// Half the height of the surroundings. Unit: inlier distances. Set by hand.
const HALF_HEIGHT: f64 = 12.0;

/// Number of rings around the axis.
const RINGS: usize = 8;
/// Number of slabs perpendicular to the axis. The middle two contain the tangent plane.
const SLABS: usize = 12;
const CELLS: usize = RINGS * SLABS;
/// Number of steps of the azimuth, the bits of a cell.
pub(super) const AZIMUTHS: u32 = u32::BITS;

/// A point with its unit normal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Oriented {
    pub(super) point: Vector,
    pub(super) normal: Vector,
}

impl Oriented {
    /// Two unit vectors perpendicular to the normal, from which its azimuth is measured. The first
    /// is the same for the opposite normal.
    pub(super) fn across(&self) -> [Vector; 2] {
        let axis = Vector::ith(self.normal.iamin(), 1.0);
        let y = (axis - self.normal * self.normal.dot(&axis)).normalize();
        [y, self.normal.cross(&y)]
    }

    /// The motion that maps this point and normal onto another, after a rotation about the normal
    /// by `turns` full turns.
    pub(super) fn laid_on(&self, other: &Self, turns: f64) -> IsometryMatrix3<f64> {
        let frame = |oriented: &Self| {
            let [y, z] = oriented.across();
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[oriented.normal, y, z]))
        };
        let about = Rotation3::from_scaled_axis(turns * TAU * Vector::x());
        let rotation = frame(other) * about * frame(self).inverse();
        IsometryMatrix3::from_parts(Translation3::from(other.point - rotation * self.point), rotation)
    }
}

/// The bins of a cylinder about a normal: a cell for each ring and slab, with a bit for each step of
/// the azimuth. A rotation about the normal rotates the bits.
#[derive(Clone)]
pub(super) struct Surroundings {
    /// Surfaces whose normals lie along the axis.
    along: [u32; CELLS],
    /// Other surfaces.
    across: [u32; CELLS],
    /// Space through which the sensor looked.
    free: [u32; CELLS],
}

/// The voxels of a cloud and the free space between them.
pub(super) struct Scene {
    pub(super) normals: Vec<Vector>,
    /// Finds the voxels within the radius of the surroundings.
    pub(super) grid: NearGrid,
    pub(super) free: FreeSpace,
}

impl Surroundings {
    /// The surroundings within `RADIUS` of a place, and within `HALF_HEIGHT` along its normal.
    pub(super) fn new(place: &Oriented, scene: &Scene, inlier_distance: f64) -> Self {
        let ring = RADIUS * inlier_distance / RINGS as f64;
        let slab = 2.0 * HALF_HEIGHT * inlier_distance / SLABS as f64;
        let [y, z] = place.across();
        let mut around = Self { along: [0; CELLS], across: [0; CELLS], free: [0; CELLS] };
        scene.grid.within(&place.point, |voxel, offset, _| {
            let (u, v) = (offset.dot(&y), offset.dot(&z));
            let ring = ((u * u + v * v).sqrt() / ring) as usize;
            let slab = offset.dot(&place.normal) / slab + SLABS as f64 / 2.0;
            if ring >= RINGS || slab < 0.0 || slab >= SLABS as f64 {
                return;
            }
            let turns = v.atan2(u) / TAU;
            let azimuth = ((turns - turns.floor()) * f64::from(AZIMUTHS)) as u32 % AZIMUTHS;
            let is_along = scene.normals[voxel].dot(&place.normal).abs() > surface::AGREEING_COSINE;
            let kind = if is_along { &mut around.along } else { &mut around.across };
            kind[ring * SLABS + slab as usize] |= 1 << azimuth;
        });
        for azimuth in 0..AZIMUTHS {
            let (sine, cosine) = ((f64::from(azimuth) + 0.5) * TAU / f64::from(AZIMUTHS)).sin_cos();
            for cell in 0..CELLS {
                let radius = ring * ((cell / SLABS) as f64 + 0.5);
                let height = slab * ((cell % SLABS) as f64 + 0.5 - SLABS as f64 / 2.0);
                let bin = place.point + radius * (cosine * y + sine * z) + height * place.normal;
                let is_free = scene.free.contains(&bin);
                around.free[cell] |= u32::from(is_free) << azimuth;
            }
        }
        for cell in 0..CELLS {
            around.free[cell] &= !around.surface(cell);
        }
        around
    }

    fn surface(&self, cell: usize) -> u32 {
        self.along[cell] | self.across[cell]
    }

    /// The surroundings with surfaces in the next bins too, because normals have errors.
    pub(super) fn dilated(&self) -> Self {
        let dilate = |cells: &[u32; CELLS]| {
            std::array::from_fn(|cell| {
                let slab = cell % SLABS;
                let below = if slab > 0 { cells[cell - 1] } else { 0 };
                let above = if slab + 1 < SLABS { cells[cell + 1] } else { 0 };
                let here = cells[cell];
                here | here.rotate_left(1) | here.rotate_right(1) | below | above
            })
        };
        Self { along: dilate(&self.along), across: dilate(&self.across), free: self.free }
    }

    /// The score after a rotation about the axis: the number of bins whose surfaces meet surfaces
    /// of the other surroundings, less the number of bins with a surface in free space. Surfaces
    /// meet in the tangent plane after any rotation, so its bins do not add to the score.
    pub(super) fn score(&self, other: &Self, turn: u32) -> i32 {
        let mut score = 0;
        for cell in 0..CELLS {
            let rotated = [self.along[cell], self.across[cell], self.free[cell]].map(|bits| bits.rotate_left(turn));
            let [along, across, free] = rotated;
            let is_tangent = (SLABS / 2 - 1..=SLABS / 2).contains(&(cell % SLABS));
            if !is_tangent {
                let met = (along & other.along[cell]).count_ones() + (across & other.across[cell]).count_ones();
                score += met as i32;
            }
            let violated =
                ((along | across) & other.free[cell]).count_ones() + (free & other.surface(cell)).count_ones();
            score -= violated as i32;
        }
        score
    }
}

#[cfg(test)]
mod tests {
    use chacha20::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn random(rng: &mut ChaCha8Rng) -> Surroundings {
        let mut cells = || std::array::from_fn(|_| rng.random::<u32>() & rng.random::<u32>());
        let (along, across, free): ([u32; CELLS], [u32; CELLS], [u32; CELLS]) = (cells(), cells(), cells());
        Surroundings { along, across, free: std::array::from_fn(|cell| free[cell] & !along[cell] & !across[cell]) }
    }

    /// The score bin by bin.
    fn plain_score(a: &Surroundings, b: &Surroundings, turn: u32) -> i32 {
        let mut score = 0;
        for ring in 0..RINGS {
            for slab in 0..SLABS {
                for azimuth in 0..AZIMUTHS {
                    let cell = ring * SLABS + slab;
                    let bit = |cells: &[u32; CELLS], azimuth: u32| cells[cell] >> (azimuth % AZIMUTHS) & 1 == 1;
                    let [a_along, a_across, a_free] = [&a.along, &a.across, &a.free].map(|cells| bit(cells, azimuth));
                    let [b_along, b_across, b_free] =
                        [&b.along, &b.across, &b.free].map(|cells| bit(cells, azimuth + turn));
                    if slab + 1 != SLABS / 2 && slab != SLABS / 2 {
                        score += i32::from(a_along && b_along) + i32::from(a_across && b_across);
                    }
                    score -= i32::from((a_along || a_across) && b_free) + i32::from(a_free && (b_along || b_across));
                }
            }
        }
        score
    }

    #[test]
    fn score_is_that_of_the_plain_loop_over_bins() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..4 {
            let (a, b) = (random(&mut rng), random(&mut rng).dilated());
            for turn in 0..AZIMUTHS {
                assert_eq!(a.score(&b, turn), plain_score(&a, &b, turn), "turn {turn}");
            }
        }
    }
}
