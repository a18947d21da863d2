//! PointNet++ (Qi et al. 2017), the second point encoder: features of points from two sizes of neighbourhood.
//!
//! Neighbourhoods are balls about centres that farthest-point sampling chooses. Each has the maximum of a small network over
//! its points. Features return from the centres to the points by interpolation. `training/snake_training/pointnet2.py` is the
//! same network.
//!
//! Every point is compared with every centre, of which there are at most 512, so the time grows with the number of points
//! alone, and no index is built.

use rayon::prelude::*;

use crate::Result;
use crate::control::Counter;
use crate::lattice::VoxelGroups;
use crate::network::config::ModelConfig;
use crate::network::layers::{Linear, TILE};
use crate::network::weights::Scope;
use snake_geometry::{Point, farthest_points};
use snake_kernels::{Epilogue, Scratch};

/// The number of fine balls, and of coarse ones.
const CENTERS: [usize; 2] = [512, 128];

/// The radii of the balls, in network units.
const RADII: [f32; 2] = [0.1, 0.25];

/// The point encoder before scattering.
#[derive(Debug)]
pub(crate) struct PointNet2 {
    hidden: usize,
    fine: TwoLayers,
    coarse: TwoLayers,
    to_fine: TwoLayers,
    to_points: TwoLayers,
    fc_c: Linear,
}

/// Two fully connected layers, each with a ReLU.
#[derive(Debug)]
struct TwoLayers {
    inputs: usize,
    first: Linear,
    second: Linear,
}

impl TwoLayers {
    fn load(scope: &Scope, [inputs, hidden, outputs]: [usize; 3]) -> Result<Self> {
        let (first, second) = (scope.at("0"), scope.at("2"));
        Ok(Self {
            inputs,
            first: Linear::load(&first, inputs, hidden)?,
            second: Linear::load(&second, hidden, outputs)?,
        })
    }

    /// `(rows, inputs)` to `(rows, outputs)`.
    fn forward(&self, input: &[f32], output: &mut [f32]) {
        let mut hidden = Scratch::arbitrary(input.len() / self.inputs * self.first.outputs());
        self.first.forward(input, &mut hidden, Epilogue::Relu);
        self.second.forward(&hidden, output, Epilogue::Relu);
    }
}

/// Positions with a feature each, of width 0 for the points of a cloud.
struct Centers<'a> {
    positions: &'a [Point],
    width: usize,
    features: Vec<f32>,
}

impl PointNet2 {
    pub(super) fn load(scope: &Scope, config: &ModelConfig) -> Result<Self> {
        let (hidden, layers) = (config.hidden_dim, scope.at("pointnet2"));
        let load = |name: &str, sizes| TwoLayers::load(&layers.at(name), sizes);
        Ok(Self {
            hidden,
            fine: load("fine", [3, hidden, hidden])?,
            coarse: load("coarse", [3 + hidden, 2 * hidden, 2 * hidden])?,
            to_fine: load("to_fine", [3 * hidden, 2 * hidden, hidden])?,
            to_points: load("to_points", [hidden + 3, hidden, hidden])?,
            fc_c: Linear::load(&scope.at("fc_c"), hidden, config.c_dim)?,
        })
    }

    /// The progress units of [`PointNet2::add_to_voxels`]: each point once to choose centres, once for balls, once at the end.
    pub(super) fn work(&self, num_points: usize) -> usize {
        3 * num_points
    }

    /// Number of channels of a feature.
    pub(super) fn channels(&self) -> usize {
        self.fc_c.outputs()
    }

