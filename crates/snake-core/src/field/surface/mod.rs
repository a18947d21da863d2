//! Surface reconstruction: marching cubes on the occupancy field.

mod cube;
mod marching_cubes;
mod middle;
mod outer;
mod samples;
#[cfg(test)]
mod tests;

use crate::Result;
use crate::control::Control;
use crate::field::grid::coordinate;
use crate::field::{Field, Quantity, log_odds};
use crate::network::layers::TILE;
use crate::options::{MeshOptions, MeshSurface};
use snake_geometry::{Mesh, Point, in_parallel, try_in_parallel, unit};

use marching_cubes::{Crossing, Surface};
use samples::{Sample, Samples};

impl Field {
    /// The surface of the cloud, or the shell around it where the occupancy equals [`MeshOptions::level`] (marching cubes,
    /// linear in the log-odds along edges).
    ///
    /// The occupancy describes a surface, not the inside of a body. A thin wall has a shell on both sides, almost a voxel
    /// from it. With [`MeshSurface::Middle`] both sides move to the ridge of the occupancy between them. The triangles stay those
    /// of the shell, and so do the normals, except where a moved triangle faces another way.
    ///
    /// The surface is closed. The grid covers the box of the feature volume: the network's cube ±0.5 with its padding, or
    /// the bounding box of a scene's blocks. Where the box cuts the occupied region, its face closes the surface. A field
    /// without a surface gives a mesh without triangles.
    ///
    /// Samples are taken only near the surface, in blocks of 4³. The mesh equals that of all samples, except that a small
    /// occupied region is missed if it contains no sample of every fourth along each axis and no point of the cloud lies
    /// in its blocks.
    ///
    /// ```
    /// use snake_core::{Builtin, EncodeOptions, MeshOptions, Model};
    /// # let points: Vec<[f32; 3]> = (0..500).map(|i| { let a = i as f32 * 0.1; [a.cos(), a.sin(), (a * 0.3).sin()] }).collect();
    /// let field = Model::builtin(Builtin::Compact).encode(&points, &EncodeOptions::default())?;
    /// let mesh = field.mesh(&MeshOptions::default().with_resolution(32).with_outer(true))?;
    /// assert_eq!(mesh.vertices.len(), mesh.normals.len());
    /// # Ok::<(), snake_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Option`](crate::Error::Option) when an option is out of its range.
    pub fn mesh(&self, options: &MeshOptions) -> Result<Mesh> {
        self.mesh_with(options, &Control::default())
    }

    /// [`Field::mesh`] with progress and cancellation.
    ///
    /// # Errors
    /// The errors of [`Field::mesh`]; [`Error::Cancelled`](crate::Error::Cancelled) and
    /// [`Error::DeadlineExceeded`](crate::Error::DeadlineExceeded).
    pub fn mesh_with(&self, options: &MeshOptions, control: &Control) -> Result<Mesh> {
        options.check()?;
        let grid = Grid::new(self, options.resolution);
        let near_points = self.points().iter().map(|&point| grid.sample_below(self.normalization().to_network(point)));
        grid.mesh(options, near_points, control)
    }
}

/// The sample positions of a field.
struct Grid<'a> {
    field: &'a Field,
    /// Coordinates in the network's frame along each axis.
    coordinates: [Vec<f32>; 3],
}

impl<'a> Grid<'a> {
    fn new(field: &'a Field, resolution: usize) -> Self {
        let coordinates = field
            .lattice()
            .bounds()
            .map(|[low, high]| (0..resolution).map(|index| coordinate(low, high, resolution, index)).collect());
        Self { field, coordinates }
    }

    fn point(&self, sample: Sample) -> Point {
        std::array::from_fn(|axis| self.coordinates[axis][sample[axis]])
    }

    /// The last sample that does not exceed a point along each axis; the first one for a point below all samples.
    fn sample_below(&self, point: Point) -> Sample {
        std::array::from_fn(|axis| {
            let above = self.coordinates[axis].partition_point(|&coordinate| coordinate <= point[axis]);
            above.saturating_sub(1)
        })
    }

    fn vertex(&self, samples: &Samples, crossing: &Crossing) -> Point {
        let (low, axis) = samples.ends(crossing.edge);
        let mut point = self.point(low);
        point[axis] += crossing.fraction * (self.coordinates[axis][low[axis] + 1] - point[axis]);
        point
    }

    fn mesh(&self, options: &MeshOptions, likely: impl IntoIterator<Item = Sample>, control: &Control) -> Result<Mesh> {
        let value_at = |queries: &[Point]| -> Vec<f32> {
            let values = self.field.tile_values(Quantity::Occupancy, queries);
            // A network can overflow: `max` replaces NaN by 0.
            values.iter().map(|value| log_odds(value.max(0.0))).collect()
        };
        let value =
            |samples: &[Sample]| value_at(&samples.iter().map(|&sample| self.point(sample)).collect::<Vec<_>>());
        let samples = Samples::near_surface(options.resolution, log_odds(options.level), value, likely, control)?;
        control.begin("triangles", 0).check()?;
        let mut surface = Surface::of(&samples);
        control.check()?;
        let num_all = surface.triangles.len();
        if options.outer {
            surface.retain_outer(&samples);
            control.check()?;
        }
        let num_removed = options.outer.then(|| num_all - surface.triangles.len());
        let vertices = in_parallel(surface.crossings.iter(), |crossing| self.vertex(&samples, crossing));
        let counter = control.begin("normals", vertices.len());
        let gradients = try_in_parallel(vertices.chunks(TILE), |tile| {
            counter.check()?;
            counter.add(tile.len());
            Ok(self.field.tile_values_and_gradients(Quantity::Occupancy, tile).1)
        });
        let gradients = gradients?.concat();
        let normalization = self.field.normalization();
        let mut mesh = Mesh {
            vertices: vertices.into_iter().map(|vertex| normalization.to_cloud(vertex)).collect(),
            normals: Vec::new(),
            triangles: surface.triangles,
            num_removed,
        };
        mesh.normals = normals(&mesh, &gradients);
        if options.surface == MeshSurface::Middle {
            let counter = control.begin("middle of the shell", mesh.vertices.len());
            let value = |points: &[Point]| {
                value_at(&points.iter().map(|&point| normalization.to_network(point)).collect::<Vec<_>>())
            };
            middle::move_to_middle(&mut mesh.vertices, &mesh.normals, self.field.voxel_size(), value, &counter)?;
            mesh.normals = normals(&mesh, &gradients);
        }
        Ok(mesh)
    }
}

/// The normal of each vertex: the direction of the negative gradient, or the mean normal of the adjacent triangles where the two
/// oppose each other, as on the faces of the box and where the two sides of the shell met.
fn normals(mesh: &Mesh, gradients: &[Point]) -> Vec<[f32; 3]> {
    let mut around = vec![[0.0; 3]; mesh.vertices.len()];
    for &triangle in &mesh.triangles {
        let cross = mesh.area_vector(triangle);
        for sum in triangle.map(|vertex| vertex as usize) {
            around[sum] = std::array::from_fn(|axis| around[sum][axis] + cross[axis]);
        }
    }
    let normals = around.into_iter().zip(gradients).map(|(around, gradient)| {
        let gradient = gradient.map(|v| -f64::from(v));
        let agrees = (0..3).map(|axis| gradient[axis] * around[axis]).sum::<f64>() >= 0.0;
        let directions = [if agrees { gradient } else { around }, around].map(unit);
        directions.into_iter().find(|direction| *direction != [0.0; 3]).unwrap_or([0.0, 0.0, 1.0])
    });
    normals.collect()
}
