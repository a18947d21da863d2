//! Signs of a scene: how a cloud of a room, a street or terrain differs from one of a single object, in any unit.
//!
//! An object is seen from all around, or from one side: then it bulges toward its sensor, is denser there, and ends where it turns away. A scene is
//! seen from within, much of it is flat, and it ends anywhere. The signs are measured on patches: the mean points of the cells of
//! a coarse grid, which do not depend on the density of near points, laid on the planes of their surroundings, because a noisy
//! wall is flat too. `python -m snake_training.cloud_kind` fits the network in `choose/kind.json`.

use nalgebra::Matrix3;

use super::quantile;
use snake_geometry::{Point, Vector, drawn, eigen, vector};

/// The number of signs.
pub const NUM_SIGNS: usize = 16;

/// Points that are looked at, at most.
const POINTS: usize = 6000;
/// Fewest points of a cloud with signs.
const MIN_POINTS: usize = 100;
/// Cells along the radius of the cloud.
const CELLS: f64 = 12.0;
/// Fewest points that make a plane.
const MIN_PLANE_POINTS: f64 = 6.0;
/// Fewest patches that make surroundings, or a cloud with signs.
const MIN_PATCHES: u32 = 6;
/// Patches whose surroundings are measured, at most.
const SAMPLES: usize = 200;
/// Cosine between the normals of parallel patches.
const PARALLEL: f64 = 0.97;
/// Radii of surroundings, in sizes of the cloud (the root mean square distance of the patches from their mean): two whose
/// flatness is measured, and one that bulges or not.
const RADII: [f64; 2] = [0.25, 0.5];
const BULGE_RADIUS: f64 = 0.3;
/// A patch is at an edge if the mean of the patches within the first many sides of a cell is at least the second many away.
const EDGE: [f64; 2] = [3.5, 1.2];
/// The surface goes on behind a patch if more than this share of the patches is at least so many sides of a cell behind its plane.
const BEHIND: [f64; 2] = [0.02, 2.0];

/// The signs of a cloud `(N, 3)` of finite points. `None` where the patches are too few, or the cloud has no extent.
///
/// The signs are the flatness (the smallest eigenvalue's share) of surroundings of two radii and the breadth (the middle one's) of
/// the smaller; the logarithm of the area; the shares of parallel pairs of patches and of the largest connected part; how far the
/// mean of the points is from that of the patches; how far surroundings bulge as the whole cloud does, and toward the denser side;
/// the share of patches at edges, and how much more than others these face the direction
/// in which the cloud bulges; the root of the share of patches with surface on both sides of their planes, as things in a room have;
/// the greatest and the median share of the patches on one plane; and the flatness and breadth of the whole cloud.
pub fn scene_signs(points: &[Point]) -> Option<[f64; NUM_SIGNS]> {
    let drawn: Vec<Vector> = drawn(points, POINTS).into_iter().map(vector).collect();
    let surface = Surface::new(&drawn)?;
    let Surface { patches, side, connected, dense } = &surface;
    let number = patches.len() as f64;
    // The mean foot of the perpendiculars from the middle to the planes: zero for closed surfaces, and long for the half of one.
    let bulge = patches.iter().map(|p| p.normal * p.normal.dot(&p.position)).sum::<Vector>() / number;
    let direction = bulge.try_normalize(1e-9).unwrap_or_default();
    let samples: Vec<&Patch> =
        (0..SAMPLES.min(patches.len())).map(|i| &patches[i * patches.len() / SAMPLES.min(patches.len())]).collect();
    let measured: Vec<Surroundings> = samples.iter().map(|sample| surface.surroundings(sample, &direction)).collect();
    let at = |radius: usize, value: usize, share: f64| {
        let values: Vec<f64> = measured.iter().filter_map(|s| Some(s.shares[radius]?[value])).collect();
        (!values.is_empty()).then(|| quantile(values, share))
    };
    let mean = |value: fn(&Surroundings) -> f64| measured.iter().map(value).sum::<f64>() / measured.len() as f64;
    let pairs = f64::max(mean(|s| s.pairs), 1e-9);
    let edges = mean(|s| s.edge);
    let on_plane = |share: f64| quantile(measured.iter().map(|s| s.on_plane).collect(), share);
    let [flatness, breadth] = eigenvalue_shares(patches.iter().map(|patch| patch.position))?;
    Some([
        at(0, 0, 0.5)?,
        at(1, 0, 0.9)?,
        at(0, 1, 0.25)?,
        (number * side * side).ln(),
        parallel_share(&samples),
        *connected,
        dense.norm(),
        mean(|s| s.bulge) / pairs,
        mean(|s| s.toward_dense) / pairs,
        edges,
        mean(|s| s.edge * s.facing) / edges.max(1e-9) - mean(|s| s.facing),
        mean(|s| s.amid).sqrt(),
        on_plane(1.0),
        on_plane(0.5),
        flatness,
        breadth,
    ])
}