    /// Adds the points, given by `point` in the network's frame, to the sums of their voxels.
    pub(super) fn add_to_voxels(
        &self,
        groups: &VoxelGroups,
        point: impl Fn(usize) -> Point + Sync,
        add: impl Fn(Point, &[f32], &mut [f32]) + Sync,
        sums: &mut [f32],
        counter: &Counter,
    ) -> Result<()> {
        let num_points = groups.num_points(0..groups.num_voxels());
        let points: Vec<Point> = (0..num_points).into_par_iter().map(&point).collect();
        let chosen = farthest_points(&points, CENTERS[0], || counter.check())?;
        let positions: Vec<Point> = chosen.into_iter().map(|(index, _)| points[index]).collect();
        counter.add(num_points);
        let fine = self.fine_centers(&points, &positions, counter)?;
        counter.add(num_points);
        // A voxel with more points than a tile is one thread's.
        groups.in_parts(TILE, sums, &|voxels, sums| {
            let width = sums.len() / voxels.len();
            let rows = voxels
                .clone()
                .enumerate()
                .flat_map(|(row, voxel)| std::iter::repeat_n(row, groups.num_points(voxel..voxel + 1)));
            let members: Vec<(usize, usize)> = groups.members(voxels).zip(rows).collect();
            for members in members.chunks(TILE) {
                counter.check()?;
                let points = Scratch::collect(members.len(), members.iter().map(|&(index, _)| points[index]));
                let features = self.features(&fine, &points);
                for ((&point, feature), (_, row)) in
                    points.iter().zip(features.chunks_exact(self.channels())).zip(members)
                {
                    add(point, feature, &mut sums[row * width..][..width]);
                }
                counter.add(members.len());
            }
            Ok(())
        })
    }

    /// The fine centres, with features of the fine and the coarse balls.
    fn fine_centers<'a>(&self, points: &[Point], positions: &'a [Point], counter: &Counter) -> Result<Centers<'a>> {
        let bare = Centers { positions: points, width: 0, features: Vec::new() };
        let fine = Centers {
            positions,
            width: self.hidden,
            features: maxima(&self.fine, RADII[0], positions, &bare, counter)?,
        };
        // The first ones are what sampling the fine centres again would choose.
        let positions = &positions[..positions.len().min(CENTERS[1])];
        let features = maxima(&self.coarse, RADII[1], positions, &fine, counter)?;
        let coarse = Centers { positions, width: 2 * self.hidden, features };
        let mut features = vec![0.0; fine.features.len()];
        let rows = fine.positions.iter().zip(fine.features.chunks_exact(self.hidden));
        for ((position, feature), output) in rows.zip(features.chunks_exact_mut(self.hidden)) {
            let mut input = Scratch::zeros(3 * self.hidden);
            let (of_coarse, of_fine) = input.split_at_mut(coarse.width);
            coarse.interpolate(position, of_coarse);
            of_fine.copy_from_slice(feature);
            self.to_fine.forward(&input, output);
        }
        Ok(Centers { features, ..fine })
    }

    /// The features `(points, c_dim)` of points.
    fn features(&self, fine: &Centers, points: &[Point]) -> Scratch<f32> {
        let mut input = Scratch::zeros(points.len() * self.to_points.inputs);
        for (point, row) in points.iter().zip(input.chunks_exact_mut(self.to_points.inputs)) {
            let (of_fine, position) = row.split_at_mut(fine.width);
            fine.interpolate(point, of_fine);
            position.copy_from_slice(point);
        }
        let mut hidden = Scratch::arbitrary(points.len() * self.hidden);
        self.to_points.forward(&input, &mut hidden);
        let mut output = Scratch::arbitrary(points.len() * self.channels());
        self.fc_c.forward(&hidden, &mut output, Epilogue::Store);
        output
    }
}

impl Centers<'_> {
    /// Adds the features of the three nearest centres, weighted by 1 / squared distance, to `feature`.
    fn interpolate(&self, query: &Point, feature: &mut [f32]) {
        let mut nearest = [(f32::INFINITY, 0); 3];
        for (index, position) in self.positions.iter().enumerate() {
            let squared = squared_distance(query, position);
            if squared < nearest[2].0 {
                nearest[2] = (squared, index);
                nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
            }
        }
        let weights = nearest.map(|(squared, _)| 1.0 / (squared + 1e-8));
        let total: f32 = weights.iter().sum();
        for ((_, index), weight) in nearest.into_iter().zip(weights) {
            let of_center = &self.features[index * self.width..][..self.width];
            feature.iter_mut().zip(of_center).for_each(|(sum, value)| *sum += weight / total * value);
        }
    }
}