/// What is measured about a sample.
struct Surroundings {
    /// The smallest and the middle eigenvalue's shares within each of [`RADII`].
    shares: [Option<[f64; 2]>; 2],
    /// The number of patches within [`BULGE_RADIUS`], and the sums of how steeply they lie below the sample's plane, seen
    /// against the bulge and from the denser side.
    pairs: f64,
    bulge: f64,
    toward_dense: f64,
    /// 1 at an edge, else 0.
    edge: f64,
    /// The cosine between the normal and the direction of the bulge, without its sign.
    facing: f64,
    /// 1 with surface on both sides of the plane, else 0.
    amid: f64,
    /// The share of the patches that lie on the plane.
    on_plane: f64,
}

/// The surface of a cloud about its middle, in units of its size.
struct Surface {
    patches: Vec<Patch>,
    /// The side of a cell.
    side: f64,
    /// The share of the largest connected part.
    connected: f64,
    /// From the mean of the patches to that of the points, which are denser toward their sensor.
    dense: Vector,
}

/// The part of the surface in a cell.
struct Patch {
    position: Vector,
    /// Zero where the points make no plane.
    normal: Vector,
    /// Number of points.
    points: f64,
}

impl Surface {
    fn new(points: &[Vector]) -> Option<Self> {
        let cells = cells(points)?;
        let near: Vec<Vec<usize>> = cells.iter().map(|cell| neighbors(cell, &cells)).collect();
        let mut patches: Vec<Patch> = cells.iter().zip(&near).map(|(cell, near)| patch(cell, near, &cells)).collect();
        let number = patches.len() as f64;
        let mean = patches.iter().map(|patch| patch.position).sum::<Vector>() / number;
        patches.iter_mut().for_each(|patch| patch.position -= mean);
        let scale = (patches.iter().map(|patch| patch.position.norm_squared()).sum::<f64>() / number).sqrt();
        patches.iter_mut().for_each(|patch| patch.position /= scale);
        let points: f64 = patches.iter().map(|patch| patch.points).sum();
        let dense = patches.iter().map(|patch| patch.position * patch.points).sum::<Vector>() / points;
        let (side, connected) = (1.0 / scale, connected_share(&near));
        (patches.len() >= MIN_PATCHES as usize && scale > 0.0).then_some(Self { patches, side, connected, dense })
    }

    fn surroundings(&self, sample: &Patch, bulge: &Vector) -> Surroundings {
        let Self { patches, side, .. } = self;
        let reach = f64::max(RADII[1], EDGE[0] * side);
        let offsets = patches.iter().map(|patch| patch.position - sample.position);
        let near: Vec<(Vector, f64)> =
            offsets.map(|o| (o, o.norm_squared())).filter(|(_, squared)| *squared <= reach * reach).collect();
        let behind = |normal: Vector| {
            let is_behind = |patch: &&Patch| normal.dot(&(patch.position - sample.position)) > BEHIND[1] * side;
            patches.iter().filter(is_behind).count() as f64 > BEHIND[0] * patches.len() as f64
        };
        let is_on_plane = |patch: &&Patch| {
            sample.normal.dot(&(patch.position - sample.position)).abs() < *side
                && sample.normal.dot(&patch.normal).abs() > PARALLEL
        };
        let within = |radius: f64| near.iter().filter(move |(_, squared)| *squared <= radius * radius);
        let shares = RADII.map(|radius| eigenvalue_shares(within(radius).map(|(offset, _)| *offset)));
        let slopes: Vec<f64> = within(BULGE_RADIUS)
            .filter(|(_, squared)| *squared > 0.0)
            .map(|(offset, squared)| -sample.normal.dot(offset) / squared.sqrt())
            .collect();
        let below: f64 = slopes.iter().sum();
        // The sample itself is one of them, without an offset.
        let around =
            within(EDGE[0] * side).fold((Vector::zeros(), -1.0), |(sum, n), (offset, _)| (sum + offset, n + 1.0));
        Surroundings {
            shares,
            pairs: slopes.len() as f64,
            bulge: below * sample.normal.dot(bulge),
            toward_dense: below * sample.normal.dot(&self.dense.try_normalize(1e-9).unwrap_or_default()),
            edge: f64::from(around.1 > 0.0 && around.0.norm() > EDGE[1] * side * around.1),
            facing: sample.normal.dot(bulge).abs(),
            amid: f64::from(behind(sample.normal) && behind(-sample.normal)),
            on_plane: patches.iter().filter(is_on_plane).count() as f64 / patches.len() as f64,
        }
    }
}

/// The points of a cell, in units of its side: their number, and the sums of positions and of their products.
struct Cell {
    key: [i64; 3],
    number: f64,
    sum: Vector,
    products: Matrix3<f64>,
}

/// The cells in the order of the grid, the middle of the cloud, and the side of a cell.
fn cells(points: &[Vector]) -> Option<Vec<Cell>> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let middle = Vector::from_fn(|axis, _| quantile(points.iter().map(|p| p[axis]).collect(), 0.5));
    let side = quantile(points.iter().map(|p| (p - middle).norm()).collect(), 0.98) / CELLS;
    if !(side > 0.0 && side.is_finite()) {
        return None;
    }
    let mut keyed: Vec<([i64; 3], Vector)> = points
        .iter()
        .map(|point| (point - middle) / side)
        .map(|place| (place.map(|v| v.floor() as i64).into(), place))
        .collect();
    keyed.sort_by_key(|(key, _)| *key);
    let cell = |group: &[([i64; 3], Vector)]| Cell {
        key: group[0].0,
        number: group.len() as f64,
        sum: group.iter().map(|(_, place)| place).sum(),
        products: group.iter().map(|(_, place)| place * place.transpose()).sum(),
    };
    Some(keyed.chunk_by(|a, b| a.0 == b.0).map(cell).collect())
}

/// The cells among the 27 about a cell.
fn neighbors(cell: &Cell, cells: &[Cell]) -> Vec<usize> {
    let [x, y, z] = cell.key;
    let rows = (0..9).map(|i| (x - 1 + i / 3, y - 1 + i % 3));
    let range = |(x, y)| [z - 1, z + 2].map(|z| cells.partition_point(|other| other.key < [x, y, z]));
    rows.map(range).flat_map(|[start, end]| start..end).collect()
}

/// The mean of a cell's points on the plane of the points in the cells near it.
fn patch(cell: &Cell, near: &[usize], cells: &[Cell]) -> Patch {
    let (mut number, mut sum, mut products) = (0.0, Vector::zeros(), Matrix3::zeros());
    for near in near.iter().map(|&index| &cells[index]) {
        number += near.number;
        sum += near.sum;
        products += near.products;
    }
    let (position, mean) = (cell.sum / cell.number, sum / number);
    if number < MIN_PLANE_POINTS {
        return Patch { position, normal: Vector::zeros(), points: cell.number };
    }
    let (_, normal) = eigen(products / number - mean * mean.transpose());
    Patch { position: position - normal * normal.dot(&(position - mean)), normal, points: cell.number }
}

/// The smallest and the middle eigenvalue of the covariance as shares of the sum. `None` for few or equal positions.
fn eigenvalue_shares(positions: impl Iterator<Item = Vector>) -> Option<[f64; 2]> {
    let (number, total, products) = positions
        .fold((0, Vector::zeros(), Matrix3::zeros()), |(number, total, products), p| {
            (number + 1, total + p, products + p * p.transpose())
        });
    let mean = total / f64::from(number);
    let mut values: [f64; 3] = (products / f64::from(number) - mean * mean.transpose()).symmetric_eigenvalues().into();
    values.sort_by(f64::total_cmp);
    let sum: f64 = values.iter().sum();
    (number >= MIN_PATCHES && sum > 0.0).then(|| [values[0].max(0.0) / sum, values[1] / sum])
}

/// The share of the largest connected part, by the neighbours of each cell.
fn connected_share(near: &[Vec<usize>]) -> f64 {
    let (mut is_reached, mut largest) = (vec![false; near.len()], 0);
    for start in 0..near.len() {
        let (mut open, mut size) = (vec![start], 0);
        while let Some(index) = open.pop() {
            if !std::mem::replace(&mut is_reached[index], true) {
                size += 1;
                open.extend(near[index].iter().filter(|&&other| !is_reached[other]));
            }
        }
        largest = largest.max(size);
    }
    f64::from(largest) / near.len() as f64
}

/// The share of pairs of samples whose planes are parallel.
fn parallel_share(samples: &[&Patch]) -> f64 {
    let normals: Vec<Vector> =
        samples.iter().map(|patch| patch.normal).filter(|normal| *normal != Vector::zeros()).collect();
    let pairs =
        normals.iter().enumerate().flat_map(|(i, normal)| normals[..i].iter().map(move |other| normal.dot(other)));
    let (parallel, number) = pairs
        .fold((0.0, 0.0), |(parallel, number), cosine| (parallel + f64::from(cosine.abs() > PARALLEL), number + 1.0));
    parallel / f64::max(number, 1.0)
}