/// The maximum of a network over the points within a radius of each centre, `(centres, outputs)`.
///
/// Its input is a point's offset from the centre as a share of the radius, and its feature.
fn maxima(network: &TwoLayers, radius: f32, centers: &[Point], of: &Centers, counter: &Counter) -> Result<Vec<f32>> {
    let width = network.second.outputs();
    let of_center = |center: &Point| {
        counter.check()?;
        let mut most = vec![0.0_f32; width]; // what a ReLU is at least
        let mut take = |rows: &[f32]| {
            let mut values = Scratch::arbitrary(rows.len() / network.inputs * width);
            network.forward(rows, &mut values);
            for value in values.chunks_exact(width) {
                most.iter_mut().zip(value).for_each(|(most, value)| *most = most.max(*value));
            }
        };
        let mut rows = Vec::with_capacity(TILE * network.inputs);
        for (index, point) in of.positions.iter().enumerate() {
            if squared_distance(center, point) <= radius * radius {
                rows.extend((0..3).map(|axis| (point[axis] - center[axis]) / radius));
                rows.extend_from_slice(&of.features[index * of.width..][..of.width]);
                if rows.len() == TILE * network.inputs {
                    take(&rows);
                    rows.clear();
                }
            }
        }
        take(&rows);
        Ok(most)
    };
    let of_centers: Vec<Vec<f32>> = centers.par_iter().map(of_center).collect::<Result<_>>()?;
    Ok(of_centers.concat())
}

fn squared_distance(a: &Point, b: &Point) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::lattice::VolumeFrame;

    const HIDDEN: usize = 5;

    fn network(random: &mut ChaCha8Rng) -> PointNet2 {
        let mut linear = |inputs: usize, outputs: usize| {
            let mut values = |number| -> Vec<f32> { (0..number).map(|_| random.random::<f32>() - 0.4).collect() };
            let (weight, bias) = (values(inputs * outputs), values(outputs));
            Linear::new(inputs, outputs, &weight, &bias)
        };
        let mut two_layers = |inputs: usize, hidden: usize, outputs: usize| TwoLayers {
            inputs,
            first: linear(inputs, hidden),
            second: linear(hidden, outputs),
        };
        PointNet2 {
            hidden: HIDDEN,
            fine: two_layers(3, HIDDEN, HIDDEN),
            coarse: two_layers(3 + HIDDEN, 2 * HIDDEN, 2 * HIDDEN),
            to_fine: two_layers(3 * HIDDEN, 2 * HIDDEN, HIDDEN),
            to_points: two_layers(HIDDEN + 3, HIDDEN, HIDDEN),
            fc_c: linear(HIDDEN, 4),
        }
    }

    fn distance(a: &Point, b: &Point) -> f64 {
        (0..3).map(|axis| (f64::from(a[axis]) - f64::from(b[axis])).powi(2)).sum::<f64>().sqrt()
    }

    /// The features `(points, c_dim)` by the formulas of PointNet++, one point after the other.
    fn plain(net: &PointNet2, points: &[Point]) -> Vec<Vec<f32>> {
        let row = |layers: &TwoLayers, input: &[f32]| {
            let mut output = vec![0.0; layers.second.outputs()];
            layers.forward(input, &mut output);
            output
        };
        let mean: Point = std::array::from_fn(|axis| {
            (points.iter().map(|p| f64::from(p[axis])).sum::<f64>() / points.len() as f64) as f32
        });
        let mut fine: Vec<Point> = Vec::new();
        while fine.len() < CENTERS[0] {
            let from: &[Point] = if fine.is_empty() { &[mean] } else { &fine };
            let gap = |p: &Point| from.iter().map(|center| distance(p, center)).fold(f64::INFINITY, f64::min);
            let farthest = points.iter().max_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap();
            if !fine.is_empty() && gap(farthest) == 0.0 {
                break;
            }
            fine.push(*farthest);
        }
        let coarse = &fine[..fine.len().min(CENTERS[1])];
        let ball = |layers: &TwoLayers, center: &Point, radius: f32, points: &[(Point, Vec<f32>)]| {
            let inside = points.iter().filter(|(p, _)| distance(center, p) <= f64::from(radius));
            let rows = inside.map(|(p, feature)| {
                let offset = (0..3).map(|axis| (p[axis] - center[axis]) / radius);
                row(layers, &offset.chain(feature.iter().copied()).collect::<Vec<_>>())
            });
            rows.reduce(|a, b| a.iter().zip(b).map(|(a, b)| a.max(b)).collect()).unwrap()
        };
        let between = |query: &Point, centers: &[(Point, Vec<f32>)]| {
            let mut sorted: Vec<_> = centers.iter().map(|(c, feature)| (distance(query, c).powi(2), feature)).collect();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            sorted.truncate(3);
            let total: f64 = sorted.iter().map(|(squared, _)| 1.0 / (squared + 1e-8)).sum();
            let of =
                |k: usize| sorted.iter().map(|(squared, f)| f64::from(f[k]) / (squared + 1e-8) / total).sum::<f64>();
            (0..sorted[0].1.len()).map(|k| of(k) as f32).collect::<Vec<f32>>()
        };
        let bare: Vec<_> = points.iter().map(|p| (*p, vec![])).collect();
        let mut of_fine: Vec<_> = fine.iter().map(|c| (*c, ball(&net.fine, c, RADII[0], &bare))).collect();
        let of_coarse: Vec<_> = coarse.iter().map(|c| (*c, ball(&net.coarse, c, RADII[1], &of_fine))).collect();
        for (center, feature) in &mut of_fine {
            *feature = row(&net.to_fine, &[between(center, &of_coarse), feature.clone()].concat());
        }
        let features = points.iter().map(|p| row(&net.to_points, &[&between(p, &of_fine)[..], p].concat()));
        features
            .map(|hidden| {
                let mut output = vec![0.0; net.channels()];
                net.fc_c.forward(&hidden, &mut output, Epilogue::Store);
                output
            })
            .collect()
    }

    #[test]
    fn features_of_any_cloud_are_those_of_the_formulas() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let net = network(&mut random);
        let frame = VolumeFrame { resolution: [6, 5, 4], padding: 0.125, z_bounds: [-0.5, 0.5] };
        // Fewer points than are interpolated, fewer than centres, more, and each point several times.
        for (number, repeats) in [(1, 1), (2, 3), (300, 1), (900, 1), (200, 4)] {
            let distinct: Vec<Point> =
                (0..number).map(|_| std::array::from_fn(|_| random.random::<f32>() - 0.5)).collect();
            let points = distinct.repeat(repeats);
            let mut groups = VoxelGroups::default();
            groups.fill(points.len(), |index| points[index], &frame);
            let mut sums = vec![0.0; groups.num_voxels() * 4];
            let add = |_: Point, feature: &[f32], sums: &mut [f32]| {
                sums.iter_mut().zip(feature).for_each(|(sum, value)| *sum += value);
            };
            net.add_to_voxels(&groups, |index| points[index], add, &mut sums, &Counter::default()).unwrap();
            let features = plain(&net, &points);
            for (voxel, sums) in sums.chunks(4).enumerate() {
                for (k, sum) in sums.iter().enumerate() {
                    let expected: f32 = groups.members(voxel..voxel + 1).map(|index| features[index][k]).sum();
                    assert!(
                        (sum - expected).abs() <= 1e-5 * expected.abs().max(1.0),
                        "{number}: {sum}, not {expected}"
                    );
                }
            }
        }
    }
}
